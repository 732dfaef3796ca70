//! What the task shows and pays, for people.

use leadtime_sims::{Quantity, RewardTerm};

use super::settings::{EntryPenalty, LanderWorldSettings, NearCharge, NearPenalty};
use crate::world;

pub(super) fn quantities(settings: &LanderWorldSettings) -> Vec<Quantity> {
    let mut all = world::quantities();
    if settings.has_jitter() {
        let sides = [("x0", "left"), ("x1", "right"), ("y0", "lower"), ("y1", "upper")];
        let unbounded = [f32::NEG_INFINITY, f32::INFINITY];
        all.extend((1..=settings.zones.len()).flat_map(|zone| {
            sides.map(|(name, side)| {
                let meaning = format!("{side} side of the danger zone");
                Quantity::new(format!("zone{zone}.{name}"), meaning, unbounded)
            })
        }));
    }
    if settings.observe_time {
        let meaning = "share of the steps of an episode that is left";
        all.push(Quantity::new("time_left", meaning, [0.0, 1.0]));
    }
    all
}

pub(super) fn reward_terms(settings: &LanderWorldSettings) -> Vec<RewardTerm> {
    let on_pad = if settings.on_pad { " on the pad" } else { "" };
    let entry = match (settings.zone_ends_episode, settings.entry_charged) {
        (true, _) => {
            let amount = -settings.zone_end_penalty;
            RewardTerm::new(
                "entering a zone, which ends the episode",
                amount,
                "world.zone_end_penalty",
            )
        }
        (false, EntryPenalty::Once) => {
            let amount = -settings.entry_penalty;
            RewardTerm::new("entering a zone for the first time", amount, "world.entry_penalty")
        }
        (false, EntryPenalty::PerFrame) => {
            RewardTerm::new("a frame in a zone", -settings.entry_penalty, "world.entry_penalty")
        }
        (false, EntryPenalty::PerStep) => {
            RewardTerm::new("a step in a zone", -settings.entry_penalty, "world.entry_penalty")
        }
    };
    let near = settings.near_distance;
    let nearness = match settings.near_penalty {
        NearPenalty::Off => None,
        NearPenalty::Depth => Some(format!("max(0, {near} - distance), of each zone")),
        NearPenalty::Sides => Some(format!("max(0, {near} - distance), of each side")),
        NearPenalty::Literal => Some(format!("the distance to a zone, below {near}")),
    };
    let mut terms = vec![
        RewardTerm::new(
            format!("a landing{on_pad}"),
            settings.landing_reward,
            "world.landing_reward",
        ),
        RewardTerm::new(
            "a crash, or leaving the view",
            -settings.crash_penalty,
            "world.crash_penalty",
        ),
        RewardTerm::new("running out of time", -settings.timeout_penalty, "world.timeout_penalty"),
        entry,
    ];
    let per_what = match settings.near_charged {
        NearCharge::PerFrame => ", a frame",
        NearCharge::PerStep => "",
    };
    terms.extend(
        nearness.map(|when| {
            RewardTerm::new(when + per_what, -settings.near_weight, "world.near_weight")
        }),
    );
    terms.push(RewardTerm::new(
        "a frame of the main engine",
        -settings.main_fuel,
        "world.main_fuel",
    ));
    terms.push(RewardTerm::new("a frame of a side engine", -settings.side_fuel, "world.side_fuel"));
    terms
}
