//! `leadtime eval`: evaluates a policy over many episodes, and scripted players on the same ones.

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use leadtime_config::{Config, Override};
use leadtime_eval::measure::{Choice, Comparison, PlaySettings, Player};
use leadtime_eval::record_steps;
use leadtime_runs::{LoadedPolicy, Tasks};
use leadtime_taxonomy::Pace;
use serde_json::{Value, json};

use super::{episode, evaluation};
use crate::cli::EvalArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW, HEAR};

pub(super) fn run(tasks: &Tasks, args: &EvalArgs) -> Result<(), Failure> {
    let Some(each) = &args.each else {
        let task = EvalTask::load(tasks, args, None)?;
        if args.transcript {
            return transcript(tasks, args, &task);
        }
        if let Some(path) = &args.episodes_to {
            task.record_steps(tasks, args, path)?;
        }
        let comparison = task.compare(tasks, args)?;
        if args.shown.json {
            output::json(&task.json(args, &comparison));
            return Ok(());
        }
        evaluation::print(&comparison, args.shown.all);
        let is_spoken = !tasks.topics(&task.config.evaluation.task).is_empty();
        output::next(&task.path, if is_spoken { &[DRAW, HEAR] } else { &[DRAW] });
        return Ok(());
    };
    // All of them first, so that an impossible value is reported before an hour's work.
    let load = |change| EvalTask::load(tasks, args, Some(change));
    let loaded = each.0.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    let mut results = Vec::new();
    for (task, change) in loaded.iter().zip(&each.0) {
        let comparison = task.compare(tasks, args)?;
        if args.shown.json {
            let mut result = task.json(args, &comparison);
            result["each"] = change.to_string().into();
            results.push(result);
        } else {
            output::line(&format!("{change}\n\n{}", comparison.text(args.shown.all)));
        }
    }
    if args.shown.json {
        output::json(&results);
    }
    Ok(())
}

/// A policy, the task that it is evaluated in, and every player.
struct EvalTask {
    path: PathBuf,
    config: Config,
    action: Choice,
    players: Vec<Player>,
}

impl EvalTask {
    /// Loads the policy, with one more change of its task.
    fn load(tasks: &Tasks, args: &EvalArgs, change: Option<&Override>) -> Result<Self, Failure> {
        let acting = &args.acting;
        let changes: Vec<Override> = acting.set.iter().chain(change).cloned().collect();
        let loaded = LoadedPolicy::load(&tasks.registry, &acting.runs, &args.policy, &changes)
            .blame(ExitCode::WrongInput)?;
        let config = loaded.config;
        evaluation::check_measures(&config, &args.measure).blame(ExitCode::WrongInput)?;
        let action = acting.action.unwrap_or(config.evaluation.action);
        let mut players = vec![evaluation::policy("policy", &config, &loaded.parameters, action)?];
        players.extend(args.baseline.iter().map(|name| Player::baseline(name)));
        let environment = tasks.registry.build(&config.evaluation.task);
        let environment = environment.blame(ExitCode::WrongInput)?;
        let mut checks = players.iter().map(|player| player.check(environment.as_ref()));
        checks.try_for_each(|check| check.blame(ExitCode::WrongInput))?;
        Ok(Self { path: loaded.path, config, action, players })
    }

    /// Writes every step of the policy's episodes.
    fn record_steps(&self, tasks: &Tasks, args: &EvalArgs, path: &Path) -> Result<(), Failure> {
        let make = || tasks.registry.build(&self.config.evaluation.task);
        let n_episodes = self.n_episodes(args);
        let settings = PlaySettings::new(u64::from(n_episodes), args.eval_seed);
        let settings = settings.threads(evaluation::n_threads());
        let cannot = || format!("writing {}", path.display());
        let mut file = File::create(path).with_context(cannot).blame(ExitCode::WrongInput)?;
        let write = |lines: &str| file.write_all(lines.as_bytes()).with_context(cannot);
        Ok(record_steps(&make, &self.players[0], &settings, write)?)
    }

    fn n_episodes(&self, args: &EvalArgs) -> u32 {
        args.episodes.unwrap_or(self.config.evaluation.episodes)
    }

    fn compare(&self, tasks: &Tasks, args: &EvalArgs) -> Result<Comparison, Failure> {
        let n_episodes = self.n_episodes(args);
        tracing::info!(policy = %self.path.display(), n_episodes, "evaluating");
        let (config, players, seed) = (&self.config, &self.players, args.acting.eval_seed);
        let evaluations = evaluation::evaluate_all(tasks, config, players, n_episodes, seed)?;
        Ok(evaluation::compare(config, &evaluations, &args.measure))
    }

    fn json(&self, args: &EvalArgs, comparison: &Comparison) -> Value {
        json!({
            "policy": self.path.display().to_string(),
            "domain": self.config.domain.as_str(),
            "action": self.action,
            "seed": args.acting.eval_seed,
            "comparison": comparison,
        })
    }
}

/// Prints the same episodes of every player, word by word.
fn transcript(tasks: &Tasks, args: &EvalArgs, task: &EvalTask) -> Result<(), Failure> {
    let config = &task.config;
    let voice = episode::voice(tasks, config, args.words.as_deref())?;
    for player in &task.players {
        for index in 0..u64::from(args.episodes.unwrap_or(1)) {
            let (voice, seed) = (voice.as_ref(), args.acting.eval_seed);
            let played = episode::record(tasks, config, player, voice, seed, index);
            output::line(&played.blame(ExitCode::WrongInput)?.transcript(&Pace::default()));
        }
    }
    Ok(())
}
