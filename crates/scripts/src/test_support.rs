//! A small world for tests: a walker who is to stop just before an edge that only the notifier sees.

use leadtime_episodes::{EnvSlot, EpisodeObserver, Observer, PlaySettings, Player, play};
use leadtime_numerics::Purpose;
use leadtime_sims::environment::{read_snapshot, write_snapshot};
use leadtime_sims::human::{HumanSettings, ReactionDelay};
use leadtime_sims::notifier::NotifierSettings;
use leadtime_sims::{
    Advance, Domain, End, Environment, EpisodeSeed, NotifierEnv, Quantity, ReactionStatus,
    ReactionStep, Scene, SnapshotError, TaskError,
};
use serde::{Deserialize, Serialize};

/// How near to the edge the walker is to stop.
const NEAR: u32 = 3;

#[derive(Debug, Default, Serialize, Deserialize)]
struct Walk {
    n_steps: u32,
    edge: u32,
    stopped: bool,
}

#[derive(Debug, Default)]
struct Cliff {
    walk: Walk,
}

impl Cliff {
    fn left(&self) -> u32 {
        self.walk.edge - self.walk.n_steps
    }
}

impl Domain for Cliff {
    fn topics(&self) -> &[&'static str] {
        &["stop", "sing"]
    }

    fn obs_dim(&self) -> usize {
        1
    }

    fn quantities(&self) -> Vec<Quantity> {
        vec![Quantity::new("walked", "steps so far", [0.0, 30.0])]
    }

    fn script_quantities(&self) -> Vec<Quantity> {
        vec![Quantity::new("left", "steps to the edge", [0.0, 30.0])]
    }

    fn observe_for_scripts(&self, out: &mut [f32]) {
        out[0] = self.left() as f32;
    }

    fn reset(&mut self, seed: EpisodeSeed) {
        let edge = 12 + seed.stream(Purpose::World).below(10) as u32;
        self.walk = Walk { edge, ..Walk::default() };
    }

    fn observe(&self, out: &mut [f32]) {
        out[0] = self.walk.n_steps as f32;
    }

    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
        self.walk.stopped |= reaction.is_some_and(|it| it.topic == 0);
        self.walk.n_steps += u32::from(!self.walk.stopped);
        let end = (self.walk.stopped || self.left() == 0).then_some(End::Terminated);
        Advance { reward: 1.0, reaction: reaction.map(|_| ReactionStatus::Followed), end }
    }

    fn success(&self) -> bool {
        self.walk.stopped && self.left() <= NEAR
    }

    fn scripts(&self) -> &'static [&'static str] {
        &["unaided"]
    }

    fn metric_names(&self) -> &'static [&'static str] {
        &[]
    }

    fn metrics(&self, _out: &mut [f32]) {}

    fn snapshot(&self, out: &mut Vec<u8>) {
        write_snapshot(&self.walk, out);
    }

    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        self.walk = read_snapshot(snapshot)?;
        Ok(())
    }

    fn scene(&self) -> Scene {
        Scene::default()
    }
}

/// Makes the task; the listener's delay varies from message to message.
pub(crate) fn cliff() -> Result<Box<dyn Environment>, TaskError> {
    cliff_with(&NotifierSettings::default())
}

/// Makes the same task with another notifier.
pub(crate) fn cliff_with(notifier: &NotifierSettings) -> Result<Box<dyn Environment>, TaskError> {
    let delay = r#"{"uniform": {"low": 1, "high": 2, "drawn": "per_notification"}}"#;
    let reaction_delay: ReactionDelay = serde_json::from_str(delay).unwrap();
    let human = HumanSettings { reaction_delay, ..HumanSettings::default() };
    Ok(Box::new(NotifierEnv::new(Cliff::default(), &human, notifier)?))
}

/// What an episode gave: success, return, messages.
pub(crate) type Gave = [f64; 3];

struct Giving;

impl Observer for Giving {}

impl EpisodeObserver for Giving {
    type Output = Gave;

    fn finish(self, slot: &EnvSlot, _end: End) -> Gave {
        let metrics = slot.metrics();
        [f64::from(metrics[0]), slot.episode_return(), f64::from(metrics[1])]
    }
}

/// Plays episodes of a task as an evaluation does.
pub(crate) fn played(player: &Player, n_episodes: u64, seed: u64) -> Vec<Gave> {
    play(&cliff, player, &PlaySettings::new(n_episodes, seed), |_| Giving).unwrap()
}

pub(crate) fn share(gave: &[Gave]) -> f64 {
    gave.iter().map(|it| it[0]).sum::<f64>() / gave.len() as f64
}
