//! How an episode starts: where the cook stands, and what the stations already hold.
//!
//! "Pre-occupied" has two meanings. *Usable* stations hold work that the cook can go on with; not knowing of it, the
//! cook fetches what nobody needs. *Unavailable* stations are in somebody else's use; not knowing of it, the cook walks
//! there in vain. At least one station of each kind stays available.

use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};

use super::grid::{Grid, Pose};
use super::kinds::{Content, Direction, Station, WorkTimes};
use super::state::start_pose;

/// What the stations hold when an episode starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartFamily {
    /// Nothing at any station.
    Empty,
    /// A half-done steak on every grill.
    Grills,
    /// A half-chopped garnish on every board.
    Boards,
    /// A half-washed plate in every sink.
    Sinks,
    /// Half-done work at the first station of each kind.
    FirstOfEach,
    /// Half-done work at every station.
    AllPartial,
    /// Finished work at every station.
    AllReady,
    /// Each station holds work with probability 1/2, as far as it may be; at least one does.
    Random,
    /// Each station is in somebody else's use with probability 1/2; at least one is, and one of each kind is not.
    Unavailable,
}

impl StartFamily {
    /// Returns whether a kitchen has enough stations for it.
    pub fn is_possible(self, grid: &Grid) -> bool {
        let count = |station| grid.slots.iter().filter(|slot| slot.station == station).count();
        self != Self::Unavailable || Station::ALL.into_iter().any(|station| count(station) > 1)
    }

    /// Fills the stations. Shape of `contents`: one per slot.
    ///
    /// # Panics
    ///
    /// Never where [`StartFamily::is_possible`].
    pub fn fill(
        self,
        grid: &Grid,
        times: WorkTimes,
        generator: &mut Pcg64,
        contents: &mut [Content],
    ) {
        loop {
            for (slot, at) in grid.slots.iter().enumerate() {
                let is_first = slot == 0 || grid.slots[slot - 1].station != at.station;
                contents[slot] = self.draw(at.station, is_first, times, generator);
            }
            let is_free = |station| {
                let mut slots = grid.slots.iter().zip(contents.iter());
                slots.any(|(slot, content)| slot.station == station && *content == Content::Empty)
            };
            let fits = match self {
                Self::Random => contents.iter().any(|content| *content != Content::Empty),
                Self::Unavailable => {
                    Station::ALL.into_iter().all(is_free)
                        && contents.contains(&Content::Unavailable)
                }
                _ => true,
            };
            if fits {
                return;
            }
        }
    }

    fn draw(
        self,
        station: Station,
        is_first: bool,
        times: WorkTimes,
        generator: &mut Pcg64,
    ) -> Content {
        let limit = times.limit(station);
        let (occupied, content) = match self {
            Self::Grills => (station == Station::Grill, Content::Work(limit / 2)),
            Self::Boards => (station == Station::Board, Content::Work(limit / 2)),
            Self::Sinks => (station == Station::Sink, Content::Work(limit / 2)),
            Self::FirstOfEach => (is_first, Content::Work(limit / 2)),
            Self::AllPartial => (true, Content::Work(limit / 2)),
            Self::AllReady => (true, Content::Work(limit)),
            Self::Unavailable => (generator.unit() < 0.5, Content::Unavailable),
            Self::Random if generator.unit() < 0.5 => {
                (true, Content::Work(generator.integers(0, i64::from(limit) + 1) as u8))
            }
            Self::Empty | Self::Random => (false, Content::Empty),
        };
        if occupied { content } else { Content::Empty }
    }
}

/// How a kitchen looks when an episode starts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KitchenStart {
    /// Where the cook stands and looks.
    pub pose: Pose,
    /// What stations hold, by slot.
    pub contents: Vec<Content>,
    /// When stations in somebody else's use become free, in steps; `None`: never.
    pub release_at: Option<u32>,
}

impl KitchenStart {
    /// Returns the cook on the listener's start tile of an empty kitchen; `None` if there is no such tile.
    pub fn new(grid: &Grid) -> Option<Self> {
        let pose = start_pose(grid.person_start?);
        let contents = vec![Content::Empty; grid.slots.len()];
        Some(Self { pose, contents, release_at: None })
    }
}

/// Draws a pose uniformly over floor and directions.
pub fn random_pose(grid: &Grid, generator: &mut Pcg64) -> Pose {
    let place = grid.floor[generator.below(grid.floor.len())];
    Pose { place, facing: Direction::ALL[generator.below(4)] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::layouts::kitchen;

    fn drawn(family: StartFamily, seed: u64) -> Vec<Content> {
        let ring = kitchen("ring").unwrap();
        let mut contents = vec![Content::Work(9); 6];
        let mut generator = Pcg64::seed_from_u64(seed);
        family.fill(&ring, WorkTimes::default(), &mut generator, &mut contents);
        contents
    }

    #[test]
    fn fixed_families_hold_what_they_say() {
        use Content::{Empty as E, Work as W};
        let rows = [
            (StartFamily::Empty, [E, E, E, E, E, E]),
            (StartFamily::Grills, [W(5), W(5), E, E, E, E]),
            (StartFamily::Boards, [E, E, W(1), W(1), E, E]),
            (StartFamily::Sinks, [E, E, E, E, W(1), W(1)]),
            (StartFamily::FirstOfEach, [W(5), E, W(1), E, W(1), E]),
            (StartFamily::AllPartial, [W(5), W(5), W(1), W(1), W(1), W(1)]),
            (StartFamily::AllReady, [W(10), W(10), W(2), W(2), W(2), W(2)]),
        ];
        for (family, contents) in rows {
            assert_eq!(drawn(family, 1), contents, "{family:?}");
        }
    }

    #[test]
    fn random_stations_hold_something_and_taken_ones_leave_one_of_each_kind() {
        let mut counters = [0_u32; 3];
        for seed in 0..300 {
            let contents = drawn(StartFamily::Random, seed);
            assert!(contents.iter().any(|content| content.work().is_some()));
            for content in &contents[2..4] {
                if let Content::Work(counter) = *content {
                    counters[usize::from(counter)] += 1;
                }
            }
            let contents = drawn(StartFamily::Unavailable, seed);
            assert!(contents.contains(&Content::Unavailable));
            for kind in contents.chunks_exact(2) {
                assert!(kind.contains(&Content::Empty), "{contents:?}");
            }
        }
        // Three equally likely counters over about 300 occupied boards: four standard deviations are 33.
        assert!(counters.iter().all(|&n| n.abs_diff(100) < 40), "{counters:?}");
    }

    #[test]
    fn a_kitchen_with_one_station_of_each_kind_can_spare_none() {
        let mid = kitchen("steak_mid_2").unwrap();
        assert!(!StartFamily::Unavailable.is_possible(&mid));
        assert!(StartFamily::Random.is_possible(&mid));
        assert!(StartFamily::Unavailable.is_possible(&kitchen("ring").unwrap()));
    }
}
