//! What the learner calls while it works: its progress is written down, shown and logged.

use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::time::Instant;

use leadtime_learner::{
    HeldOutMeans, ProgressSink, RatedPolicy, RunEvent, RunHealth, UpdateProgress,
};
use leadtime_link::{Archive, RareLine};
use leadtime_process::{MetricsPipe, ProcessTrace, shutdown};
use leadtime_proto::phrase::{counted, duration};
use leadtime_runs::RunRecorder;
use leadtime_status::LearnerStatus;
use leadtime_trace::TraceSpan;
use tokio_util::sync::CancellationToken;
use tracing::{debug, error, info, warn};

use crate::display::Display;
use crate::service::{self, Service};

/// The most lines in the log, of a kind and in a minute, about what actors do: who takes part without certificates may come under as
/// many names as they like.
const ACTOR_LINES: u32 = 64;

/// The lines about what actors do, by kind.
#[derive(Debug, Default)]
struct ActorLines(BTreeMap<&'static str, RareLine>);

impl ActorLines {
    /// Returns what a line of a kind ends with, if it is time for one.
    fn suffix(&mut self, kind: &'static str, now: Instant) -> Option<String> {
        self.0.entry(kind).or_insert_with(|| RareLine::of_many(ACTOR_LINES)).suffix(now)
    }
}

/// Names the kind of an event that actors can cause as often as they like; `None` for every other.
fn kind_of_actors(event: &RunEvent) -> Option<&'static str> {
    Some(match event {
        RunEvent::ActorJoined { .. } => "joined",
        RunEvent::ActorLeft { .. } => "left",
        RunEvent::WaitingForActors { .. } => "too few",
        RunEvent::TooManyActors { .. } => "too many",
        RunEvent::Refused { .. } => "refused",
        RunEvent::CutOff { .. } => "cut off",
        RunEvent::WaitingForRollouts { .. } => "late",
        RunEvent::Astray { .. } => "astray",
        RunEvent::Distrusted { .. } => "distrusted",
        RunEvent::InheritedRefused { .. } => "inherited",
        RunEvent::SnapshotRefused { .. } => "snapshot refused",
        RunEvent::SnapshotLost { .. } => "snapshot lost",
        _ => return None,
    })
}

/// Records a run's progress and shows it.
#[derive(Debug)]
pub(crate) struct RunSink {
    directory: PathBuf,
    recorder: RunRecorder,
    display: Display,
    actor_lines: ActorLines,
    has_warned: bool,
    /// Whether it was logged that policies cannot be evaluated.
    has_told_failure: bool,
    /// Who serves what the run reports, if somebody does.
    status: Option<LearnerStatus>,
    service: Service,
    /// After how many updates in all the run is asked to stop, and by what.
    stop: Option<(u64, CancellationToken)>,
    /// Who else gets the metrics.
    pipe: Option<MetricsPipe>,
    /// Who writes down where the time goes, if somebody does.
    trace: Option<ProcessTrace>,
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
            actor_lines: ActorLines::default(),
            has_warned: false,
            has_told_failure: false,
            status: None,
            service: Service::find(),
            stop,
            pipe: None,
            trace: None,
        }
    }

    /// Hands every update's metrics on to a command, too.
    pub(crate) fn hand_on(&mut self, pipe: MetricsPipe) {
        self.pipe = Some(pipe);
    }

    /// Also serves what the run reports.
    pub(crate) fn with_status(self, status: Option<LearnerStatus>) -> Self {
        Self { status, ..self }
    }

    /// Also writes down where the time goes.
    pub(crate) fn with_trace(self, trace: Option<ProcessTrace>) -> Self {
        Self { trace, ..self }
    }

    /// Asks the run to stop if it has made as many updates as it was to make.
    fn stop_after(&self, n_done: u64) {
        if let Some((n_updates, planned)) = &self.stop
            && n_done >= *n_updates
        {
            planned.cancel();
        }
    }

    /// Warns once that a file cannot be written; the run goes on, because its checkpoints are what it needs.
    fn warn(&mut self, result: io::Result<()>) {
        let Err(error) = result else { return };
        if let Some(status) = &self.status {
            status.dropped();
        }
        if !std::mem::replace(&mut self.has_warned, true) {
            warn!(directory = %self.directory.display(), "metrics or policies cannot be written: {error:#}");
        }
    }
}

impl ProgressSink for RunSink {
    fn on_update(&mut self, progress: &UpdateProgress) {
        let line = RunRecorder::line(progress);
        let written = self.recorder.update(progress, &line);
        self.warn(written);
        if let Some(pipe) = &mut self.pipe {
            pipe.line(format!("{line}\n"));
        }
        self.display.update(progress);
        if let Some(status) = &mut self.status {
            status.update(progress);
        }
        self.stop_after(progress.n_updates);
    }

    fn on_event(&mut self, event: &RunEvent) {
        if let RunEvent::Resumed { n_updates, .. } = event {
            let resumed = self.recorder.resumed(*n_updates);
            self.warn(resumed);
            if self.stop.as_ref().is_some_and(|(asked, _)| n_updates >= asked) {
                info!("--stop-after is reached already: nothing more is trained");
            }
            self.stop_after(*n_updates);
        }
        if matches!(event, RunEvent::Listening { .. }) {
            let noted = self.recorder.note_start();
            self.warn(noted);
        }
        if let RunEvent::EvaluationFailed { .. } = event
            && std::mem::replace(&mut self.has_told_failure, true)
        {
            return;
        }
        if let Some(status) = &mut self.status {
            status.event(event);
        }
        if let RunEvent::Unsaved { kept, .. } = event {
            shutdown::wait_for_unsaved();
            // And what the last try takes.
            service::extend(*kept + shutdown::DEADLINE);
        }
        match kind_of_actors(event) {
            None => log(event),
            Some(kind) => {
                if let Some(more) = self.actor_lines.suffix(kind, Instant::now()) {
                    log_actors(event, &more);
                }
            }
        }
    }

    fn on_tick(&mut self, health: &RunHealth) {
        self.service.tick(health.has_enough_actors);
        if let Some(status) = &self.status {
            status.tick(health);
        }
        if let Some(trace) = &mut self.trace {
            trace.flush();
        }
    }

    fn on_span(&mut self, span: &TraceSpan<'_>) {
        if let Some(trace) = &mut self.trace {
            trace.span(span);
        }
    }

    fn on_policies(&mut self, last: &RatedPolicy, best: &RatedPolicy, held_out: &[HeldOutMeans]) {
        let written = self.recorder.policies(last, best, held_out);
        self.warn(written);
    }

    fn on_held_out(&mut self, history: &[HeldOutMeans]) {
        let written = self.recorder.held_out(history);
        self.warn(written);
        if let Some(newest) = history.last() {
            debug!("evaluated: {}", held_out_sentence(newest));
        }
    }

    fn bulletin(&mut self) -> Option<Vec<u8>> {
        self.recorder.take_bulletin()
    }

    fn archive(&self) -> Option<Archive> {
        Some(self.recorder.archive())
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
        Assigned, CheckpointDamaged, CheckpointFailed, CheckpointRecovered, CheckpointWritten,
        Evaluating, EvaluationFailed, Listening, OtherBuild, Paused, Reached, Resumed, Stopping,
        Unsaved,
    };
    match event {
        Listening { locators } if locators.is_empty() => {
            info!("connected to a router; actors find the run there");
        }
        Listening { locators } => info!(at = %locators.join(", "), "listening"),
        Resumed { path, n_updates, .. } => {
            info!("resumed from update {n_updates}: {}", path.display());
        }
        CheckpointDamaged { path, damage } => {
            warn!(checkpoint = %path.display(), "a checkpoint cannot be used: {damage}; using the previous one");
        }
        Assigned { actor, epoch, n_given, n_kept } => {
            debug!(%actor, %epoch, n_given, n_kept, "environments assigned");
        }
        OtherBuild { actor, build } => {
            let who = actor.as_ref().map_or("this learner", |actor| actor.as_str());
            let (program, cpu) = (&build.program, &build.cpu);
            let told = "another build of the program, or class of CPU, than before";
            warn!(who, program, cpu, "{told}: the run is not reproducible bit for bit");
        }
        CheckpointWritten { path, n_updates } => {
            debug!(n_updates, checkpoint = %path.display(), "checkpointed");
        }
        CheckpointFailed { .. } | CheckpointRecovered { .. } | Paused { .. } | Unsaved { .. } => {
            log_saving(event);
        }
        Reached { .. } | Evaluating | EvaluationFailed { .. } => log_evaluation(event),
        Stopping => info!("stopping: writing checkpoint and books"),
        // What actors cause is logged as often as it may be.
        _ => {}
    }
}

/// Logs what actors do; `more` says how often there was reason for this line.
fn log_actors(event: &RunEvent, more: &str) {
    use RunEvent::{
        ActorJoined, ActorLeft, CutOff, Refused, SnapshotLost, SnapshotRefused, TooManyActors,
        WaitingForActors, WaitingForRollouts,
    };
    match event {
        ActorJoined { actor, n_actors } => {
            info!("actor joined: {actor} ({}){more}", counted(n_actors, "actor"));
        }
        ActorLeft { actor, n_actors, n_envs } => {
            let (actors, envs) = (counted(n_actors, "actor"), counted(n_envs, "environment"));
            info!("actor left: {actor}, which had {envs} ({actors} now){more}");
        }
        WaitingForActors { n_actors, n_needed } => {
            info!("waiting for actors: {n_actors} of {n_needed}{more}");
        }
        Refused { actor, cause, reason } => {
            let actor = actor.as_ref().map_or("unknown", |actor| actor.as_str());
            warn!(actor, %cause, "message refused: {reason}{more}");
        }
        CutOff { actor, reason, .. } => warn!(%actor, "actor cut off: {reason}{more}"),
        WaitingForRollouts { actor, n_envs, waited } => {
            let (envs, time) = (counted(n_envs, "environment"), duration(*waited));
            warn!("waiting for rollouts of actor {actor} ({envs}), for {time} so far{more}");
        }
        TooManyActors { n_actors, n_envs } => {
            let idle = "some have nothing to do (see learner.n_envs)";
            let (actors, envs) = (counted(n_actors, "actor"), counted(n_envs, "environment"));
            warn!("{actors} for {envs}: {idle}{more}");
        }
        SnapshotRefused { actor, env_id } => {
            warn!(%actor, %env_id, "the actor cannot restore the environment from its snapshot{more}");
        }
        SnapshotLost { env_id } => {
            warn!(
                %env_id,
                "nobody can go on with the environment from its snapshot: its last rollouts are made again, or a fresh \
                 episode begins{more}"
            );
        }
        _ => log_wrong_way(event, more),
    }
}

/// Logs what the held-out episodes say of the training.
fn log_evaluation(event: &RunEvent) {
    use RunEvent::{Evaluating, EvaluationFailed, Reached};
    match event {
        Reached { means } => info!(
            "held-out episodes of update {} reach evaluation.stop_at: {:.2}; the training ends here",
            means.version.0,
            means.score()
        ),
        Evaluating => info!("training is done; evaluating on held-out episodes"),
        EvaluationFailed { version, reason } => {
            let told = "the run goes on, and the best policy is chosen among the others";
            warn!("the policy of update {version} cannot be evaluated: {reason}; {told}");
        }
        _ => {}
    }
}

/// Says what an actor has done that the others, or the run, have to make up for.
fn log_wrong_way(event: &RunEvent, more: &str) {
    match event {
        RunEvent::Distrusted { actor, reason } => {
            warn!(%actor, "the other actors take over environments from this one: {reason}{more}");
        }
        RunEvent::Astray { actor, told } => {
            warn!(
                %actor,
                "the actor follows assignment {told}, which this learner did not give: it gets its environments anew. If \
                 that happens again, somebody else gives orders on this network (see --tls){more}"
            );
        }
        RunEvent::InheritedRefused { actor, env_id, begun_by, reason } => {
            let begun_by = begun_by.as_ref().map_or("unknown", |actor| actor.as_str());
            warn!(
                %actor,
                %env_id,
                begun_by,
                "a rollout is refused: {reason}. It may follow from what others made of the episode before, so that it is \
                 not charged to the actor, and another one tries to go on from there{more}"
            );
        }
        _ => {}
    }
}

/// Says what becomes of a state that cannot be saved.
fn log_saving(event: &RunEvent) {
    use RunEvent::{CheckpointFailed, CheckpointRecovered, Paused, Unsaved};
    match event {
        CheckpointFailed { reason, retry } => {
            warn!(
                "{reason}; training continues, and the checkpoint is tried again every {}",
                duration(*retry)
            );
        }
        CheckpointRecovered { unsaved } => {
            info!("checkpoints can be written again, after {}", duration(*unsaved));
        }
        Paused { unsaved } => {
            warn!(
                "no checkpoint could be written for {}: training waits until there is room on the disk",
                duration(*unsaved)
            );
        }
        Unsaved { reason, kept } => {
            error!(
                "the end of the run cannot be saved: {reason}; trying again for {}, or until you interrupt once more",
                duration(*kept)
            );
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{ActorId, Incarnation};

    use super::*;

    #[test]
    fn actors_of_any_number_of_names_do_not_fill_the_log() {
        let (mut lines, now) = (ActorLines::default(), Instant::now());
        let mut tell = |n: usize, now| {
            let actor = ActorId::new(format!("a{n}")).unwrap();
            let incarnation = Incarnation(1);
            let reason = String::new();
            [
                RunEvent::ActorJoined { actor: actor.clone(), n_actors: 1 },
                RunEvent::CutOff { actor: actor.clone(), incarnation, reason },
                RunEvent::ActorLeft { actor, n_actors: 0, n_envs: 2 },
                RunEvent::WaitingForActors { n_actors: 0, n_needed: 1 },
            ]
            .map(|event| lines.suffix(kind_of_actors(&event).unwrap(), now))
        };
        assert_eq!(tell(0, now), [const { Some(String::new()) }; 4]);
        let n_told: usize = (1..1_000).map(|n| tell(n, now).iter().flatten().count()).sum();
        assert_eq!(n_told, 4 * (ACTOR_LINES as usize - 1));
        let later = tell(1_000, now + std::time::Duration::from_mins(1));
        assert_eq!(later, [(); 4].map(|()| Some(" (937 times since the last line)".to_owned())));
        assert_eq!(kind_of_actors(&RunEvent::Stopping), None, "nobody else's line is kept back");
    }
}
