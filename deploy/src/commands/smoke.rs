//! `leadtime smoke`: the whole path once, trained, evaluated and drawn, and a verdict.
//!
//! ```text
//! up (learner + actors over the network)  ->  policy file
//!    ->  trained, unaided, heuristic and untrained play the same episodes  ->  table, report.html, playthrough.png
//! ```

use std::ffi::OsString;
use std::path::Path;

use anyhow::Context as _;
use leadtime_config::{Config, Layer};
use leadtime_eval::measure::Comparison;
use leadtime_eval::report::Verdict;
use leadtime_runs::evaluation::EVAL_SEED;
use leadtime_runs::findings::{EvaluationRequest, RunEvaluation, evaluate_run};
use leadtime_runs::launch::Launch;
use leadtime_runs::record::books_sentence;
use leadtime_runs::{LoadedPolicy, Naming, QUICK_UPDATES, REPORT_PAGE, RunFiles, RunRecord, Tasks};
use serde_json::json;

use super::launch::launch;
use super::{evaluation, play, report};
use crate::cli::SmokeArgs;
use crate::ending::{Watch, drain_on_request, unless_cancelled, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW, EVALUATE, HEAR};

/// Episodes of a quick run.
const QUICK_EPISODES: u32 = 10;

pub(super) async fn run(
    tasks: &Tasks,
    args: &SmokeArgs,
    options: &[OsString],
) -> Result<(), Failure> {
    let config = configure(tasks, args).blame(ExitCode::WrongInput)?;
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    // Success would say that it has passed, so it is interrupted by that like by anything else.
    drain_on_request(&shutdown).blame(ExitCode::Failed)?;
    if args.quick {
        output::note("smoke --quick checks the mechanics only: nothing is claimed about learning");
    }
    let stem = format!("smoke-{}", config.domain);
    let what = Launch { options, ..Launch::new(Naming::New(&stem), args.actors) };
    let directory = launch(&config, &what, &shutdown).await?;
    let (tasks, arguments, run) = (tasks.clone(), args.clone(), directory.clone());
    let work = move || evaluate(&tasks, &arguments, &run).map_err(Failure::from);
    let outcome = unless_cancelled(&shutdown, work).await;
    // Interrupted, it has a trained policy all the same.
    let outcome = outcome.inspect_err(|_| output::next(&directory, &[EVALUATE, DRAW]))?;
    print(args, &directory, &outcome);
    if outcome.verdict.holds { Ok(()) } else { Err(Failure::silent(ExitCode::Failed)) }
}

/// Loads the domain's configuration, made small for a quick run.
fn configure(tasks: &Tasks, args: &SmokeArgs) -> anyhow::Result<Config> {
    let mut source = args.source.clone();
    source.config = source.config.or_else(|| args.domain.clone());
    let config = source.load(tasks, None)?;
    if !args.quick {
        return Ok(config);
    }
    let steps = QUICK_UPDATES * config.steps_per_update();
    let quick = format!(
        "learner.total_steps = {steps}\nrun.checkpoint_every = 4\n[evaluation]\nduring_training = 1\nheld_out_episodes = \
         {QUICK_EPISODES}\n"
    );
    Ok(config.with([Layer::text("--quick", quick)], &tasks.registry)?)
}

/// What the evaluation found.
struct SmokeOutcome {
    comparison: Comparison,
    verdict: Verdict,
    books: serde_json::Value,
}

fn evaluate(tasks: &Tasks, args: &SmokeArgs, directory: &Path) -> anyhow::Result<SmokeOutcome> {
    let mut record = RunRecord::read(directory)?;
    if args.quick {
        record.quick = true;
        record.write(directory).context("noting that the run is a quick one")?;
    }
    let run = RunFiles::read(directory)?;
    let policy = LoadedPolicy::load(&tasks.registry, directory, directory, &[])?;
    evaluation::warn_of_own_episodes(&policy, EVAL_SEED);
    let episodes = args.episodes.or(args.quick.then_some(QUICK_EPISODES));
    let request = EvaluationRequest { episodes, action: None, seed: EVAL_SEED };
    let RunEvaluation { findings, record: evaluated } =
        evaluate_run(tasks, &run, &policy, &request)?;
    if let Some(first) = findings.episodes.first() {
        play::draw(first, &directory.join("playthrough.png"))?;
    }
    let nobody = || Verdict {
        holds: true,
        sentence: "There is nobody to compare with: no verdict.".to_owned(),
    };
    let outcome = SmokeOutcome {
        comparison: evaluated.comparison.clone(),
        verdict: findings.verdict.clone().unwrap_or_else(nobody),
        books: record.result.map(|result| result.books).unwrap_or_default(),
    };
    evaluation::save(&evaluated, directory, &policy.config)?;
    report::write(tasks, run, findings)?;
    Ok(outcome)
}

fn print(args: &SmokeArgs, directory: &Path, outcome: &SmokeOutcome) {
    let page = directory.join(REPORT_PAGE);
    if args.shown.json {
        output::json(&json!({
            "run": directory.display().to_string(),
            "report": page.display().to_string(),
            "quick": args.quick,
            "passed": outcome.verdict.holds,
            "verdict": outcome.verdict.sentence,
            "comparison": outcome.comparison,
            "books": outcome.books,
        }));
        return;
    }
    evaluation::print(&outcome.comparison, args.shown.all);
    output::line(&format!("\n{}", outcome.verdict.sentence));
    output::line(&format!("Books:  {}", books_sentence(&outcome.books)));
    output::line(&format!("Report: {}", page.display()));
    output::next(directory, &[DRAW, HEAR]);
}
