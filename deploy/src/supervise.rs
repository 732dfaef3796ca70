//! A learner and its actors as child processes of this one, watched until the last of them is gone.
//!
//! | what happens | what is done |
//! |---|---|
//! | an actor dies | it is started again, at most [`RESTARTS`] times, each time after a longer pause |
//! | the learner is killed | it is started again and resumes from its checkpoint; the actors find it by themselves |
//! | the learner ends | the actors end with it; its exit code is ours |
//! | Ctrl-C, SIGTERM | every child is asked to end, and killed if it does not within [`GRACE`] |
//! | this process dies | the children see their standard input close, and end |
//!
//! Every child leads a process group of its own, so that Ctrl-C at a terminal reaches only the supervisor, and so
//! that killing a child kills what it started.

use std::ffi::OsString;
use std::fs::OpenOptions;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use process_wrap::std::{ChildWrapper, CommandWrap, ProcessGroup};
use tokio_util::sync::CancellationToken;

use crate::exit::{Blame as _, ExitCode, Failure};
use crate::shutdown::{DEADLINE, SUPERVISOR_DEADLINE};

/// How often one child may be started again.
pub const RESTARTS: u32 = 5;
/// How long children may take to end by themselves before they are killed: longer than their own deadline, shorter
/// than ours.
pub const GRACE: Duration = Duration::from_millis(4_600);
/// How often the children are looked at.
const TICK: Duration = Duration::from_millis(20);
const _: () = assert!(
    DEADLINE.as_millis() < GRACE.as_millis() && GRACE.as_millis() < SUPERVISOR_DEADLINE.as_millis(),
    "a child ends by itself first, then it is killed, then the supervisor ends"
);
/// Pause before the first restart; doubled for each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(200);

/// What to start: the arguments after the program's name.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Of the learner.
    pub learner: Vec<OsString>,
    /// Of each actor.
    pub actors: Vec<Vec<OsString>>,
    /// Whether the learner's results go to our standard output.
    pub learner_talks: bool,
    /// Where the children's talk is appended, instead of on our standard error.
    pub log: Option<PathBuf>,
}

/// Runs a plan to its end.
///
/// # Errors
///
/// [`Failure`] with the learner's exit code (it has said why), or with [`ExitCode::Interrupted`].
pub async fn supervise(plan: &Plan, shutdown: &CancellationToken) -> Result<(), Failure> {
    let nowhere = Output { results: false, log: plan.log.clone() };
    let talk = Output { results: plan.learner_talks, ..nowhere.clone() };
    let mut learner = Keeper::start("learner", &plan.learner, talk).blame(ExitCode::Failed)?;
    let mut actors = Vec::new();
    for (index, args) in plan.actors.iter().enumerate() {
        let name = format!("actor {}", index + 1);
        actors.push(Keeper::start(&name, args, nowhere.clone()).blame(ExitCode::Failed)?);
    }
    let mut ticks = tokio::time::interval(TICK);
    let verdict = loop {
        tokio::select! {
            () = shutdown.cancelled() => break Some(ExitCode::Interrupted),
            _ = ticks.tick() => {}
        }
        match learner.look(Role::Learner).blame(ExitCode::Failed)? {
            Health::Gone(code) => break Some(code),
            Health::Alive => {}
        }
        let mut n_well = 0;
        for actor in &mut actors {
            let health = actor.look(Role::Actor).blame(ExitCode::Failed)?;
            // An actor that ended well was sent home: the learner is about to end as well.
            n_well += usize::from(matches!(health, Health::Alive | Health::Gone(ExitCode::Done)));
        }
        if n_well == 0 {
            tracing::error!("no actor is left: giving up; the run can be taken up again");
            break None;
        }
    };
    if verdict != Some(ExitCode::Done) {
        learner.request_stop();
        actors.iter_mut().for_each(Keeper::request_stop);
    }
    wait_for_all(&mut learner, &mut actors).await;
    match verdict {
        Some(ExitCode::Done) => Ok(()),
        Some(code) => Err(Failure::silent(code)),
        None => Err(Failure::silent(ExitCode::Failed)),
    }
}

/// Waits until every child has ended; what has not within [`GRACE`] is asked, then killed by its keeper's drop.
async fn wait_for_all(learner: &mut Keeper, actors: &mut [Keeper]) {
    let started = Instant::now();
    let mut ticks = tokio::time::interval(TICK);
    while started.elapsed() < GRACE {
        ticks.tick().await;
        let n_running =
            actors.iter_mut().chain([&mut *learner]).filter_map(|keeper| keeper.running()).count();
        if n_running == 0 {
            return;
        }
        if started.elapsed() > GRACE / 4 {
            actors.iter_mut().for_each(Keeper::request_stop);
        }
    }
    tracing::warn!("some processes did not end in time and are killed");
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Learner,
    Actor,
}

/// Where a child's output goes.
#[derive(Clone, Debug)]
struct Output {
    /// Its results go to our standard output, instead of nowhere.
    results: bool,
    /// Its talk goes to the end of this file, instead of to our standard error.
    log: Option<PathBuf>,
}

impl Output {
    fn talk(&self) -> io::Result<Stdio> {
        let open = |path: &Path| OpenOptions::new().create(true).append(true).open(path);
        Ok(self.log.as_deref().map(open).transpose()?.map_or_else(Stdio::inherit, Stdio::from))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Health {
    /// It runs, or will again after a pause.
    Alive,
    /// It ended for good.
    Gone(ExitCode),
}

/// One child and its restarts.
#[derive(Debug)]
struct Keeper {
    name: String,
    args: Vec<OsString>,
    output: Output,
    child: Option<Child>,
    gone: Option<ExitCode>,
    n_restarts: u32,
    restart_at: Option<Instant>,
}

impl Keeper {
    fn start(name: &str, args: &[OsString], output: Output) -> io::Result<Self> {
        let child = Some(Child::spawn(args, &output)?);
        Ok(Self {
            name: name.to_owned(),
            args: args.to_vec(),
            output,
            child,
            gone: None,
            n_restarts: 0,
            restart_at: None,
        })
    }

    /// Looks after the child: notices its end, starts it again when its pause is over.
    fn look(&mut self, role: Role) -> io::Result<Health> {
        if let Some(code) = self.gone {
            return Ok(Health::Gone(code));
        }
        if let Some(at) = self.restart_at {
            if Instant::now() >= at {
                self.restart_at = None;
                self.child = Some(Child::spawn(&self.args, &self.output)?);
            }
            return Ok(Health::Alive);
        }
        let Some(status) = self.child.as_mut().map(Child::poll).transpose()?.flatten() else {
            return Ok(Health::Alive);
        };
        self.child = None;
        Ok(self.ended(role, status))
    }

    fn ended(&mut self, role: Role, status: ExitStatus) -> Health {
        let code = status.code().map(ExitCode::from_status);
        let again = match (role, code) {
            // Killed from outside, or crashed: worth another try.
            (_, None) => true,
            // An actor may have lost the network; a learner that ended with an error would only repeat it.
            (Role::Actor, Some(code)) => matches!(code, ExitCode::Failed | ExitCode::PeerLost),
            (Role::Learner, Some(_)) => false,
        };
        if again && self.n_restarts < RESTARTS {
            let pause = FIRST_PAUSE * 2_u32.pow(self.n_restarts);
            self.n_restarts += 1;
            self.restart_at = Some(Instant::now() + pause);
            tracing::warn!(process = %self.name, %status, restart = self.n_restarts, "process died; starting it again");
            return Health::Alive;
        }
        let code = code.unwrap_or(ExitCode::Failed);
        self.gone = Some(code);
        Health::Gone(code)
    }

    /// Returns the child if it has not ended yet.
    fn running(&mut self) -> Option<&mut Child> {
        let child = self.child.as_mut()?;
        if !matches!(child.poll(), Ok(None)) {
            self.child = None;
        }
        self.child.as_mut()
    }

    fn request_stop(&mut self) {
        self.restart_at = None;
        if let Some(child) = &mut self.child {
            child.lifeline = None;
        }
    }
}

/// A running process of ours; dropping it kills its group.
#[derive(Debug)]
struct Child {
    process: Box<dyn ChildWrapper>,
    /// The child ends when this closes.
    lifeline: Option<ChildStdin>,
}

impl Child {
    fn spawn(args: &[OsString], output: &Output) -> io::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        let stdout = if output.results { Stdio::inherit() } else { Stdio::null() };
        command.args(args).stdin(Stdio::piped()).stdout(stdout).stderr(output.talk()?);
        let mut process = CommandWrap::from(command).wrap(ProcessGroup::leader()).spawn()?;
        let lifeline = process.stdin().take();
        Ok(Self { process, lifeline })
    }

    fn poll(&mut self) -> io::Result<Option<ExitStatus>> {
        self.process.try_wait()
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        if matches!(self.process.try_wait(), Ok(Some(_))) {
            return;
        }
        if let Err(error) = self.process.start_kill().and_then(|()| self.process.wait()) {
            tracing::warn!(%error, "a process could not be killed");
        }
    }
}
