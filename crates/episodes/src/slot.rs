//! One environment with the episode that is being played in it, and its snapshot.

use leadtime_numerics::Pcg64;
use leadtime_proto::limits::may_hold;
use leadtime_proto::{EnvId, EpisodeSummary, packed};
use leadtime_sims::environment::{read_snapshot, write_snapshot};
use leadtime_sims::{Environment, EpisodeSeed, SnapshotError, StepOutcome};
use serde::{Deserialize, Serialize};

/// The part of a slot that its environment does not hold. No observation: restoring the environment writes it.
#[derive(Serialize, Deserialize)]
struct SlotSnapshot {
    episode: u64,
    episode_return: f64,
    length: u32,
    #[serde(with = "packed")]
    recurrent: Vec<f32>,
    #[serde(with = "serde_bytes")]
    env: Vec<u8>,
}

/// One environment among those that are stepped together.
pub struct EnvSlot {
    pub(crate) env: Box<dyn Environment>,
    pub(crate) observation: Vec<f32>,
    pub(crate) recurrent: Vec<f32>,
    pub(crate) draws: Pcg64,
    seed: EpisodeSeed,
    episode_return: f64,
    n_steps: u32,
}

impl std::fmt::Debug for EnvSlot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EnvSlot").field("seed", &self.seed).finish_non_exhaustive()
    }
}

impl EnvSlot {
    /// Starts an episode in an environment, for a policy with a recurrent state of the given width.
    pub fn new(env: Box<dyn Environment>, recurrent_dim: usize, seed: EpisodeSeed) -> Self {
        let mut slot = Self::idle(env, recurrent_dim, seed);
        slot.begin(seed);
        slot
    }

    /// Continues from a snapshot; the environment's future is the same, bit for bit, or it begins an episode if it is one that
    /// cannot be restored.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the bytes are not a snapshot of such a slot.
    pub fn restored(
        env: Box<dyn Environment>,
        recurrent_dim: usize,
        run_seed: u64,
        env_id: EnvId,
        bytes: &[u8],
    ) -> Result<Self, SnapshotError> {
        let snapshot: SlotSnapshot = read_snapshot(bytes)?;
        if snapshot.recurrent.len() != recurrent_dim {
            return Err(SnapshotError::Mismatch { what: "width of the recurrent state" });
        }
        let is_paid = snapshot.length > 0 || snapshot.episode_return == 0.0;
        let within =
            may_hold(snapshot.episode_return) && snapshot.recurrent.iter().copied().all(may_hold);
        if !is_paid || !within {
            return Err(SnapshotError::Mismatch { what: "return or recurrent state" });
        }
        let seed = EpisodeSeed { run_seed, env_id, episode: snapshot.episode };
        if !seed.may_be() {
            return Err(SnapshotError::Mismatch { what: "number of the episode" });
        }
        let mut slot = Self::idle(env, recurrent_dim, seed);
        slot.env.restore(&snapshot.env, &mut slot.observation)?;
        // One that cannot go on where it was has begun an episode, to which nothing of the other one belongs.
        if slot.env.is_restorable() {
            slot.episode_return = snapshot.episode_return;
            slot.n_steps = snapshot.length;
            slot.recurrent = snapshot.recurrent;
        }
        Ok(slot)
    }

    fn idle(env: Box<dyn Environment>, recurrent_dim: usize, seed: EpisodeSeed) -> Self {
        Self {
            observation: vec![0.0; env.spec().obs_dim],
            recurrent: vec![0.0; recurrent_dim],
            draws: Pcg64::seed_from_u64(0),
            env,
            seed,
            episode_return: 0.0,
            n_steps: 0,
        }
    }

    /// Starts another episode: resets the environment with this seed and clears recurrent state and counters.
    pub fn begin(&mut self, seed: EpisodeSeed) {
        (self.seed, self.episode_return, self.n_steps) = (seed, 0.0, 0);
        self.recurrent.fill(0.0);
        self.env.reset(seed, &mut self.observation);
    }

    /// Starts the next episode of the same environment.
    pub fn begin_next(&mut self) {
        self.begin(self.seed.following());
    }

    /// Sets the stream from which a sampling policy's actions are drawn.
    pub fn draw_from(&mut self, stream: Pcg64) {
        self.draws = stream;
    }

    /// Appends everything that the slot's future depends on, except the stream of action draws.
    pub fn snapshot(&self, out: &mut Vec<u8>) {
        let mut env = Vec::new();
        self.env.snapshot(&mut env);
        let snapshot = SlotSnapshot {
            episode: self.seed.episode,
            episode_return: self.episode_return,
            length: self.n_steps,
            recurrent: self.recurrent.clone(),
            env,
        };
        write_snapshot(&snapshot, out);
    }

    /// Returns the environment, to be looked at.
    pub fn env(&self) -> &dyn Environment {
        self.env.as_ref()
    }

    /// Lends the environment and the observation of it, to somebody who restores both.
    pub fn env_mut(&mut self) -> (&mut dyn Environment, &mut [f32]) {
        (self.env.as_mut(), &mut self.observation)
    }

    /// Lends what a player keeps from step to step: a policy's recurrent state, a script's numbers.
    pub fn memory(&mut self) -> &mut [f32] {
        &mut self.recurrent
    }

    /// Returns the latest observation. Shape `[D]`.
    pub fn observation(&self) -> &[f32] {
        &self.observation
    }

    /// Returns the policy's recurrent state. Shape `[S]`.
    pub fn recurrent(&self) -> &[f32] {
        &self.recurrent
    }

    /// Returns what names the episode's random streams.
    pub fn seed(&self) -> EpisodeSeed {
        self.seed
    }

    /// Returns the sum of the episode's raw rewards so far.
    pub fn episode_return(&self) -> f64 {
        self.episode_return
    }

    /// Returns the number of steps of the episode so far.
    pub fn n_steps(&self) -> u32 {
        self.n_steps
    }

    /// Returns the task's metrics of the episode so far.
    pub fn metrics(&self) -> Vec<f32> {
        let mut metrics = vec![0.0; self.env.spec().metrics.len()];
        self.env.metrics(&mut metrics);
        metrics
    }

    /// Summarises the episode so far.
    pub fn summary(&self) -> EpisodeSummary {
        EpisodeSummary {
            episode: self.seed.episode,
            episode_return: self.episode_return,
            length: self.n_steps,
            metrics: self.metrics(),
        }
    }

    pub(crate) fn step(&mut self, action: &[u8]) -> StepOutcome {
        let outcome = self.env.step(action, &mut self.observation);
        self.episode_return += f64::from(outcome.reward);
        // A snapshot may be made up.
        self.n_steps = self.n_steps.saturating_add(1);
        outcome
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::limits::{MAX_COUNT, MAX_MAGNITUDE};
    use leadtime_proto::{ActionSpec, EnvSpec};

    use super::*;

    /// Pays 1 for every step, and may begin anew where it should go on.
    struct Paying {
        spec: EnvSpec,
        goes_on: bool,
    }

    impl Environment for Paying {
        fn spec(&self) -> &EnvSpec {
            &self.spec
        }

        fn reset(&mut self, _seed: EpisodeSeed, observation: &mut [f32]) {
            observation.fill(0.0);
        }

        fn step(&mut self, _action: &[u8], observation: &mut [f32]) -> StepOutcome {
            observation.fill(1.0);
            StepOutcome { reward: 1.0, end: None }
        }

        fn metrics(&self, _out: &mut [f32]) {}

        fn is_restorable(&self) -> bool {
            self.goes_on
        }

        fn write_state(&self, _out: &mut Vec<u8>) {}

        fn read_state(
            &mut self,
            _state: &[u8],
            observation: &mut [f32],
        ) -> Result<(), SnapshotError> {
            observation.fill(if self.goes_on { 1.0 } else { 0.0 });
            Ok(())
        }
    }

    #[test]
    fn what_begins_an_episode_when_it_is_restored_has_nothing_of_the_one_before() {
        for (goes_on, episode_return, n_steps, memory) in
            [(true, 1.0, 1, 0.5), (false, 0.0, 0, 0.0)]
        {
            let actions = ActionSpec::discrete("action", 2);
            let spec = EnvSpec { obs_dim: 1, actions, metrics: Vec::new() };
            let env = || Box::new(Paying { spec: spec.clone(), goes_on });
            let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(2), episode: 3 };
            let mut slot = EnvSlot::new(env(), 1, seed);
            slot.step(&[0]);
            slot.memory().fill(0.5);
            let mut bytes = Vec::new();
            slot.snapshot(&mut bytes);
            let slot = EnvSlot::restored(env(), 1, seed.run_seed, seed.env_id, &bytes).unwrap();
            assert_eq!(slot.episode_return(), episode_return);
            assert_eq!((slot.n_steps(), slot.recurrent()), (n_steps, &[memory][..]));
            assert_eq!(slot.seed(), seed);
        }
    }

    #[test]
    fn what_no_rollout_may_hold_is_not_restored() {
        let actions = ActionSpec::discrete("action", 2);
        let spec = EnvSpec { obs_dim: 1, actions, metrics: Vec::new() };
        let env = || Box::new(Paying { spec: spec.clone(), goes_on: true });
        let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(2), episode: 3 };
        for (episode_return, memory, fits) in [
            (1.0, 0.5, true),
            (f64::NAN, 0.5, false),
            (2.0 * MAX_MAGNITUDE, 0.5, false),
            (1.0, f32::NAN, false),
            (1.0, f32::MAX, false),
        ] {
            let mut slot = EnvSlot::new(env(), 1, seed);
            slot.step(&[0]);
            slot.episode_return = episode_return;
            slot.memory().fill(memory);
            let mut bytes = Vec::new();
            slot.snapshot(&mut bytes);
            let restored = EnvSlot::restored(env(), 1, seed.run_seed, seed.env_id, &bytes);
            assert_eq!(restored.is_ok(), fits, "{episode_return} {memory}");
        }
    }

    #[test]
    fn an_episode_that_no_run_reaches_is_not_restored_and_one_that_is_restored_can_be_followed() {
        let actions = ActionSpec::discrete("action", 2);
        let spec = EnvSpec { obs_dim: 1, actions, metrics: Vec::new() };
        let env = || Box::new(Paying { spec: spec.clone(), goes_on: true });
        let again = |episode: u64, follows: bool| {
            let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(2), episode };
            let (mut slot, mut bytes) = (EnvSlot::new(env(), 1, seed), Vec::new());
            slot.n_steps = u32::MAX;
            slot.step(&[0]);
            if follows {
                slot.begin_next();
            }
            slot.snapshot(&mut bytes);
            EnvSlot::restored(env(), 1, seed.run_seed, seed.env_id, &bytes).is_ok()
        };
        assert!(again(MAX_COUNT, false) && again(MAX_COUNT - 1, true) && again(MAX_COUNT, true));
        assert!(!again(MAX_COUNT + 1, false) && !again(u64::MAX, false));
    }
}
