//! What a cook's action did, in the kitchen and in the books of the original.

use super::kinds::Item;

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
