//! `leadtime smoke`: the whole path once, trained, judged and drawn, and a verdict.
//!
//! ```text
//! up (learner + actors over the network)  ->  policy file
//!    ->  trained, unaided, heuristic and untrained play the same episodes  ->  table, report.html, playthrough.png
//! ```

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use leadtime_eval::measure::{Comparison, Evaluation, Player};
use leadtime_eval::report::Verdict;
use serde_json::json;

use super::launch::{Launch, launch};
use super::run_report::{self, Findings};
use super::{judge, play, policy_file};
use crate::cli::{RunChoice, SmokeArgs};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::record::RunRecord;
use crate::run_dir;
use crate::shutdown::{Watch, watch};
use crate::{Program, output};
use leadtime_config::{Config, Layer};

/// What the trained notifier must gain over the unaided person, in success, with its whole interval.
const MARK: f64 = 0.3;
/// Updates and episodes of a quick run.
const QUICK_UPDATES: u64 = 12;
const QUICK_EPISODES: u32 = 10;
/// The name of the trained policy in tables.
const TRAINED: &str = "trained";
/// The player that shows what the person does alone.
const UNAIDED: &str = "unaided";

pub(super) async fn run(program: &Program, args: &SmokeArgs) -> Result<(), Failure> {
    let config = configure(program, args).blame(ExitCode::WrongInput)?;
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    let name = run_dir::fresh_name(&config, &format!("smoke-{}", config.domain))
        .blame(ExitCode::WrongInput)?;
    if args.quick {
        output::say("smoke --quick checks the mechanics only: nothing is claimed about learning");
    }
    let choice = RunChoice::default();
    let what = Launch {
        name: &name,
        n_actors: args.actors,
        listen: &[],
        choice: &choice,
        learner_talks: false,
        log: None,
    };
    launch(&config, &what, &shutdown).await?;
    let directory = config.run.directory.join(name.as_str());
    let judged = judge(program, args, &config, &directory)?;
    let record = RunRecord::read(&directory.join("run.json"))?;
    let books = record.result.map(|result| result.books).unwrap_or_default();
    print(args, &directory, &judged, &books);
    if judged.passed { Ok(()) } else { Err(Failure::silent(ExitCode::Failed)) }
}

/// Loads the domain's configuration, made small for a quick run.
fn configure(program: &Program, args: &SmokeArgs) -> anyhow::Result<Config> {
    let mut source = args.source.clone();
    source.config.get_or_insert_with(|| PathBuf::from(&args.domain));
    let config = program.configure(&source, None)?;
    if !args.quick {
        return Ok(config);
    }
    let steps = QUICK_UPDATES * config.steps_per_update();
    let quick = format!("learner.total_steps = {steps}\nrun.checkpoint_every = 4\n");
    Ok(config.with([Layer::text("--quick", quick)], &program.registry)?)
}

/// What came out.
struct Judged {
    comparison: Comparison,
    sentence: String,
    passed: bool,
}

fn judge(
    program: &Program,
    args: &SmokeArgs,
    config: &Config,
    directory: &Path,
) -> anyhow::Result<Judged> {
    let name = directory.to_str().context("the run directory's path is not UTF-8")?;
    let loaded = policy_file::load(program, &config.run.directory, name, &[])?;
    let action = config.evaluation.action;
    let trained = judge::policy(TRAINED, config, &loaded.parameters, action)?;
    let environment = config.build(&program.registry)?;
    let scripts = environment.baselines().iter().map(|script| Player::baseline(script));
    let untrained = Player::untrained(&config.policy, config.seed, judge::choice(action))?;
    let players: Vec<Player> = [trained].into_iter().chain(scripts).chain([untrained]).collect();
    let default = if args.quick { QUICK_EPISODES } else { config.evaluation.episodes };
    let n_episodes = args.episodes.unwrap_or(default);
    let evaluations = judge::evaluate_all(program, config, &players, n_episodes, judge::EVAL_SEED)?;
    let comparison = judge::compare(config, &evaluations, &[])?;
    let (sentence, passed) = verdict(args, config, &comparison);
    let pictures = draw(program, config, &players, &evaluations, directory)?;
    let findings = Findings {
        lead: lead(config, &loaded.path),
        verdicts: vec![Verdict { holds: passed, sentence: sentence.clone() }],
        comparison: Some(comparison.clone()),
        pictures,
        notes: notes(args),
    };
    run_report::write(directory, findings)?;
    Ok(Judged { comparison, sentence, passed })
}

fn lead(config: &Config, policy: &Path) -> String {
    let file = policy.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    format!(
        "Trained on domain {} for {} updates of {} steps by a learner and separate actors, then judged on \
         episodes that training never saw. The judged policy is {file}.",
        config.domain,
        config.learner.n_updates(),
        config.steps_per_update()
    )
}

fn notes(args: &SmokeArgs) -> Vec<String> {
    let quick = "This was a quick run: it checks the mechanics only, and its figures say nothing about learning.";
    if args.quick { vec![quick.to_owned()] } else { Vec::new() }
}

/// Says whether the trained policy gained enough, where the task has a person to compare with.
fn verdict(args: &SmokeArgs, config: &Config, comparison: &Comparison) -> (String, bool) {
    if args.quick {
        return ("The mechanics work; learning was not checked (--quick).".to_owned(), true);
    }
    let measure = judge::main_measure(config);
    let against =
        |name: &str| comparison.differences.iter().find(|difference| difference.minus == name);
    let (Some(difference), true) = (against(UNAIDED), measure == "success") else {
        return ("This task has no unaided person to compare with: no verdict.".to_owned(), true);
    };
    let low = difference.interval.low;
    let passed = low > MARK;
    let verb = if passed { "gained" } else { "did not gain" };
    let interval = difference.sentence(comparison.bootstrap.confidence);
    let sentence = format!("The trained notifier {verb} more than {MARK} in success: {interval}.");
    (sentence, passed)
}

/// Draws the first episode that shows what training did: the trained policy succeeds where the unaided person fails.
fn draw(
    program: &Program,
    config: &Config,
    players: &[Player],
    evaluations: &[Evaluation],
    directory: &Path,
) -> anyhow::Result<Vec<leadtime_eval::report::Picture>> {
    let environment = program.registry.build(&config.evaluation.task)?;
    if environment.scene().is_none() {
        return Ok(Vec::new());
    }
    let index = telling_episode(evaluations);
    let voice = judge::shipped_voice(program, config);
    let mut pictures = Vec::new();
    for (i, player) in players.iter().enumerate().take(2) {
        let seed = judge::EVAL_SEED;
        let spoken = judge::record(program, config, player, voice.as_ref(), seed, index)?;
        if i == 0 {
            play::draw(&spoken, &directory.join("playthrough.png"))?;
        }
        pictures.push(play::picture(&spoken, &format!("playthrough-{i}")));
    }
    Ok(pictures)
}

fn telling_episode(evaluations: &[Evaluation]) -> u64 {
    let success = |at: usize| evaluations.get(at).and_then(|e| e.column("success"));
    let (Some(trained), Some(other)) = (success(0), success(1)) else { return 0 };
    let telling =
        trained.iter().zip(&other).position(|(ours, theirs)| *ours > 0.5 && *theirs < 0.5);
    telling.unwrap_or(0) as u64
}

fn print(args: &SmokeArgs, directory: &Path, judged: &Judged, books: &serde_json::Value) {
    let report = directory.join("report.html");
    if args.json {
        output::json(&json!({
            "run": directory,
            "report": report,
            "quick": args.quick,
            "passed": judged.passed,
            "verdict": judged.sentence,
            "comparison": judged.comparison,
            "books": books,
        }));
        return;
    }
    output::line(judged.comparison.text().trim_end());
    output::line(&format!("\n{}", judged.sentence));
    output::line(&format!("Books:  {books}"));
    output::line(&format!("Report: {}", report.display()));
}
