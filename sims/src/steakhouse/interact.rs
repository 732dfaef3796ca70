//! What using the tile in front does.
//!
//! | tile in front | it holds | the hand holds | what happens |
//! |---|---|---|---|
//! | counter | - | an item | the item is put down |
//! | counter | an item | nothing, or an item | it is taken; the hand's item takes its place |
//! | supply | - | nothing | an item is taken |
//! | grill | - | meat | it starts to cook |
//! | grill | a raw steak | meat | one extra tick; the meat stays in the hand (the original does so) |
//! | grill | a done steak | a clean plate | the steak is taken |
//! | board | - | an onion | it is put down |
//! | board | an unfinished garnish | nothing | one chop |
//! | board | a garnish | a steak | the dish is taken |
//! | sink | - | a plate | it is put in |
//! | sink | an unfinished plate | nothing | one wash |
//! | sink | a clean plate | nothing | it is taken |
//! | window | - | a dish | it is served |
//!
//! Everything else changes nothing; so does a station in somebody else's use.

use super::grid::Place;
use super::kinds::{Content, Item, Station, Tile};
use super::world::{Order, World};

/// What the original pays for a dish that was ordered.
pub const DELIVERY_REWARD: u32 = 20;

/// What the original logs about an interaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Something was taken; where two items change places, the one that was put down.
    Pickup(Item),
    /// An onion was taken while there was an empty grill.
    UsefulOnionPickup,
    /// Meat was put on the grill, or held over it.
    Cooking,
    /// An onion was put on the board, or chopped.
    Chopping,
    /// A plate was washed.
    Washing,
    /// A dish was served, wanted or not.
    Delivery,
}

/// What came of a cook's action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Whether the action changed anything: pose, hand or the tile in front.
    pub changed: bool,
    /// What the original logs, at most two things.
    pub events: [Option<Event>; 2],
    /// What the original pays.
    pub reward: u32,
}

impl Outcome {
    const NOTHING: Self = Self { changed: false, events: [None; 2], reward: 0 };
    const SILENT: Self = Self { changed: true, ..Self::NOTHING };

    const fn logged(event: Event) -> Self {
        Self { events: [Some(event), None], ..Self::SILENT }
    }
}

impl World {
    /// Lets a cook use the tile in front.
    pub(super) fn interact(&mut self, cook: usize) -> Outcome {
        let body = self.state.cooks[cook];
        let place = self.grid().ahead(body.pose);
        match self.grid().tile(place) {
            Tile::Counter => self.use_counter(cook, place),
            Tile::Supply(item) if body.held.is_none() => {
                self.state.cooks[cook].held = Some(item);
                self.picked_up(item)
            }
            Tile::Station(station) => {
                let slot = self.grid().slot_at(place).expect("every station has a slot");
                self.use_station(cook, station, slot)
            }
            Tile::Window if body.held == Some(Item::Dish) => {
                self.state.cooks[cook].held = None;
                Outcome { reward: self.serve(), ..Outcome::logged(Event::Delivery) }
            }
            Tile::Floor | Tile::Supply(_) | Tile::Window => Outcome::NOTHING,
        }
    }

    fn use_counter(&mut self, cook: usize, place: Place) -> Outcome {
        let held = self.state.cooks[cook].held;
        let taken = self.lay(place, held);
        self.state.cooks[cook].held = taken;
        match (taken, held) {
            (None, None) => Outcome::NOTHING,
            (None, Some(_)) => Outcome::SILENT,
            (Some(item), None) | (Some(_), Some(item)) => self.picked_up(item),
        }
    }

    fn picked_up(&self, item: Item) -> Outcome {
        let mut outcome = Outcome::logged(Event::Pickup(item));
        let mut grills = self.grid().slots().iter().zip(&self.state.contents);
        let room = |(slot, content): (&super::grid::Slot, &Content)| {
            slot.station == Station::Grill && *content == Content::Empty
        };
        if item == Item::Onion && grills.any(room) {
            outcome.events[1] = Some(Event::UsefulOnionPickup);
        }
        outcome
    }

    fn use_station(&mut self, cook: usize, station: Station, slot: usize) -> Outcome {
        use Content::{Empty, Work};
        let limit = self.times().limit(station);
        let held = self.state.cooks[cook].held;
        let content = self.state.contents[slot];
        let (content, held, outcome) = match (station, content, held) {
            (Station::Grill, Empty, Some(Item::Meat)) => {
                (Work(0), None, Outcome::logged(Event::Cooking))
            }
            (Station::Grill, Work(n), Some(Item::Meat)) if n < limit => {
                (Work(n + 1), held, Outcome::logged(Event::Cooking))
            }
            (Station::Grill, Work(n), Some(Item::CleanPlate)) if n >= limit => {
                (Empty, Some(Item::Steak), Outcome::logged(Event::Pickup(Item::Steak)))
            }
            (Station::Board, Empty, Some(Item::Onion)) => {
                (Work(0), None, Outcome::logged(Event::Chopping))
            }
            (Station::Board, Work(n), None) if n < limit => {
                (Work(n + 1), None, Outcome::logged(Event::Chopping))
            }
            (Station::Board, Work(n), Some(Item::Steak)) if n >= limit => {
                (Empty, Some(Item::Dish), Outcome::logged(Event::Pickup(Item::Dish)))
            }
            (Station::Sink, Empty, Some(Item::Plate)) => (Work(0), None, Outcome::SILENT),
            (Station::Sink, Work(n), None) if n < limit => {
                (Work(n + 1), None, Outcome::logged(Event::Washing))
            }
            (Station::Sink, Work(_), None) => {
                (Empty, Some(Item::CleanPlate), Outcome::logged(Event::Pickup(Item::CleanPlate)))
            }
            _ => return Outcome::NOTHING,
        };
        self.state.contents[slot] = content;
        self.state.cooks[cook].held = held;
        outcome
    }

    /// Serves a dish, and returns what the original pays for it.
    fn serve(&mut self) -> u32 {
        match &mut self.state.orders {
            None => DELIVERY_REWARD,
            Some(orders) if orders.first() == Some(&Order::Steak) => {
                orders.remove(0);
                DELIVERY_REWARD
            }
            Some(_) => 0,
        }
    }
}
