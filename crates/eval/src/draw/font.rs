//! The typeface, and how wide its text is.
//!
//! Pictures are set in Inter. A subset of two weights is part of this crate (`assets/`, SIL Open Font License), so
//! that PNG and GIF files have text on machines without any font. A browser that has no Inter takes its own
//! sans-serif; every text says how long it is, so the browser fits it into the width that the layout counts on.

/// The `font-family` of every picture.
pub const FAMILY: &str = "Inter, 'Helvetica Neue', Arial, 'Liberation Sans', sans-serif";

/// The embedded regular weight.
pub(super) const REGULAR_FACE: &[u8] = include_bytes!("../../assets/Inter-Regular-subset.otf");
/// The embedded semi-bold weight.
pub(super) const BOLD_FACE: &[u8] = include_bytes!("../../assets/Inter-SemiBold-subset.otf");

/// How heavy text is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Weight {
    /// For text of all kinds but titles.
    #[default]
    Regular,
    /// For titles: Inter's semi-bold.
    Bold,
}

/// Computes how wide a text is when set in the embedded face.
///
/// # Units
///
/// Pixels, for `size` in pixels. Characters that pictures do not use count as wide as a digit.
pub fn text_width(text: &str, size: f64, weight: Weight) -> f64 {
    let widths = match weight {
        Weight::Regular => &REGULAR,
        Weight::Bold => &BOLD,
    };
    let advance = |c: char| {
        let place = (c as usize).checked_sub(32).unwrap_or(usize::MAX);
        let ascii = widths.get(place).copied();
        ascii.or_else(|| OTHERS.iter().find(|other| other.0 == c).map(|other| other.1))
    };
    let thousandths: u32 = text.chars().map(|c| u32::from(advance(c).unwrap_or(640))).sum();
    f64::from(thousandths) / 1000.0 * size
}

/// Advance widths of what else pictures use, in the regular face; the semi-bold one is within three percent.
const OTHERS: [(char, u16); 13] = [
    ('\u{b2}', 420),
    ('\u{b3}', 430),
    ('\u{b7}', 276),
    ('\u{d7}', 659),
    ('\u{2013}', 500),
    ('\u{2014}', 1000),
    ('\u{2018}', 199),
    ('\u{2019}', 185),
    ('\u{201c}', 381),
    ('\u{201d}', 381),
    ('\u{2026}', 821),
    ('\u{2192}', 955),
    ('\u{2212}', 659),
];

// Advance widths of U+0020..=U+007E in thousandths of the font size, read from the embedded faces with fontTools:
// [round(hmtx[cmap[c]][0] * 1000 / unitsPerEm) for c in range(32, 127)].
const REGULAR: [u16; 95] = [
    281, 278, 403, 631, 638, 812, 639, 222, 362, 362, 500, 659, 280, 460, 276, 357, 625, 464, 605,
    636, 642, 608, 624, 571, 616, 624, 276, 280, 659, 659, 659, 507, 936, 676, 651, 727, 719, 598,
    587, 743, 740, 264, 543, 652, 562, 889, 753, 761, 635, 761, 639, 638, 642, 741, 676, 949, 642,
    665, 625, 362, 357, 362, 469, 452, 497, 564, 621, 558, 621, 582, 361, 609, 591, 237, 237, 544,
    237, 869, 585, 597, 609, 609, 372, 523, 364, 581, 557, 812, 540, 557, 541, 362, 327, 362, 659,
];
const BOLD: [u16; 95] = [
    248, 309, 396, 643, 649, 844, 663, 213, 393, 393, 543, 673, 295, 466, 290, 379, 667, 481, 621,
    652, 666, 632, 648, 587, 646, 648, 290, 295, 673, 673, 673, 544, 999, 724, 657, 744, 724, 608,
    586, 755, 744, 275, 561, 677, 566, 906, 741, 775, 643, 776, 651, 649, 660, 734, 724, 1007, 690,
    705, 653, 393, 379, 393, 481, 468, 497, 575, 630, 577, 630, 593, 377, 625, 613, 261, 261, 569,
    261, 898, 610, 608, 625, 625, 397, 549, 380, 608, 576, 837, 562, 576, 562, 393, 358, 393, 673,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn width_grows_with_text_size_and_weight() {
        let width = text_width("shift_left", 12.0, Weight::Regular);
        assert!((45.0..60.0).contains(&width), "{width}");
        assert!((text_width("shift_left", 24.0, Weight::Regular) - 2.0 * width).abs() < 1e-9);
        assert!(text_width("shift_left", 12.0, Weight::Bold) > width);
        assert!(text_width("→", 10.0, Weight::Regular) > 0.0);
    }
}
