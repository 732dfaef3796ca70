//! The thread that trains, so that the learner's loop keeps answering meanwhile.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use leadtime_ppo::{TrainError, Trainer, TrainerState, UpdateReport};
use leadtime_proto::{CheckedRollout, EnvId, PolicyVersion};
use tokio::sync::mpsc;

use crate::Error;

/// One batch and one result may be under way.
const DEPTH: usize = 1;

/// The rollouts of an update, and the environments whose episodes so far are over without an end in a rollout.
type TrainingBatch = (Vec<CheckedRollout>, BTreeSet<EnvId>);

#[derive(Debug)]
pub(crate) struct Updated {
    pub(crate) report: UpdateReport,
    pub(crate) version: PolicyVersion,
    pub(crate) weights: Arc<[u8]>,
    /// The state after it: what a checkpoint holds, also while the next update is under way.
    pub(crate) state: TrainerState,
    pub(crate) rollouts: Vec<CheckedRollout>,
    pub(crate) started: Instant,
    /// Its parts, each with its end.
    pub(crate) parts: Vec<(&'static str, Instant)>,
    pub(crate) took: Duration,
}

/// The loop's end of the training thread.
#[derive(Debug)]
pub(crate) struct TrainingThread {
    batches: SyncSender<TrainingBatch>,
    updates: mpsc::Receiver<Result<Updated, Error>>,
}

impl TrainingThread {
    /// Starts the thread; it ends when this value is dropped.
    pub(crate) fn start(trainer: Trainer) -> Result<Self, Error> {
        let (batches, inbox) = sync_channel(DEPTH);
        let (outbox, updates) = mpsc::channel(DEPTH);
        thread::Builder::new()
            .name("learner-train".to_owned())
            .spawn(move || work(trainer, &inbox, &outbox))
            .map_err(Error::Thread)?;
        Ok(Self { batches, updates })
    }

    /// Begins an update from rollouts sorted by environment and iteration; no other may be under way. The episodes that the
    /// `broken_off` environments had before are over.
    pub(crate) fn begin(
        &self,
        rollouts: Vec<CheckedRollout>,
        broken_off: BTreeSet<EnvId>,
    ) -> Result<(), Error> {
        self.batches.try_send((rollouts, broken_off)).map_err(|_gone| Error::TrainerGone)
    }

    /// Waits for the end of the update under way.
    pub(crate) async fn updated(&mut self) -> Result<Updated, Error> {
        self.updates.recv().await.unwrap_or(Err(Error::TrainerGone))
    }
}

fn work(
    mut trainer: Trainer,
    inbox: &Receiver<TrainingBatch>,
    outbox: &mpsc::Sender<Result<Updated, Error>>,
) {
    while let Ok((rollouts, broken_off)) = inbox.recv() {
        for env_id in broken_off {
            trainer.forget_episode(env_id);
        }
        if outbox.blocking_send(update(&mut trainer, rollouts)).is_err() {
            return; // The run is over and nothing waits for the result.
        }
    }
}

fn update(trainer: &mut Trainer, rollouts: Vec<CheckedRollout>) -> Result<Updated, Error> {
    let started = Instant::now();
    let mut parts = Vec::new();
    let mut ended = |part| parts.push((part, Instant::now()));
    let report = trainer.update_in_parts(&rollouts, &mut ended)?;
    Ok(Updated {
        report,
        version: trainer.version(),
        weights: encode(trainer)?,
        state: trainer.state()?,
        rollouts,
        started,
        parts,
        took: started.elapsed(),
    })
}

/// Writes the trainer's parameters as actors pull them.
pub(crate) fn encode(trainer: &Trainer) -> Result<Arc<[u8]>, Error> {
    let bytes = trainer.parameters().to_safetensors(&BTreeMap::new()).map_err(TrainError::from)?;
    Ok(bytes.into())
}
