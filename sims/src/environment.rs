//! What every task looks like to actors, learner, wire and evaluation: they know nothing else.
//!
//! An environment is stepped one decision at a time. It never resets itself: its driver sees the final
//! observation first. Its whole future depends on its snapshot and on the actions to come, because every random
//! draw comes from streams named by [`EpisodeSeed`].

use leadtime_numerics::{Pcg64, Purpose, stream};
use leadtime_proto::limits::MAX_COUNT;
use leadtime_proto::{EgoAttention, EnvId, EnvSpec, Mask};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::description::{Description, Quantity};
use crate::fact::Fact;
use crate::notifier::Session;
use crate::scene::{Scene, Word};
use crate::scriptable::Scriptable;

/// Names the random streams of one episode of one environment of one run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpisodeSeed {
    /// Seed of the run.
    pub run_seed: u64,
    /// Which of the run's environments.
    pub env_id: EnvId,
    /// Zero-based index of the episode within its environment.
    pub episode: u64,
}

impl EpisodeSeed {
    /// Opens the episode's stream for one purpose.
    pub fn stream(&self, purpose: Purpose) -> Pcg64 {
        stream(self.run_seed, purpose, self.env_id.0, self.episode)
    }

    /// Returns whether an environment may have come to the episode. A snapshot may be made up.
    pub fn may_be(&self) -> bool {
        self.episode <= MAX_COUNT
    }

    /// Returns the seed of the next episode of the same environment. One that [may be](Self::may_be) stays so: nobody is to blame
    /// for having gone on with it.
    #[must_use]
    pub fn following(self) -> Self {
        Self { episode: if self.episode < MAX_COUNT { self.episode + 1 } else { 0 }, ..self }
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

/// An observation that consists of entities: rows of numbers, one entity each.
///
/// The listener's own entity comes first; the first number of a row says whether there is anything (1) or not (0).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entities {
    /// How many entities there is room for: one row each.
    pub n_entities: usize,
    /// Numbers per entity, the presence flag included.
    pub n_features: usize,
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
    /// Numbers about the own action behind each observation.
    pub action_dim: usize,
}

impl EntityHistory {
    /// Returns the ego attention that reads it.
    pub fn attention(&self, width: usize, n_heads: usize) -> EgoAttention {
        let Self { n_frames, entities: Entities { n_entities, n_features }, action_dim } = *self;
        EgoAttention { n_frames, n_entities, n_features, action_dim, width, n_heads }
    }
}

/// The result of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepOutcome {
    /// Reward of the task, not normalised.
    pub reward: f32,
    /// The end of the episode, if this step was its last.
    pub end: Option<End>,
}

/// The listener's hidden state, for measuring what a policy knows of it; no policy ever sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Insight {
    /// The reaction delay `d_r` of a message that would be understood now, in steps; `None` where every message draws
    /// its own.
    pub reaction_delay: Option<u32>,
    /// Messages that were understood in this episode.
    pub comprehended: u32,
    /// The last step was the first in which the listener did what some message asks for.
    pub reaction_began: bool,
    /// The word that was heard in the last step, be it the last one of its message; `None` in silence.
    pub word: Option<Word>,
}

/// The layout of every environment's snapshots; a change to any of them adds 1. A choice behind all others, such as a car's role on
/// the highway, is none: what was written before is read as it was meant, and an earlier build refuses what has the new one.
const SNAPSHOT_SCHEMA: u32 = 3;
/// How a snapshot begins; what was written before there was a schema does not.
const SNAPSHOT_MARK: [u8; 4] = *b"ltS\xf5";
/// Bytes before the state: the mark, the schema, the task.
const SNAPSHOT_TAG: usize = 16;

/// Why a snapshot cannot be restored.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum SnapshotError {
    /// It was written by a release with other layouts, or by none at all.
    #[error(
        "snapshot was not written by this release of Leadtime, which reads schema {SNAPSHOT_SCHEMA} only: continue the \
         run with the release that began it, or begin a new run"
    )]
    OtherRelease,
    /// It is of another task, or of one that looks otherwise: other shapes, heads or metrics.
    #[error("snapshot is of another task, or of this one with other settings")]
    OtherTask,
    /// The bytes are not a snapshot of this kind of environment.
    #[error("snapshot cannot be read by this environment")]
    Codec(#[from] leadtime_proto::codec::CodecError),
    /// The snapshot was made by another world, or under other settings.
    #[error("snapshot does not fit this environment: {what}")]
    Mismatch { what: &'static str },
    /// What steps the environment, outside of this process, has failed; the snapshot may be sound.
    #[error("{0}")]
    Outside(String),
}

/// A task that a policy can learn.
pub trait Environment: Send {
    /// Returns shapes, heads and metric names.
    fn spec(&self) -> &EnvSpec;

    /// Says what the numbers of the observation, the choices of the action and the parts of the reward are.
    fn describe(&self) -> Description {
        Description::unnamed(self.spec())
    }

    /// Describes the observation as a history of entities, if it is one: an attention encoder needs to know.
    fn entity_history(&self) -> Option<EntityHistory> {
        None
    }

    /// Starts an episode and writes its first observation. Shape `[obs_dim]`.
    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]);

    /// Returns the choices that are offered in the coming step.
    fn mask(&self) -> Mask {
        Mask::ALL
    }

    /// Takes in the action of the coming step, before any environment next to this one takes its own. One that is
    /// stepped in another process sends it there, so that the steps of a batch are taken together; all others need not
    /// know.
    fn announce(&mut self, _action: &[u8]) {}

    /// Takes one step (one choice per head) and writes the observation after it: the final one, if the episode ended.
    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome;

    /// Writes the metrics of the episode so far, in the order of [`EnvSpec::metrics`].
    fn metrics(&self, out: &mut [f32]);

    /// Says why the environment cannot be stepped any more, if what steps it outside of this process has failed. Each of its
    /// episodes is over after one step then, and nothing that it has shown since counts.
    fn failure(&self) -> Option<String> {
        None
    }

    /// Returns whether a restored environment goes on where it was. One that does not begins an episode instead.
    fn is_restorable(&self) -> bool {
        true
    }

    /// Appends everything the future depends on.
    fn write_state(&self, out: &mut Vec<u8>);

    /// Continues from a state, bit for bit, and writes the observation at that point.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the bytes are no state of such an environment; it must then be reset.
    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError>;

    /// Appends the state, with a tag in front that says what can read it.
    fn snapshot(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&snapshot_tag(self.spec()));
        self.write_state(out);
    }

    /// Returns how much a snapshot may grow beyond twice its size at the start of an episode, in bytes.
    fn snapshot_margin(&self) -> usize {
        256
    }

    /// Returns an upper bound on the size of a snapshot, in bytes; starts an episode to measure one.
    fn max_snapshot_bytes(&mut self) -> usize {
        let mut observation = vec![0.0; self.spec().obs_dim];
        let seed = EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode: 0 };
        self.reset(seed, &mut observation);
        let mut snapshot = Vec::new();
        self.snapshot(&mut snapshot);
        2 * snapshot.len() + self.snapshot_margin()
    }

    /// Continues from a snapshot, bit for bit, and writes the observation at that point.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the bytes are no snapshot of such an environment in this release; it must then be reset.
    fn restore(&mut self, snapshot: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        let own = snapshot_tag(self.spec());
        let parts = snapshot.split_at_checked(SNAPSHOT_TAG);
        let (tag, state) = parts.ok_or(SnapshotError::OtherRelease)?;
        // The encoding says nothing about what it encodes, so bytes of another layout may well decode into a state.
        if tag[..8] != own[..8] {
            return Err(SnapshotError::OtherRelease);
        }
        if tag != own {
            return Err(SnapshotError::OtherTask);
        }
        self.read_state(state, observation)
    }

    /// Lists the scripted policies that this task knows, such as `unaided` and `heuristic`.
    fn baselines(&self) -> &'static [&'static str] {
        &[]
    }

    /// Writes the action that a scripted policy takes now; `false` if there is no such policy.
    fn baseline_action(&self, _name: &str, _action: &mut [u8]) -> bool {
        false
    }

    /// Returns what a script of named numbers and messages needs, if messages are sent in this task.
    fn scriptable(&self) -> Option<&dyn Scriptable> {
        None
    }

    /// Returns the notifier of this task without its world and its listener, if messages are sent in it: what speaks to
    /// somebody who is no simulation. It has to begin an episode before anything else.
    fn session(&self) -> Option<Session> {
        None
    }

    /// Returns the listener's hidden state, if there is a listener.
    ///
    /// A step that was taken before a snapshot was restored is not remembered: no reaction began in it, and no word
    /// was heard.
    fn insight(&self) -> Option<Insight> {
        None
    }

    /// Lists the facts that the task can state, if there is a listener who hears sentences.
    fn facts(&self) -> Vec<Fact> {
        Vec::new()
    }

    /// Names those that hold now; a scene has them, too.
    fn facts_that_hold(&self) -> Vec<&'static str> {
        Vec::new()
    }

    /// Describes the present moment for a picture, if there is anything to draw.
    fn scene(&self) -> Option<Scene> {
        None
    }
}

/// Returns what snapshots of a task begin with: mark, schema, and a hash (FNV-1a) of what the task looks like.
fn snapshot_tag(spec: &EnvSpec) -> [u8; SNAPSHOT_TAG] {
    let heads = spec.actions.heads.iter().map(|head| (head.name.as_str(), head.n_choices));
    let metrics = spec.metrics.iter().map(|name| (name.as_str(), 0));
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for (name, number) in [("", spec.obs_dim)].into_iter().chain(heads).chain(metrics) {
        for byte in name.bytes().chain([0]).chain((number as u64).to_le_bytes()) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    let mut tag = [0; SNAPSHOT_TAG];
    tag[..4].copy_from_slice(&SNAPSHOT_MARK);
    tag[4..8].copy_from_slice(&SNAPSHOT_SCHEMA.to_le_bytes());
    tag[8..].copy_from_slice(&hash.to_le_bytes());
    tag
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

/// What a step of [`TwoPlayers`] has brought to both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedOutcome {
    /// The notifier's reward: the world's, what is paid for reactions, less the cost of messages.
    pub notifier_reward: f32,
    /// The listener's reward: the world's. Words cost them nothing.
    pub person_reward: f32,
    /// Why the episode ended, if it did.
    pub end: Option<End>,
}

/// A task for a notifier and a listener, who both may learn.
///
/// In an [`Environment`] the listener is the model of [`human`](crate::human). Here somebody else decides, step by
/// step, whether the listener carries out a topic or goes on by their own plan: a second policy, or a program that has
/// another model of listeners.
pub trait TwoPlayers: Send {
    /// Returns the notifier's side: shapes, heads, mask, metrics. It is stepped here and nowhere else.
    fn notifier(&self) -> &dyn Environment;

    /// Names the topics that the listener can carry out, by id.
    fn topics(&self) -> &[&'static str];

    /// Says what the numbers are that the listener sees and remembers: those of the world, how much was heard of the
    /// message that runs, the topic that was understood last, and how long ago that was.
    fn person_quantities(&self) -> Vec<Quantity>;

    /// Starts an episode and writes the first observation of both. Shapes `[obs_dim]`, `[person_quantities().len()]`.
    fn reset(&mut self, seed: EpisodeSeed, notifier: &mut [f32], person: &mut [f32]);

    /// Takes one step: the notifier's choices, one per head, and the topic that the listener carries out, or `None` for
    /// their own plan. Shapes as of [`TwoPlayers::reset`].
    ///
    /// # Panics
    ///
    /// If a choice is not one of its head's, or the topic is unknown.
    fn step(
        &mut self,
        action: &[u8],
        topic: Option<usize>,
        notifier: &mut [f32],
        person: &mut [f32],
    ) -> SharedOutcome;
}
