//! World and cook together: the cook decides, the world moves on, the cook looks.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::grid::Grid;
use super::kinds::{Action, ActionOutcome, WorkTimes};
use super::mind::{Mind, Ties};
use super::paths::Paths;
use super::sight::{FieldOfView, Sight};
use super::start::KitchenStart;
use super::state::{KitchenWorld, Order, OrdersEnd, WorldState, start_pose};

/// What never changes about a kitchen, computed once.
#[derive(Clone, Debug)]
pub struct Floorplan {
    /// The tiles of the kitchen.
    pub grid: Arc<Grid>,
    /// The shortest paths through it.
    pub paths: Paths,
    /// What is seen from where.
    pub sight: Sight,
}

impl Floorplan {
    /// Computes paths and views.
    pub fn new(grid: Grid, field_of_view: FieldOfView) -> Self {
        let (paths, sight) = (Paths::new(&grid), Sight::new(&grid, field_of_view));
        Self { grid: Arc::new(grid), paths, sight }
    }
}

/// Everything about a kitchen and its cook that the future depends on, but the choice between equals.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KitchenState {
    world: WorldState,
    mind: Mind,
    /// Steps since the start.
    pub n_steps: u32,
    release_at: Option<u32>,
}

/// A kitchen with one cook in it, and one order.
#[derive(Clone, Debug)]
pub struct Kitchen {
    /// The floor plan, with its paths and views.
    pub plan: Arc<Floorplan>,
    see_delay: u8,
    /// The kitchen with the cook's body in it.
    pub world: KitchenWorld,
    /// What the cook believes and intends.
    pub mind: Mind,
    /// Steps since the start.
    pub n_steps: u32,
    release_at: Option<u32>,
}

impl Kitchen {
    /// Opens a kitchen whose cook knows a station after `see_delay` steps in view.
    pub fn new(plan: Arc<Floorplan>, times: WorkTimes, see_delay: u8) -> Self {
        let grid = Arc::clone(&plan.grid);
        let pose = start_pose(grid.floor[0]);
        let state = WorldState::new(&grid, &[pose], Some(vec![Order::Steak]));
        let mind = Mind::new(grid.slots.len());
        let world = KitchenWorld::new(grid, times, OrdersEnd::AllServed, state);
        Self { plan, see_delay, world, mind, n_steps: 0, release_at: None }
    }

    /// Starts over; an aware cook knows what the stations hold.
    pub fn begin(&mut self, start: &KitchenStart, is_aware: bool) {
        self.world.begin(start.pose, &start.contents);
        self.mind.clear();
        if is_aware {
            self.mind.learn(self.world.contents());
        }
        (self.n_steps, self.release_at) = (0, start.release_at);
        self.look();
    }

    /// Lets the cook choose the coming step's action by their own plan.
    pub fn decide(&mut self, ties: Ties<'_>) -> Action {
        self.mind.decide(&self.world, &self.plan.paths, ties)
    }

    /// Takes a step. `is_own` says whether the action was the cook's own choice, and not somebody's instruction.
    pub fn step(&mut self, action: Action, is_own: bool) -> ActionOutcome {
        let outcome = self.world.step(&[action])[0];
        if is_own {
            self.mind.acted(action, outcome.changed);
        }
        self.n_steps += 1;
        if self.release_at == Some(self.n_steps) {
            self.world.release();
        }
        self.mind.belief.tick(&self.world);
        self.look();
        outcome
    }

    fn look(&mut self) {
        let visible = self.plan.sight.stations(self.world.cook().pose);
        self.mind.belief.look(visible, self.world.contents(), self.see_delay);
    }

    /// Makes the cook think again.
    pub fn replan(&mut self) {
        self.mind.replan();
    }

    /// Shows the cook the true state of every station.
    pub fn disclose(&mut self) {
        self.mind.learn(self.world.contents());
    }

    /// Returns what a cook who knows everything would do in this one's place.
    pub fn informed_action(&self) -> Action {
        self.mind.informed_action(&self.world, &self.plan.paths)
    }

    /// Counts the steps to delivery of a cook who knows everything from the start and breaks ties by the first;
    /// `max_steps` if nothing was delivered by then.
    pub fn reference_steps(&mut self, start: &KitchenStart, max_steps: u32) -> u32 {
        self.begin(start, true);
        while !self.world.is_done() && self.n_steps < max_steps {
            let action = self.decide(Ties::First);
            self.step(action, true);
        }
        self.n_steps
    }

    /// Returns the state between two steps.
    pub fn state(&self) -> KitchenState {
        KitchenState {
            world: self.world.state().clone(),
            mind: self.mind.clone(),
            n_steps: self.n_steps,
            release_at: self.release_at,
        }
    }

    /// Continues from a state, bit for bit; `false`, and nothing changes, if it is of another kitchen.
    pub fn restore(&mut self, state: KitchenState) -> bool {
        let has_one_order = state.world.orders.as_ref().is_some_and(|orders| orders.len() <= 1);
        let possible = has_one_order && state.mind.fits(&self.world);
        let fits = possible && self.world.restore(state.world);
        if fits {
            self.mind = state.mind;
            (self.n_steps, self.release_at) = (state.n_steps, state.release_at);
        }
        fits
    }
}

#[cfg(test)]
#[path = "kitchen_tests.rs"]
mod tests;
