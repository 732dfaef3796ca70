//! Which subtasks there are, which of them a cook with a belief may choose, and where each can be done.
//!
//! Tiers are tried from the top; the first with an available subtask wins. Hands empty:
//!
//! | tier | subtask | available when |
//! |---|---|---|
//! | 0 | take the dish | one lies on a counter |
//! | 1 | take the plated steak | one lies on a counter, a board is ready |
//! | 2 | chop; wash | as tier 5, and the last thing done was of the same station |
//! | 3 | fetch meat | no grill in use, no plated steak on a counter |
//! | 4 | fetch an onion; fetch a plate | no board in use; no sink in use, no clean plate or plated steak on a counter |
//! | 5 | chop; wash | a board busy, none ready; a sink busy, none ready, no clean plate or plated steak on a counter |
//! | 6 | take the clean plate | there is one (in a sink or on a counter), a board ready, a grill in use |
//!
//! With full hands there is one subtask: the next station that takes the item, or a free counter if there is none.
//! A station in somebody else's use is to the cook as if it were not there.
//!
//! # Source
//!
//! The rules of FOV-aware-planner's cook, with random ties inside a tier, and with what keeps it from standing before
//! half-done work for ever: tiers 0, 1 and 5.

use serde::{Deserialize, Serialize};

use super::belief::Belief;
use super::grid::GridPlace;
use super::kinds::{Content, Item, Station, StationPhase};
use super::state::KitchenWorld;

/// What a cook is about to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Subtask {
    /// Takes the dish from a counter.
    TakeDish,
    /// Takes the plated steak from a counter.
    TakePlatedSteak,
    /// Chops what is on the board.
    Chop,
    /// Washes what is in the sink.
    Wash,
    /// Fetches meat from a supply.
    FetchMeat,
    /// Fetches an onion from a supply.
    FetchOnion,
    /// Fetches a dirty plate.
    FetchPlate,
    /// Takes a clean plate out of a sink, or from a counter.
    TakeCleanPlate,
    /// Puts meat on a grill.
    PlaceMeat,
    /// Puts an onion on a board.
    PlaceOnion,
    /// Puts a plate into a sink.
    PlacePlate,
    /// Takes a steak off the grill, with a clean plate.
    PlateSteak,
    /// Takes the garnish, with a plated steak.
    Garnish,
    /// Serves the dish at a window.
    Serve,
    /// Puts what is in hand onto a counter.
    Discard,
    /// Waits for something to change.
    Wait,
}

impl Subtask {
    /// Returns the station whose use makes it pointless: it brings what such a station already has.
    pub(super) fn supplied_station(self) -> Option<Station> {
        match self {
            Self::FetchMeat | Self::PlaceMeat => Some(Station::Grill),
            Self::FetchOnion | Self::PlaceOnion => Some(Station::Board),
            Self::FetchPlate | Self::PlacePlate => Some(Station::Sink),
            _ => None,
        }
    }

    /// Returns whether it fetches something from a supply.
    pub(crate) fn fetches(self) -> bool {
        matches!(self, Self::FetchMeat | Self::FetchOnion | Self::FetchPlate)
    }

    /// Returns whether it takes more than one interaction, so that an effective one does not end it.
    pub(super) fn repeats(self) -> bool {
        matches!(self, Self::Chop | Self::Wash)
    }
}

/// The subtasks of the winning tier: one or two.
#[derive(Clone, Copy, Debug)]
pub(super) struct Options {
    pub(super) first: Subtask,
    pub(super) second: Option<Subtask>,
}

impl Options {
    const fn one(first: Subtask) -> Self {
        Self { first, second: None }
    }

    fn of([first, second]: [Option<Subtask>; 2]) -> Option<Self> {
        match first {
            Some(first) => Some(Self { first, second }),
            None => second.map(Self::one),
        }
    }
}

const BUSY: u8 = 1 << StationPhase::Busy as u8;
const READY: u8 = 1 << StationPhase::Ready as u8;
const EMPTY: u8 = 1 << StationPhase::Empty as u8;
const IN_USE: u8 = BUSY | READY;

/// The phases that occur, believed or true: a set of [`StationPhase`] per kind of station.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Phases([u8; 3]);

impl Phases {
    /// Collects the phases of stations that hold this.
    pub(super) fn of(world: &KitchenWorld, contents: &[Content]) -> Self {
        let mut phases = Self::default();
        for (slot, (at, &content)) in world.grid().slots.iter().zip(contents).enumerate() {
            phases.0[at.station as usize] |= 1 << world.phase(slot, content) as u8;
        }
        phases
    }

    fn any(self, station: Station, phases: u8) -> bool {
        self.0[station as usize] & phases != 0
    }

    /// Returns whether a station of that kind holds work that the cook could go on with.
    pub(super) fn in_use(self, station: Station) -> bool {
        self.any(station, IN_USE)
    }
}

/// Returns what a cook may choose to do, by what it believes and last did.
pub(super) fn options(
    world: &KitchenWorld,
    belief: &Belief,
    last_done: Option<Subtask>,
) -> Options {
    let phases = Phases::of(world, &belief.contents);
    match world.cook().held {
        Some(item) => Options::one(with_full_hands(item, phases)),
        None => with_empty_hands(world, phases, last_done),
    }
}

fn with_full_hands(item: Item, phases: Phases) -> Subtask {
    let (subtask, possible) = match item {
        Item::Meat => (Subtask::PlaceMeat, phases.any(Station::Grill, EMPTY)),
        Item::Onion => (Subtask::PlaceOnion, phases.any(Station::Board, EMPTY)),
        Item::Plate => (Subtask::PlacePlate, phases.any(Station::Sink, EMPTY)),
        Item::CleanPlate => (Subtask::PlateSteak, phases.any(Station::Grill, IN_USE)),
        Item::Steak => (Subtask::Garnish, phases.any(Station::Board, READY)),
        Item::Dish => (Subtask::Serve, true),
    };
    if possible { subtask } else { Subtask::Discard }
}

fn with_empty_hands(world: &KitchenWorld, phases: Phases, last_done: Option<Subtask>) -> Options {
    let unfinished = |station| phases.any(station, BUSY) && !phases.any(station, READY);
    let (plated, clean) = (world.is_lying(Item::Steak), world.is_lying(Item::CleanPlate));
    let needs_plate = !clean && !plated;
    let chop = unfinished(Station::Board).then_some(Subtask::Chop);
    let wash = (unfinished(Station::Sink) && needs_plate).then_some(Subtask::Wash);
    let was_at = |place, work| last_done == Some(place) || last_done == Some(work);
    let goes_on = [
        chop.filter(|_| was_at(Subtask::PlaceOnion, Subtask::Chop)),
        wash.filter(|_| was_at(Subtask::PlacePlate, Subtask::Wash)),
    ];
    let fetch = [
        (!phases.in_use(Station::Board)).then_some(Subtask::FetchOnion),
        (!phases.in_use(Station::Sink) && needs_plate).then_some(Subtask::FetchPlate),
    ];
    let garnish_waits = phases.any(Station::Board, READY);
    let plate_waits = phases.any(Station::Sink, READY) || clean;
    if world.is_lying(Item::Dish) {
        return Options::one(Subtask::TakeDish);
    }
    if plated && garnish_waits {
        return Options::one(Subtask::TakePlatedSteak);
    }
    if let Some(options) = Options::of(goes_on) {
        return options;
    }
    if !phases.in_use(Station::Grill) && !plated {
        return Options::one(Subtask::FetchMeat);
    }
    if let Some(options) = Options::of(fetch).or(Options::of([chop, wash])) {
        return options;
    }
    let takes_plate = plate_waits && garnish_waits && phases.in_use(Station::Grill);
    Options::one(if takes_plate { Subtask::TakeCleanPlate } else { Subtask::Wait })
}

/// What counters a subtask can be done at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Counters {
    None,
    Free,
    With(Item),
}

/// Lists where a subtask can be done, by what the cook believes: stations, then supplies or windows, then counters.
pub(super) fn targets<'a>(
    world: &'a KitchenWorld,
    belief: &'a Belief,
    subtask: Subtask,
) -> impl Iterator<Item = GridPlace> + 'a {
    let grid = world.grid();
    let (stations, fixed, counters): (_, &[GridPlace], _) = match subtask {
        Subtask::TakeDish => (None, &[], Counters::With(Item::Dish)),
        Subtask::TakePlatedSteak => (None, &[], Counters::With(Item::Steak)),
        Subtask::Chop => (Some((Station::Board, BUSY)), &[], Counters::None),
        Subtask::Wash => (Some((Station::Sink, BUSY)), &[], Counters::None),
        Subtask::FetchMeat => (None, grid.supplies(Item::Meat), Counters::With(Item::Meat)),
        Subtask::FetchOnion => (None, grid.supplies(Item::Onion), Counters::With(Item::Onion)),
        Subtask::FetchPlate => (None, grid.supplies(Item::Plate), Counters::With(Item::Plate)),
        Subtask::TakeCleanPlate => {
            (Some((Station::Sink, READY)), &[], Counters::With(Item::CleanPlate))
        }
        Subtask::PlaceMeat => (Some((Station::Grill, EMPTY)), &[], Counters::None),
        Subtask::PlaceOnion => (Some((Station::Board, EMPTY)), &[], Counters::None),
        Subtask::PlacePlate => (Some((Station::Sink, EMPTY)), &[], Counters::None),
        Subtask::PlateSteak => {
            let ready = Phases::of(world, &belief.contents).any(Station::Grill, READY);
            (Some((Station::Grill, if ready { READY } else { BUSY })), &[], Counters::None)
        }
        Subtask::Garnish => (Some((Station::Board, READY)), &[], Counters::None),
        Subtask::Serve => (None, &grid.windows, Counters::None),
        Subtask::Discard => (None, &[], Counters::Free),
        Subtask::Wait => (None, &[], Counters::None),
    };
    let stations = stations.into_iter().flat_map(move |(station, phases)| {
        let slots = grid.slots.iter().zip(&belief.contents).enumerate();
        slots.filter_map(move |(slot, (at, &content))| {
            let fits = at.station == station && phases >> world.phase(slot, content) as u8 & 1 == 1;
            fits.then_some(at.place)
        })
    });
    let searched: &[GridPlace] = match counters {
        Counters::With(item) if world.is_lying(item) => &grid.counters,
        Counters::Free => &grid.counters,
        Counters::None | Counters::With(_) => &[],
    };
    let on_counters = searched.iter().copied().filter(move |&place| match counters {
        Counters::None => false,
        Counters::Free => world.lying(place).is_none(),
        Counters::With(item) => world.lying(place) == Some(item),
    });
    stations.chain(fixed.iter().copied()).chain(on_counters)
}
