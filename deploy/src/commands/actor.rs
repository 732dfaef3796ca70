//! `leadtime actor`: environments for a learner somewhere else.

use std::fs;

use anyhow::{Context as _, bail};
use leadtime_actor::{ActorEnd, ActorProgress, ActorSettings, ActorSink, Error};
use leadtime_certs::Role;
use leadtime_link::{Endpoint, Error as LinkError, StartKey};
use leadtime_process::{ProcessTrace, TraceFile, log_line};
use leadtime_proto::phrase::counted;
use leadtime_proto::{ActorId, RegionName, RunName};
use leadtime_runs::{ProgramBuild, Tasks};
use leadtime_status::ActorStatus;
use leadtime_trace::TraceSpan;
use leadtime_worker::WorkerRules;
use serde_json::json;
use tokio::sync::watch;

use super::learner::bind_status;

use crate::cli::ActorArgs;
use crate::credentials::{connect_settings, is_wrong_input};
use crate::ending::{self, Watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::{build, output};

/// The longest part of a host's name that becomes part of an actor's.
const HOST_CHARS: usize = 24;

pub(super) async fn run(tasks: &Tasks, args: &ActorArgs) -> Result<(), Failure> {
    let watched = if args.supervised { Watch::SignalsAndStdin } else { Watch::Signals };
    let shutdown = ending::watch(watched).blame(ExitCode::Failed)?;
    let settings = settings(args, build::this_build()?).blame(ExitCode::WrongInput)?;
    tasks.workers.follow(WorkerRules {
        permission: args.worker.permission(false),
        refuses_pickles: !args.worker.trust_worker,
        starts_at_once: true,
        n_workers: args.workers as usize,
    });
    let status = bind_status(args.status.as_deref()).await?;
    let (progress, told) = watch::channel(None);
    let own = settings.connect.identity.as_ref().map(|identity| identity.certificate().to_owned());
    let written = || settings.connect.endpoints.iter().find_map(Endpoint::certificate);
    let certificate = own.or_else(written);
    let actor = settings.actor.as_str();
    log_line::is_about_actor(actor);
    let _status = status.map(|server| ActorStatus::serve(server, actor, certificate, told));
    tracing::info!(actor = %settings.actor, at = %args.connect.join(", "), "looking for a learner");
    // A supervisor has made the file.
    let asked = args.trace.file.as_deref().filter(|_| !args.supervised);
    let made = TraceFile::create(asked).blame(ExitCode::WrongInput)?;
    let trace = ProcessTrace::join(args.trace.file.as_deref(), "actor", actor);
    let sink = Box::new(ActorOutlet { progress, trace });
    let report =
        leadtime_actor::run_watched(settings, tasks.registry.clone(), shutdown, sink).await;
    if let Some(told) = made.and_then(TraceFile::finish) {
        output::note(&told);
    }
    let report = report.map_err(failure)?;
    // The actor's own account of what it did; the learner's books must agree with it.
    if args.json {
        output::json(&json!({
            "run": report.run,
            "steps": report.n_steps,
            "made": report.made,
            "published": report.sent,
            "acknowledged": report.acknowledged,
            "reconnects": report.n_reconnects,
        }));
    } else {
        let steps = counted(report.n_steps, "step");
        let (sent, taken) = (counted(report.sent, "rollout"), report.acknowledged);
        output::line(&format!("run {}: {steps}, {sent} sent, {taken} acknowledged", report.run));
    }
    if !args.supervised {
        let command = output::this_command();
        output::note(&format!(
            "\nWhile a learner runs there, the same command joins it:\n  {command}"
        ));
    }
    match report.end {
        ActorEnd::Dismissed { .. } => Ok(()),
        ActorEnd::Cancelled => Err(Failure::silent(ExitCode::Interrupted)),
    }
}

/// Where what an actor reports goes.
struct ActorOutlet {
    /// To its status page.
    progress: watch::Sender<Option<ActorProgress>>,
    trace: Option<ProcessTrace>,
}

impl ActorSink for ActorOutlet {
    fn on_tick(&mut self, progress: ActorProgress) {
        self.progress.send_replace(Some(progress));
        if let Some(trace) = &mut self.trace {
            trace.flush();
        }
    }

    fn on_span(&mut self, span: &TraceSpan<'_>) {
        if let Some(trace) = &mut self.trace {
            trace.span(span);
        }
    }
}

fn settings(args: &ActorArgs, build: ProgramBuild) -> anyhow::Result<ActorSettings> {
    let mut connect =
        connect_settings(&args.connect, &args.tls, args.connect_timeout, &[Role::Actor])?;
    connect.region = args.region.clone().map(RegionName::new).transpose().context("--region")?;
    let run = args.run.clone().map(RunName::new).transpose().context("--run")?;
    let shown = connect.identity.as_ref().and_then(|identity| identity.shown.name.clone());
    let id = match (&args.id, shown) {
        // One certificate for a group of actors, where nobody has a list of names.
        (Some(id), Some(shown)) if *id != shown && !id.starts_with(&format!("{shown}-")) => bail!(
            "--id: the certificate is for `{shown}`: take part as `{shown}`, or as `{shown}-...` where there is no list of names"
        ),
        (Some(id), _) => id.clone(),
        (None, Some(shown)) => shown,
        (None, None) => default_id(&host()),
    };
    Ok(ActorSettings {
        actor: ActorId::new(id).context("--id")?,
        start: StartKey::draw()?,
        run,
        connect,
        reconnect_timeout: args.reconnect_timeout,
        yields_to_learner: args.yields_to_learner,
        program: build.program,
        cpu: build.cpu,
    })
}

/// Reads the host's name, where the system keeps one.
fn host() -> String {
    let files = ["/proc/sys/kernel/hostname", "/etc/hostname"];
    files.iter().find_map(|file| fs::read_to_string(file).ok()).unwrap_or_default()
}

/// Makes an actor's name from its host's and its process id.
fn default_id(host: &str) -> String {
    let keep = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let host: String = host.trim().chars().take(HOST_CHARS).map(keep).collect();
    let host = host.trim_matches('-');
    let host = if host.is_empty() { "actor" } else { host };
    format!("{host}-{}", std::process::id())
}

/// Chooses the exit code for an actor's error.
fn failure(error: Error) -> Failure {
    let code = match &error {
        Error::CancelledEarly => return Failure::silent(ExitCode::Interrupted),
        Error::Link(error) if is_wrong_input(error) => ExitCode::WrongInput,
        Error::Task(_)
        | Error::NeverWorked { .. }
        | Error::Link(
            LinkError::Name(_)
            | LinkError::SeveralRuns { .. }
            | LinkError::Taken { .. }
            | LinkError::RunNotFound { .. },
        ) => ExitCode::WrongInput,
        Error::Link(_)
        | Error::SpecMismatch { .. }
        | Error::CutOff { .. }
        | Error::LearnerLost { .. }
        | Error::RunChanged { .. } => ExitCode::PeerLost,
        _ => ExitCode::Failed,
    };
    Failure::of(code, error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_hosts_name_becomes_part_of_an_actors() {
        for host in ["", "box", "My_Host.example.org\n", "-", &"x".repeat(300), "Ünï"] {
            let id = default_id(host);
            assert!(ActorId::new(id.clone()).is_ok(), "{id}");
        }
    }
}
