//! `leadtime learner`: one run, from its directory to its result.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::Path;
use std::sync::atomic::Ordering;

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_config::Config;
use leadtime_learner::{RunEnd, RunReport, RunStop};
use leadtime_link::{Endpoint, ListenSettings};
use leadtime_process::{MetricsPipe, ProcessTrace, TraceFile, log_line};
use leadtime_proto::hex;
use leadtime_runs::findings::Findings;
use leadtime_runs::held_out::held_out_evaluation;
use leadtime_runs::record::books_sentence;
use leadtime_runs::{
    ProgramBuild, ResultCause, RunDir, RunFiles, RunRecorder, RunResult, RunState, Tasks, clock,
    learner_config, scratch,
};
use leadtime_status::{LearnerFacts, LearnerStatus, StatusServer};
use leadtime_web::parse_address;
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;

use super::report;
use crate::build;
use crate::cli::{LearnerArgs, STATUS_ADDRESS, StopAfter};
use crate::credentials::{guard_options, is_wrong_address, is_wrong_input, listen_settings};
use crate::ending::{Watch, drain_on_request, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW, EVALUATE};
use crate::service;
use crate::sink::{RunSink, held_out_sentence};

/// Where a learner listens if nothing else is said; with a certificate by TLS, else by TCP.
const DEFAULT_ADDRESS: &str = "127.0.0.1:7447";
/// What helps after a divergence.
const DIVERGED: &str = "the run goes on from its last good update with --name and a smaller \
                        --change learner.learning_rate=...; if it diverges at once again, remove \
                        the newest of its checkpoints first";

pub(super) async fn run(tasks: &Tasks, args: &LearnerArgs) -> Result<(), Failure> {
    let watched = if args.supervised { Watch::SignalsAndStdin } else { Watch::Signals };
    let shutdown = watch(watched).blame(ExitCode::Failed)?;
    // An end that was planned has no deadline: it ends when all is saved, with success.
    let planned = shutdown.child_token();
    let config = args.run.load(tasks, &args.source).blame(ExitCode::WrongInput)?;
    let listen = listening(args).blame(ExitCode::WrongInput)?;
    let status = bind_status(args.status.as_deref()).await?;
    // A supervisor has made the file.
    let trace = args.run.trace.file.as_deref();
    let made = TraceFile::create(trace.filter(|_| !args.supervised)).blame(ExitCode::WrongInput)?;
    let drained = drain_on_request(&planned).blame(ExitCode::Failed)?;
    let build = build::this_build()?;
    let (mut run_dir, state) = open(&config, args, &build)?;
    log_line::is_about_run(run_dir.name.as_str());
    if args.supervised {
        run_dir.note_supervisor();
    }
    if state == RunState::Finished {
        service::ready();
        tell_finished(&run_dir, args.json);
        return Ok(());
    }
    if let Some(rounded) = config.rounded_steps() {
        tracing::info!("{rounded}");
    }
    tell_changes(&run_dir, &config);
    tracing::info!("run opened: {}", run_dir.path.display());
    let facts = facts(&run_dir, &config, &listen);
    let learner = learner_config(&config, &run_dir, listen, build, args.local_actors)
        .blame(ExitCode::WrongInput)?;
    let recorder = open_recorder(&run_dir, &config)?;
    let n_asked = args.run.stop_after.and_then(|it| it.n_updates(config.steps_per_update()));
    let time_is_up = args
        .run
        .stop_after
        .map_or_else(CancellationToken::new, |stop_after| stop_in_time(stop_after, &planned));
    // At the end of the run there is nothing to stop, and a last evaluation to wait for.
    let n_before_end = n_asked.filter(|n_updates| *n_updates < config.learner.n_updates());
    let stop_after = n_before_end.map(|n_updates| (n_updates, planned.clone()));
    let status = status.map(|server| LearnerStatus::serve(server, facts));
    let trace = ProcessTrace::join(trace, "learner", "learner");
    let sink = RunSink::new(run_dir.path.clone(), recorder, stop_after);
    let mut sink = sink.with_status(status).with_trace(trace);
    if let Some(command) = &args.run.metrics_to {
        sink.hand_on(MetricsPipe::start(command).context("--metrics-to").blame(ExitCode::Failed)?);
    }
    let held_out = held_out_evaluation(&config, &tasks.registry);
    let run_stop = RunStop { ask: planned, insist: shutdown.clone() };
    let report = leadtime_learner::run(learner, Box::new(sink), held_out, run_stop).await;
    service::stopping();
    if let Some(told) = made.and_then(TraceFile::finish) {
        output::note(&told);
    }
    if let (Some(scratch), true) = (&args.scratch, shutdown.is_cancelled()) {
        // A supervisor that lives removes it itself; if it was killed nobody else would.
        scratch::remove_if_abandoned(scratch);
    }
    let report = report.map_err(failure)?;
    let is_asked = time_is_up.is_cancelled()
        || drained.load(Ordering::Relaxed)
        || n_asked.is_some_and(|n| report.n_updates >= n);
    let concluded = conclude(&mut run_dir, &report, &config, is_asked, args);
    write_report(tasks, &config, &run_dir);
    concluded
}

/// Gathers what a status page says of the run itself.
fn facts(run_dir: &RunDir, config: &Config, listen: &ListenSettings) -> LearnerFacts {
    let own = listen.identity.as_ref().map(|identity| identity.certificate().to_owned());
    let mut endpoints = listen.endpoints.iter().chain(&listen.connect);
    let listens_with_it = |endpoint: &Endpoint| endpoint.as_str().starts_with("tls/");
    LearnerFacts {
        run: run_dir.name.to_string(),
        directory: run_dir.path.clone(),
        checkpoint_interval: config.run.checkpoints.time,
        certificate: own.or_else(|| endpoints.find_map(Endpoint::certificate)),
        is_certificate_read_once: listen.endpoints.iter().any(listens_with_it),
    }
}

/// Opens the files to which the run is recorded.
fn open_recorder(run_dir: &RunDir, config: &Config) -> Result<RunRecorder, Failure> {
    let recorder = RunRecorder::open(&run_dir.path, config, run_dir.name.as_str())
        .with_context(|| format!("opening the files of {}", run_dir.path.display()))
        .blame(ExitCode::WrongInput)?;
    Ok(recorder.keeping(run_dir))
}

/// Says that there is nothing to train, and what to do; as JSON, how the run ended.
fn tell_finished(run_dir: &RunDir, as_json: bool) {
    if let (true, Some(result)) = (as_json, &run_dir.record.result) {
        let RunResult { end, updates, steps, weights_sha256, books, .. } = result;
        let line = end_json(&run_dir.path, Some(*end), *updates, *steps, weights_sha256, books);
        output::json(&line);
    }
    let (name, path) = (&run_dir.name, run_dir.path.display());
    let setting = match run_dir.record.result.as_ref().map(|result| result.end) {
        Some(ResultCause::StopAt) => "evaluation.stop_at, or leave it out,",
        _ => "learner.total_steps (`--steps`)",
    };
    output::say(&format!(
        "run `{name}` is finished: see {path}; raise {setting} to train on, or take another --name"
    ));
}

/// Opens the run, with other settings where the command line asks for them.
fn open(
    config: &Config,
    args: &LearnerArgs,
    build: &ProgramBuild,
) -> Result<(RunDir, RunState), Failure> {
    let fork = args.run.fork.as_deref().map(|from| RunDir::fork(config, from));
    let fork = fork.transpose().context("--fork").blame(ExitCode::WrongInput)?.flatten();
    let opened = match args.run.changed_keys().as_slice() {
        [] => RunDir::open(config, fork.as_ref(), build),
        keys => RunDir::open_changed(config, keys, build),
    };
    opened.blame(ExitCode::WrongInput)
}

/// Writes the page of a run that has ended.
fn write_report(tasks: &Tasks, config: &Config, run_dir: &RunDir) {
    let files = RunFiles::read(&run_dir.path).map_err(anyhow::Error::from);
    let written = files.and_then(|run| {
        let findings = Findings::of_training(config, &run, &output::program());
        report::write(tasks, run, findings)
    });
    if let Err(error) = written {
        tracing::warn!("report.html cannot be written: {error:#}");
    }
}

/// Asks the run to stop when its time is over; the token says that it was.
fn stop_in_time(stop_after: StopAfter, planned: &CancellationToken) -> CancellationToken {
    let time_is_up = CancellationToken::new();
    if let Some(time) = stop_after.time() {
        let (planned, told) = (planned.clone(), time_is_up.clone());
        tokio::spawn(async move {
            tokio::time::sleep(time).await;
            tracing::info!("the time of --stop-after is over: finishing");
            told.cancel();
            planned.cancel();
        });
    }
    time_is_up
}

/// Says how a run that goes on differs from what it was.
fn tell_changes(run_dir: &RunDir, config: &Config) {
    if let (Some(grown), true) = (&run_dir.grown, config.learner.anneal) {
        tracing::warn!(
            "{grown}: with learner.anneal = true the learning rate falls over the new length from here on, so the \
             weights will differ from those of a run that has this length from the start"
        );
    }
    for change in &run_dir.record.changes {
        tracing::info!("changed while it went on: {change}");
    }
}

/// Takes the address of `--status`, before anything of the run is touched.
pub(super) async fn bind_status(address: Option<&str>) -> Result<Option<StatusServer>, Failure> {
    let Some(address) = address else { return Ok(None) };
    let bound = async { StatusServer::bind(parse_address(address, STATUS_ADDRESS)?).await };
    bound.await.context("--status").blame(ExitCode::WrongInput).map(Some)
}

/// Returns where to listen: on this machine, unless a router is to be dialled instead.
fn addresses(args: &LearnerArgs) -> Vec<String> {
    let is_reached = !args.listen.is_empty() || !args.connect.is_empty();
    if is_reached { args.listen.clone() } else { vec![DEFAULT_ADDRESS.to_owned()] }
}

/// Returns how this learner is reached, and for how many actors it keeps room.
fn listening(args: &LearnerArgs) -> anyhow::Result<ListenSettings> {
    let settings = listen_settings(&addresses(args), &args.connect, &args.guard, Role::Learner)?;
    Ok(ListenSettings { max_actors: args.max_actors as usize, ..settings })
}

/// Returns the options that give another learner the same addresses, and the same room for actors.
fn network_options(args: &LearnerArgs) -> Vec<OsString> {
    let option = |name: &str, value: &String| -> [OsString; 2] { [name.into(), value.into()] };
    let listen = args.listen.iter().flat_map(|address| option("--listen", address));
    let connect = args.connect.iter().flat_map(|address| option("--connect", address));
    let is_default = args.max_actors == ListenSettings::DEFAULT_MAX_ACTORS;
    let room = option("--max-actors", &args.max_actors.to_string());
    let room = room.into_iter().filter(|_| !is_default);
    listen.chain(connect).chain(guard_options(&args.guard)).chain(room).collect()
}

/// Chooses the exit code for a learner's error.
fn failure(error: leadtime_learner::Error) -> Failure {
    use leadtime_learner::Error;
    let error = match error {
        // What was given is at fault, and not the network.
        Error::Link(error) if is_wrong_input(&error) || is_wrong_address(&error) => {
            return Failure::of(ExitCode::WrongInput, error);
        }
        // The same command would make the same update again.
        error if error.is_divergence() => {
            let told = format!("{:#}; {DIVERGED}", anyhow::Error::from(error));
            return Failure::of(ExitCode::Failed, anyhow::Error::msg(told));
        }
        error => error,
    };
    let code = match &error {
        Error::Checkpoint(_) | Error::ConfigurationChanged { .. } => ExitCode::WrongInput,
        Error::Link(_) => ExitCode::PeerLost,
        _ => ExitCode::Failed,
    };
    Failure::of(code, error)
}

/// Records and prints how the run ended; `is_asked` tells whether it stopped where the command line says.
fn conclude(
    run_dir: &mut RunDir,
    report: &RunReport,
    config: &Config,
    is_asked: bool,
    args: &LearnerArgs,
) -> Result<(), Failure> {
    // As the record keeps them.
    let mut books = json!(BTreeMap::from(report.books.entries()));
    books["refusals"] = json!(report.books.refusals);
    books["balanced"] = json!(report.balance.is_ok());
    let is_early = report.n_updates < config.learner.n_updates();
    let cause = if is_early { ResultCause::StopAt } else { ResultCause::TotalSteps };
    let end = (report.end != RunEnd::Stopped).then_some(cause);
    print_end(&run_dir.path, report, end, &books, args.json);
    if let Err(imbalance) = report.balance {
        return Err(imbalance).blame(ExitCode::Failed);
    }
    if let Some(end) = end {
        let result = RunResult {
            finished: clock::utc_now(),
            end,
            updates: report.n_updates,
            steps: report.n_steps,
            weights_sha256: hex::encode(&report.digest),
            reproducible: report.reproducible && run_dir.record.changes.is_empty(),
            books,
        };
        run_dir.finish(result).blame(ExitCode::WrongInput)?;
        // The supervisor that started this process says what comes next.
        if !args.supervised {
            output::next(&run_dir.path, &[EVALUATE, DRAW]);
        }
        return Ok(());
    }
    if !args.supervised {
        let (path, name) = (&run_dir.path, run_dir.name.as_str());
        output::next_resumes("learner", path, name, &network_options(args));
        output::note("The actors have to be started again, too.");
    }
    if is_asked { Ok(()) } else { Err(Failure::silent(ExitCode::Interrupted)) }
}

/// Returns how a run ended as JSON.
fn end_json(
    run: &Path,
    end: Option<ResultCause>,
    updates: u64,
    steps: u64,
    weights_sha256: &str,
    books: &Value,
) -> Value {
    json!({
        "run": run.display().to_string(),
        "end": end,
        "updates": updates,
        "steps": steps,
        "weights_sha256": weights_sha256,
        "books": books,
    })
}

/// Prints how a run ended, or where it stopped if nothing ended it.
fn print_end(
    run: &Path,
    report: &RunReport,
    end: Option<ResultCause>,
    books: &Value,
    as_json: bool,
) {
    let (n_updates, n_steps) = (report.n_updates, report.n_steps);
    let (digest, best) = (hex::encode(&report.digest), &report.best.held_out);
    if as_json {
        let mut line = end_json(run, end, n_updates, n_steps, &digest, books);
        line["best"] = json!(best);
        return output::json(&line);
    }
    output::line(&format!("run      {}", run.display()));
    output::line(&format!("updates  {n_updates} ({n_steps} steps)"));
    if end == Some(ResultCause::StopAt) {
        output::line("ended    by evaluation.stop_at, which this policy reaches");
    }
    output::line(&format!("weights  sha256 {digest}"));
    if let Some(means) = best {
        output::line(&format!("best     {}", held_out_sentence(means)));
    }
    output::line(&format!("books    {}", books_sentence(books)));
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::{Cli, Command};

    fn read(options: &str) -> Result<LearnerArgs, clap::Error> {
        let words = format!("leadtime learner -c cartpole {options}");
        match Cli::try_parse_from(words.split_whitespace())?.command {
            Command::Learner(args) => Ok(args),
            other => panic!("{other:?} is another command"),
        }
    }

    #[test]
    fn the_room_for_actors_reaches_the_network_and_whoever_goes_on() {
        let args = read("").unwrap();
        assert_eq!(listening(&args).unwrap().max_actors, 256);
        assert!(network_options(&args).is_empty());
        let args = read("--max-actors 700").unwrap();
        assert_eq!(listening(&args).unwrap().max_actors, 700);
        assert_eq!(network_options(&args), ["--max-actors", "700"]);
        for wrong in ["0", "1001", "-1", "many"] {
            let told = read(&format!("--max-actors={wrong}")).unwrap_err().to_string();
            assert!(told.contains("--max-actors"), "{told}");
        }
    }

    #[test]
    fn a_divergence_names_what_helps() {
        let cause = "gradient norm of minibatch 3 is inf".to_owned();
        let error = leadtime_ppo::TrainError::Diverged(cause);
        let failure = failure(leadtime_learner::Error::Train(error));
        assert_eq!(failure.code, ExitCode::Failed);
        let told = failure.error.unwrap().to_string();
        let cause = "training failed: gradient norm of minibatch 3 is inf: training has diverged; ";
        assert_eq!(told, format!("{cause}{DIVERGED}"));
    }
}
