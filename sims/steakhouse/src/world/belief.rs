//! What a cook believes of the stations, and how it comes to know better.
//!
//! Supplies, window and walls are known, and so is what lies on counters, because only the cook puts anything there.
//! Of a station the cook knows what it last saw, or was told; grills go on cooking in its mind. Nothing is forgotten.

use serde::{Deserialize, Serialize};

use super::kinds::{Content, Station};
use super::state::KitchenWorld;

/// A cook's knowledge of the stations, by slot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Belief {
    /// What stations are believed to hold.
    pub contents: Vec<Content>,
    /// For how many steps in a row each station has been in view.
    in_view: Vec<u8>,
}

impl Belief {
    /// Believes every station empty.
    pub(super) fn new(n_stations: usize) -> Self {
        Self { contents: vec![Content::Empty; n_stations], in_view: vec![0; n_stations] }
    }

    pub(super) fn clear(&mut self) {
        self.contents.fill(Content::Empty);
        self.in_view.fill(0);
    }

    /// Lets the steaks cook that are believed to be on a grill.
    pub(super) fn tick(&mut self, world: &KitchenWorld) {
        for (content, slot) in self.contents.iter_mut().zip(&world.grid().slots) {
            if slot.station == Station::Grill {
                content.tick(world.times.cook);
            }
        }
    }

    /// Looks at the stations in view: those that were seen `see_delay` times in a row are known as they are.
    pub(super) fn look(&mut self, visible: u16, truth: &[Content], see_delay: u8) {
        for (slot, in_view) in self.in_view.iter_mut().enumerate() {
            *in_view = if visible >> slot & 1 == 1 { in_view.saturating_add(1) } else { 0 };
            if *in_view >= see_delay {
                self.contents[slot] = truth[slot];
            }
        }
    }

    /// Returns whether a station's phase is as believed.
    pub fn is_aware(&self, slot: usize, world: &KitchenWorld) -> bool {
        world.phase(slot, self.contents[slot]) == world.phase(slot, world.contents()[slot])
    }

    /// Returns whether every station's phase is as believed.
    pub fn is_aware_of_all(&self, world: &KitchenWorld) -> bool {
        (0..self.contents.len()).all(|slot| self.is_aware(slot, world))
    }

    /// Returns whether it could be a belief about such a kitchen.
    pub(super) fn fits(&self, world: &KitchenWorld) -> bool {
        world.grid().can_hold(&self.contents, world.times)
            && self.in_view.len() == self.contents.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_station_is_known_once_it_was_in_view_for_long_enough() {
        let truth = [Content::Work(1), Content::Unavailable];
        let mut belief = Belief::new(2);
        belief.look(0b11, &truth, 2);
        assert_eq!(belief.contents, [Content::Empty; 2]);
        belief.look(0b10, &truth, 2);
        assert_eq!(belief.contents, [Content::Empty, Content::Unavailable]);
        // Out of view for a step: the count starts again.
        belief.look(0b01, &truth, 2);
        assert_eq!(belief.contents[0], Content::Empty);
        belief.look(0b01, &truth, 2);
        assert_eq!(belief.contents, truth);
        belief.clear();
        assert_eq!(belief, Belief::new(2));
    }
}
