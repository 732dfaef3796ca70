//! What is true of the kitchen now: the facts that sentences to the cook presuppose.
//!
//! *Free, ready*: one such station is enough, for it can be used. *Busy, occupied, full*: no station of the kind is free,
//! because a cook who sees a free board next to a taken one would call "board occupied" wrong. Where a sentence sends
//! the cook somewhere for something ("sink free, go right"), it must lie on that side: in a column further right, in a
//! row further up. *Now* is news: it is so, and the cook believes that it is not. *Still* is no news: the cook believes
//! it, and it is so. *Further* goes on in the direction that the cook faces, which is that of the last move.

use leadtime_sims::Fact;

use crate::world::{
    Content, Direction, GridPlace, Item, Kitchen, Slot, Station, StationPhase, WorkTimes,
};

/// A side of the cook.
type CookSide = fn([usize; 2], [usize; 2]) -> bool;

fn up(place: [usize; 2], cook: [usize; 2]) -> bool {
    place[1] < cook[1]
}

fn down(place: [usize; 2], cook: [usize; 2]) -> bool {
    place[1] > cook[1]
}

fn left(place: [usize; 2], cook: [usize; 2]) -> bool {
    place[0] < cook[0]
}

fn right(place: [usize; 2], cook: [usize; 2]) -> bool {
    place[0] > cook[0]
}

/// What stations hold, truly or as the cook believes.
#[derive(Clone, Copy)]
struct StationView<'a> {
    slots: &'a [Slot],
    contents: &'a [Content],
    times: WorkTimes,
}

impl StationView<'_> {
    /// Lists the phases and contents of a kind of station, or of all.
    fn of(self, kind: Option<Station>) -> impl Iterator<Item = (Slot, StationPhase, Content)> {
        let Self { slots, contents, times } = self;
        let both = slots.iter().zip(contents);
        let both = both.filter(move |(slot, _)| kind.is_none_or(|kind| slot.station == kind));
        both.map(move |(&slot, &content)| (slot, content.phase(times.limit(slot.station)), content))
    }

    fn any(self, kind: Station, phase: StationPhase) -> bool {
        self.of(Some(kind)).any(|(_, found, _)| found == phase)
    }

    fn occupied(self, kind: Option<Station>) -> bool {
        self.of(kind).all(|(_, phase, _)| phase != StationPhase::Empty)
    }

    /// Returns whether every station is at work or in somebody else's use.
    fn busy(self, kind: Option<Station>) -> bool {
        let is_busy = |phase| matches!(phase, StationPhase::Busy | StationPhase::Unavailable);
        self.of(kind).all(|(_, phase, _)| is_busy(phase))
    }

    /// Returns whether unfinished work of some station has come to such a counter.
    fn works(self, kind: Station, holds: fn(u8) -> bool) -> bool {
        let mut all = self.of(Some(kind)).filter(|(_, phase, _)| *phase == StationPhase::Busy);
        all.any(|(.., content)| content.work().is_some_and(holds))
    }
}

/// What the facts are read off.
#[derive(Clone, Copy)]
struct KitchenMoment<'a> {
    kitchen: &'a Kitchen,
    truth: StationView<'a>,
    belief: StationView<'a>,
}

impl<'a> KitchenMoment<'a> {
    fn new(kitchen: &'a Kitchen) -> Self {
        let (world, slots) = (&kitchen.world, &kitchen.world.grid().slots[..]);
        let stations = |contents| StationView { slots, contents, times: world.times };
        let (truth, belief) = (stations(world.contents()), stations(&kitchen.mind.belief.contents));
        Self { kitchen, truth, belief }
    }

    fn is_news(self, holds: fn(StationView<'_>) -> bool) -> bool {
        holds(self.truth) && !holds(self.belief)
    }

    fn is_known(self, holds: fn(StationView<'_>) -> bool) -> bool {
        holds(self.truth) && holds(self.belief)
    }

    /// Returns whether a station of a kind, or of any, in a phase lies on a side of the cook.
    fn lies(self, kind: Option<Station>, phase: StationPhase, side: CookSide) -> bool {
        self.truth.of(kind).any(|(slot, found, _)| found == phase && self.is_at(slot.place, side))
    }

    fn is_at(self, place: GridPlace, side: CookSide) -> bool {
        let world = &self.kitchen.world;
        side(world.grid().position(place), world.grid().position(world.cook().pose.place))
    }

    fn lies_on_counter(self, item: Item, side: CookSide) -> bool {
        let world = &self.kitchen.world;
        let mut counters = world.grid().counters.iter();
        counters.any(|&at| world.lying(at) == Some(item) && self.is_at(at, side))
    }

    /// Returns whether such an item is in hand or on a counter.
    fn there_is(self, item: Item) -> bool {
        self.kitchen.world.cook().held == Some(item) || self.kitchen.world.is_lying(item)
    }

    /// Returns whether the cook has got beyond needing something of a station: it is at work or done, or used already.
    fn is_supplied(self, kind: Station, later: &[Item]) -> bool {
        let mut all = self.truth.of(Some(kind));
        all.any(|(.., content)| content.work().is_some())
            || later.iter().any(|&item| self.there_is(item))
    }

    fn is_supply(self, item: Item, side: CookSide) -> bool {
        let supplies = self.kitchen.world.grid().supplies(item);
        supplies.iter().any(|&place| self.is_at(place, side))
    }

    fn is_window(self, side: CookSide) -> bool {
        let windows = &self.kitchen.world.grid().windows;
        windows.iter().any(|&place| self.is_at(place, side))
    }

    fn is_waited_for(self) -> bool {
        !self.kitchen.world.is_done()
    }

    fn goes(self, direction: Direction) -> bool {
        self.kitchen.world.cook().pose.facing == direction
    }
}

use Station::{Board, Grill, Sink};
use StationPhase::{Busy, Empty, Ready};

/// A fact, and whether it holds.
type KitchenFact = (&'static str, &'static str, fn(KitchenMoment<'_>) -> bool);

/// Every fact of the domain.
const TOLD: &[KitchenFact] = &[
    ("grill_ready", "a grill holds a done steak", |v| v.truth.any(Grill, Ready)),
    ("grill_ready_up", "a grill in a row further up holds a done steak", |v| {
        v.lies(Some(Grill), Ready, up)
    }),
    ("grill_now_ready", "a grill holds a done steak, and the cook believes that none does", |v| {
        v.is_news(|s| s.any(Grill, Ready))
    }),
    ("grill_free", "a grill is empty", |v| v.truth.any(Grill, Empty)),
    ("grill_free_up", "a grill in a row further up is empty", |v| v.lies(Some(Grill), Empty, up)),
    ("grill_now_free", "a grill is empty, and the cook believes that none is", |v| {
        v.is_news(|s| s.any(Grill, Empty))
    }),
    ("grill_busy", "every grill is cooking or in somebody else's use", |v| {
        v.truth.busy(Some(Grill))
    }),
    ("grill_still_busy", "every grill is busy, as the cook believes", |v| {
        v.is_known(|s| s.busy(Some(Grill)))
    }),
    ("steak_cooking", "a steak is on a grill and not done", |v| v.truth.any(Grill, Busy)),
    ("steak_still_cooking", "a steak is cooking, as the cook believes", |v| {
        v.is_known(|s| s.any(Grill, Busy))
    }),
    ("board_free", "a chopping board is empty", |v| v.truth.any(Board, Empty)),
    ("board_free_left", "a chopping board in a column further left is empty", |v| {
        v.lies(Some(Board), Empty, left)
    }),
    ("board_now_free", "a chopping board is empty, and the cook believes that none is", |v| {
        v.is_news(|s| s.any(Board, Empty))
    }),
    ("board_occupied", "every chopping board holds something or is in somebody else's use", |v| {
        v.truth.occupied(Some(Board))
    }),
    (
        "board_busy",
        "every chopping board holds unfinished work or is in somebody else's use",
        |v| v.truth.busy(Some(Board)),
    ),
    ("board_still_busy", "every chopping board is busy, as the cook believes", |v| {
        v.is_known(|s| s.busy(Some(Board)))
    }),
    ("onion_waiting", "an onion lies on a chopping board, not chopped at all", |v| {
        v.truth.works(Board, |n| n == 0)
    }),
    ("garnish_half_chopped", "an onion on a chopping board is chopped in part", |v| {
        v.truth.works(Board, |n| n > 0)
    }),
    ("garnish_done", "a chopping board holds a garnish", |v| v.truth.any(Board, Ready)),
    ("garnish_done_left", "a chopping board in a column further left holds a garnish", |v| {
        v.lies(Some(Board), Ready, left)
    }),
    ("sink_free", "a sink is empty", |v| v.truth.any(Sink, Empty)),
    ("sink_free_down", "a sink in a row further down is empty", |v| {
        v.lies(Some(Sink), Empty, down)
    }),
    ("sink_free_right", "a sink in a column further right is empty", |v| {
        v.lies(Some(Sink), Empty, right)
    }),
    ("sink_occupied", "every sink holds something or is in somebody else's use", |v| {
        v.truth.occupied(Some(Sink))
    }),
    ("plate_soaking", "a plate lies in a sink and is not clean", |v| v.truth.any(Sink, Busy)),
    ("plate_washing", "a plate in a sink is washed in part", |v| v.truth.works(Sink, |n| n > 0)),
    (
        "plate_clean_right",
        "a clean plate is in a sink or on a counter in a column further right",
        |v| v.lies(Some(Sink), Ready, right) || v.lies_on_counter(Item::CleanPlate, right),
    ),
    ("stations_occupied", "no station is empty", |v| v.truth.occupied(None)),
    ("stations_now_occupied", "no station is empty, and the cook believes that one is", |v| {
        v.is_news(|s| s.occupied(None))
    }),
    ("stations_busy", "every station is at work or in somebody else's use", |v| v.truth.busy(None)),
    ("stations_now_busy", "every station is busy, and the cook believes that one is not", |v| {
        v.is_news(|s| s.busy(None))
    }),
    ("station_free_right", "a station in a column further right is empty", |v| {
        v.lies(None, Empty, right)
    }),
    ("plates_up", "the supply of plates, or a clean plate, is in a row further up", |v| {
        v.is_supply(Item::Plate, up)
            || v.lies(Some(Sink), Ready, up)
            || v.lies_on_counter(Item::CleanPlate, up)
    }),
    (
        "plates_needed_right",
        "no plate is in a sink, in hand or on a counter, none is under a steak, and the supply is in a column further right",
        |v| {
            let later = [Item::Plate, Item::CleanPlate, Item::Steak, Item::Dish];
            v.is_waited_for() && !v.is_supplied(Sink, &later) && v.is_supply(Item::Plate, right)
        },
    ),
    (
        "onion_needed_left",
        "no onion is on a board, in hand or on a counter, none is in a dish, and the supply is in a column further left",
        |v| {
            let later = [Item::Onion, Item::Dish];
            v.is_waited_for() && !v.is_supplied(Board, &later) && v.is_supply(Item::Onion, left)
        },
    ),
    ("order_waiting", "the guest's order is not served", |v| v.is_waited_for()),
    (
        "dish_ready_down",
        "the dish is on a counter in a row further down, or in hand and the serving window is",
        |v| {
            let is_held = v.kitchen.world.cook().held == Some(Item::Dish);
            v.lies_on_counter(Item::Dish, down) || (is_held && v.is_window(down))
        },
    ),
    (
        "window_clear_down",
        "no dish stands in the serving window, which is in a row further down",
        |v| v.is_waited_for() && v.is_window(down),
    ),
    ("going_up", "the cook faces up, where the last move went", |v| v.goes(Direction::North)),
    ("going_down", "the cook faces down, where the last move went", |v| v.goes(Direction::South)),
    ("going_left", "the cook faces left, where the last move went", |v| v.goes(Direction::West)),
    ("going_right", "the cook faces right, where the last move went", |v| v.goes(Direction::East)),
];

pub(super) fn facts() -> Vec<Fact> {
    TOLD.iter().map(|&(name, meaning, _)| Fact { name, meaning }).collect()
}

/// Says which of them hold. Shape as [`facts`].
pub(super) fn observe(kitchen: &Kitchen, holds: &mut [bool]) {
    let view = KitchenMoment::new(kitchen);
    for ((.., is_so), out) in TOLD.iter().zip(holds) {
        *out = is_so(view);
    }
}

#[cfg(test)]
#[path = "facts_tests.rs"]
mod tests;
