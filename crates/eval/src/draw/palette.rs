//! The colours, by meaning.
//!
//! The eight saturated ones are Okabe and Ito's palette, which people with the common forms of colour blindness can
//! distinguish; yellow is left out because it vanishes on white.

/// A colour named by what it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Titles and labels.
    Text,
    /// Secondary text: ticks, captions.
    Muted,
    /// Axis lines and frames.
    Axis,
    /// Grid lines and other faint help.
    Grid,
    /// The background of a picture.
    Paper,
    /// The background of a panel within a picture.
    Panel,
    /// Ground, road, walls.
    Ground,
    /// A neutral path: no message is running.
    Neutral,
    /// Okabe-Ito blue.
    Blue,
    /// Okabe-Ito orange.
    Orange,
    /// Okabe-Ito bluish green.
    Green,
    /// Okabe-Ito vermilion.
    Vermilion,
    /// Okabe-Ito reddish purple.
    Purple,
    /// Okabe-Ito sky blue.
    Sky,
}

/// Every ink in order: its name in class attributes, its colour on a light page and on a dark one.
const INKS: [(Ink, &str, &str, &str); 14] = [
    (Ink::Text, "text", "#1f2430", "#e6e8ee"),
    (Ink::Muted, "muted", "#5c6370", "#a3a9b6"),
    (Ink::Axis, "axis", "#8b919c", "#767d8b"),
    (Ink::Grid, "grid", "#e3e5e9", "#333946"),
    (Ink::Paper, "paper", "#ffffff", "#171a21"),
    (Ink::Panel, "panel", "#f7f8fa", "#1e222b"),
    (Ink::Ground, "ground", "#c9c4bb", "#4d4a45"),
    (Ink::Neutral, "neutral", "#6b7280", "#9aa1ae"),
    (Ink::Blue, "blue", "#0072b2", "#4aa3df"),
    (Ink::Orange, "orange", "#e69f00", "#f0b429"),
    (Ink::Green, "green", "#009e73", "#2bbf95"),
    (Ink::Vermilion, "vermilion", "#d55e00", "#f07f3c"),
    (Ink::Purple, "purple", "#cc79a7", "#dd94bd"),
    (Ink::Sky, "sky", "#56b4e9", "#7cc7f2"),
];

impl Ink {
    /// Lists inks that series of a chart take in turn.
    pub const SERIES: [Self; 8] = [
        Self::Blue,
        Self::Orange,
        Self::Green,
        Self::Purple,
        Self::Sky,
        Self::Vermilion,
        Self::Neutral,
        Self::Text,
    ];

    /// Returns the ink of the `i`-th series.
    pub fn series(i: usize) -> Self {
        Self::SERIES[i % Self::SERIES.len()]
    }

    /// Returns the colour on a light page.
    pub fn light(self) -> &'static str {
        INKS[self as usize].2
    }

    /// Returns the ink's name in class attributes.
    pub fn class(self) -> &'static str {
        INKS[self as usize].1
    }

    /// Writes the rules that recolour every picture of a page for a dark page (to stand in a media query).
    pub fn dark_css() -> String {
        let rules = INKS.map(|(_, class, _, dark)| {
            format!("svg .f-{class}{{fill:{dark}}}svg .s-{class}{{stroke:{dark}}}")
        });
        rules.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ink_has_its_own_class_and_colours() {
        for (i, (ink, class, light, dark)) in INKS.into_iter().enumerate() {
            assert_eq!(ink as usize, i, "{class}");
            let same = |other: &&(Ink, &str, &str, &str)| {
                other.1 == class || other.2 == light || other.3 == dark
            };
            assert_eq!(INKS.iter().filter(same).count(), 1, "{class}");
        }
    }
}
