//! A task whose observation reveals the listener's delay as plainly as a test wants.

use leadtime_numerics::{Pcg64, Purpose};
use leadtime_proto::{ActionSpec, Encoder, EnvSpec, PolicySpec};
use leadtime_sims::{
    End, Environment, EpisodeSeed, Insight, SnapshotError, StepOutcome, TaskError,
};

use crate::measure::{Choice, Player};

/// What the observation reveals of the delay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Revealed {
    /// Everything, from the first reaction on.
    AfterTheFirstReaction,
    /// Nothing: it is noise.
    Nothing,
}

/// Numbers in an observation, besides the one that may reveal it.
const N_NOISE: usize = 7;
/// Steps from one reaction to the next.
const STEPS_PER_STAGE: u32 = 4;

/// A listener with a delay of 0 to 5 steps, who reacts every four steps whatever the message; up to eight times.
#[derive(Debug)]
pub(super) struct Synthetic {
    spec: EnvSpec,
    told: Revealed,
    noise: Pcg64,
    delay: u32,
    n_steps: u32,
    end: u32,
    /// Each message draws its own delay.
    pub(super) fickle: bool,
    /// The largest delay, in steps.
    pub(super) most: u32,
}

impl Synthetic {
    pub(super) fn new(told: Revealed) -> Self {
        let spec = spec();
        let noise = Pcg64::seed_from_u64(0);
        Self { spec, told, noise, delay: 0, n_steps: 0, end: 0, fickle: false, most: 5 }
    }

    fn observe(&mut self, observation: &mut [f32]) {
        for value in observation.iter_mut() {
            *value = self.noise.normal() as f32;
        }
        if self.told == Revealed::AfterTheFirstReaction {
            let seen = self.n_steps >= STEPS_PER_STAGE;
            observation[0] = if seen { self.delay as f32 - 2.5 } else { 0.0 };
        }
    }
}

impl Environment for Synthetic {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
        let mut listener = seed.stream(Purpose::Human);
        self.delay = listener.integers(0, i64::from(self.most) + 1) as u32;
        self.end = STEPS_PER_STAGE * (1 + listener.integers(0, 9) as u32);
        (self.noise, self.n_steps) = (seed.stream(Purpose::World), 0);
        self.observe(observation);
    }

    fn step(&mut self, _action: &[u8], observation: &mut [f32]) -> StepOutcome {
        self.n_steps += 1;
        self.observe(observation);
        let end = (self.n_steps >= self.end).then_some(End::Truncated);
        StepOutcome { reward: 0.0, end }
    }

    fn metrics(&self, _out: &mut [f32]) {}

    fn write_state(&self, _out: &mut Vec<u8>) {}

    fn read_state(&mut self, _: &[u8], _: &mut [f32]) -> Result<(), SnapshotError> {
        Err(SnapshotError::Mismatch { what: "a test's world" })
    }

    fn insight(&self) -> Option<Insight> {
        let n = self.n_steps;
        Some(Insight {
            reaction_delay: (!self.fickle).then_some(self.delay),
            comprehended: n / STEPS_PER_STAGE,
            reaction_began: n > 0 && n.is_multiple_of(STEPS_PER_STAGE),
            word: None,
        })
    }
}

fn spec() -> EnvSpec {
    let actions = ActionSpec::discrete("speak", 2);
    EnvSpec { obs_dim: 1 + N_NOISE, actions, metrics: Vec::new() }
}

pub(super) fn make(told: Revealed) -> impl Fn() -> Result<Box<dyn Environment>, TaskError> + Sync {
    move || Ok(Box::new(Synthetic::new(told)))
}

/// A network that was never trained: wide enough to keep what it sees.
pub(super) fn player() -> Player {
    let encoder = Encoder::Lstm { projection: 0, state: 12 };
    let spec = PolicySpec { encoder, ..PolicySpec::dense(&spec(), &[32]) };
    Player::untrained(&spec, 5, Choice::Sample).expect("the architecture is possible")
}
