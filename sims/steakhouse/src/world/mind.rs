//! The myopic cook: believes, chooses a subtask, keeps to it, and walks the shortest way.
//!
//! A chosen subtask and its target are kept while they are still possible, by what the cook believes. They are dropped
//! when a one-step subtask is done, when somebody's instruction has been followed, and when the cook learns how
//! things are.

use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};

use super::belief::Belief;
use super::grid::GridPlace;
use super::kinds::{Action, Content, StationPhase};
use super::paths::Paths;
use super::state::KitchenWorld;
use super::subtask::{Options, Subtask, options, targets};

/// How a cook chooses between equals.
#[derive(Debug)]
pub enum Ties<'a> {
    /// The first in the order of the lists.
    First,
    /// One of them, drawn uniformly from this stream.
    Random(&'a mut Pcg64),
}

impl Ties<'_> {
    fn choose(&mut self, n: usize) -> usize {
        match self {
            Self::Random(generator) if n > 1 => generator.below(n),
            Self::First | Self::Random(_) => 0,
        }
    }
}

/// What a cook knows, intends and last did.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mind {
    /// What the cook believes of the stations.
    pub belief: Belief,
    /// What the cook intends, if anything.
    pub subtask: Option<Subtask>,
    /// Where the cook intends to do it.
    pub goal: Option<GridPlace>,
    last_done: Option<Subtask>,
}

impl Mind {
    /// Believes every station empty, and intends nothing.
    pub(super) fn new(n_stations: usize) -> Self {
        Self { belief: Belief::new(n_stations), subtask: None, goal: None, last_done: None }
    }

    pub(super) fn clear(&mut self) {
        self.belief.clear();
        self.replan();
        self.last_done = None;
    }

    /// Returns the subtask that the cook is at, or would choose first.
    pub fn leaning(&self, world: &KitchenWorld) -> Subtask {
        let options = options(world, &self.belief, self.last_done);
        self.kept(options).unwrap_or(options.first)
    }

    /// Returns what the cook intends, if it is still possible.
    fn kept(&self, options: Options) -> Option<Subtask> {
        self.subtask.filter(|&kept| options.first == kept || options.second == Some(kept))
    }

    /// Chooses the action of the coming step.
    pub(super) fn decide(
        &mut self,
        world: &KitchenWorld,
        paths: &Paths,
        mut ties: Ties<'_>,
    ) -> Action {
        let options = options(world, &self.belief, self.last_done);
        let kept = self.kept(options);
        let subtask = kept.unwrap_or_else(|| self.choose_subtask(options, &mut ties));
        let is_target =
            |goal: &GridPlace| targets(world, &self.belief, subtask).any(|t| t == *goal);
        self.goal = self.goal.filter(is_target);
        if self.goal.is_none() {
            self.goal = self.choose_goal(world, paths, subtask, &mut ties);
        }
        let Some(goal) = self.goal else { return Action::Stay };
        let route = paths.route(world.cook().pose, goal);
        let action = route.map_or(Action::Stay, |route| route.first);
        let is_busy = |slot| world.phase(slot, self.belief.contents[slot]) == StationPhase::Busy;
        let waits =
            subtask == Subtask::PlateSteak && world.grid().slot_at(goal).is_some_and(is_busy);
        if waits && action == Action::Interact { Action::Stay } else { action }
    }

    fn choose_subtask(&mut self, options: Options, ties: &mut Ties<'_>) -> Subtask {
        let subtask = match options.second {
            Some(second) if ties.choose(2) == 1 => second,
            _ => options.first,
        };
        (self.subtask, self.goal) = (Some(subtask), None);
        subtask
    }

    /// Chooses the nearest place for a subtask, among equally near ones by `ties`.
    fn choose_goal(
        &self,
        world: &KitchenWorld,
        paths: &Paths,
        subtask: Subtask,
        ties: &mut Ties<'_>,
    ) -> Option<GridPlace> {
        let pose = world.cook().pose;
        let cost = |place| paths.route(pose, place).map(|route| route.cost);
        let (mut nearest, mut n_nearest, mut first) = (u16::MAX, 0, None);
        for place in targets(world, &self.belief, subtask) {
            let Some(cost) = cost(place) else { continue };
            if cost < nearest {
                (nearest, n_nearest, first) = (cost, 1, Some(place));
            } else if cost == nearest {
                n_nearest += 1;
            }
        }
        let chosen = ties.choose(n_nearest);
        if chosen == 0 {
            return first;
        }
        let mut equals =
            targets(world, &self.belief, subtask).filter(|&place| cost(place) == Some(nearest));
        equals.nth(chosen)
    }

    /// Records whether the chosen action changed anything.
    pub(super) fn acted(&mut self, action: Action, changed: bool) {
        if action != Action::Interact || !changed {
            return;
        }
        self.last_done = self.subtask;
        if self.subtask.is_some_and(|subtask| !subtask.repeats()) {
            self.replan();
        }
    }

    pub(super) fn replan(&mut self) {
        (self.subtask, self.goal) = (None, None);
    }

    /// Learns the true state of every station, and drops what was intended.
    pub(super) fn learn(&mut self, truth: &[Content]) {
        self.belief.contents.copy_from_slice(truth);
        self.replan();
    }

    /// Returns the action that a cook who knows everything would choose in this one's place.
    pub(super) fn informed_action(&self, world: &KitchenWorld, paths: &Paths) -> Action {
        let mut informed = self.clone();
        informed.learn(world.contents());
        informed.decide(world, paths, Ties::First)
    }

    /// Returns whether it could be the mind of a cook in such a kitchen.
    pub(super) fn fits(&self, world: &KitchenWorld) -> bool {
        let known = |goal: GridPlace| goal.index() < world.state().lying.len();
        self.belief.fits(world)
            && self.goal.is_none_or(|goal| known(goal) && !world.grid().is_floor(goal))
    }
}
