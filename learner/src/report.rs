//! What a run reports while it goes on and when it ends.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use leadtime_link::Archive;
use leadtime_ppo::UpdateReport;
use leadtime_proto::{ActorId, EnvId, Epoch, Incarnation, PolicyVersion, RefusalCause};
use leadtime_trace::TraceSpan;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::books::{Books, Imbalance};
use crate::builds::{Build, Builds};
use crate::episodes::EpisodeMeans;
use crate::held_out::HeldOutMeans;

/// Where the learner's time went between two updates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhaseTimes {
    /// The trainer had nothing to do: rollouts were missing.
    pub wait: Duration,
    /// An update was computed.
    pub train: Duration,
    /// Checkpoints were written to the disk.
    pub checkpoint: Duration,
    /// The new weights were put on offer.
    pub weights: Duration,
}

/// The health of a run at one moment, whether it makes updates or not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunHealth {
    /// Actors that are connected and take part.
    pub n_actors: usize,
    /// Whether they are enough for the run to go on.
    pub has_enough_actors: bool,
    /// Environments of which no rollout waits.
    pub n_envs_waiting: usize,
    /// Accepted rollouts that wait for their update.
    pub n_queued: usize,
    /// Bytes of messages that were received and not looked at yet.
    pub queued_bytes: usize,
    /// For how long the newest state could not be saved; `None` if it can be.
    pub unsaved: Option<Duration>,
    /// Updates wait until the state can be saved.
    pub is_paused: bool,
    /// Messages refused so far, by cause, those before a resume included.
    pub refusals: BTreeMap<RefusalCause, u64>,
}

/// One update, and how the run stands after it.
#[derive(Clone, Debug)]
pub struct UpdateProgress {
    /// The update's own figures.
    pub update: UpdateReport,
    /// Updates so far, those before a resume included.
    pub n_updates: u64,
    /// Updates of the whole run.
    pub n_updates_total: u64,
    /// Environment steps trained on so far.
    pub n_steps: u64,
    /// Environment steps per second since the update before.
    pub steps_per_second: f64,
    /// Where the time went.
    pub phases: PhaseTimes,
    /// The last training episodes.
    pub episodes: EpisodeMeans,
    /// The newest evaluation on held-out episodes; `None` before the first.
    pub held_out: Option<HeldOutMeans>,
    /// Actors that are connected and take part.
    pub n_actors: usize,
    /// Accepted rollouts that wait for their update.
    pub n_queued: usize,
    /// The books after the update.
    pub books: Books,
}

/// The state of one actor, as the learner sees it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RosterEntry {
    /// The actor's name, unique in the run.
    pub id: ActorId,
    /// Its start, in hexadecimal as in keys.
    pub incarnation: String,
    /// Environments that it steps.
    pub envs: usize,
    /// The assignment under which it got the newest of them; 0 without any.
    pub epoch: u64,
    /// The iteration of its last rollout; `None` before the first.
    pub iteration: Option<u64>,
    /// How many versions older than the newest its policy was in that rollout.
    pub staleness: Option<u64>,
    /// Rollouts that arrived in order.
    pub acknowledged: u64,
    /// The highest sequence that it may publish.
    pub limit: u64,
    /// Its refused messages by cause.
    pub refused: BTreeMap<RefusalCause, u64>,
    /// Seconds since its last rollout, in steps of a tick.
    pub silent_s: f64,
}

/// Something that happens now and then.
#[derive(Clone, Debug)]
pub enum RunEvent {
    /// The learner can be reached.
    Listening {
        /// The addresses, with the port that was taken.
        locators: Vec<String>,
    },
    /// The run goes on from a checkpoint.
    Resumed {
        /// The checkpoint's file that was read.
        path: PathBuf,
        /// Updates done before, which the checkpoint holds.
        n_updates: u64,
        /// Environment steps that they trained on.
        n_steps: u64,
        /// Training episodes that ended in them.
        n_episodes: u64,
        /// The books with which the run goes on.
        books: Books,
    },
    /// A checkpoint could not be used; an older one was.
    CheckpointDamaged {
        /// The file that is damaged; it stays until the run has passed it.
        path: PathBuf,
        /// What is wrong with it.
        damage: String,
    },
    /// An actor takes part from now on.
    ActorJoined {
        /// The actor that is a member now.
        actor: ActorId,
        /// How many there are now.
        n_actors: usize,
    },
    /// An actor is gone: killed, cut off from the network, or at its end.
    ActorLeft {
        /// The actor that was a member.
        actor: ActorId,
        /// How many there are now.
        n_actors: usize,
        /// How many environments it had.
        n_envs: usize,
    },
    /// Nothing can be trained, because actors are missing; reported again while that lasts.
    WaitingForActors {
        /// How many there are.
        n_actors: usize,
        /// How many there have to be.
        n_needed: usize,
    },
    /// Nothing can be trained, because this actor's rollouts are missing; reported again while that lasts.
    WaitingForRollouts {
        /// The actor that the run waits for.
        actor: ActorId,
        /// How many of its environments lack a rollout.
        n_envs: usize,
        /// For how long the run has been waiting.
        waited: Duration,
    },
    /// An actor gives some or all of its environments to the others, and has to wait before it gets more.
    Distrusted {
        /// The actor that gives environments back.
        actor: ActorId,
        /// Half a sentence: what it did.
        reason: &'static str,
    },
    /// An actor follows an assignment that this learner did not give; it gets its environments anew.
    Astray {
        /// The actor that does so.
        actor: ActorId,
        /// The number of that assignment.
        told: Epoch,
    },
    /// There are more actors than environments, so some have nothing to do.
    TooManyActors {
        /// Actors that are connected and take part.
        n_actors: usize,
        /// Environments of the run.
        n_envs: usize,
    },
    /// An actor cannot restore an environment from its snapshot; another one tries.
    SnapshotRefused {
        /// The actor that cannot.
        actor: ActorId,
        /// The environment that it cannot restore.
        env_id: EnvId,
    },
    /// A rollout is refused for what it holds, and that may follow from what others made of the episode before: it is not charged to
    /// its sender, and another actor tries to go on from the same snapshot.
    InheritedRefused {
        /// The actor that sent the rollout.
        actor: ActorId,
        /// The environment that it is of.
        env_id: EnvId,
        /// The actor that began the episode; `None` if that was before this start of the learner.
        begun_by: Option<ActorId>,
        /// The refusal as a sentence.
        reason: String,
    },
    /// No actor goes on with an environment from its snapshot: its last rollouts are made again if they still waited, or it
    /// begins a fresh episode.
    SnapshotLost {
        /// The environment whose snapshot is given up.
        env_id: EnvId,
    },
    /// An actor was given another set of environments.
    Assigned {
        /// The actor that steps them from now on.
        actor: ActorId,
        /// The number of the assignment.
        epoch: Epoch,
        /// How many environments it was given.
        n_given: usize,
        /// How many it keeps.
        n_kept: usize,
    },
    /// The first refused message of a cause from an actor; the following ones are only counted.
    Refused {
        /// The sender, if that is known.
        actor: Option<ActorId>,
        /// What it is counted by.
        cause: RefusalCause,
        /// The refusal as a sentence.
        reason: String,
    },
    /// An actor was cut off.
    CutOff {
        /// The actor that is not listened to any more.
        actor: ActorId,
        /// The start of the actor that this is about.
        incarnation: Incarnation,
        /// The sentence that it is sent.
        reason: String,
    },
    /// Another build of the program, or class of CPU, takes part than those before: it may compute other numbers.
    OtherBuild {
        /// The actor that runs it; `None`: this learner.
        actor: Option<ActorId>,
        /// What it computes with.
        build: Build,
    },
    /// A checkpoint is on the disk.
    CheckpointWritten {
        /// The file that was written.
        path: PathBuf,
        /// Updates that it holds.
        n_updates: u64,
    },
    /// A checkpoint cannot be written: training goes on, and it is tried again.
    CheckpointFailed {
        /// What is wrong, and what to do.
        reason: String,
        /// Pause between two tries.
        retry: Duration,
    },
    /// No further update is begun until a checkpoint can be written.
    Paused {
        /// For how long none could be.
        unsaved: Duration,
    },
    /// A checkpoint could be written again.
    CheckpointRecovered {
        /// For how long none could be.
        unsaved: Duration,
    },
    /// The end of the run cannot be saved: it is kept in memory for a while, and tried again.
    Unsaved {
        /// What is wrong, and what to do.
        reason: String,
        /// For how long it is kept.
        kept: Duration,
    },
    /// A policy could not be evaluated on held-out episodes; the run goes on without.
    EvaluationFailed {
        /// The version of the policy that was to play.
        version: PolicyVersion,
        /// What kept it from being evaluated, as half a sentence.
        reason: String,
    },
    /// The newest policy is as good as was asked for: the run ends with it.
    Reached {
        /// What it did on held-out episodes.
        means: HeldOutMeans,
    },
    /// Training is done, and its last policies are still being evaluated on held-out episodes.
    Evaluating,
    /// The run is asked to end.
    Stopping,
}

/// A policy with what it achieved.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RatedPolicy {
    /// The updates that it has learned from.
    pub version: PolicyVersion,
    /// Mean success (or return) of the last training episodes, once there are enough.
    pub score: Option<f64>,
    /// How it did on held-out episodes, once it was evaluated on them.
    pub held_out: Option<HeldOutMeans>,
    /// Parameters as safetensors, without metadata.
    #[serde(serialize_with = "write_bytes", deserialize_with = "read_bytes")]
    pub weights: Arc<[u8]>,
}

fn write_bytes<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}

fn read_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Arc<[u8]>, D::Error> {
    serde_bytes::deserialize(deserializer).map(|bytes: Vec<u8>| bytes.into())
}

/// Takes in what a run reports; called from the run's loop, so it must be quick.
pub trait ProgressSink: Send {
    /// Takes in an update.
    fn on_update(&mut self, progress: &UpdateProgress);

    /// Takes in anything else that happens.
    fn on_event(&mut self, event: &RunEvent);

    /// Takes in the newest and the best policy, whenever a checkpoint is written; the newest is the best one as long as none
    /// was evaluated. With them come all evaluations so far, the oldest first: the disk may have been full when they were made.
    fn on_policies(&mut self, last: &RatedPolicy, best: &RatedPolicy, held_out: &[HeldOutMeans]);

    /// Takes in every evaluation on held-out episodes so far, the oldest first, whenever there is one more.
    fn on_held_out(&mut self, history: &[HeldOutMeans]);

    /// Returns the last update as observers receive it, JSON with `"kind": "update"`; `None` where nothing is sent.
    fn bulletin(&mut self) -> Option<Vec<u8>> {
        None
    }

    /// Returns what observers may ask for; asked once, before the first update.
    fn archive(&self) -> Option<Archive> {
        None
    }

    /// Takes in how a thread of the learner spent its time, for a trace of the run; called a few times per update.
    fn on_span(&mut self, _span: &TraceSpan<'_>) {}

    /// Takes in how the run stands; called about twice a second, for as long as the run's loop goes round.
    fn on_tick(&mut self, _health: &RunHealth) {}
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunEnd {
    /// All updates are done, or the newest policy is as good as was asked for.
    Finished,
    /// It had been finished before; nothing was done.
    AlreadyFinished,
    /// It was asked to stop and can be resumed.
    Stopped,
}

impl RunEnd {
    /// Returns the name under which observers receive it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Finished | Self::AlreadyFinished => "finished",
            Self::Stopped => "stopped",
        }
    }
}

/// What a run leaves behind.
#[derive(Clone, Debug)]
pub struct RunReport {
    /// Whether it finished or was ended early.
    pub end: RunEnd,
    /// Updates done, over all resumes.
    pub n_updates: u64,
    /// Environment steps trained on, over all resumes.
    pub n_steps: u64,
    /// SHA-256 over the parameters: equal runs have equal digests.
    pub digest: [u8; 32],
    /// The policy after the last update.
    pub last: RatedPolicy,
    /// The best one by held-out episodes; the newest where none was evaluated.
    pub best: RatedPolicy,
    /// Every evaluation on held-out episodes, the oldest first.
    pub held_out: Vec<HeldOutMeans>,
    /// The last training episodes.
    pub episodes: EpisodeMeans,
    /// How many rollouts each staleness had.
    pub staleness: BTreeMap<u64, u64>,
    /// The books at the end of the run.
    pub books: Books,
    /// Whether the books balance.
    pub balance: Result<(), Imbalance>,
    /// Whether the same seed would give the same bits: a deterministic schedule, one build of the
    /// program, one class of CPU.
    pub reproducible: bool,
    /// Everyone who computed the run, over all resumes.
    pub builds: Builds,
}
