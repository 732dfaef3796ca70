//! One environment as an actor steps it, and its snapshot.

use leadtime_numerics::{Pcg64, Purpose, stream};
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{EnvId, EpisodeSummary, Iteration, packed};
use leadtime_sims::environment::{read_snapshot, write_snapshot};
use leadtime_sims::{Environment, EpisodeSeed, SnapshotError};
use serde::{Deserialize, Serialize};

/// What of a lane is not in its environment; the observation is, because restoring writes it.
#[derive(Serialize, Deserialize)]
struct LaneSnapshot {
    episode: u64,
    episode_return: f64,
    length: u32,
    #[serde(with = "packed")]
    recurrent: Vec<f32>,
    #[serde(with = "serde_bytes")]
    env: Vec<u8>,
}

/// One environment with everything that goes on from rollout to rollout.
pub(crate) struct Lane {
    pub(crate) env_id: EnvId,
    pub(crate) iteration: Iteration,
    pub(crate) env: Box<dyn Environment>,
    pub(crate) observation: Vec<f32>,
    pub(crate) recurrent: Vec<f32>,
    run_seed: u64,
    episode: u64,
    episode_return: f64,
    length: u32,
}

impl Lane {
    /// Starts an environment from the beginning, or goes on from a snapshot.
    pub(crate) fn new(
        run_seed: u64,
        env: Box<dyn Environment>,
        recurrent_dim: usize,
        assignment: &EnvAssignment,
    ) -> Result<Self, SnapshotError> {
        let mut lane = Self {
            env_id: assignment.env_id,
            iteration: assignment.iteration,
            observation: vec![0.0; env.spec().obs_dim],
            recurrent: vec![0.0; recurrent_dim],
            env,
            run_seed,
            episode: 0,
            episode_return: 0.0,
            length: 0,
        };
        if assignment.snapshot.is_empty() {
            lane.reset();
        } else {
            lane.restore(&assignment.snapshot)?;
        }
        Ok(lane)
    }

    /// Opens the stream of action draws of the rollout at hand.
    pub(crate) fn action_stream(&self) -> Pcg64 {
        stream(self.run_seed, Purpose::Act, self.env_id.0, self.iteration.0)
    }

    /// Counts a step of the episode.
    pub(crate) fn count(&mut self, reward: f32) {
        self.episode_return += f64::from(reward);
        self.length += 1;
    }

    /// Sums up the episode so far.
    pub(crate) fn summary(&self) -> EpisodeSummary {
        let mut metrics = vec![0.0; self.env.spec().metrics.len()];
        self.env.metrics(&mut metrics);
        EpisodeSummary {
            episode: self.episode,
            episode_return: self.episode_return,
            length: self.length,
            metrics,
        }
    }

    /// Goes on to the next episode.
    pub(crate) fn next_episode(&mut self) {
        self.episode += 1;
        self.reset();
    }

    /// Appends everything that the lane's future depends on, beside its iteration.
    pub(crate) fn snapshot(&self, out: &mut Vec<u8>) {
        let mut env = Vec::new();
        self.env.snapshot(&mut env);
        let snapshot = LaneSnapshot {
            episode: self.episode,
            episode_return: self.episode_return,
            length: self.length,
            recurrent: self.recurrent.clone(),
            env,
        };
        write_snapshot(&snapshot, out);
    }

    fn reset(&mut self) {
        self.episode_return = 0.0;
        self.length = 0;
        self.recurrent.fill(0.0);
        let (run_seed, env_id, episode) = (self.run_seed, self.env_id, self.episode);
        self.env.reset(EpisodeSeed { run_seed, env_id, episode }, &mut self.observation);
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SnapshotError> {
        let snapshot: LaneSnapshot = read_snapshot(bytes)?;
        if snapshot.recurrent.len() != self.recurrent.len() {
            return Err(SnapshotError::Mismatch { what: "width of the recurrent state" });
        }
        self.episode = snapshot.episode;
        self.episode_return = snapshot.episode_return;
        self.length = snapshot.length;
        self.recurrent = snapshot.recurrent;
        self.env.restore(&snapshot.env, &mut self.observation)
    }
}
