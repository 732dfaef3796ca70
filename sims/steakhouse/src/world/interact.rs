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

use super::grid::GridPlace;
use super::kinds::{ActionOutcome, Content, Event, Item, Station, Tile};
use super::state::{KitchenWorld, Order};

/// What the original pays for a dish that was ordered.
const DELIVERY_REWARD: u32 = 20;

impl KitchenWorld {
    /// Lets a cook use the tile in front.
    pub(super) fn interact(&mut self, cook: usize) -> ActionOutcome {
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
                ActionOutcome { reward: self.serve(), ..ActionOutcome::logged(Event::Delivery) }
            }
            Tile::Floor | Tile::Supply(_) | Tile::Window => ActionOutcome::NOTHING,
        }
    }

    fn use_counter(&mut self, cook: usize, place: GridPlace) -> ActionOutcome {
        let held = self.state.cooks[cook].held;
        let taken = self.lay(place, held);
        self.state.cooks[cook].held = taken;
        match (taken, held) {
            (None, None) => ActionOutcome::NOTHING,
            (None, Some(_)) => ActionOutcome::SILENT,
            (Some(item), None) | (Some(_), Some(item)) => self.picked_up(item),
        }
    }

    fn picked_up(&self, item: Item) -> ActionOutcome {
        let mut outcome = ActionOutcome::logged(Event::Pickup(item));
        let mut grills = self.grid().slots.iter().zip(&self.state.contents);
        let room = |(slot, content): (&super::grid::Slot, &Content)| {
            slot.station == Station::Grill && *content == Content::Empty
        };
        if item == Item::Onion && grills.any(room) {
            outcome.events[1] = Some(Event::UsefulOnionPickup);
        }
        outcome
    }

    fn use_station(&mut self, cook: usize, station: Station, slot: usize) -> ActionOutcome {
        use ActionOutcome as Did;
        use Content::{Empty, Work};
        use Event::{Chopping, Cooking, Washing};
        let take = |item| (Empty, Some(item), Did::logged(Event::Pickup(item)));
        let limit = self.times.limit(station);
        let held = self.state.cooks[cook].held;
        let content = self.state.contents[slot];
        let (content, held, outcome) = match (station, content, held) {
            (Station::Grill, Empty, Some(Item::Meat)) => (Work(0), None, Did::logged(Cooking)),
            (Station::Grill, Work(n), Some(Item::Meat)) if n < limit => {
                (Work(n + 1), held, Did::logged(Cooking))
            }
            (Station::Grill, Work(n), Some(Item::CleanPlate)) if n >= limit => take(Item::Steak),
            (Station::Board, Empty, Some(Item::Onion)) => (Work(0), None, Did::logged(Chopping)),
            (Station::Board, Work(n), None) if n < limit => {
                (Work(n + 1), None, Did::logged(Chopping))
            }
            (Station::Board, Work(n), Some(Item::Steak)) if n >= limit => take(Item::Dish),
            (Station::Sink, Empty, Some(Item::Plate)) => (Work(0), None, Did::SILENT),
            (Station::Sink, Work(n), None) if n < limit => {
                (Work(n + 1), None, Did::logged(Washing))
            }
            (Station::Sink, Work(_), None) => take(Item::CleanPlate),
            _ => return ActionOutcome::NOTHING,
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
