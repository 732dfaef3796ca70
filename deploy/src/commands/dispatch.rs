//! From a parsed command line to the command.

use std::ffi::OsString;

use leadtime_runs::Tasks;
use tokio::runtime;

use super::{
    actor, certs, check, compare, config, conformance, describe, drive, eval, health, learner, new,
    pilot, play, probe, race, record, record_run, replay, report, router, runs, script_search,
    serve, smoke, taxonomy, up, version, watch,
};
use crate::cli::{Cli, Command, PilotCommand, TaxonomyCommand, Verbosity};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::{ending, log, output, targets, threads};

/// Carries out one command.
pub(crate) fn dispatch(tasks: &Tasks, cli: Cli) -> Result<(), Failure> {
    targets::check(&cli)?;
    let Cli { command, verbosity, logs } = cli;
    let is_one_of_many = matches!(&command, Command::Actor(args) if args.supervised);
    let level = match verbosity {
        Verbosity { verbose: true, .. } => "info,leadtime=debug",
        Verbosity { quiet: true, .. } => "warn",
        // What an environment of the user's own prints is theirs to see.
        _ if is_one_of_many => "warn,leadtime::worker=info",
        _ => "info",
    };
    log::start(level, &logs)?;
    threads::check()?;
    if !watches(&command) {
        ending::at_once().blame(ExitCode::Failed)?;
    }
    let options = verbosity.options().iter().map(OsString::from);
    let options: Vec<OsString> = options.chain(logs.options()).collect();
    let options = options.as_slice();
    match command {
        Command::Smoke(args) => block_on(smoke::run(tasks, &args, options)),
        Command::Up(args) => block_on(up::up(tasks, &args, options)),
        Command::Race(args) => block_on(race::run(tasks, &args, options)),
        Command::Learner(args) => block_on(learner::run(tasks, &args)),
        Command::Actor(args) => block_on(actor::run(tasks, &args)),
        Command::Watch(args) => block_on(watch::run(tasks, &args)),
        Command::Router(args) => block_on(router::run(&args)),
        Command::Serve(args) => block_on(serve::run(tasks, &args)),
        Command::Drive(args) => block_on(drive::run(tasks, &args)),
        Command::Record(args) => match &args.run {
            Some(run) => block_on(record_run::run(&args, run)),
            None => block_on(record::run(&args)),
        },
        Command::Replay(args) => block_on(replay::run(tasks, &args)),
        Command::Certs { command } => certs::run(&command),
        Command::Eval(args) => eval::run(tasks, &args),
        Command::Probe(args) => probe::run(tasks, &args),
        Command::Play(args) => play::run(tasks, &args),
        Command::Report(args) => report::run(tasks, &args),
        Command::Compare(args) => block_on(compare::run(tasks, &args)),
        Command::Pilot { command: PilotCommand::Eval(args) } => pilot::run(&args),
        Command::Taxonomy { command } => match command {
            TaxonomyCommand::Build(args) => taxonomy::build(&args),
            TaxonomyCommand::Rate(args) => taxonomy::rate(&args),
            TaxonomyCommand::Report(args) => taxonomy::report(&args),
            TaxonomyCommand::Export(args) => taxonomy::export(&args),
            TaxonomyCommand::Validate(args) => taxonomy::validate(tasks, &args),
            TaxonomyCommand::Speak(args) => taxonomy::speak(&args),
        },
        Command::ScriptSearch(args) => script_search::run(tasks, &args),
        Command::Conformance(args) => conformance::run(&args),
        Command::New(args) => new::run(&args),
        Command::Config(args) => config::run(tasks, &args),
        Command::Describe(args) => describe::run(tasks, &args),
        Command::Runs(args) => runs::run(&args),
        Command::Check(args) => block_on(check::run(tasks, &args)),
        Command::Health(args) => health::run(&args),
        Command::Version(args) => {
            version::run(&args);
            Ok(())
        }
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::documented(), "leadtime", &mut script);
            output::data(String::from_utf8_lossy(&script).trim_end());
            Ok(())
        }
    }
}

/// Returns whether a command has something to finish when it is asked to end, and sees to that itself.
fn watches(command: &Command) -> bool {
    matches!(
        command,
        Command::Smoke(_)
            | Command::Up(_)
            | Command::Race(_)
            | Command::Learner(_)
            | Command::Actor(_)
            | Command::Watch(_)
            | Command::Router(_)
            | Command::Serve(_)
            | Command::Drive(_)
            | Command::Record(_)
            | Command::Replay(_)
            | Command::Compare(_)
    )
}

/// Runs a command that waits for several things at once.
fn block_on(work: impl Future<Output = Result<(), Failure>>) -> Result<(), Failure> {
    let runtime = runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("leadtime-async")
        .enable_all()
        .build()
        .blame(ExitCode::Failed)?;
    let result = runtime.block_on(work);
    // Whatever still runs has been asked to stop; the process does not wait for it.
    runtime.shutdown_background();
    result
}
