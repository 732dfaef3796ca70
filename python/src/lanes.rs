//! Many environments in lockstep, without Python: an episode that ends is followed by the next one at once.

use leadtime_proto::EnvId;
use leadtime_sims::{End, Environment, EpisodeSeed};

use crate::choices::write_offered;

/// The environments, and what their newest step has shown.
pub(crate) struct Lanes {
    environments: Vec<Box<dyn Environment>>,
    run_seed: u64,
    /// The index of each environment's next episode.
    episodes: Vec<u64>,
    pub(crate) obs_dim: usize,
    n_heads: usize,
    n_metrics: usize,
    /// What the environments show. Shape `[n, obs_dim]`.
    pub(crate) observations: Vec<f32>,
    /// The rewards of the step. Shape `[n]`.
    pub(crate) rewards: Vec<f32>,
    /// Whether an episode has truly ended. Shape `[n]`.
    pub(crate) terminated: Vec<bool>,
    /// Whether a time limit cut an episode. Shape `[n]`.
    pub(crate) truncated: Vec<bool>,
    /// What may be chosen, 1 or 0 per choice. Shape `[n, n_choices]`.
    pub(crate) offered: Vec<i8>,
    /// The same as bits. Shape `[n]`.
    masks: Vec<u64>,
    /// The environments whose episodes have ended.
    pub(crate) ended: Vec<usize>,
    /// Their last observations. Shape `[n_ended, obs_dim]`.
    pub(crate) last: Vec<f32>,
    /// Their metrics. Shape `[n_ended, n_metrics]`.
    pub(crate) metrics: Vec<f32>,
}

impl Lanes {
    /// Arranges environments of one task, of which there is one at least.
    pub(crate) fn new(environments: Vec<Box<dyn Environment>>) -> Self {
        let (n, spec) = (environments.len(), environments[0].spec());
        let (obs_dim, n_choices) = (spec.obs_dim, spec.actions.n_choices());
        Self {
            run_seed: 0,
            episodes: vec![0; n],
            obs_dim,
            n_heads: spec.actions.heads.len(),
            n_metrics: spec.metrics.len(),
            observations: vec![0.0; n * obs_dim],
            rewards: vec![0.0; n],
            terminated: vec![false; n],
            truncated: vec![false; n],
            // Nothing is offered before an episode has begun.
            offered: vec![0; n * n_choices],
            masks: vec![0; n],
            ended: Vec::new(),
            last: Vec::new(),
            metrics: Vec::new(),
            environments,
        }
    }

    /// Starts an episode in each: those of the run with this seed, from its first ones on, or its next ones without a seed.
    pub(crate) fn reset(&mut self, run_seed: Option<u64>) {
        if let Some(run_seed) = run_seed {
            self.run_seed = run_seed;
            self.episodes.fill(0);
        }
        for lane in 0..self.environments.len() {
            self.begin(lane);
            self.look(lane);
        }
    }

    /// Takes a step in each. Shape of the actions: `[n, n_heads]`.
    pub(crate) fn step(&mut self, actions: &[u8]) {
        self.ended.clear();
        self.last.clear();
        self.metrics.clear();
        for (lane, action) in actions.chunks_exact(self.n_heads).enumerate() {
            let observation = &mut self.observations[lane * self.obs_dim..][..self.obs_dim];
            let environment = &mut self.environments[lane];
            let outcome = environment.step(action, observation);
            self.rewards[lane] = outcome.reward;
            self.terminated[lane] = outcome.end == Some(End::Terminated);
            self.truncated[lane] = outcome.end == Some(End::Truncated);
            if outcome.end.is_some() {
                self.ended.push(lane);
                self.last.extend_from_slice(observation);
                let before = self.metrics.len();
                self.metrics.resize(before + self.n_metrics, 0.0);
                environment.metrics(&mut self.metrics[before..]);
                self.begin(lane);
            }
            self.look(lane);
        }
    }

    /// Starts the next episode of an environment.
    fn begin(&mut self, lane: usize) {
        let (run_seed, episode) = (self.run_seed, self.episodes[lane]);
        let seed = EpisodeSeed { run_seed, env_id: EnvId(lane as u32), episode };
        let observation = &mut self.observations[lane * self.obs_dim..][..self.obs_dim];
        self.environments[lane].reset(seed, observation);
        self.episodes[lane] += 1;
    }

    /// Notes what may be chosen in an environment.
    fn look(&mut self, lane: usize) {
        let mask = self.environments[lane].mask();
        // In most steps the same as before.
        if self.masks[lane] != mask.0 {
            self.masks[lane] = mask.0;
            let n_choices = self.offered.len() / self.masks.len();
            write_offered(mask, &mut self.offered[lane * n_choices..][..n_choices]);
        }
    }
}
