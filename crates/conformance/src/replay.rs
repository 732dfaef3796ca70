//! What every world's replay comes to: a report, and the same as tables.

use leadtime_lander::world::Physics;
use serde_json::Value;

use crate::error::ReplayError;
use crate::section::Section;
use crate::{highway, lander, steakhouse};

/// A public original of one of our worlds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Original {
    /// Gymnasium's `LunarLander-v3`.
    Lander,
    /// The merge environments of highway-env.
    Highway,
    /// FOV-aware-planner's kitchen, and recorded episodes of our own cook.
    Steakhouse,
}

/// What a replay found.
#[derive(Clone, Debug)]
pub struct Replay {
    /// What recorded the traces.
    pub source: String,
    /// Whether everything is within its bounds.
    pub passed: bool,
    /// The whole report, as JSON.
    pub json: String,
    /// The report as tables.
    pub sections: Vec<Section>,
}

impl Original {
    /// Replays recorded traces.
    ///
    /// # Errors
    ///
    /// [`ReplayError`] if the text is of no known format, or holds nothing to compare.
    pub fn replay(self, text: &str) -> Result<Replay, ReplayError> {
        self.replay_as_asked(text).map_err(|error| match (error, Self::of(text)) {
            (ReplayError::Format { .. } | ReplayError::Empty { .. }, Some(found))
                if found != self =>
            {
                ReplayError::OtherWorld { asked: self.name(), found: found.name() }
            }
            (error, _) => error,
        })
    }

    /// Returns the world that traces are of, as far as they say so.
    fn of(text: &str) -> Option<Self> {
        let traces: Value = serde_json::from_str(text).ok()?;
        if traces["meta"]["highway_env"].is_string() {
            return Some(Self::Highway);
        }
        match &traces["source"] {
            Value::String(_) => Some(Self::Lander),
            Value::Object(_) => Some(Self::Steakhouse),
            _ => None,
        }
    }

    /// Returns the name of our world.
    fn name(self) -> &'static str {
        match self {
            Self::Lander => "lander",
            Self::Highway => "highway",
            Self::Steakhouse => "steakhouse",
        }
    }

    fn replay_as_asked(self, text: &str) -> Result<Replay, ReplayError> {
        // A report has its own type in each world, and the same is wanted of each.
        macro_rules! replay {
            ($report:expr) => {{
                let report = $report?;
                Ok(Replay {
                    passed: report.passed,
                    json: serde_json::to_string(&report).unwrap_or_default(),
                    sections: report.sections(),
                    source: report.source,
                })
            }};
        }
        match self {
            Self::Lander => replay!(lander::replay(text, Physics::default())),
            Self::Highway => replay!(highway::replay(text)),
            Self::Steakhouse => replay!(steakhouse::replay(text)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn traces_of_another_world_are_told_apart_from_damaged_ones() {
        let lander = r#"{"source": "gymnasium", "episodes": []}"#;
        let highway = r#"{"meta": {"highway_env": "1.10", "dt": 0.1}}"#;
        let kitchen = r#"{"source": {"repository": "r", "commit": "c"}, "traces": []}"#;
        let says = |asked: Original, text: &str| asked.replay(text).unwrap_err().to_string();
        for (asked, text, found) in [
            (Original::Highway, lander, "lander"),
            (Original::Steakhouse, lander, "lander"),
            (Original::Lander, highway, "highway"),
            (Original::Steakhouse, highway, "highway"),
            (Original::Highway, kitchen, "steakhouse"),
        ] {
            let says = says(asked, text);
            assert!(
                says.contains(&format!("are of `{found}`, not of `{}`", asked.name())),
                "{says}"
            );
        }
        assert_eq!(says(Original::Highway, "{}"), "traces cannot be read");
        assert_eq!(says(Original::Lander, "{"), "traces cannot be read");
    }
}
