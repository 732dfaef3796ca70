//! `leadtime smoke`: the whole path once, trained, evaluated and drawn, and a verdict.
//!
//! ```text
//! up (learner + actors over the network)  ->  policy file
//!    ->  trained, unaided, heuristic and untrained play the same episodes  ->  table, report.html, playthrough.png
//! ```

use std::path::{Path, PathBuf};

use leadtime_config::{Config, Layer};
use leadtime_eval::measure::Comparison;
use leadtime_eval::report::Verdict;
use leadtime_runs::evaluation::{EVAL_SEED, TRAINED, UNAIDED, evaluate_all, main_measure};
use leadtime_runs::launch::Launch;
use leadtime_runs::record::books_sentence;
use leadtime_runs::report::Findings;
use leadtime_runs::{EvaluationRecord, LoadedPolicy, Naming, RunRecord, Tasks};
use serde_json::json;

use super::launch::launch;
use super::{evaluation, play, report};
use crate::cli::SmokeArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW, EVALUATE, HEAR};
use crate::shutdown::{Watch, unless_cancelled, watch};

/// What the trained notifier must gain over the unaided listener, in success, with its whole interval, in a built-in world.
/// In a world of one's own, where nobody knows what can be gained, any gain will do.
const MARK: f64 = 0.3;
/// Updates and episodes of a quick run.
const QUICK_UPDATES: u64 = 12;
const QUICK_EPISODES: u32 = 10;

pub(super) async fn run(tasks: &Tasks, args: &SmokeArgs, options: &[&str]) -> Result<(), Failure> {
    let config = configure(tasks, args).blame(ExitCode::WrongInput)?;
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    if args.quick {
        output::note("smoke --quick checks the mechanics only: nothing is claimed about learning");
    }
    let stem = format!("smoke-{}", config.domain);
    let what = Launch { options, ..Launch::new(Naming::New(&stem), args.actors) };
    let directory = launch(&config, &what, &shutdown).await?;
    let (tasks, arguments, run) = (tasks.clone(), args.clone(), directory.clone());
    let work = move || evaluate(&tasks, &arguments, &config, &run).map_err(Failure::from);
    let outcome = unless_cancelled(&shutdown, work).await;
    // Interrupted, it has a trained policy all the same.
    let outcome = outcome.inspect_err(|_| output::next(&directory, &[EVALUATE, DRAW]))?;
    let record = RunRecord::read(&directory).blame(ExitCode::Failed)?;
    let books = record.result.map(|result| result.books).unwrap_or_default();
    print(args, &directory, &outcome, &books);
    if outcome.passed { Ok(()) } else { Err(Failure::silent(ExitCode::Failed)) }
}

/// Loads the domain's configuration, made small for a quick run.
fn configure(tasks: &Tasks, args: &SmokeArgs) -> anyhow::Result<Config> {
    let mut source = args.source.clone();
    source.config.get_or_insert_with(|| PathBuf::from(&args.domain));
    let config = source.load(tasks, None)?;
    if !args.quick {
        return Ok(config);
    }
    let steps = QUICK_UPDATES * config.steps_per_update();
    let quick = format!("learner.total_steps = {steps}\nrun.checkpoint_every = 4\n");
    Ok(config.with([Layer::text("--quick", quick)], &tasks.registry)?)
}

/// What the evaluation found.
struct SmokeOutcome {
    comparison: Comparison,
    sentence: String,
    passed: bool,
}

fn evaluate(
    tasks: &Tasks,
    args: &SmokeArgs,
    config: &Config,
    directory: &Path,
) -> anyhow::Result<SmokeOutcome> {
    let loaded = LoadedPolicy::load(&tasks.registry, &config.run.directory, directory, &[])?;
    let action = config.evaluation.action;
    let trained = evaluation::policy(TRAINED, config, &loaded.parameters, action)?;
    let players = leadtime_runs::evaluation::players(tasks, trained, config, action)?;
    let default = if args.quick { QUICK_EPISODES } else { config.evaluation.episodes };
    let n_episodes = args.episodes.unwrap_or(default);
    let seed = EVAL_SEED;
    let evaluations = evaluate_all(tasks, config, &players, n_episodes, seed)?;
    let comparison = leadtime_runs::evaluation::compare(config, &evaluations, &[]);
    let (sentence, passed) = verdict(args, config, &comparison);
    let quick = "This was a quick run: it checks the mechanics only, and its figures say nothing about learning.";
    let episodes = leadtime_runs::evaluation::telling(tasks, config, &players, &evaluations)?;
    if let Some(first) = episodes.first() {
        play::draw(first, &directory.join("playthrough.png"))?;
    }
    let record = EvaluationRecord::new(&loaded, action, seed, comparison.clone());
    evaluation::save(&record, directory, config)?;
    let findings = Findings {
        lead: report::lead(config, &loaded.path),
        verdicts: vec![Verdict { holds: passed, sentence: sentence.clone() }],
        comparison: Some(comparison.clone()),
        pictures: report::pictures(&episodes),
        notes: args.quick.then(|| quick.to_owned()).into_iter().collect(),
    };
    report::write(tasks, directory, findings)?;
    Ok(SmokeOutcome { comparison, sentence, passed })
}

/// Says whether the trained policy gained enough, where the task has a person to compare with.
fn verdict(args: &SmokeArgs, config: &Config, comparison: &Comparison) -> (String, bool) {
    if args.quick {
        return ("The mechanics work; learning was not checked (--quick).".to_owned(), true);
    }
    let measure = main_measure(config);
    let against = comparison.differences.iter().find(|difference| difference.minus == UNAIDED);
    let (Some(difference), true) = (against, measure == "success") else {
        return ("This task has no unaided person to compare with: no verdict.".to_owned(), true);
    };
    let mark = if Tasks::is_built_in(config.domain.as_str()) { MARK } else { 0.0 };
    let passed = difference.interval.low > mark;
    let verb = if passed { "gained" } else { "did not gain" };
    let interval = difference.sentence(comparison.bootstrap.confidence);
    let amount =
        if mark > 0.0 { format!("more than {mark} in success") } else { "in success".to_owned() };
    (format!("The trained notifier {verb} {amount}: {interval}."), passed)
}

fn print(args: &SmokeArgs, directory: &Path, outcome: &SmokeOutcome, books: &serde_json::Value) {
    let report = directory.join("report.html");
    if args.shown.json {
        output::json(&json!({
            "run": directory.display().to_string(),
            "report": report.display().to_string(),
            "quick": args.quick,
            "passed": outcome.passed,
            "verdict": outcome.sentence,
            "comparison": outcome.comparison,
            "books": books,
        }));
        return;
    }
    evaluation::print(&outcome.comparison, args.shown.all);
    output::line(&format!("\n{}", outcome.sentence));
    output::line(&format!("Books:  {}", books_sentence(books)));
    output::line(&format!("Report: {}", report.display()));
    output::next(directory, &[DRAW, HEAR]);
}
