//! Every fact of the kitchen, where a cook would agree and where not.

use std::sync::Arc;

use super::*;
use crate::world::{Action, FieldOfView, Floorplan, KitchenStart, Pose, Ties, kitchen};

use Content::{Empty as E, Unavailable as U, Work as W};

/// In a corner of the ring, looking at no station.
const CORNER: (i32, i32, Direction) = (7, 3, Direction::East);
/// Between the two sinks.
const SINKS: (i32, i32, Direction) = (1, 5, Direction::North);
/// Beside the plates, in the row of the first sink.
const PLATES: (i32, i32, Direction) = (7, 5, Direction::East);

fn open(layout: &str) -> Kitchen {
    let plan = Floorplan::new(kitchen(layout).unwrap(), FieldOfView::Block);
    Kitchen::new(Arc::new(plan), WorkTimes::default(), 1)
}

/// Opens the ring with stations that hold this: two grills, two boards, two sinks.
fn ring(contents: [Content; 6], at: (i32, i32, Direction), is_aware: bool) -> Kitchen {
    let mut ring = open("ring");
    let (x, y, facing) = at;
    let pose = Pose { place: ring.plan.grid.place(x, y).unwrap(), facing };
    let contents = contents.to_vec();
    ring.begin(&KitchenStart { pose, contents, release_at: Some(1) }, is_aware);
    ring
}

fn holds(name: &str, kitchen: &Kitchen) -> bool {
    let told = TOLD.iter().find(|told| told.0 == name).unwrap_or_else(|| panic!("{name}"));
    (told.2)(KitchenMoment::new(kitchen))
}

#[test]
fn what_stations_hold_is_told() {
    let cases: &[(&str, [Content; 6], [Content; 6])] = &[
        ("grill_ready", [W(10), E, E, E, E, E], [W(9), E, E, E, E, E]),
        ("grill_ready_up", [W(10), E, E, E, E, E], [W(9), E, E, E, E, E]),
        ("grill_free", [W(5), E, E, E, E, E], [W(5), U, E, E, E, E]),
        ("grill_free_up", [W(5), E, E, E, E, E], [W(5), U, E, E, E, E]),
        ("grill_busy", [W(5), U, E, E, E, E], [W(5), E, E, E, E, E]),
        ("grill_busy", [W(5), U, E, E, E, E], [W(5), W(10), E, E, E, E]),
        ("steak_cooking", [W(5), E, E, E, E, E], [W(10), U, E, E, E, E]),
        ("board_free", [E, E, W(1), E, E, E], [E, E, W(1), W(2), E, E]),
        ("board_free_left", [E, E, W(1), E, E, E], [E, E, W(1), W(2), E, E]),
        ("board_occupied", [E, E, W(1), W(2), E, E], [E, E, W(1), E, E, E]),
        ("board_busy", [E, E, W(1), U, E, E], [E, E, W(1), W(2), E, E]),
        ("onion_waiting", [E, E, W(0), E, E, E], [E, E, W(1), E, E, E]),
        ("garnish_half_chopped", [E, E, W(1), E, E, E], [E, E, W(0), W(2), E, E]),
        ("garnish_done", [E, E, W(2), E, E, E], [E, E, W(1), E, E, E]),
        ("garnish_done_left", [E, E, W(2), E, E, E], [E, E, W(1), E, E, E]),
        ("sink_free", [E, E, E, E, W(1), E], [E, E, E, E, W(1), U]),
        ("sink_occupied", [E, E, E, E, W(1), U], [E, E, E, E, W(1), E]),
        ("plate_soaking", [E, E, E, E, W(0), E], [E, E, E, E, W(2), E]),
        ("plate_washing", [E, E, E, E, W(1), E], [E, E, E, E, W(0), E]),
        ("stations_occupied", [W(5), U, W(2), W(1), W(1), U], [W(5), U, E, W(1), W(1), U]),
        ("stations_busy", [W(5), U, W(1), W(1), W(1), U], [W(5), U, W(2), W(1), W(1), U]),
        ("plates_needed_right", [E; 6], [E, E, E, E, W(0), E]),
    ];
    for (name, so, other) in cases {
        assert!(holds(name, &ring(*so, CORNER, false)), "{name}: {so:?}");
        assert!(!holds(name, &ring(*other, CORNER, false)), "{name}: {other:?}");
    }
}

#[test]
fn what_one_is_sent_for_lies_on_that_side() {
    let sinks = [U, U, U, U, U, E];
    for name in ["sink_free_right", "station_free_right"] {
        assert!(holds(name, &ring(sinks, SINKS, false)));
        assert!(!holds(name, &ring(sinks, CORNER, false)));
    }
    let first = [U, U, U, U, E, U];
    assert!(holds("sink_free_down", &ring(first, CORNER, false)));
    assert!(!holds("sink_free_down", &ring(first, PLATES, false)));
    let clean = [E, E, E, E, E, W(2)];
    assert!(holds("plate_clean_right", &ring(clean, SINKS, false)));
    assert!(!holds("plate_clean_right", &ring(clean, CORNER, false)));
    // The ring's plates are in its lowest row, and its onions at its right; those of the other kitchen are at its top.
    let mut other = open("steak_mid_2");
    let mut start = KitchenStart::new(&other.plan.grid).unwrap();
    start.pose.place = other.plan.grid.place(10, 3).unwrap();
    other.begin(&start, false);
    for name in ["plates_up", "onion_needed_left"] {
        assert!(holds(name, &other), "{name}");
        assert!(!holds(name, &ring([E; 6], PLATES, false)), "{name}");
    }
}

#[test]
fn a_change_is_news_and_a_lasting_state_is_not() {
    let all = [W(5), U, W(1), W(1), W(1), U];
    let cases = [
        ("grill_still_busy", all, true),
        ("board_still_busy", all, true),
        ("steak_still_cooking", all, true),
        ("grill_now_ready", [W(10), E, E, E, E, E], false),
        ("stations_now_occupied", all, false),
        ("stations_now_busy", all, false),
    ];
    for (name, contents, to_the_aware) in cases {
        for is_aware in [false, true] {
            let told = holds(name, &ring(contents, CORNER, is_aware));
            assert_eq!(told, is_aware == to_the_aware, "{name} to {is_aware}");
        }
    }
    // Somebody else leaves their stations, out of sight.
    let mut kitchen = ring([U; 6], CORNER, true);
    let news = ["grill_now_free", "board_now_free"];
    assert!(!news.iter().any(|name| holds(name, &kitchen)));
    kitchen.step(Action::Stay, true);
    assert!(news.iter().all(|name| holds(name, &kitchen)));
}

#[test]
fn the_order_waits_until_the_dish_is_served() {
    let mut kitchen = ring([E; 6], CORNER, true);
    let cook = |kitchen: &mut Kitchen, until: fn(&Kitchen) -> bool| {
        while !until(kitchen) {
            let action = kitchen.decide(Ties::First);
            kitchen.step(action, true);
        }
    };
    let holding = |kitchen: &Kitchen| {
        let names =
            ["order_waiting", "window_clear_down", "dish_ready_down", "plates_needed_right"];
        names.map(|name| holds(name, kitchen))
    };
    assert_eq!(holding(&kitchen), [true, true, false, true]);
    cook(&mut kitchen, |kitchen| kitchen.world.cook().held == Some(Item::Dish));
    assert_eq!(holding(&kitchen), [true, true, true, false]);
    cook(&mut kitchen, |kitchen| kitchen.world.is_done());
    assert_eq!(holding(&kitchen), [false; 4]);
}

#[test]
fn further_goes_on_where_the_cook_faces() {
    let names = ["going_up", "going_down", "going_right", "going_left"];
    for (facing, name) in Direction::ALL.into_iter().zip(names) {
        let kitchen = ring([E; 6], (7, 3, facing), false);
        for other in names {
            assert_eq!(holds(other, &kitchen), other == name);
        }
    }
}
