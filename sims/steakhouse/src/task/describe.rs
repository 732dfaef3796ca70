//! What the task shows and pays, for people.

use leadtime_sims::{Quantity, RewardTerm};

use super::settings::SteakhouseWorldSettings;
use crate::world::{Grid, Station};

/// Says what the numbers of the observation are; there are at least `n_slots` places for stations.
pub(super) fn quantities(grid: &Grid, n_slots: usize) -> Vec<Quantity> {
    let flag = |name: &str, meaning: &str| Quantity::flag(name, meaning);
    let mut all = vec![
        flag("x", "the cook's column, as a share of the width"),
        flag("y", "the cook's row, as a share of the height"),
    ];
    let one_hot = |group: &str, what: &str, names: &[&str]| {
        let flag = |name: &&str| Quantity::flag(format!("{group}.{name}"), what);
        names.iter().map(flag).collect::<Vec<_>>()
    };
    all.extend(one_hot(
        "faces",
        "whether the cook faces that way",
        &["north", "south", "east", "west"],
    ));
    let items = ["nothing", "onion", "meat", "plate", "clean_plate", "steak", "dish"];
    all.extend(one_hot("holds", "whether the cook holds that", &items));
    let number = |slot: usize, station: Station| {
        1 + grid.slots[..slot].iter().filter(|before| before.station == station).count()
    };
    let names = grid.slots.iter().enumerate();
    let names =
        names.map(|(slot, it)| format!("{}{}", it.station.name(), number(slot, it.station)));
    let empty = (grid.slots.len()..n_slots).map(|slot| format!("slot{}", slot + 1));
    all.extend(names.chain(empty).flat_map(|name| {
        let flag = |part: &str, what: &str| Quantity::flag(format!("{name}.{part}"), what);
        [
            flag("empty", "whether it is empty"),
            flag("busy", "whether it is at work or taken"),
            flag("ready", "whether its work is ready"),
            flag("done", "share of its work that is done"),
            flag("known", "whether the cook's belief is right"),
        ]
    }));
    all.push(flag("time", "steps so far, of the longest episode"));
    all.push(flag("left", "steps to the deadline, of the longest episode"));
    all
}

pub(super) fn reward_terms(settings: &SteakhouseWorldSettings) -> Vec<RewardTerm> {
    let useful = "an interaction of use; undoing it costs it";
    vec![
        RewardTerm::new("a delivery in time", settings.delivery_reward, "world.delivery_reward"),
        RewardTerm::new("a later delivery", settings.late_reward, "world.late_reward"),
        RewardTerm::new(useful, settings.progress_reward, "world.progress_reward"),
        RewardTerm::new("a step", -settings.step_cost, "world.step_cost"),
        RewardTerm::new("a step of work in vain", -settings.redundant_cost, "world.redundant_cost"),
    ]
}
