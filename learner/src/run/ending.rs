//! How a run ends: actors are told, the update under way is waited for, the state goes to the disk.

use std::sync::Arc;
use std::time::Duration;

use leadtime_link::LearnerEvent;
use leadtime_policy::Parameters;
use leadtime_ppo::TrainerState;
use tokio::time::{interval, timeout};
use tokio_util::sync::CancellationToken;
use tracing::warn;

use super::{Run, TICK};
use crate::report::{RatedPolicy, RunEnd, RunEvent, RunReport};
use crate::resume::Standing;
use crate::training::{Job, Outcome};
use crate::{Error, LearnerConfig};

/// How long the end of a run waits for actors to leave and for the update under way.
const FAREWELL: Duration = Duration::from_millis(2_500);
/// How long copying the trainer's state may take.
const STATE_TIMEOUT: Duration = Duration::from_secs(1);

impl Run {
    pub(super) async fn end(
        &mut self,
        events: &flume::Receiver<LearnerEvent>,
        end: RunEnd,
    ) -> Result<RunReport, Error> {
        self.sink.on_event(&RunEvent::Stopping);
        let reason = match end {
            RunEnd::Stopped => "the learner was asked to stop",
            RunEnd::Finished | RunEnd::AlreadyFinished => "the run is finished",
        };
        self.coordinator.stop_everyone(reason);
        self.act();
        self.farewell(events).await?;
        let state = self.final_state().await?;
        self.coordinator.close();
        let checkpointed = state.is_some();
        if let Some(state) = state {
            self.checkpoint(*state)?;
        } else {
            warn!("the update under way took too long; a resume will make it again");
        }
        let last = self.last();
        let parameters = Parameters::from_safetensors(&last.weights, &self.config.spec.policy)?;
        let books = self.coordinator.books().clone();
        Ok(RunReport {
            end,
            n_updates: self.n_updates,
            n_steps: self.n_updates * self.config.steps_per_update(),
            digest: parameters.digest()?,
            last,
            best: self.best.clone(),
            episodes: self.episodes.means(),
            staleness: self.staleness.clone(),
            balance: books.check(),
            books,
            reproducible: self.is_uniform() && self.config.settings.schedule().is_deterministic(),
            checkpointed,
        })
    }

    /// Goes on listening until the actors have left and the update under way is done, or time is up.
    pub(super) async fn farewell(
        &mut self,
        events: &flume::Receiver<LearnerEvent>,
    ) -> Result<(), Error> {
        let never = CancellationToken::new();
        let mut ticks = interval(TICK);
        let deadline = tokio::time::Instant::now() + FAREWELL;
        while self.coordinator.n_actors() > 0 || self.is_training {
            let wake = self.next_wake(events, &mut ticks, &never);
            match tokio::time::timeout_at(deadline, wake).await {
                Ok(wake) => self.handle(wake?, events)?,
                Err(_) => break,
            }
            self.act();
        }
        Ok(())
    }

    /// Copies the trainer's state, unless it is busy beyond patience.
    async fn final_state(&mut self) -> Result<Option<Box<TrainerState>>, Error> {
        if self.is_training {
            return Ok(None);
        }
        self.training.begin(Job::State)?;
        match timeout(STATE_TIMEOUT, self.training.outcome()).await {
            Ok(Outcome::State(state)) => Ok(Some(state)),
            Ok(Outcome::Failed(error)) => Err(error),
            Ok(Outcome::Updated(_)) | Err(_) => Ok(None),
        }
    }
}

/// Reports on a run that had all its updates before this start.
pub(super) fn already_finished(
    config: &LearnerConfig,
    standing: Standing,
) -> Result<RunReport, Error> {
    let version = standing.trainer.version();
    let score = standing.episodes.score();
    let last = RatedPolicy { version, score, weights: Arc::clone(&standing.offered[&version]) };
    let books = standing.start.books;
    Ok(RunReport {
        end: RunEnd::AlreadyFinished,
        n_updates: version.0,
        n_steps: version.0 * config.steps_per_update(),
        digest: standing.trainer.parameters().digest()?,
        last,
        best: standing.best,
        episodes: standing.episodes.means(),
        staleness: standing.staleness,
        balance: books.check(),
        books,
        reproducible: standing.uniform && config.settings.schedule().is_deterministic(),
        checkpointed: true,
    })
}
