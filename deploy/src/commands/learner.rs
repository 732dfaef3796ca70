//! `leadtime learner`: one run, from its directory to its result.

use std::collections::BTreeMap;

use anyhow::Context as _;
use leadtime_learner::{LearnerConfig, RunEnd, RunReport};
use leadtime_link::{Endpoint, ListenSettings};

use super::policy_file;
use super::run_report::{self, Findings};
use crate::cli::LearnerArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::progress::RunSink;
use crate::record::RunResult;
use crate::run_dir::{self, RunDir, State};
use crate::shutdown::{Watch, watch};
use crate::{Program, build_id, clock, cpu, output};
use leadtime_config::Config;

pub(super) async fn run(program: &Program, args: &LearnerArgs) -> Result<(), Failure> {
    let watched = if args.supervised { Watch::SignalsAndStdin } else { Watch::Signals };
    let shutdown = watch(watched).blame(ExitCode::Failed)?;
    let name = args.run.name.as_deref();
    let mut config = program.configure(&args.source, name).blame(ExitCode::WrongInput)?;
    let fork = args.run.fork.as_ref().map(|from| policy_file::read_fork(&config, from));
    let fork = fork.transpose().blame(ExitCode::WrongInput)?;
    config.run.name = Some(run_dir::choose_name(&config, &args.run).blame(ExitCode::WrongInput)?);
    let listen = listen_settings(&args.listen).blame(ExitCode::WrongInput)?;
    let (mut run_dir, state) = RunDir::open(&config).blame(ExitCode::WrongInput)?;
    if state == State::Finished {
        let (name, path) = (run_dir.name(), run_dir.path().display());
        output::say(&format!(
            "run `{name}` is finished: see {path}; raise learner.total_steps to train on, or take another --name"
        ));
        return Ok(());
    }
    if let (State::Fresh, Some(weights)) = (state, &fork) {
        policy_file::write_fork(run_dir.path(), weights).blame(ExitCode::WrongInput)?;
    }
    if let (Some(grown), true) = (run_dir.grown(), config.learner.anneal) {
        tracing::warn!(
            "{grown}: with learner.anneal = true the learning rate falls over the new length from here on, so the \
             weights will differ from those of a run that has this length from the start"
        );
    }
    for notice in config.notices() {
        tracing::warn!("{notice}");
    }
    tracing::info!(run = %run_dir.name(), directory = %run_dir.path().display(), "run opened");
    let metadata = policy_file::metadata(&config, run_dir.name().as_str());
    let mut sink =
        RunSink::open(run_dir.path(), config.policy.clone(), metadata, config.steps_per_update())
            .with_context(|| format!("opening the files of {}", run_dir.path().display()))
            .blame(ExitCode::WrongInput)?;
    sink.stop_after(args.run.stop_after, shutdown.clone());
    let build = build_id::fingerprint()
        .context("reading the program's own file")
        .blame(ExitCode::Failed)?;
    let learner = learner_config(&config, &run_dir, listen, build);
    let report = leadtime_learner::run(learner, Box::new(sink), shutdown.clone()).await;
    if let (Some(scratch), true) = (&args.scratch, shutdown.is_cancelled()) {
        // If the supervisor lives it does the same; if it was killed nobody else would.
        drop(std::fs::remove_dir_all(scratch));
    }
    let concluded = conclude(&mut run_dir, &report.map_err(failure)?, args);
    if let Err(error) = run_report::write(run_dir.path(), Findings::of_training(&config)) {
        tracing::warn!("report.html cannot be written: {error:#}");
    }
    concluded
}

fn listen_settings(listen: &[String]) -> anyhow::Result<ListenSettings> {
    let endpoints: Result<Vec<Endpoint>, _> = listen.iter().map(|text| text.parse()).collect();
    let endpoints = endpoints.context("--listen")?;
    for endpoint in endpoints.iter().filter(|endpoint| is_open(endpoint.as_str())) {
        tracing::warn!(%endpoint, "whoever reaches this address can take part: it has neither encryption nor passwords");
    }
    Ok(ListenSettings::new(endpoints))
}

/// Tells whether other machines can reach an address without showing who they are.
fn is_open(endpoint: &str) -> bool {
    let local = ["127.0.0.1:", "localhost:", "[::1]:"];
    let address = endpoint.strip_prefix("tcp/");
    address.is_some_and(|address| !local.iter().any(|prefix| address.starts_with(prefix)))
}

fn learner_config(
    config: &Config,
    run_dir: &RunDir,
    listen: ListenSettings,
    program: String,
) -> LearnerConfig {
    LearnerConfig {
        run: run_dir.name().clone(),
        incarnation: clock::incarnation(),
        run_seed: config.seed,
        task: config.task.clone(),
        env: config.env.clone(),
        policy: config.policy.clone(),
        settings: config.learner.clone(),
        window: config.window,
        actors_min: config.run.actors_min as usize,
        listen,
        program,
        cpu: cpu::fingerprint(),
        checkpoints: run_dir.path().join("checkpoints"),
        checkpoint_interval: config.run.checkpoints,
        initial: policy_file::initial(run_dir.path()),
        identity: run_dir::identity(config),
    }
}

/// Decides whose fault a learner's end is.
fn failure(error: leadtime_learner::Error) -> Failure {
    use leadtime_learner::Error;
    use leadtime_link::Error as LinkError;
    let code = match &error {
        Error::Checkpoint(_)
        | Error::ConfigurationChanged { .. }
        | Error::Link(
            LinkError::AddressInUse { .. } | LinkError::Listen { .. } | LinkError::NoEndpoint,
        ) => ExitCode::WrongInput,
        Error::Link(_) => ExitCode::PeerLost,
        _ => ExitCode::Failed,
    };
    Failure { code, error: Some(error.into()) }
}

/// Writes down how the run ended, and says it.
fn conclude(run_dir: &mut RunDir, report: &RunReport, args: &LearnerArgs) -> Result<(), Failure> {
    let digest = output::hex(&report.digest);
    let mut books = serde_json::to_value(Accounts::from(report)).blame(ExitCode::Failed)?;
    books["balanced"] = report.balance.is_ok().into();
    let (n_updates, n_steps) = (report.n_updates, report.n_steps);
    output::line(&format!("run      {}", run_dir.path().display()));
    output::line(&format!("updates  {n_updates} ({n_steps} steps)"));
    output::line(&format!("weights  sha256 {digest}"));
    output::line(&format!("books    {books}"));
    if let Err(imbalance) = report.balance {
        return Err(imbalance).blame(ExitCode::Failed);
    }
    if report.end != RunEnd::Stopped {
        let result = RunResult {
            finished: clock::utc_now(),
            updates: n_updates,
            steps: n_steps,
            weights_sha256: digest,
            reproducible: report.reproducible,
            books,
        };
        return run_dir.finish(result).blame(ExitCode::WrongInput);
    }
    if !report.checkpointed {
        tracing::warn!(
            "the state at the end is not on the disk: a resume goes on from an older checkpoint"
        );
    }
    let asked = args.run.stop_after.is_some_and(|updates| n_updates >= updates);
    if asked { Ok(()) } else { Err(Failure::silent(ExitCode::Interrupted)) }
}

/// The books as the record keeps them.
#[derive(serde::Serialize)]
struct Accounts {
    published: u64,
    trained: u64,
    dropped_stale: u64,
    refused: u64,
    refusals: BTreeMap<&'static str, u64>,
    superseded: u64,
    unused_at_end: u64,
    rolled_back: u64,
    duplicates: u64,
    steps_redone: u64,
}

impl From<&RunReport> for Accounts {
    fn from(report: &RunReport) -> Self {
        let books = &report.books;
        Self {
            published: books.published,
            trained: books.trained,
            dropped_stale: books.dropped_stale,
            refused: books.refused,
            refusals: books.refusals.iter().map(|(cause, &n)| (cause.name(), n)).collect(),
            superseded: books.superseded,
            unused_at_end: books.unused_at_end,
            rolled_back: books.rolled_back,
            duplicates: books.duplicates,
            steps_redone: books.steps_redone,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::is_open;

    #[test]
    fn only_addresses_that_others_can_reach_are_open() {
        for closed in ["tcp/127.0.0.1:7447", "tcp/[::1]:0", "unixsock-stream//tmp/a", "tls/h:1"] {
            assert!(!is_open(closed), "{closed}");
        }
        assert!(is_open("tcp/0.0.0.0:7447") && is_open("tcp/box.example.org:1"));
    }
}
