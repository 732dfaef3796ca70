//! The kitchen in time: cooks, what lies where, and one step of everything.
//!
//! A step: interactions, first cook first, each seeing the effects of the earlier ones; moves, all at once; then every
//! grill with a steak on it gains a tick. [`interact`](super::interact) holds the rules of interactions.
//!
//! # Source
//!
//! The rules are those of FOV-aware-planner's steakhouse; `leadtime conformance` replays its recorded
//! states. What is ours: stations in [`Unavailable`](super::Content::Unavailable) use, and the end of a list of orders
//! at its last one.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::grid::{Grid, GridPlace, Pose};
use super::kinds::{
    Action, ActionOutcome, Content, Direction, Item, Station, StationPhase, Tile, WorkTimes,
};

/// A cook's body: where it is, and what it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cook {
    /// Where the cook stands and looks.
    pub pose: Pose,
    /// What is in hand.
    pub held: Option<Item>,
}

/// What a guest waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// A steak with its garnish.
    Steak,
    /// Something that this kitchen does not make; it is never served, and blocks what comes after it.
    Other,
}

/// When a list of orders is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum OrdersEnd {
    /// When all are served.
    AllServed,
    /// When at most one is left: the original's rule, which never serves the last.
    OneLeft,
}

/// Everything that changes in a kitchen.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorldState {
    /// The cooks, by number.
    pub cooks: Vec<Cook>,
    /// What stations hold, by slot.
    pub contents: Vec<Content>,
    /// What lies on each tile; only counters hold anything.
    pub lying: Vec<Option<Item>>,
    /// What guests wait for, first come first; `None`: every dish is welcome.
    pub orders: Option<Vec<Order>>,
}

impl WorldState {
    /// Describes an empty kitchen with empty-handed cooks.
    pub fn new(grid: &Grid, poses: &[Pose], orders: Option<Vec<Order>>) -> Self {
        Self {
            cooks: poses.iter().map(|&pose| Cook { pose, held: None }).collect(),
            contents: vec![Content::Empty; grid.slots.len()],
            lying: vec![None; grid.width * grid.height()],
            orders,
        }
    }

    /// Returns whether such a grid could be in this state.
    ///
    /// States come back from other processes, so nothing about them is taken on trust.
    pub(super) fn fits(&self, grid: &Grid, times: WorkTimes) -> bool {
        let n_tiles = grid.width * grid.height();
        let on_counter = |place: GridPlace| {
            grid.tile(place) == Tile::Counter || self.lying[place.index()].is_none()
        };
        self.cooks.iter().all(|cook| grid.is_floor(cook.pose.place))
            && grid.can_hold(&self.contents, times)
            && self.lying.len() == n_tiles
            && grid.places().all(on_counter)
    }
}

/// A kitchen with cooks in it.
#[derive(Clone, Debug)]
pub struct KitchenWorld {
    grid: Arc<Grid>,
    /// How long work takes.
    pub times: WorkTimes,
    orders_end: OrdersEnd,
    pub(super) state: WorldState,
    /// How many of each item lie on counters.
    n_lying: [u16; 6],
    outcomes: Vec<ActionOutcome>,
    /// Where each cook would be after the coming moves.
    intended: Vec<GridPlace>,
}

impl KitchenWorld {
    /// Opens a kitchen in this state; nothing has been done in it yet.
    pub fn new(
        grid: Arc<Grid>,
        times: WorkTimes,
        orders_end: OrdersEnd,
        state: WorldState,
    ) -> Self {
        let n_cooks = state.cooks.len();
        let mut world = Self {
            grid,
            times,
            orders_end,
            state,
            n_lying: [0; 6],
            outcomes: vec![ActionOutcome::NOTHING; n_cooks],
            intended: Vec::with_capacity(n_cooks),
        };
        world.count_lying();
        world
    }

    fn count_lying(&mut self) {
        self.n_lying = [0; 6];
        for item in self.state.lying.iter().flatten() {
            self.n_lying[*item as usize] += 1;
        }
    }

    /// Empties the kitchen, and puts its one cook, empty-handed, and its stations' contents in place.
    pub(super) fn begin(&mut self, pose: Pose, contents: &[Content]) {
        self.state.cooks[0] = Cook { pose, held: None };
        self.state.contents.copy_from_slice(contents);
        self.state.lying.fill(None);
        self.n_lying = [0; 6];
        let orders = self.state.orders.get_or_insert_default();
        orders.clear();
        orders.push(Order::Steak);
        self.outcomes.fill(ActionOutcome::NOTHING);
    }

    /// Continues from a state of the same kitchen; `false` if it cannot be one, and nothing changes.
    pub(super) fn restore(&mut self, state: WorldState) -> bool {
        let fits = state.fits(&self.grid, self.times) && state.cooks.len() == self.outcomes.len();
        if fits {
            self.state = state;
            self.count_lying();
        }
        fits
    }

    /// Returns the floor plan.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Returns everything that changes.
    pub fn state(&self) -> &WorldState {
        &self.state
    }

    /// Returns the first cook: the only one, outside the conformance replays.
    pub fn cook(&self) -> Cook {
        self.state.cooks[0]
    }

    /// Returns what stations hold, by slot.
    pub fn contents(&self) -> &[Content] {
        &self.state.contents
    }

    /// Returns how far the work at a station is, if it held this.
    pub fn phase(&self, slot: usize, content: Content) -> StationPhase {
        content.phase(self.times.limit(self.grid.slots[slot].station))
    }

    /// Returns what lies on a tile.
    pub fn lying(&self, place: GridPlace) -> Option<Item> {
        self.state.lying[place.index()]
    }

    /// Returns whether such an item lies on some counter.
    pub fn is_lying(&self, item: Item) -> bool {
        self.n_lying[item as usize] > 0
    }

    /// Lays something onto a counter, or takes it away; returns what lay there.
    pub(super) fn lay(&mut self, place: GridPlace, item: Option<Item>) -> Option<Item> {
        let before = std::mem::replace(&mut self.state.lying[place.index()], item);
        if let Some(item) = item {
            self.n_lying[item as usize] += 1;
        }
        if let Some(before) = before {
            self.n_lying[before as usize] -= 1;
        }
        before
    }

    /// Returns whether no guest waits any more.
    pub fn is_done(&self) -> bool {
        let left = match self.orders_end {
            OrdersEnd::AllServed => 0,
            OrdersEnd::OneLeft => 1,
        };
        self.state.orders.as_ref().is_some_and(|orders| orders.len() <= left)
    }

    /// Takes one step; returns the outcome of each cook's action.
    ///
    /// # Shapes
    ///
    /// `actions`: one per cook.
    pub fn step(&mut self, actions: &[Action]) -> &[ActionOutcome] {
        for (cook, action) in actions.iter().enumerate() {
            self.outcomes[cook] = match action {
                Action::Interact => self.interact(cook),
                Action::Go(_) | Action::Stay => ActionOutcome::NOTHING,
            };
        }
        self.go(actions);
        for (content, slot) in self.state.contents.iter_mut().zip(&self.grid.slots) {
            if slot.station == Station::Grill {
                content.tick(self.times.cook);
            }
        }
        &self.outcomes
    }

    /// Turns the cooks, and moves all of them unless two would collide.
    fn go(&mut self, actions: &[Action]) {
        self.intended.clear();
        for (cook, action) in self.state.cooks.iter().zip(actions) {
            let Pose { place, .. } = cook.pose;
            let intended = match *action {
                Action::Go(facing) => self.grid.free_ahead(Pose { place, facing }),
                Action::Stay | Action::Interact => None,
            };
            self.intended.push(intended.unwrap_or(place));
        }
        let moves = !self.collide();
        let cooks = self.state.cooks.iter_mut().zip(&self.intended);
        for ((cook, &intended), (action, outcome)) in
            cooks.zip(actions.iter().zip(&mut self.outcomes))
        {
            let Action::Go(direction) = *action else { continue };
            let place = if moves { intended } else { cook.pose.place };
            let pose = Pose { place, facing: direction };
            outcome.changed = pose != cook.pose;
            cook.pose = pose;
        }
    }

    /// Returns whether two cooks would be on one tile, or change places.
    fn collide(&self) -> bool {
        let cooks = &self.state.cooks;
        let mut pairs = (0..cooks.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
        pairs.any(|(a, b)| {
            let (to_a, to_b) = (self.intended[a], self.intended[b]);
            to_a == to_b || (to_a == cooks[b].pose.place && to_b == cooks[a].pose.place)
        })
    }

    /// Frees every station that somebody else used.
    pub(super) fn release(&mut self) {
        let contents = self.state.contents.iter_mut();
        contents.filter(|it| **it == Content::Unavailable).for_each(|it| *it = Content::Empty);
    }
}

/// Returns the pose in which every cook starts: facing south.
pub fn start_pose(place: GridPlace) -> Pose {
    Pose { place, facing: Direction::South }
}
