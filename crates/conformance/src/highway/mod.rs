//! Does our traffic move like the original? Recorded scenes, replayed from their first row.
//!
//! A trace holds, for every frame, the state of every car in highway-env; merge episodes also hold, for every
//! decision, the action, the observation and the reward. The replay starts from the recorded start (merge episodes:
//! from the unrounded random draws), drives on by itself, and compares everything.
//!
//! # Source
//!
//! The format is that of the script that recorded them: one object per scenario with `lanes`, `vehicles` and
//! `states` (a row per car and frame; `meta.row` names its columns), or with `lanes` and `episodes`; and open-loop
//! cases `unit_collisions`, `unit_idm`. Keys that are not listed here are ignored.

mod compare;
mod replay;
mod trace;

pub use compare::{Errors, HighwayReport, ScenarioReport};
pub use replay::replay;
