//! `leadtime watch`: a live page of a run, over the network or from its directory; or one screen of text.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_config::Config;
use leadtime_link::{ConnectSettings, Error as LinkError};
use leadtime_proto::RunName;
use leadtime_runs::evaluation::{EVAL_SEED, shipped_voice};
use leadtime_runs::{Tasks, clock};
use leadtime_watch::{Attachment, Error, FlightPlan, Page, PlanMaker, screen};
use tokio_util::sync::CancellationToken;

use crate::cli::WatchArgs;
use crate::credentials::{connect_settings, is_wrong_input};
use crate::ending::{Watch, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

mod directory;
mod served;

pub(super) use served::PageServer;

/// How long `--once` listens to who is here: every actor speaks once a second.
const LISTEN: Duration = Duration::from_millis(2_300);

pub(super) async fn run(tasks: &Tasks, args: &WatchArgs) -> Result<(), Failure> {
    let shutdown = watch(Watch::Signals).blame(ExitCode::Failed)?;
    let done = start(tasks, args, &shutdown).await;
    if shutdown.is_cancelled() { Err(Failure::silent(ExitCode::Interrupted)) } else { done }
}

async fn start(
    tasks: &Tasks,
    args: &WatchArgs,
    shutdown: &CancellationToken,
) -> Result<(), Failure> {
    let plays = args.play == "on";
    if args.directory.is_none() && args.connect.is_empty() {
        return Err(Failure::input(
            "say which run: its name or directory on this disk, or --connect ADDRESS of its learner",
        ));
    }
    if let Some(name) = &args.directory {
        let run = leadtime_runs::find_run(&args.runs, name).blame(ExitCode::WrongInput)?;
        let mut source = directory::RunSource::open(tasks, &run)?;
        let page = Page::new(source.name(), clock::unix_seconds);
        source.show(&page)?;
        if args.once {
            print(&page, args.json);
            return Ok(());
        }
        let server = PageServer::bind("--http", &args.http, &args.access).await?;
        server.announce(args.json);
        let serving = server.serve(&page, shutdown);
        tokio::select! {
            () = shutdown.cancelled() => {}
            followed = source.follow(tasks, &page, plays) => match followed? {},
        }
        return serving.await.blame(ExitCode::Failed);
    }
    let settings = settings(args).blame(ExitCode::WrongInput)?;
    let run = args.run.clone().map(RunName::new).transpose().context("--run");
    let run = run.blame(ExitCode::WrongInput)?;
    // The address first: it may be in use, and the run may be long to find.
    let server = if args.once {
        None
    } else {
        Some(PageServer::bind("--http", &args.http, &args.access).await?)
    };
    let attachment = tokio::select! {
        () = shutdown.cancelled() => return Ok(()),
        attached = Attachment::open(&settings, run) => attached.map_err(failure)?,
    };
    let page = Page::new(attachment.run.as_str(), clock::unix_seconds);
    let Some(server) = server else {
        attachment.look_once(&page, LISTEN).await.map_err(failure)?;
        print(&page, args.json);
        return Ok(());
    };
    server.announce(args.json);
    let serving = server.serve(&page, shutdown);
    let plan = plays.then(|| plan_maker(tasks));
    attachment.follow(page, plan, shutdown.clone()).await.map_err(failure)?;
    serving.await.blame(ExitCode::Failed)
}

/// Serves a page of a run that is about to be launched, until the token is cancelled.
pub(super) async fn beside(
    tasks: Tasks,
    page: Arc<Page>,
    endpoint: String,
    run: RunName,
    stop: CancellationToken,
) {
    let followed = async {
        let settings = ConnectSettings::new(vec![endpoint.parse::<leadtime_link::Endpoint>()?]);
        let attachment = Attachment::open(&settings, Some(run)).await?;
        attachment.follow(page, Some(plan_maker(&tasks)), stop.clone()).await
    };
    tokio::select! {
        () = stop.cancelled() => {}
        followed = followed => if let Err(error) = followed {
            tracing::warn!("the page shows nothing: {error:#}");
        },
    }
}

fn settings(args: &WatchArgs) -> anyhow::Result<ConnectSettings> {
    let roles = [Role::Observer, Role::Recorder];
    connect_settings(&args.connect, &args.tls, args.connect_timeout, &roles)
}

fn print(page: &Page, json: bool) {
    if json {
        output::json(&page.with(|view, now| view.json(now)));
    } else {
        output::line(&page.with(|view, now| screen(view, now)));
    }
}

/// Returns how a run's configuration becomes what its policies play.
fn plan_maker(tasks: &Tasks) -> Arc<PlanMaker> {
    let tasks = tasks.clone();
    Arc::new(move |text: &str| {
        let config = Config::stored("the learner's configuration", text, &[], &tasks.registry);
        let config = config.map_err(|error| {
            format!(
                "the configuration cannot be read, which another release may have written: {error}"
            )
        })?;
        flight_plan(&tasks, &config)
    })
}

/// Plans to play the task of a configuration as it is in evaluation.
fn flight_plan(tasks: &Tasks, config: &Config) -> Result<FlightPlan, String> {
    let (registry, task) = (tasks.registry.clone(), config.evaluation.task.clone());
    let environment = registry.build(&task).map_err(|error| error.to_string())?;
    if environment.scene().is_none() {
        return Err("this task has nothing to draw".to_owned());
    }
    Ok(FlightPlan {
        voice: shipped_voice(tasks, config),
        make: Arc::new(move || registry.build(&task)),
        policy: config.policy.clone(),
        choice: config.evaluation.action,
        seed: EVAL_SEED,
    })
}

/// Chooses the exit code for an error of watching.
fn failure(error: Error) -> Failure {
    let code = match &error {
        Error::Link(error) if is_wrong_input(error) => ExitCode::WrongInput,
        Error::Link(
            LinkError::Name(_) | LinkError::SeveralRuns { .. } | LinkError::RunNotFound { .. },
        ) => ExitCode::WrongInput,
        Error::Thread(_) => ExitCode::Failed,
        _ => ExitCode::PeerLost,
    };
    Failure::of(code, error)
}

/// Names a run's directory as people know it.
fn name_of(run: &Path) -> String {
    run.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
