//! What the listener at the wheel does when they react.
//!
//! | topic | command | when |
//! |---|---|---|
//! | `slow_down`, `speed_up` | the next speed of the grid, seen from the actual speed | in every step |
//! | `merge_left`, `merge_right` | steer for the next lane | in the first step |
//!
//! While a reaction runs, MOBIL rests; the listener still brakes for what they see. A lane change that is impossible
//! (no lane, a ramp, out of reach) changes nothing, but the time of the reaction runs on.

use leadtime_sims::{ReactionStatus, ReactionStep};

use super::settings::{EgoSettings, UnsafeChanges};
use crate::world::{Driver, DriverCommand, Side, Traffic};

/// Names of the topics, by id.
pub(super) const TOPICS: &[&str] = &["slow_down", "speed_up", "merge_left", "merge_right"];
pub(super) const SLOW_DOWN: usize = 0;
pub(super) const SPEED_UP: usize = 1;
pub(super) const MERGE_LEFT: usize = 2;
pub(super) const MERGE_RIGHT: usize = 3;

/// Number of the ego among the cars.
pub(super) const EGO: usize = 0;

/// Commands the ego's driver in the coming step; `refused` remembers an impossible lane change.
pub(super) fn react(
    traffic: &mut Traffic,
    reaction: Option<ReactionStep>,
    settings: &EgoSettings,
    refused: &mut bool,
) -> Option<ReactionStatus> {
    let topic = reaction.map(|reaction| reaction.topic);
    let at_speed = matches!(topic, Some(SLOW_DOWN | SPEED_UP));
    let changes_lanes = reaction.is_none() && settings.changes_lanes;
    let ego = &mut traffic.vehicles[EGO];
    if let Driver::Idm(idm) = &mut ego.driver {
        (idm.changes_lanes, idm.holds_speed) = (changes_lanes, at_speed);
        idm.held_braking = settings.braking;
    }
    if !at_speed {
        ego.target_speed = settings.desired_speed;
    }
    let reaction = reaction?;
    match reaction.topic {
        SLOW_DOWN => *refused = !traffic.command(EGO, DriverCommand::Slower, &settings.speed_grid),
        SPEED_UP => *refused = !traffic.command(EGO, DriverCommand::Faster, &settings.speed_grid),
        topic if reaction.first => {
            let side = if topic == MERGE_LEFT { Side::Left } else { Side::Right };
            *refused = !change_lanes(traffic, side, settings);
        }
        _ => {}
    }
    Some(if *refused { ReactionStatus::Refused } else { ReactionStatus::Followed })
}

pub(super) fn is_lane_change(topic: usize) -> bool {
    matches!(topic, MERGE_LEFT | MERGE_RIGHT)
}

fn change_lanes(traffic: &mut Traffic, side: Side, settings: &EgoSettings) -> bool {
    // The command of no effect brings the target lane up to date where a road ends.
    traffic.command(EGO, DriverCommand::Idle, &settings.speed_grid);
    let Some(lane) = traffic.lane_for_change(EGO, side) else { return false };
    let safe =
        settings.unsafe_changes == UnsafeChanges::Execute || traffic.is_safe_change(EGO, lane);
    safe && traffic.command(EGO, DriverCommand::Change(side), &settings.speed_grid)
}
