//! What a kitchen knows: directions, actions and what came of them, things to carry, tiles, a station's work.

use serde::{Deserialize, Serialize};

/// A direction in the grid; y grows downward, so north is y - 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Direction {
    /// Up in the grid.
    North,
    /// Down in the grid.
    South,
    /// To the right in the grid.
    East,
    /// To the left in the grid.
    West,
}

impl Direction {
    /// All of them, in the order of their indices.
    pub const ALL: [Self; 4] = [Self::North, Self::South, Self::East, Self::West];

    /// Returns the step it makes, `(dx, dy)`.
    pub const fn offset(self) -> (i32, i32) {
        match self {
            Self::North => (0, -1),
            Self::South => (0, 1),
            Self::East => (1, 0),
            Self::West => (-1, 0),
        }
    }
}

/// What a cook does in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Action {
    /// Turns to a direction, and steps onto the tile there if it is free floor.
    Go(Direction),
    /// Does nothing in this step.
    Stay,
    /// Uses the tile in front.
    Interact,
}

/// A thing that a hand or a counter holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Item {
    /// A raw onion, for the board (the paper's radish).
    Onion,
    /// Raw meat, for the grill.
    Meat,
    /// A dirty plate, for the sink.
    Plate,
    /// A clean plate, for the steak.
    CleanPlate,
    /// A steak on a plate, for the garnish.
    Steak,
    /// A garnished steak, for the window.
    Dish,
}

impl Item {
    /// All of them, in the order of their indices.
    pub const ALL: [Self; 6] =
        [Self::Onion, Self::Meat, Self::Plate, Self::CleanPlate, Self::Steak, Self::Dish];
}

/// Where something is made from something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Station {
    /// Turns meat into a steak by itself.
    Grill,
    /// Turns an onion into a garnish, chop by chop.
    Board,
    /// Turns a plate into a clean one, wash by wash.
    Sink,
}

impl Station {
    /// All of them, in the order of station slots.
    pub const ALL: [Self; 3] = [Self::Grill, Self::Board, Self::Sink];

    /// Names it, in pictures and recordings.
    pub fn name(self) -> &'static str {
        ["grill", "board", "sink"][self as usize]
    }
}

/// What a tile is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tile {
    /// Where a cook can stand.
    Floor,
    /// A counter, which holds any one item; every wall is one.
    Counter,
    /// An endless supply of an item.
    Supply(Item),
    /// A grill, board or sink.
    Station(Station),
    /// Where dishes are served.
    Window,
}

/// How many ticks, chops and washes work takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkTimes {
    /// Steps on the grill, C.
    pub cook: u8,
    /// Chops on the board, H.
    pub chop: u8,
    /// Washes in the sink, V.
    pub wash: u8,
}

impl Default for WorkTimes {
    /// The times of every published experiment: 10/2/2.
    fn default() -> Self {
        Self { cook: 10, chop: 2, wash: 2 }
    }
}

impl WorkTimes {
    /// Returns the counter at which a station's work is done.
    pub fn limit(self, station: Station) -> u8 {
        match station {
            Station::Grill => self.cook,
            Station::Board => self.chop,
            Station::Sink => self.wash,
        }
    }
}

/// What a station holds, truly or as somebody believes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Content {
    /// Nothing is in it.
    Empty,
    /// Work that has come to this counter, at most the station's limit; anyone may continue it.
    Work(u8),
    /// Somebody else's work: nobody here can use the station.
    Unavailable,
}

/// How far a station's work has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StationPhase {
    /// Nothing is in it, so work can begin.
    Empty,
    /// Work that is not finished.
    Busy,
    /// Work that is finished and can be taken.
    Ready,
    /// In somebody else's use.
    Unavailable,
}

impl Content {
    /// Judges the content by the counter at which work is done.
    pub fn phase(self, limit: u8) -> StationPhase {
        match self {
            Self::Empty => StationPhase::Empty,
            Self::Work(counter) if counter < limit => StationPhase::Busy,
            Self::Work(_) => StationPhase::Ready,
            Self::Unavailable => StationPhase::Unavailable,
        }
    }

    /// Returns the counter of work that can be gone on with.
    pub fn work(self) -> Option<u8> {
        match self {
            Self::Work(counter) => Some(counter),
            Self::Empty | Self::Unavailable => None,
        }
    }

    /// Gains one tick, if there is unfinished work.
    pub(super) fn tick(&mut self, limit: u8) {
        if let Self::Work(counter) = self
            && *counter < limit
        {
            *counter += 1;
        }
    }
}

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
#[derive(Clone, Copy, Debug)]
pub struct ActionOutcome {
    /// Whether the action changed anything: pose, hand or the tile in front.
    pub changed: bool,
    /// What the original logs, at most two things.
    pub events: [Option<Event>; 2],
    /// What the original pays.
    pub reward: u32,
}

impl ActionOutcome {
    pub(super) const NOTHING: Self = Self { changed: false, events: [None; 2], reward: 0 };
    pub(super) const SILENT: Self = Self { changed: true, ..Self::NOTHING };

    pub(super) const fn logged(event: Event) -> Self {
        Self { events: [Some(event), None], ..Self::SILENT }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_grows_to_its_limit_and_only_work_does() {
        let mut content = Content::Work(0);
        for phase in [StationPhase::Busy, StationPhase::Ready, StationPhase::Ready] {
            content.tick(2);
            assert_eq!(content.phase(2), phase);
        }
        assert_eq!(content, Content::Work(2));
        for mut idle in [Content::Empty, Content::Unavailable] {
            let before = idle;
            idle.tick(2);
            assert_eq!((idle, idle.work()), (before, None));
        }
    }
}
