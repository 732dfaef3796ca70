//! The thread that trains, so that the learner's loop keeps answering meanwhile.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use leadtime_ppo::{TrainError, Trainer, TrainerState, UpdateReport};
use leadtime_proto::{CheckedRollout, PolicyVersion};
use tokio::sync::mpsc;

use crate::Error;

/// One job and one result may be under way.
const DEPTH: usize = 1;

/// What the trainer is asked to do.
#[derive(Debug)]
pub(crate) enum Job {
    /// Make an update of these rollouts, and copy the state afterwards if asked to.
    Update {
        /// Sorted by environment and iteration.
        rollouts: Vec<CheckedRollout>,
        /// A checkpoint is due.
        want_state: bool,
    },
    /// Copy the state.
    State,
}

/// A finished update.
#[derive(Debug)]
pub(crate) struct Updated {
    pub(crate) report: UpdateReport,
    pub(crate) version: PolicyVersion,
    pub(crate) weights: Arc<[u8]>,
    pub(crate) state: Option<Box<TrainerState>>,
    pub(crate) rollouts: Vec<CheckedRollout>,
    pub(crate) took: Duration,
}

/// What came of a job.
#[derive(Debug)]
pub(crate) enum Outcome {
    Updated(Box<Updated>),
    State(Box<TrainerState>),
    Failed(Error),
}

/// The loop's end of the training thread.
#[derive(Debug)]
pub(crate) struct Training {
    jobs: SyncSender<Job>,
    outcomes: mpsc::Receiver<Outcome>,
}

impl Training {
    /// Starts the thread; it ends when this value is dropped.
    pub(crate) fn start(trainer: Trainer) -> Result<Self, Error> {
        let (jobs, inbox) = sync_channel(DEPTH);
        let (outbox, outcomes) = mpsc::channel(DEPTH);
        thread::Builder::new()
            .name("learner-train".to_owned())
            .spawn(move || work(trainer, &inbox, &outbox))
            .map_err(Error::Thread)?;
        Ok(Self { jobs, outcomes })
    }

    /// Hands a job over; there must be no other under way.
    pub(crate) fn begin(&self, job: Job) -> Result<(), Error> {
        self.jobs.try_send(job).map_err(|_gone| Error::TrainerGone)
    }

    /// Waits for the result of the job under way.
    pub(crate) async fn outcome(&mut self) -> Outcome {
        self.outcomes.recv().await.unwrap_or(Outcome::Failed(Error::TrainerGone))
    }
}

fn work(mut trainer: Trainer, inbox: &Receiver<Job>, outbox: &mpsc::Sender<Outcome>) {
    while let Ok(job) = inbox.recv() {
        let outcome = match job {
            Job::State => trainer.state().map_or_else(
                |error| Outcome::Failed(error.into()),
                |s| Outcome::State(Box::new(s)),
            ),
            Job::Update { rollouts, want_state } => update(&mut trainer, rollouts, want_state)
                .map_or_else(Outcome::Failed, |updated| Outcome::Updated(Box::new(updated))),
        };
        if outbox.blocking_send(outcome).is_err() {
            return; // The run is over and nobody waits for the result.
        }
    }
}

fn update(
    trainer: &mut Trainer,
    rollouts: Vec<CheckedRollout>,
    want_state: bool,
) -> Result<Updated, Error> {
    let started = Instant::now();
    let report = trainer.update(&rollouts)?;
    let weights = encode(trainer)?;
    let state = if want_state { Some(Box::new(trainer.state()?)) } else { None };
    Ok(Updated {
        report,
        version: trainer.version(),
        weights,
        state,
        rollouts,
        took: started.elapsed(),
    })
}

/// Writes the trainer's parameters as actors pull them.
pub(crate) fn encode(trainer: &Trainer) -> Result<Arc<[u8]>, Error> {
    let bytes = trainer.parameters().to_safetensors(&BTreeMap::new()).map_err(TrainError::from)?;
    Ok(bytes.into())
}
