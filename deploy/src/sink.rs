//! What the learner calls while it works: its progress is written down, shown and logged.

use std::io;
use std::path::PathBuf;

use leadtime_learner::{ProgressSink, RatedPolicy, RunEvent, UpdateProgress};
use leadtime_runs::RunRecorder;
use tokio_util::sync::CancellationToken;

use crate::display::Display;

/// Records a run's progress and shows it.
#[derive(Debug)]
pub struct RunSink {
    directory: PathBuf,
    recorder: RunRecorder,
    display: Display,
    has_warned: bool,
    stop: Option<(u64, CancellationToken)>,
}

impl RunSink {
    /// Shows what a recorder writes into a run directory.
    pub fn new(directory: PathBuf, recorder: RunRecorder) -> Self {
        Self { directory, recorder, display: Display::new(), has_warned: false, stop: None }
    }

    /// Asks the run to stop once it has made this many updates in all.
    pub fn stop_after(&mut self, n_updates: Option<u64>, shutdown: CancellationToken) {
        self.stop = n_updates.map(|n_updates| (n_updates, shutdown));
    }

    /// Warns once that a file cannot be written; the run goes on, because its checkpoints are what it needs.
    fn warn(&mut self, result: io::Result<()>) {
        if let Err(error) = result
            && !self.has_warned
        {
            self.has_warned = true;
            tracing::warn!(directory = %self.directory.display(), "metrics or policies cannot be written: {error:#}");
        }
    }
}

impl ProgressSink for RunSink {
    fn on_update(&mut self, progress: &UpdateProgress) {
        let written = self.recorder.update(progress);
        self.warn(written);
        self.display.update(progress);
        if let Some((n_updates, shutdown)) = &self.stop
            && progress.n_updates >= *n_updates
        {
            shutdown.cancel();
        }
    }

    fn on_event(&mut self, event: &RunEvent) {
        if let RunEvent::Resumed { n_updates, .. } = event {
            let resumed = self.recorder.resumed(*n_updates);
            self.warn(resumed);
        }
        log(event);
    }

    fn on_policies(&mut self, last: &RatedPolicy, best: Option<&RatedPolicy>) {
        let written = self.recorder.policies(last, best);
        self.warn(written);
    }
}

impl Drop for RunSink {
    fn drop(&mut self) {
        self.display.finish();
    }
}

fn log(event: &RunEvent) {
    match event {
        RunEvent::Listening { locators } => {
            tracing::info!(at = %locators.join(", "), "listening");
        }
        RunEvent::Resumed { path, n_updates } => {
            tracing::info!(n_updates, checkpoint = %path.display(), "resumed");
        }
        RunEvent::CheckpointDamaged { path, damage } => {
            tracing::warn!(checkpoint = %path.display(), "a checkpoint cannot be used: {damage}; taking the one before");
        }
        RunEvent::ActorJoined { actor, n_actors } => {
            tracing::info!(%actor, n_actors, "actor joined");
        }
        RunEvent::ActorLeft { actor, n_actors, n_envs } => {
            tracing::info!(%actor, n_actors, n_envs, "actor left");
        }
        RunEvent::WaitingForActors { n_actors, n_needed } => {
            tracing::info!("waiting for actors: {n_actors} of {n_needed}");
        }
        RunEvent::Assigned { actor, epoch, n_given, n_kept } => {
            tracing::debug!(%actor, %epoch, n_given, n_kept, "environments assigned");
        }
        RunEvent::Refused { actor, cause, reason } => {
            let actor = actor.as_ref().map_or("unknown", |actor| actor.as_str());
            tracing::warn!(actor, ?cause, "message refused: {reason}");
        }
        RunEvent::CutOff { actor, reason, .. } => {
            tracing::warn!(%actor, "actor cut off: {reason}");
        }
        RunEvent::OtherBuild { actor, build } => {
            let who = actor.as_ref().map_or("this learner", |actor| actor.as_str());
            let (program, cpu) = (&build.program, &build.cpu);
            tracing::warn!(
                who,
                program,
                cpu,
                "another build of the program, or class of CPU, than before: the run is not reproducible bit for bit"
            );
        }
        RunEvent::WaitingForRollouts { actor, n_envs, waited } => {
            let seconds = waited.as_secs();
            tracing::warn!(
                "waiting for rollouts of actor {actor} ({n_envs} environments) for {seconds} s"
            );
        }
        RunEvent::Distrusted { actor, reason } => {
            tracing::warn!(%actor, "the other actors take environments over from this one: {reason}");
        }
        RunEvent::TooManyActors { n_actors, n_envs } => {
            tracing::warn!(
                "{n_actors} actors for {n_envs} environments: some have nothing to do (see learner.n_envs)"
            );
        }
        RunEvent::SnapshotRefused { actor, env_id } => {
            tracing::warn!(%actor, %env_id, "the actor cannot restore the environment from its snapshot");
        }
        RunEvent::SnapshotLost { env_id } => {
            tracing::warn!(%env_id, "nobody can restore the environment from its snapshot: its last rollout is made again, or a fresh episode begins");
        }
        RunEvent::CheckpointWritten { path, n_updates } => {
            tracing::debug!(n_updates, checkpoint = %path.display(), "checkpointed");
        }
        RunEvent::Stopping => tracing::info!("stopping: writing checkpoint and books"),
    }
}
