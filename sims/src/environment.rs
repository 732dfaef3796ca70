//! What every task looks like to actors, learner, wire and evaluation: they know nothing else.
//!
//! An environment is stepped one decision at a time. It never resets itself: whoever drives it sees the final
//! observation first. Its whole future depends on its snapshot and on the actions to come, because every random
//! draw comes from streams named by [`EpisodeSeed`].

use leadtime_numerics::{Pcg64, Purpose, stream};
use leadtime_proto::{EgoAttention, EnvId, EnvSpec, Mask};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{Entities, Scene, Speech};

/// Names the random streams of one episode of one environment of one run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpisodeSeed {
    /// Seed of the run.
    pub run_seed: u64,
    /// The environment.
    pub env_id: EnvId,
    /// The how-manieth episode of this environment, from 0.
    pub episode: u64,
}

impl EpisodeSeed {
    /// Opens the episode's stream for one purpose.
    pub fn stream(&self, purpose: Purpose) -> Pcg64 {
        stream(self.run_seed, purpose, self.env_id.0, self.episode)
    }
}

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// A true end: nothing comes after it.
    Terminated,
    /// A time limit: the value of the final observation stands for what would have come.
    Truncated,
}

/// How an observation begins that is a history of observations of entities.
///
/// `n_frames` times: `entities` (row by row), then `action_dim` numbers about the own action. More may follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EntityHistory {
    /// How many observations there are, oldest first.
    pub n_frames: usize,
    /// What each consists of.
    pub entities: Entities,
    /// Numbers behind each.
    pub action_dim: usize,
}

impl EntityHistory {
    /// Returns the ego attention that reads it.
    pub fn attention(&self, width: usize, n_heads: usize) -> EgoAttention {
        let Self { n_frames, entities: Entities { n_entities, n_features }, action_dim } = *self;
        EgoAttention { n_frames, n_entities, n_features, action_dim, width, n_heads }
    }
}

/// What one step gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepOutcome {
    /// Raw reward.
    pub reward: f32,
    /// The end of the episode, if this step was its last.
    pub end: Option<End>,
}

/// What is in a person's head, for whoever measures what a policy knows of it: no policy ever sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Insight {
    /// The reaction delay `d_r` of a message that would be understood now, in steps; `None` where every message draws
    /// its own.
    pub reaction_delay: Option<u32>,
    /// Messages that were understood in this episode.
    pub comprehended: u32,
    /// The last step was the first in which the person did what some message asks for.
    pub reaction_began: bool,
    /// The running utterance.
    pub speech: Option<Speech>,
}

/// Why a snapshot cannot be restored.
#[derive(Debug, Error)]
pub enum SnapshotError {
    /// The bytes are not a snapshot of this kind of environment.
    #[error("snapshot cannot be read by this environment")]
    Codec(#[from] leadtime_proto::codec::CodecError),
    /// The snapshot is of another world, or of other settings.
    #[error("snapshot does not fit this environment: {what}")]
    Mismatch {
        /// What differs.
        what: &'static str,
    },
}

/// How much a snapshot may grow beyond twice its size at the start, in bytes.
const SNAPSHOT_MARGIN: usize = 8 << 10;

/// A task that a policy can learn.
pub trait Environment: Send {
    /// Returns shapes, heads and metric names.
    fn spec(&self) -> &EnvSpec;

    /// Tells how the observation is a history of entities, if it is: what an attention encoder needs to know.
    fn entity_history(&self) -> Option<EntityHistory> {
        None
    }

    /// Starts an episode and writes its first observation.
    ///
    /// # Shapes
    ///
    /// `observation`: `[obs_dim]`.
    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]);

    /// Returns the choices that are offered in the coming step.
    fn mask(&self) -> Mask {
        Mask::ALL
    }

    /// Takes one step and writes the observation after it (the final one, if the episode ended).
    ///
    /// # Shapes
    ///
    /// `action`: one choice per head; `observation`: `[obs_dim]`.
    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome;

    /// Writes the metrics of the episode so far, in the order of [`EnvSpec::metrics`].
    fn metrics(&self, out: &mut [f32]);

    /// Appends everything the future depends on.
    fn snapshot(&self, out: &mut Vec<u8>);

    /// Returns an upper bound on the size of a snapshot, in bytes; starts an episode to measure one.
    ///
    /// Worlds remember more than at the start of an episode: a lander that touches the ground some four kilobytes of contacts.
    fn max_snapshot_bytes(&mut self) -> usize {
        let mut observation = vec![0.0; self.spec().obs_dim];
        let seed = EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode: 0 };
        self.reset(seed, &mut observation);
        let mut snapshot = Vec::new();
        self.snapshot(&mut snapshot);
        2 * snapshot.len() + SNAPSHOT_MARGIN
    }

    /// Continues from a snapshot, bit for bit, and writes the observation at that point.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the bytes are no snapshot of such an environment; it must then be reset.
    fn restore(&mut self, snapshot: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError>;

    /// Lists the scripted policies that this task knows, such as `unaided` and `heuristic`.
    fn baselines(&self) -> &'static [&'static str] {
        &[]
    }

    /// Writes the action that a scripted policy takes now; `false` if there is no such policy.
    fn baseline_action(&self, _name: &str, _action: &mut [u8]) -> bool {
        false
    }

    /// Tells what is in the person's head, if there is a person who listens.
    ///
    /// A step that was taken before a snapshot was restored is not remembered: no reaction began in it.
    fn insight(&self) -> Option<Insight> {
        None
    }

    /// Describes the present moment for a picture, if there is anything to draw.
    fn scene(&self) -> Option<Scene> {
        None
    }
}

/// Writes a state through the project's one codec.
///
/// # Panics
///
/// Never for plain data; a state that cannot be written is a bug of the environment.
pub fn write_snapshot<T: Serialize>(state: &T, out: &mut Vec<u8>) {
    let bytes = leadtime_proto::codec::encode(state).expect("plain data can be encoded");
    out.extend_from_slice(&bytes);
}

/// Reads a state back.
///
/// # Errors
///
/// [`SnapshotError::Codec`] if the bytes are not such a state.
pub fn read_snapshot<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, SnapshotError> {
    Ok(leadtime_proto::codec::decode(bytes, leadtime_proto::limits::MAX_SNAPSHOT_BYTES)?)
}
