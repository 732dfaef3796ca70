//! How much work is left, and which work is in vain.

use super::kinds::{Content, Item, Station};
use super::mind::Mind;
use super::state::KitchenWorld;
use super::subtask::{Phases, Subtask};

/// Counts the interactions that are still needed for one dish, R, by what is true.
///
/// That the hand holds only one item is ignored. An empty kitchen needs 10 + chops + washes; the count falls by one
/// with every interaction that the dish needs, and so cannot reward a detour.
pub fn interactions_left(world: &KitchenWorld) -> u32 {
    if world.is_done() {
        return 0;
    }
    let held = |item| world.cook().held == Some(item);
    if held(Item::Dish) {
        return 1;
    }
    if world.is_lying(Item::Dish) {
        return 2;
    }
    let times = world.times;
    let garnish = match most_advanced(world, Station::Board) {
        Some(counter) => u32::from(times.chop - counter),
        None => u32::from(times.chop) + if held(Item::Onion) { 1 } else { 2 },
    };
    if held(Item::Steak) {
        return garnish + 2;
    }
    if world.is_lying(Item::Steak) {
        return garnish + 3;
    }
    let steak = match most_advanced(world, Station::Grill) {
        Some(_) => 0,
        None if held(Item::Meat) => 1,
        None => 2,
    };
    steak + garnish + plate_left(world) + 3
}

/// Counts the interactions until a clean plate is in hand.
fn plate_left(world: &KitchenWorld) -> u32 {
    let (held, washes) = (world.cook().held, u32::from(world.times.wash));
    if held == Some(Item::CleanPlate) {
        return 0;
    }
    if world.is_lying(Item::CleanPlate) {
        return 1;
    }
    match most_advanced(world, Station::Sink) {
        Some(counter) => washes - u32::from(counter) + 1,
        None if held == Some(Item::Plate) => washes + 2,
        None => washes + 3,
    }
}

fn most_advanced(world: &KitchenWorld, station: Station) -> Option<u8> {
    let slots = world.grid().slots.iter().zip(world.contents());
    slots.filter(|(slot, _)| slot.station == station).filter_map(|(_, held)| held.work()).max()
}

/// Returns whether a subtask is in vain by what is true: it brings what some station already has, or takes it back.
pub fn is_redundant(world: &KitchenWorld, subtask: Subtask) -> bool {
    let in_use = |station| Phases::of(world, world.contents()).in_use(station);
    subtask == Subtask::Discard || subtask.supplied_station().is_some_and(in_use)
}

/// Returns whether a cook is on the way to a station in somebody else's use, without knowing.
pub fn is_misled(world: &KitchenWorld, mind: &Mind) -> bool {
    let slot = mind.goal.and_then(|goal| world.grid().slot_at(goal));
    slot.is_some_and(|slot| world.contents()[slot] == Content::Unavailable)
}
