//! What the learner calls while it works: its progress is written down, shown and logged.

use std::io;
use std::path::PathBuf;

use leadtime_learner::{HeldOutMeans, ProgressSink, RatedPolicy, RunEvent, UpdateProgress};
use leadtime_proto::phrase::{counted, duration};
use leadtime_runs::RunRecorder;
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

use crate::display::Display;

/// Records a run's progress and shows it.
#[derive(Debug)]
pub(crate) struct RunSink {
    directory: PathBuf,
    recorder: RunRecorder,
    display: Display,
    has_warned: bool,
    /// Whether it was told that policies cannot be evaluated.
    has_told_failure: bool,
    /// After how many updates in all the run is asked to stop, and by what.
    stop: Option<(u64, CancellationToken)>,
}

impl RunSink {
    /// Shows what a recorder writes into a run directory.
    pub(crate) fn new(
        directory: PathBuf,
        recorder: RunRecorder,
        stop: Option<(u64, CancellationToken)>,
    ) -> Self {
        Self {
            directory,
            recorder,
            display: Display::new(),
            has_warned: false,
            has_told_failure: false,
            stop,
        }
    }

    /// Asks the run to stop if it has made as many updates as it was to make.
    fn stop_after(&self, n_done: u64) {
        if let Some((n_updates, shutdown)) = &self.stop
            && n_done >= *n_updates
        {
            shutdown.cancel();
        }
    }

    /// Warns once that a file cannot be written; the run goes on, because its checkpoints are what it needs.
    fn warn(&mut self, result: io::Result<()>) {
        if let Err(error) = result
            && !self.has_warned
        {
            self.has_warned = true;
            warn!(directory = %self.directory.display(), "metrics or policies cannot be written: {error:#}");
        }
    }
}

impl ProgressSink for RunSink {
    fn on_update(&mut self, progress: &UpdateProgress) {
        let written = self.recorder.update(progress);
        self.warn(written);
        self.display.update(progress);
        self.stop_after(progress.n_updates);
    }

    fn on_event(&mut self, event: &RunEvent) {
        if let RunEvent::Resumed { n_updates, .. } = event {
            let resumed = self.recorder.resumed(*n_updates);
            self.warn(resumed);
            self.stop_after(*n_updates);
        }
        if let RunEvent::EvaluationFailed { .. } = event
            && std::mem::replace(&mut self.has_told_failure, true)
        {
            return;
        }
        log(event);
    }

    fn on_policies(&mut self, last: &RatedPolicy, best: &RatedPolicy) {
        let written = self.recorder.policies(last, best);
        self.warn(written);
    }

    fn on_held_out(&mut self, history: &[HeldOutMeans]) {
        let written = self.recorder.held_out(history);
        self.warn(written);
        if let Some(newest) = history.last() {
            debug!("evaluated: {}", held_out_sentence(newest));
        }
    }
}

/// Says how a policy did on held-out episodes.
pub(crate) fn held_out_sentence(means: &HeldOutMeans) -> String {
    let HeldOutMeans { version, n_episodes, success, episode_return, error, .. } = means;
    let found = success.map_or_else(
        || format!("return {episode_return:.1} \u{b1} {error:.1}"),
        |success| format!("success {success:.2} \u{b1} {error:.2}"),
    );
    let episodes = counted(n_episodes, "episode");
    format!("update {version}, {found} over {episodes} that it was not trained on")
}

fn log(event: &RunEvent) {
    use RunEvent::{
        ActorJoined, ActorLeft, Assigned, CheckpointDamaged, CheckpointWritten, CutOff, Distrusted,
        Evaluating, EvaluationFailed, Listening, OtherBuild, Refused, Resumed, SnapshotLost,
        SnapshotRefused, Stopping, TooManyActors, WaitingForActors, WaitingForRollouts,
    };
    match event {
        Listening { locators } if locators.is_empty() => {
            info!("connected to a router; actors find the run there");
        }
        Listening { locators } => info!(at = %locators.join(", "), "listening"),
        Resumed { path, n_updates } => info!("resumed from update {n_updates}: {}", path.display()),
        CheckpointDamaged { path, damage } => {
            warn!(checkpoint = %path.display(), "a checkpoint cannot be used: {damage}; taking the one before");
        }
        ActorJoined { actor, n_actors } => {
            info!("actor joined: {actor} ({})", counted(n_actors, "actor"));
        }
        ActorLeft { actor, n_actors, n_envs } => {
            let (actors, envs) = (counted(n_actors, "actor"), counted(n_envs, "environment"));
            info!("actor left: {actor}, which had {envs} ({actors} now)");
        }
        WaitingForActors { n_actors, n_needed } => {
            info!("waiting for actors: {n_actors} of {n_needed}");
        }
        Assigned { actor, epoch, n_given, n_kept } => {
            debug!(%actor, %epoch, n_given, n_kept, "environments assigned");
        }
        Refused { actor, cause, reason } => {
            let actor = actor.as_ref().map_or("unknown", |actor| actor.as_str());
            warn!(actor, %cause, "message refused: {reason}");
        }
        CutOff { actor, reason, .. } => warn!(%actor, "actor cut off: {reason}"),
        OtherBuild { actor, build } => {
            let who = actor.as_ref().map_or("this learner", |actor| actor.as_str());
            let (program, cpu) = (&build.program, &build.cpu);
            let told = "another build of the program, or class of CPU, than before";
            warn!(who, program, cpu, "{told}: the run is not reproducible bit for bit");
        }
        WaitingForRollouts { actor, n_envs, waited } => {
            let (envs, time) = (counted(n_envs, "environment"), duration(*waited));
            warn!("waiting for rollouts of actor {actor} ({envs}) for {time}");
        }
        Distrusted { actor, reason } => {
            warn!(%actor, "the other actors take environments over from this one: {reason}");
        }
        TooManyActors { n_actors, n_envs } => {
            let idle = "some have nothing to do (see learner.n_envs)";
            let (actors, envs) = (counted(n_actors, "actor"), counted(n_envs, "environment"));
            warn!("{actors} for {envs}: {idle}");
        }
        SnapshotRefused { actor, env_id } => {
            warn!(%actor, %env_id, "the actor cannot restore the environment from its snapshot");
        }
        SnapshotLost { env_id } => {
            warn!(%env_id, "nobody can restore the environment from its snapshot: its last rollout is made again, or a fresh episode begins");
        }
        CheckpointWritten { path, n_updates } => {
            debug!(n_updates, checkpoint = %path.display(), "checkpointed");
        }
        Evaluating => info!("training is done; evaluating on held-out episodes"),
        EvaluationFailed { version, reason } => {
            let told = "the run goes on, and the best policy is chosen among the others";
            warn!("the policy of update {version} cannot be evaluated: {reason}; {told}");
        }
        Stopping => info!("stopping: writing checkpoint and books"),
    }
}
