//! The colours, by meaning.
//!
//! The eight saturated ones are Okabe and Ito's palette, which people with the common forms of colour blindness can
//! distinguish; yellow is left out because it vanishes on white.

/// A colour named by what it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Titles and labels, nearly black.
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
    /// Ground, road and walls of a world.
    Ground,
    /// A neutral path: no message is running.
    Neutral,
    /// The blue of Okabe and Ito's palette.
    Blue,
    /// The orange of Okabe and Ito's palette.
    Orange,
    /// The bluish green of Okabe and Ito's palette.
    Green,
    /// The vermilion of Okabe and Ito's palette.
    Vermilion,
    /// The reddish purple of Okabe and Ito's palette.
    Purple,
    /// The sky blue of Okabe and Ito's palette.
    Sky,
    /// A paler orange, for the second part of an orange bar.
    PaleOrange,
    /// Text on fillings that are bright on any page.
    Label,
}

/// Every ink in order: its name in class attributes, its colour on a light page and on a dark one.
const INKS: [(Ink, &str, &str, &str); 16] = [
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
    (Ink::PaleOrange, "pale-orange", "#f5d489", "#c2933a"),
    (Ink::Label, "label", "#0f1216", "#0f1216"),
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

    /// Returns the ink of text that stands on a filling of this ink: legible on a light page and on a dark one.
    pub fn label(self) -> Self {
        match self {
            Self::Text | Self::Muted | Self::Neutral | Self::Blue => Self::Paper,
            Self::Paper | Self::Panel | Self::Ground | Self::Grid => Self::Text,
            _ => Self::Label,
        }
    }

    /// Returns the colour on a light page.
    pub fn light(self) -> &'static str {
        INKS[self as usize].2
    }

    /// Returns the ink's name in class attributes.
    pub fn class(self) -> &'static str {
        INKS[self as usize].1
    }

    /// Writes a picture in the colours of a dark page.
    #[cfg(test)]
    pub(crate) fn darkened(svg: &str) -> String {
        let recolour = |text: String, (_, _, light, dark): &(Self, &str, &str, &str)| {
            text.replace(&format!("\"{light}\""), &format!("\"{dark}\""))
        };
        INKS.iter().fold(svg.to_owned(), recolour)
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
    use crate::draw::inspect::{LEGIBLE, contrast};

    #[test]
    fn a_label_is_legible_on_every_ink_in_light_and_in_dark() {
        for (ink, class, light, dark) in INKS {
            let (_, _, label_light, label_dark) = INKS[ink.label() as usize];
            let contrasts = [contrast(light, label_light), contrast(dark, label_dark)];
            let needs_label = !matches!(ink, Ink::Axis | Ink::Label);
            assert!(
                !needs_label || contrasts.iter().all(|c| *c >= LEGIBLE),
                "{class} {contrasts:?}"
            );
        }
    }

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
