//! Your own domain, by example: a corridor with wet floors, trained by Leadtime's actors and learner.
//!
//! ```text
//! left    . . . . ~ . . . . . . . . . ~ . . . . . goal       ~ wet floor, which the walker does not see
//! right   > . . . . . . . . ~ . . . . . . . . . . goal       > walker: one cell per word, stays in their lane
//! ```
//!
//! The walker would slip on the first wet floor in their lane. The notifier sees it coming and has to say `go left`
//! or `go right` early enough: the walker needs k words to understand a message, and two more steps to react.
//!
//! ```bash
//! cargo run --release --example corridor -- smoke --domain corridor     # trains it and shows that it learned
//! cargo run --release --example corridor -- check -c corridor           # plays it: is a restored episode the same?
//! cargo run --release --example corridor -- up -c corridor --actors 2   # every other command works as well
//! ```
//!
//! Everything a world needs is here: what [`Domain`] asks for, and the settings it is trained with.

use std::process::ExitCode;

use leadtime::Program;
use leadtime_numerics::Purpose;
use leadtime_sims::environment::{read_snapshot, write_snapshot};
use leadtime_sims::notifier::NotifierWorld;
use leadtime_sims::{
    Advance, Domain, DomainEntry, End, EpisodeSeed, Fact, Gauge, Message, Quantity, ReactionStatus,
    ReactionStep, RewardTerm, Scene, SettingError, Shape, SnapshotError, Tone, View,
};
use serde::{Deserialize, Serialize};

/// Cells from start to goal.
const LENGTH: i32 = 40;
/// Wet floors per episode, one in every ten cells from the tenth on.
const N_WET: usize = 3;
/// How far ahead the notifier sees, in cells.
const SIGHT: i32 = 12;

fn main() -> ExitCode {
    let corridor = DomainEntry::notifier::<World>("corridor");
    Program::new().with_domain(corridor).with_defaults("corridor", SETTINGS).run()
}

/// What differs from the defaults of the code and, below them, of every notifier task.
const SETTINGS: &str = include_str!("corridor.toml");

/// The section `[world]` of a configuration: what this world can be told.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
struct World {
    /// Reward for reaching the goal; slipping costs the same.
    goal_reward: f64,
}

impl Default for World {
    fn default() -> Self {
        Self { goal_reward: 1.0 }
    }
}

impl NotifierWorld for World {
    type Task = Corridor;

    fn domain(&self) -> Result<Corridor, SettingError> {
        Ok(Corridor { world: self.clone(), state: State::default() })
    }
}

/// Everything the future depends on.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
struct State {
    cell: i32,
    /// 0: left, 1: right.
    lane: usize,
    /// Cell and lane of every wet floor, nearest first.
    wet: Vec<(i32, usize)>,
    slipped: bool,
}

#[derive(Debug)]
struct Corridor {
    world: World,
    state: State,
}

impl Corridor {
    /// Returns the next wet floor in sight.
    fn ahead(&self) -> Option<(i32, usize)> {
        let near = |(cell, _): &(i32, usize)| (1..=SIGHT).contains(&(cell - self.state.cell));
        self.state.wet.iter().copied().find(near)
    }
}

impl Domain for Corridor {
    fn topics(&self) -> &[&'static str] {
        &["go_left", "go_right"]
    }

    fn obs_dim(&self) -> usize {
        4
    }

    /// For `leadtime describe`, policy files and the findings of `leadtime check`; training needs none of it.
    fn quantities(&self) -> Vec<Quantity> {
        vec![
            Quantity::flag("lane", "the walker's lane: 0 left, 1 right"),
            Quantity::flag("wet", "whether there is a wet floor in sight"),
            Quantity::flag("distance", format!("cells to it, in {SIGHT} cells")),
            Quantity::flag("wet_lane", "its lane; 0.5 if there is none"),
        ]
    }

    fn reward_terms(&self) -> Vec<RewardTerm> {
        let goal = self.world.goal_reward;
        vec![
            RewardTerm::new("reaching the goal", goal, "world.goal_reward"),
            RewardTerm::new("slipping", -goal, "world.goal_reward"),
        ]
    }

    /// What sentences may presuppose: "wet floor ahead" is said only where it is so.
    fn facts(&self) -> Vec<Fact> {
        let meaning = "a wet floor is in sight, in the walker's lane";
        vec![Fact { name: "wet_ahead", meaning }]
    }

    fn observe_facts(&self, holds: &mut [bool]) {
        holds[0] = self.ahead().is_some_and(|(_, lane)| lane == self.state.lane);
    }

    fn reset(&mut self, seed: EpisodeSeed) {
        // Everything is set anew: nothing of the episode before may remain.
        let mut rng = seed.stream(Purpose::World);
        let mut wet_floor = |n: usize| {
            let cell = 10 * (n as i32 + 1) + rng.below(4) as i32;
            (cell, rng.below(2))
        };
        let wet = (0..N_WET).map(&mut wet_floor).collect();
        self.state = State { cell: 0, lane: rng.below(2), wet, slipped: false };
    }

    fn observe(&self, out: &mut [f32]) {
        let ahead = self.ahead();
        out[0] = self.state.lane as f32;
        out[1] = f32::from(u8::from(ahead.is_some()));
        out[2] = ahead.map_or(0.0, |(cell, _)| (cell - self.state.cell) as f32 / SIGHT as f32);
        out[3] = ahead.map_or(0.5, |(_, lane)| lane as f32);
    }

    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
        // The walker changes lanes once per message, in the first step of the reaction.
        let reaction = reaction.map(|asked| {
            if asked.first {
                self.state.lane = asked.topic;
            }
            ReactionStatus::Followed
        });
        self.state.cell += 1;
        self.state.slipped = self.state.wet.contains(&(self.state.cell, self.state.lane));
        let arrived = self.state.cell >= LENGTH;
        let reward = match (self.state.slipped, arrived) {
            (true, _) => -self.world.goal_reward,
            (false, true) => self.world.goal_reward,
            (false, false) => 0.0,
        };
        let end = (self.state.slipped || arrived).then_some(End::Terminated);
        Advance { reward, reaction, end }
    }

    fn heuristic(&self) -> Option<Message> {
        let (cell, lane) = self.ahead()?;
        let danger = lane == self.state.lane && cell - self.state.cell <= 8;
        danger.then_some(Message { topic: 1 - lane, comprehension: 2, conveyance: 2 })
    }

    fn success(&self) -> bool {
        self.state.cell >= LENGTH && !self.state.slipped
    }

    fn metric_names(&self) -> &'static [&'static str] {
        &["slipped"]
    }

    fn metrics(&self, out: &mut [f32]) {
        out[0] = f32::from(u8::from(self.state.slipped));
    }

    fn snapshot(&self, out: &mut Vec<u8>) {
        write_snapshot(&self.state, out);
    }

    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        self.state = read_snapshot(snapshot)?;
        Ok(())
    }

    fn scene(&self) -> Scene {
        let y = |lane: usize| if lane == 0 { 2.0 } else { 0.0 };
        let cell = |at: i32, lane: usize, tone| Shape::Rectangle {
            min: [f64::from(at), y(lane)],
            max: [f64::from(at) + 1.0, y(lane) + 1.0],
            tone,
        };
        let wet = self.state.wet.iter().map(|&(at, lane)| cell(at, lane, Tone::Danger));
        let goal = [cell(LENGTH, 0, Tone::Goal), cell(LENGTH, 1, Tone::Goal)];
        let walker = cell(self.state.cell, self.state.lane, Tone::Own);
        Scene {
            view: View { min: [-1.0, -3.0], max: [f64::from(LENGTH) + 2.0, 6.0] },
            shapes: wet.chain(goal).chain([walker]).collect(),
            position: [f64::from(self.state.cell) + 0.5, y(self.state.lane) + 0.5],
            gauge: Gauge { label: "cell", value: f64::from(self.state.cell) },
            outcome: if self.state.slipped { "slipped".to_owned() } else { String::new() },
            ..Scene::default()
        }
    }
}
