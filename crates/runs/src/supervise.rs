//! A learner and its actors as child processes of this one, watched until the last of them is gone.
//!
//! | what happens | what is done |
//! |---|---|
//! | an actor dies | it is restarted, after a longer pause each time; after [`RESTARTS`] restarts in a row it is given up |
//! | the learner is killed | the same; it resumes from its checkpoint, and the actors find it by themselves. Those that it had dismissed are started again, unless all updates are made |
//! | the learner ends | the actors end with it; its exit code is ours |
//! | every actor is given up | the learner is stopped, unless actors elsewhere may join |
//! | Ctrl-C, SIGTERM | every child is asked to end, and killed if it does not within [`GRACE`] |
//! | this process dies | the children see their standard input close, and end |
//!
//! A child that was healthy for a while is restarted as if it had never died, so that a long run outlives rare deaths.
//! A restart that fails is one more death: what goes wrong here never ends the other children without a checkpoint.
//!
//! Every child leads a process group of its own, so that Ctrl-C at a terminal reaches only the supervisor, and so
//! that killing a child kills what it started.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use process_wrap::std::{ChildWrapper, CommandWrap, ProcessGroup};
use tokio_util::sync::CancellationToken;

use crate::build::running_program;
use crate::placement::{Placement, start_on};
use crate::{layout, regular};

/// How often a child is restarted without having been healthy in between.
const RESTARTS: u32 = 5;
/// A child that lived this long was healthy.
const HEALTHY_TIME: Duration = Duration::from_mins(10);
/// So was one during whose life the run made this many updates, if that life was no shorter than [`HEALTHY_LIFE`].
const HEALTHY_UPDATES: u64 = 100;
/// The shortest life after which updates count: while one actor dies as soon as it starts, others make many.
const HEALTHY_LIFE: Duration = Duration::from_secs(1);
/// How long children may take to end by themselves before they are killed.
pub const GRACE: Duration = Duration::from_millis(4_600);
/// The exit codes of an actor that is worth another try: it failed, or it lost the network.
pub const RETRIED: [i32; 2] = [1, 3];
/// Pause between two looks at the children.
const TICK: Duration = Duration::from_millis(20);
/// Pause before the first restart; doubled for each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(200);

/// What to start: the arguments after the program's name.
#[derive(Clone, Debug, Default)]
pub(crate) struct ProcessPlan {
    /// Arguments of the learner.
    pub(crate) learner: Vec<OsString>,
    /// Arguments of each actor.
    pub(crate) actors: Vec<Vec<OsString>>,
    /// Which CPUs each of them keeps to.
    pub(crate) placement: Placement,
    /// Directory of the run; its journal shows whether the run advances.
    pub(crate) run: PathBuf,
    /// Updates of the whole run.
    pub(crate) n_updates: u64,
    /// When the learner is to stop.
    pub(crate) stop_at: Option<Instant>,
    /// Whether actors that are not ours may keep the run going.
    pub(crate) others_may_join: bool,
    /// Whether the learner's results go to our standard output.
    pub(crate) learner_stdout: bool,
    /// File that collects what the children log, instead of our standard error.
    pub(crate) stderr_log: Option<PathBuf>,
}

/// How a supervised run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The learner ended with this exit code; `None` if it kept being killed.
    Learner(Option<i32>),
    /// Every actor was given up, and the learner was stopped.
    NoActorLeft,
    /// We were asked to stop, and asked the learner, which ended with this exit code; `None` if it was killed.
    Stopped(Option<i32>),
}

/// Runs a plan to its end; an error says that the learner cannot be started at all.
pub(crate) async fn supervise(
    plan: &ProcessPlan,
    shutdown: &CancellationToken,
) -> io::Result<Ended> {
    let stderr_log = plan.stderr_log.as_deref();
    let mut learner = ChildHandle::new("learner", &plan.learner, stderr_log);
    learner.shows_results = plan.learner_stdout;
    learner.cpus = plan.placement.of_learner().to_vec();
    learner.stop_at = plan.stop_at;
    learner.start(&plan.run)?;
    let handle = |(number, args): (usize, &Vec<OsString>)| ChildHandle {
        is_actor: true,
        cpus: plan.placement.of_actor(number - 1).to_vec(),
        ..ChildHandle::new(&format!("actor {number}"), args, stderr_log)
    };
    let mut actors: Vec<ChildHandle> = (1..).zip(&plan.actors).map(handle).collect();
    let ended = watch(plan, &mut learner, &mut actors, shutdown).await;
    if ended != Ended::Learner(Some(0)) {
        learner.request_stop();
        actors.iter_mut().for_each(ChildHandle::request_stop);
    }
    wait_for_all(&mut learner, &mut actors).await;
    Ok(match (ended, learner.health) {
        (Ended::Stopped(_), ChildHealth::Gone(code)) => Ended::Stopped(code),
        (ended, _) => ended,
    })
}

async fn watch(
    plan: &ProcessPlan,
    learner: &mut ChildHandle,
    actors: &mut [ChildHandle],
    shutdown: &CancellationToken,
) -> Ended {
    let mut ticks = tokio::time::interval(TICK);
    let mut warned = false;
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return Ended::Stopped(None),
            _ = ticks.tick() => {}
        }
        let n_deaths = learner.n_deaths;
        if let ChildHealth::Gone(code) = learner.poll(&plan.run) {
            return Ended::Learner(code);
        }
        if learner.n_deaths != n_deaths {
            call_back(plan, actors);
        }
        let health: Vec<ChildHealth> =
            actors.iter_mut().map(|actor| actor.poll(&plan.run)).collect();
        // An actor that ended well was dismissed: the learner is about to end as well.
        if health.iter().any(|it| matches!(it, ChildHealth::Alive | ChildHealth::Gone(Some(0)))) {
            continue;
        }
        if !plan.others_may_join {
            let name = plan.run.file_name().unwrap_or_default().display();
            tracing::error!("no actor is left: giving up; --name {name} resumes the run");
            return Ended::NoActorLeft;
        }
        if !warned {
            warned = true;
            tracing::warn!("no actor of this command is left: the run depends on those elsewhere");
        }
    }
}

/// Restarts the actors that a learner had dismissed before it was killed: its next start needs them, unless its newest checkpoint
/// holds all updates. If it finds there that the run has ended before (`evaluation.stop_at`), it ends, and they end with it.
fn call_back(plan: &ProcessPlan, actors: &mut [ChildHandle]) {
    if layout::n_saved(&plan.run).is_ok_and(|n_updates| n_updates >= plan.n_updates) {
        return;
    }
    for actor in actors.iter_mut().filter(|actor| actor.health == ChildHealth::Gone(Some(0))) {
        (actor.health, actor.start_at) = (ChildHealth::Alive, Some(Instant::now()));
    }
}

/// Waits until every child has ended; what has not within [`GRACE`] is killed when its handle is dropped.
async fn wait_for_all(learner: &mut ChildHandle, actors: &mut [ChildHandle]) {
    let started = Instant::now();
    let mut ticks = tokio::time::interval(TICK);
    while started.elapsed() < GRACE {
        ticks.tick().await;
        if !learner.is_running() && actors.iter_mut().all(|actor| !actor.is_running()) {
            return;
        }
        if started.elapsed() > GRACE / 4 {
            actors.iter_mut().for_each(ChildHandle::request_stop);
        }
    }
    tracing::warn!("some processes did not end in time and are killed");
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChildHealth {
    /// It runs, or will again after a pause.
    Alive,
    /// It ended for good, with this exit code unless it was killed.
    Gone(Option<i32>),
}

/// One child and its restarts.
#[derive(Debug)]
struct ChildHandle {
    name: String,
    is_actor: bool,
    /// Finds the program again for every start, because its file may have been replaced.
    program: fn() -> io::Result<PathBuf>,
    args: Vec<OsString>,
    /// When it is to stop, which every start is told anew.
    stop_at: Option<Instant>,
    /// The CPUs that it keeps to; all that we may use if there are none.
    cpus: Vec<usize>,
    /// Its results go to our standard output, instead of nowhere.
    shows_results: bool,
    /// Its log goes to the end of this file, instead of to our standard error.
    stderr_log: Option<PathBuf>,
    process: Option<ChildProcess>,
    health: ChildHealth,
    /// Restarts since it was last healthy.
    n_restarts: u32,
    /// Its ends of all kinds, which health does not forgive.
    n_deaths: u64,
    /// When it is to be started; `None` while it runs.
    start_at: Option<Instant>,
    started: Instant,
    /// Updates of the run when it was started.
    updates_before: u64,
}

impl ChildHandle {
    /// Makes a learner without results, to be started at once.
    fn new(name: &str, args: &[OsString], stderr_log: Option<&Path>) -> Self {
        let now = Instant::now();
        Self {
            name: name.to_owned(),
            is_actor: false,
            program: running_program,
            args: args.to_vec(),
            stop_at: None,
            cpus: Vec::new(),
            shows_results: false,
            stderr_log: stderr_log.map(Path::to_owned),
            process: None,
            health: ChildHealth::Alive,
            n_restarts: 0,
            n_deaths: 0,
            start_at: Some(now),
            started: now,
            updates_before: 0,
        }
    }

    fn start(&mut self, run: &Path) -> io::Result<()> {
        // Before the start is tried: a start that fails is no life in which the child could show that it works.
        self.started = Instant::now();
        self.updates_before = layout::n_updates(run);
        self.process = Some(self.spawn()?);
        self.start_at = None;
        Ok(())
    }

    fn spawn(&self) -> io::Result<ChildProcess> {
        let stderr = self.stderr_log.as_deref().map(regular::append_to).transpose()?;
        let stderr = stderr.map_or_else(Stdio::inherit, Stdio::from);
        let stdout = if self.shows_results { Stdio::inherit() } else { Stdio::null() };
        let mut command = Command::new((self.program)()?);
        command.args(&self.args).args(self.time_left(Instant::now()));
        command.stdin(Stdio::piped()).stdout(stdout).stderr(stderr);
        start_on(&self.cpus, || {
            let mut process = CommandWrap::from(command).wrap(ProcessGroup::leader()).spawn()?;
            let lifeline = process.stdin().take();
            Ok(ChildProcess { process, lifeline })
        })
    }

    /// Returns the option that says how much is left of its time: a little where nothing is, so that it saves and ends.
    fn time_left(&self, now: Instant) -> Vec<OsString> {
        let left = self.stop_at.map(|at| at.saturating_duration_since(now).as_millis().max(1));
        let option = |left: u128| ["--stop-after".to_owned(), format!("{left}ms")];
        left.into_iter().flat_map(option).map(Into::into).collect()
    }

    /// Notices the child's end, and starts it when it is time.
    fn poll(&mut self, run: &Path) -> ChildHealth {
        if self.health != ChildHealth::Alive {
            return self.health;
        }
        if let Some(at) = self.start_at {
            if Instant::now() >= at
                && let Err(error) = self.start(run)
            {
                return self.ended(None, &error.to_string(), run);
            }
            return ChildHealth::Alive;
        }
        let status = self.process.as_mut().map(|child| child.process.try_wait()).transpose();
        let (code, how) = match status {
            Ok(None | Some(None)) => return ChildHealth::Alive,
            Ok(Some(Some(status))) => (status.code(), status.to_string()),
            Err(error) => (None, error.to_string()),
        };
        self.process = None;
        self.ended(code, &how, run)
    }

    fn ended(&mut self, code: Option<i32>, how: &str, run: &Path) -> ChildHealth {
        // Killed from outside, crashed, or not started: worth another try. A learner that ended with an error would only
        // repeat it.
        let again = code.is_none_or(|code| self.is_actor && RETRIED.contains(&code));
        self.n_deaths += 1;
        if self.was_healthy(run) {
            self.n_restarts = 0;
        }
        if again && self.n_restarts < RESTARTS {
            self.start_at = Some(Instant::now() + FIRST_PAUSE * 2_u32.pow(self.n_restarts));
            self.n_restarts += 1;
            tracing::warn!(process = %self.name, how, restart = self.n_restarts, "process died; restarting it");
            return ChildHealth::Alive;
        }
        if again {
            let n_in_a_row = self.n_restarts + 1;
            tracing::error!("{} died {n_in_a_row} times and is given up ({how})", self.name);
        } else if self.is_actor && code != Some(0) {
            tracing::error!("{} ended and is not restarted ({how})", self.name);
        }
        self.health = ChildHealth::Gone(code);
        self.health
    }

    /// Returns whether its last life shows that it works.
    fn was_healthy(&self, run: &Path) -> bool {
        let lived = self.started.elapsed();
        let n_updates = || layout::n_updates(run).saturating_sub(self.updates_before);
        lived >= HEALTHY_TIME || (lived >= HEALTHY_LIFE && n_updates() >= HEALTHY_UPDATES)
    }

    /// Tells whether it still runs after it was asked to stop; notices its end.
    fn is_running(&mut self) -> bool {
        let status = self.process.as_mut().map(|child| child.process.try_wait());
        match status {
            None => return false,
            Some(Ok(None)) => return true,
            Some(Ok(Some(status))) => self.health = ChildHealth::Gone(status.code()),
            Some(Err(_)) => self.health = ChildHealth::Gone(None),
        }
        self.process = None;
        false
    }

    fn request_stop(&mut self) {
        self.start_at = None;
        if let Some(process) = &mut self.process {
            process.lifeline = None;
        }
    }
}

/// A running process of ours; dropping it kills its group.
#[derive(Debug)]
struct ChildProcess {
    process: Box<dyn ChildWrapper>,
    /// The child ends when this closes.
    lifeline: Option<ChildStdin>,
}

impl Drop for ChildProcess {
    fn drop(&mut self) {
        if matches!(self.process.try_wait(), Ok(Some(_))) {
            return;
        }
        if let Err(error) = self.process.start_kill().and_then(|()| self.process.wait()) {
            tracing::warn!(%error, "a process could not be killed");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement;

    fn actor() -> ChildHandle {
        ChildHandle { is_actor: true, ..ChildHandle::new("actor 1", &[], None) }
    }

    fn plan(run: &Path) -> ProcessPlan {
        ProcessPlan { run: run.to_owned(), n_updates: 10, ..ProcessPlan::default() }
    }

    #[test]
    fn deaths_in_a_row_end_an_actor_and_health_in_between_forgives_them() {
        let run = tempfile::tempdir().unwrap();
        let mut hopeless = actor();
        for _ in 0..RESTARTS {
            assert_eq!(hopeless.ended(None, "killed", run.path()), ChildHealth::Alive);
        }
        assert_eq!(hopeless.ended(None, "killed", run.path()), ChildHealth::Gone(None));
        let line = format!("{{\"update\": {HEALTHY_UPDATES}}}\n");
        std::fs::write(run.path().join("metrics.jsonl"), line).unwrap();
        let mut healthy = actor();
        for _ in 0..3 * RESTARTS {
            healthy.started = Instant::now().checked_sub(HEALTHY_LIFE).unwrap();
            assert_eq!(healthy.ended(Some(1), "failed", run.path()), ChildHealth::Alive);
        }
        assert_eq!(healthy.ended(Some(2), "wrong input", run.path()), ChildHealth::Gone(Some(2)));
    }

    #[test]
    fn a_learner_that_is_started_again_stops_when_the_first_one_would_have() {
        let begun = Instant::now();
        let stop_at = begun.checked_add(Duration::from_hours(2));
        let learner = ChildHandle { stop_at, ..ChildHandle::new("learner", &[], None) };
        for (minutes, left) in [(0, "7200000ms"), (90, "1800000ms"), (121, "1ms")] {
            let now = begun + Duration::from_mins(minutes);
            assert_eq!(learner.time_left(now), ["--stop-after", left]);
        }
        assert!(actor().time_left(begun).is_empty());
    }

    #[tokio::test]
    async fn a_run_without_local_actors_goes_on_only_where_others_may_join() {
        let run = tempfile::tempdir().unwrap();
        let mut plan = plan(run.path());
        let mut learner = ChildHandle::new("learner", &["600".into()], None);
        learner.program = || Ok("sleep".into());
        let mut gone = actor();
        gone.health = ChildHealth::Gone(None);
        let mut actors = [gone];
        let stop = CancellationToken::new();
        assert_eq!(watch(&plan, &mut learner, &mut actors, &stop).await, Ended::NoActorLeft);
        plan.others_may_join = true;
        let watching = watch(&plan, &mut learner, &mut actors, &stop);
        // Far more than the one look that it takes to give up.
        let still_watching = tokio::time::timeout(10 * TICK, watching).await;
        assert!(still_watching.is_err(), "{still_watching:?}");
    }

    #[tokio::test]
    async fn actors_whose_learner_was_killed_after_it_dismissed_them_are_started_again() {
        let run = tempfile::tempdir().unwrap();
        let plan = plan(run.path());
        let once = format!(
            "cd '{}'; test -e killed || {{ touch killed; kill -KILL $$; }}",
            run.path().display()
        );
        let mut learner = ChildHandle::new("learner", &["-c".into(), once.into()], None);
        learner.program = || Ok("sh".into());
        // It was restarted before and has been healthy since: its next death counts as the first again.
        learner.start(run.path()).unwrap();
        learner.n_restarts = 1;
        learner.started = Instant::now().checked_sub(HEALTHY_TIME).unwrap();
        let gone = |health| {
            let program: fn() -> io::Result<PathBuf> = || Ok("true".into());
            ChildHandle { health, program, start_at: None, ..actor() }
        };
        let healths = [Some(0), Some(2), None].map(ChildHealth::Gone);
        let mut actors = healths.map(gone);
        let (begun, stop) = (Instant::now(), CancellationToken::new());
        let ended = watch(&plan, &mut learner, &mut actors, &stop).await;
        assert_eq!(ended, Ended::Learner(Some(0)));
        assert_eq!(actors.map(|actor| actor.started > begun), [true, false, false]);
        // Made and not saved: the next start makes the last updates again.
        std::fs::write(run.path().join("metrics.jsonl"), "{\"update\": 10}\n").unwrap();
        let mut actors = healths.map(gone);
        call_back(&plan, &mut actors);
        assert_eq!(actors[0].health, ChildHealth::Alive);
        // Where nothing is left to train, nobody is needed.
        let checkpoints = run.path().join("checkpoints");
        std::fs::create_dir(&checkpoints).unwrap();
        std::fs::write(checkpoints.join("000000000010.checkpoint"), "state").unwrap();
        let mut actors = healths.map(gone);
        call_back(&plan, &mut actors);
        assert_eq!(actors.map(|actor| actor.health), healths);
    }

    #[test]
    fn a_child_keeps_to_its_cpus_and_its_supervisor_does_not() {
        let run = tempfile::tempdir().unwrap();
        let ours = placement::allowed().unwrap();
        let last = *ours.last().unwrap();
        let mut learner = ChildHandle::new("learner", &["600".into()], None);
        learner.program = || Ok("sleep".into());
        learner.cpus = vec![last];
        learner.start(run.path()).unwrap();
        let id = learner.process.as_ref().unwrap().process.id();
        let status = std::fs::read_to_string(format!("/proc/{id}/status")).unwrap();
        assert!(status.contains(&format!("Cpus_allowed_list:\t{last}\n")), "{status}");
        assert_eq!(placement::allowed().unwrap(), ours);
    }

    #[test]
    fn a_start_that_fails_is_a_death_and_not_the_supervisors_end() {
        let run = tempfile::tempdir().unwrap();
        let mut actor = actor();
        // A log in a directory that is not there: the process cannot be started.
        actor.stderr_log = Some(run.path().join("missing/log"));
        assert_eq!(actor.poll(run.path()), ChildHealth::Alive);
        assert_eq!(actor.n_restarts, 1);
        // A pipe that nobody reads: it would keep the supervisor waiting.
        let pipe = run.path().join("log");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        actor.stderr_log = Some(pipe);
        let error = actor.spawn().map(drop).unwrap_err();
        assert_eq!(error.to_string(), "log is not a file");
    }
}
