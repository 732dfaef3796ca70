//! The colours, by meaning.
//!
//! The eight saturated ones are Okabe and Ito's palette, which people with the common forms of colour blindness can
//! distinguish; yellow is left out because it vanishes on white.

/// A colour named by what it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
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

impl Ink {
    /// Lists every ink.
    pub const ALL: [Self; 14] = [
        Self::Text,
        Self::Muted,
        Self::Axis,
        Self::Grid,
        Self::Paper,
        Self::Panel,
        Self::Ground,
        Self::Neutral,
        Self::Blue,
        Self::Orange,
        Self::Green,
        Self::Vermilion,
        Self::Purple,
        Self::Sky,
    ];

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
        match self {
            Self::Text => "#1f2430",
            Self::Muted => "#5c6370",
            Self::Axis => "#8b919c",
            Self::Grid => "#e3e5e9",
            Self::Paper => "#ffffff",
            Self::Panel => "#f7f8fa",
            Self::Ground => "#c9c4bb",
            Self::Neutral => "#6b7280",
            Self::Blue => "#0072b2",
            Self::Orange => "#e69f00",
            Self::Green => "#009e73",
            Self::Vermilion => "#d55e00",
            Self::Purple => "#cc79a7",
            Self::Sky => "#56b4e9",
        }
    }

    /// Returns the colour on a dark page.
    pub fn dark(self) -> &'static str {
        match self {
            Self::Text => "#e6e8ee",
            Self::Muted => "#a3a9b6",
            Self::Axis => "#767d8b",
            Self::Grid => "#333946",
            Self::Paper => "#171a21",
            Self::Panel => "#1e222b",
            Self::Ground => "#4d4a45",
            Self::Neutral => "#9aa1ae",
            Self::Blue => "#4aa3df",
            Self::Orange => "#f0b429",
            Self::Green => "#2bbf95",
            Self::Vermilion => "#f07f3c",
            Self::Purple => "#dd94bd",
            Self::Sky => "#7cc7f2",
        }
    }

    /// Returns the ink's name in class attributes.
    pub fn class(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Muted => "muted",
            Self::Axis => "axis",
            Self::Grid => "grid",
            Self::Paper => "paper",
            Self::Panel => "panel",
            Self::Ground => "ground",
            Self::Neutral => "neutral",
            Self::Blue => "blue",
            Self::Orange => "orange",
            Self::Green => "green",
            Self::Vermilion => "vermilion",
            Self::Purple => "purple",
            Self::Sky => "sky",
        }
    }

    /// Writes the rules that recolour every picture of a page for a dark page (to stand in a media query).
    pub fn dark_css() -> String {
        let rules = Self::ALL.iter().map(|ink| {
            let (class, color) = (ink.class(), ink.dark());
            format!("svg .f-{class}{{fill:{color}}}svg .s-{class}{{stroke:{color}}}")
        });
        rules.collect::<Vec<_>>().join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ink_has_its_own_class_and_colours() {
        for pick in [Ink::class as fn(Ink) -> &'static str, Ink::light, Ink::dark] {
            let mut seen: Vec<_> = Ink::ALL.into_iter().map(pick).collect();
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len(), Ink::ALL.len());
        }
    }
}
