//! `leadtime script-search`: the best of many scripts, evaluated on episodes that did not choose it.

use std::path::PathBuf;

use leadtime_config::Config;
use leadtime_eval::measure::{Comparison, Player};
use leadtime_proto::phrase::counted;
use leadtime_runs::Tasks;
use leadtime_runs::build::n_cores;
use leadtime_runs::evaluation::{compare, evaluate_all, main_measure};
use leadtime_scripts::{
    Error, FoundScript, Oracle, OracleBase, ScriptPlayer, SearchProgress, SearchSettings, search,
};
use leadtime_table::wrapped;
use serde::Serialize;

use super::opponent::{ORACLE, named_bases};
use super::{describe, evaluation};
use crate::cli::ScriptSearchArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::WIDTH;
use crate::{output, terminal};

/// The name of the found script in tables.
const SEARCHED: &str = "searched";

/// Where a script is from; the section `[search]` of its file.
#[derive(Debug, Serialize)]
struct SearchOrigin {
    task: String,
    domain: String,
    changes: Vec<String>,
    seed: u64,
    /// Environment steps of the search.
    steps: u64,
    scripts: u64,
    held_out_seed: u64,
    held_out_episodes: u32,
    measure: String,
    /// Estimate, and lower and upper bound.
    held_out: Vec<f64>,
}

pub(super) fn run(tasks: &Tasks, args: &ScriptSearchArgs) -> Result<(), Failure> {
    let config = describe::load(tasks, &args.task, &args.set, &args.runs)?;
    let path = destination(args)?;
    let n_steps = args.steps.unwrap_or(config.learner.total_steps);
    let seed = args.seed.unwrap_or(config.seed);
    if seed == args.eval_seed {
        let says = "the script would be evaluated on episodes that chose it";
        let says = anyhow::anyhow!(
            "--seed and --eval-seed are both {seed}: {says}; take another --eval-seed"
        );
        return Err(Failure::of(ExitCode::WrongInput, says));
    }
    let found = find(tasks, &config, n_steps, seed)?;
    let comparison = evaluate(tasks, &config, args, &found)?;
    let origin = SearchOrigin {
        task: args.task.display().to_string(),
        domain: config.domain.to_string(),
        changes: args.set.iter().map(ToString::to_string).collect(),
        seed,
        steps: found.n_steps,
        scripts: found.n_candidates,
        held_out_seed: args.eval_seed,
        held_out_episodes: n_episodes(&config, args),
        measure: main_measure(&config).to_owned(),
        held_out: held_out(&config, &comparison),
    };
    // Printed first: a file that cannot be written must not cost the results.
    if args.shown.json {
        let rules = &found.script.rules;
        output::json(
            &serde_json::json!({ "search": origin, "rules": rules, "comparison": comparison }),
        );
    } else {
        let took = format!(
            "{} in {} steps of {n_steps} ({:.0}%)",
            counted(found.n_candidates, "script"),
            found.n_steps,
            100.0 * found.n_steps as f64 / n_steps as f64
        );
        output::line(&format!("Tried {took}. The best:\n\n{}\n", words(&found)));
        evaluation::print(&comparison, args.shown.all);
    }
    let head = toml::to_string(&origin).blame(ExitCode::Failed)?;
    let text = found.script.file(&format!("[search]\n{head}"));
    output::file(&path, text.as_bytes()).blame(ExitCode::WrongInput)?;
    if !args.shown.json {
        let shown = path.display().to_string();
        let command = ["eval".into(), "RUN".into(), "--baseline".into(), path.into()];
        let command = output::command(command);
        output::note(&format!(
            "\nWritten to {shown}\n\nNext:\n  {command}\n      compare a policy with it"
        ));
    }
    Ok(())
}

/// Searches, and shows how far it is.
fn find(tasks: &Tasks, config: &Config, n_steps: u64, seed: u64) -> Result<FoundScript, Failure> {
    let make = || tasks.registry.build(&config.task);
    let stop = || false;
    let environment = make().blame(ExitCode::WrongInput)?;
    if environment.scriptable().is_none() {
        return Err(Failure::of(ExitCode::WrongInput, Error::NoMessages));
    }
    drop(environment);
    let settings = SearchSettings { n_steps, seed, n_threads: n_cores(), stop: &stop };
    tracing::info!(domain = %config.domain, n_steps, seed, "searching a script");
    let mut show = |progress: &SearchProgress| {
        if terminal::is_watched() {
            let share = progress.n_steps as f64 / n_steps as f64;
            terminal::show_bar(share, |room| sentence(progress).chars().take(room).collect());
        }
    };
    let found = search(&make, &settings, &mut show);
    terminal::hide_bar();
    found.map_err(|error| Failure::of(exit_code(&error), error))
}

/// Returns the exit code of a search that failed.
pub(super) fn exit_code(error: &Error) -> ExitCode {
    let is_input = matches!(error, Error::NoMessages | Error::Task(_));
    if is_input { ExitCode::WrongInput } else { ExitCode::Failed }
}

fn sentence(progress: &SearchProgress) -> String {
    let tried = counted(progress.n_candidates, "script");
    match progress.best {
        Some(best) => format!("{tried}, success of the best {best:.3}"),
        None => tried,
    }
}

/// Plays held-out episodes: the script, the task's own ones, and the oracle if it is wanted.
fn evaluate(
    tasks: &Tasks,
    config: &Config,
    args: &ScriptSearchArgs,
    found: &FoundScript,
) -> Result<Comparison, Failure> {
    let script = || found.script.clone();
    let mut players = vec![Player::scripted(SEARCHED, Box::new(ScriptPlayer::new(script())))];
    let environment = tasks.registry.build(&config.evaluation.task).blame(ExitCode::WrongInput)?;
    players.extend(environment.baselines().iter().map(|name| Player::baseline(name)));
    if args.oracle {
        let bases = [OracleBase::Script(script())].into_iter();
        let bases = bases.chain(named_bases(environment.as_ref())).collect();
        players.push(Player::scripted(ORACLE, Box::new(Oracle::new(bases))));
    }
    let n_episodes = n_episodes(config, args);
    tracing::info!(n_episodes, seed = args.eval_seed, "evaluating on episodes that chose nothing");
    let evaluations = evaluate_all(tasks, config, &players, n_episodes, args.eval_seed)?;
    Ok(compare(config, &evaluations, &[]))
}

fn n_episodes(config: &Config, args: &ScriptSearchArgs) -> u32 {
    args.episodes.unwrap_or(config.evaluation.episodes)
}

/// Returns estimate, and lower and upper bound, of what the found script is rated by.
fn held_out(config: &Config, comparison: &Comparison) -> Vec<f64> {
    let own = comparison.summaries.first();
    let measure = own.and_then(|own| own.get(main_measure(config)));
    let interval = measure.and_then(|measure| measure.interval);
    interval.map(|it| vec![it.estimate, it.low, it.high]).unwrap_or_default()
}

/// Writes the script in words; one without rules says so.
fn words(found: &FoundScript) -> String {
    if found.script.rules.is_empty() {
        return "keep silent: no script that was tried is better".to_owned();
    }
    let rules = found.script.to_string();
    let lines = rules.lines().map(|rule| wrapped(rule, WIDTH, 3));
    lines.collect::<Vec<_>>().join("\n")
}

/// Returns where the script will be written, and refuses at once what would fail after the search.
fn destination(args: &ScriptSearchArgs) -> Result<PathBuf, Failure> {
    let wrong = |says: String| Failure::of(ExitCode::WrongInput, anyhow::anyhow!(says));
    let stem = args.task.file_stem().and_then(|stem| stem.to_str()).unwrap_or("task");
    let own = || PathBuf::from(format!("{stem}-script.toml"));
    let path = args.out.clone().unwrap_or_else(own);
    let shown = path.display();
    if args.out.is_none() && path.exists() {
        return Err(wrong(format!("{shown} exists already; name another file with -o")));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if path.is_dir() || path.as_os_str().as_encoded_bytes().ends_with(b"/") {
        return Err(wrong(format!("{shown} is a folder; name a file with -o")));
    }
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        return Err(wrong(format!("there is no folder {}; make it first", folder.display())));
    }
    output::check_file(&path).blame(ExitCode::WrongInput)?;
    Ok(path)
}
