//! What a run tells while it goes on and when it ends.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use leadtime_ppo::UpdateReport;
use leadtime_proto::{ActorId, Epoch, Incarnation, PolicyVersion, RefusalCause};

use crate::books::{Books, Imbalance};
use crate::checkpoint::Damage;
use crate::episodes::EpisodeMeans;

/// Where the learner's time went between two updates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhaseTimes {
    /// The trainer had nothing to do: rollouts were missing.
    pub wait: Duration,
    /// Training.
    pub train: Duration,
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
    /// Actors connected.
    pub n_actors: usize,
    /// Rollouts waiting.
    pub n_queued: usize,
    /// The books.
    pub books: Books,
}

/// Something that happens now and then.
#[derive(Clone, Debug)]
pub enum RunEvent {
    /// The learner can be reached.
    Listening {
        /// Where.
        locators: Vec<String>,
    },
    /// The run goes on from a checkpoint.
    Resumed {
        /// Which.
        path: PathBuf,
        /// Updates done.
        n_updates: u64,
    },
    /// A checkpoint could not be used; an older one was.
    CheckpointDamaged {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        damage: Arc<Damage>,
    },
    /// An actor is in.
    ActorJoined {
        /// Which.
        actor: ActorId,
        /// How many there are now.
        n_actors: usize,
    },
    /// An actor is gone: killed, cut off from the network, or at its end.
    ActorLeft {
        /// Which.
        actor: ActorId,
        /// How many there are now.
        n_actors: usize,
        /// How many environments it had.
        n_envs: usize,
    },
    /// Nothing can be trained, because actors are missing; told again while that lasts.
    WaitingForActors {
        /// How many there are.
        n_actors: usize,
        /// How many there have to be.
        n_needed: usize,
    },
    /// Environments moved.
    Assigned {
        /// To whom.
        actor: ActorId,
        /// Under which assignment.
        epoch: Epoch,
        /// How many environments it was given.
        n_given: usize,
        /// How many it keeps.
        n_kept: usize,
    },
    /// The first refused message of a cause from an actor; the following ones are only counted.
    Refused {
        /// From whom, if that is known.
        actor: Option<ActorId>,
        /// What it is counted by.
        cause: RefusalCause,
        /// In words.
        reason: String,
    },
    /// An actor cannot go on from the snapshots of some environments that it was given.
    CannotRestore {
        /// The actor.
        actor: ActorId,
        /// How many environments.
        n_envs: usize,
    },
    /// An actor was cut off.
    CutOff {
        /// Which.
        actor: ActorId,
        /// Its start.
        incarnation: Incarnation,
        /// Why.
        reason: String,
    },
    /// An actor runs another build of the program than the learner: it may compute other numbers.
    OtherProgram {
        /// Which.
        actor: ActorId,
        /// Its fingerprint.
        program: String,
    },
    /// An actor runs on another class of CPU than the learner: results may differ in the last bits.
    OtherCpu {
        /// Which.
        actor: ActorId,
        /// Its fingerprint.
        cpu: String,
    },
    /// A checkpoint is on the disk.
    CheckpointWritten {
        /// Where.
        path: PathBuf,
        /// Updates it holds.
        n_updates: u64,
    },
    /// The run is asked to end.
    Stopping,
}

/// A policy with what it achieved in training.
#[derive(Clone, Debug)]
pub struct RatedPolicy {
    /// Its version.
    pub version: PolicyVersion,
    /// Mean success (or return) of the last training episodes, once there are enough.
    pub score: Option<f64>,
    /// Parameters as safetensors, without metadata.
    pub weights: Arc<[u8]>,
}

/// Takes in what a run tells; called from the run's loop, so it must be quick.
pub trait ProgressSink: Send {
    /// Is told about every update.
    fn on_update(&mut self, progress: &UpdateProgress);

    /// Is told about everything else.
    fn on_event(&mut self, event: &RunEvent);

    /// Is handed the newest and the best policy whenever a checkpoint is written.
    fn on_policies(&mut self, last: &RatedPolicy, best: Option<&RatedPolicy>);
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunEnd {
    /// All updates are done.
    Finished,
    /// It had been finished before; nothing was done.
    AlreadyFinished,
    /// It was asked to stop and can be resumed.
    Stopped,
}

/// What a run leaves behind.
#[derive(Clone, Debug)]
pub struct RunReport {
    /// How it ended.
    pub end: RunEnd,
    /// Updates done, over all resumes.
    pub n_updates: u64,
    /// Environment steps trained on, over all resumes.
    pub n_steps: u64,
    /// SHA-256 over the parameters: equal runs have equal digests.
    pub digest: [u8; 32],
    /// The newest policy.
    pub last: RatedPolicy,
    /// The best one, if enough episodes were finished to tell.
    pub best: Option<RatedPolicy>,
    /// The last training episodes.
    pub episodes: EpisodeMeans,
    /// How many rollouts each staleness had.
    pub staleness: BTreeMap<u64, u64>,
    /// The books.
    pub books: Books,
    /// Whether the books balance.
    pub balance: Result<(), Imbalance>,
    /// Whether the same seed would give the same bits: a deterministic schedule, one build of the
    /// program, one class of CPU.
    pub reproducible: bool,
    /// Whether the state at the end is on the disk; if not, a resume goes on from an older checkpoint.
    pub checkpointed: bool,
}
