//! What every world's replay comes to: a report, and the same as tables.

use leadtime_lander::world::Physics;

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
