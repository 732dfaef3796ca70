//! `leadtime eval`: evaluates a policy over many episodes, and scripted players on the same ones.

mod truth;

use std::path::Path;

use leadtime_config::Override;
use leadtime_eval::measure::{Choice, PlaySettings, Player};
use leadtime_eval::record_steps;
use leadtime_runs::build::n_cores;
use leadtime_runs::evaluation::{compare, evaluate_all, record};
use leadtime_runs::{EvaluationRecord, LoadedPolicy, RunRecord, Tasks};
use serde_json::json;

use super::opponent::{self, opponents};
use super::{episode, evaluation};
use crate::cli::EvalArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW, GrowingFile, HEAR};

pub(super) fn run(tasks: &Tasks, args: &EvalArgs) -> Result<(), Failure> {
    args.acting.choosing.worker.permit(tasks, &args.policy);
    let Some(each) = &args.each else {
        let task = EvalTask::load(tasks, args, None)?;
        warn_of_own_episodes(&task.policy, args);
        if args.transcript {
            return transcript(tasks, args, &task);
        }
        if args.truth {
            return truth::run(tasks, args, &task);
        }
        let kept_in = args.save.then(|| task.run()).transpose()?;
        // First: a path that cannot be written is reported before an hour's work.
        let steps = args.episodes_to.as_deref();
        steps.map_or(Ok(()), output::check_file).blame(ExitCode::WrongInput)?;
        let record = task.evaluate(tasks, args)?;
        // Printed first: a file that cannot be written must not cost the results.
        if args.shown.json {
            output::json(&record);
        } else {
            evaluation::print(&record.comparison, args.shown.all);
        }
        if let Some(run) = kept_in {
            evaluation::save(&record, run, &task.policy.config).blame(ExitCode::WrongInput)?;
        }
        if let Some(path) = steps {
            task.record_steps(tasks, args, path)?;
        }
        if !args.shown.json {
            let is_spoken = !tasks.topics(&task.policy.config.evaluation.task).is_empty();
            output::next(&task.policy.path, if is_spoken { &[DRAW, HEAR] } else { &[DRAW] });
        }
        return Ok(());
    };
    // All of them first, so that an impossible value is reported before an hour's work.
    let load = |change| EvalTask::load(tasks, args, Some(change));
    let loaded = each.0.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    if let Some(task) = loaded.first() {
        warn_of_own_episodes(&task.policy, args);
    }
    let mut results = Vec::new();
    for (task, change) in loaded.iter().zip(&each.0) {
        let record = task.evaluate(tasks, args)?;
        if args.shown.json {
            let mut result = json!(record);
            result["each"] = change.to_string().into();
            results.push(result);
        } else {
            output::line(&format!("{change}\n\n{}", record.comparison.text(args.shown.all)));
        }
    }
    if args.shown.json {
        output::json(&results);
    } else if let Some(task) = loaded.first() {
        output::next(&task.policy.path, &[DRAW]);
    }
    Ok(())
}

/// Warns where a player plays the episodes by which it became what it is.
fn warn_of_own_episodes(policy: &LoadedPolicy, args: &EvalArgs) {
    let seed = args.acting.choosing.eval_seed;
    evaluation::warn_of_own_episodes(policy, seed);
    opponent::warn_of_own_episodes(&args.baseline, seed);
}

/// A policy, the task that it is evaluated in, and every player.
struct EvalTask {
    policy: LoadedPolicy,
    action: Choice,
    players: Vec<Player>,
}

impl EvalTask {
    /// Loads the policy, with one more change of its task.
    fn load(tasks: &Tasks, args: &EvalArgs, change: Option<&Override>) -> Result<Self, Failure> {
        let acting = &args.acting;
        let changes: Vec<Override> = acting.set.iter().chain(change).cloned().collect();
        let policy = evaluation::load(tasks, &acting.choosing.runs, &args.policy, &changes);
        let policy = policy.blame(ExitCode::WrongInput)?;
        let config = &policy.config;
        evaluation::check_measures(config, &args.measure).blame(ExitCode::WrongInput)?;
        let action = acting.choosing.action.unwrap_or(config.evaluation.action);
        let mut players = vec![policy.player("policy", Some(action))?];
        let environment = tasks.registry.build(&config.evaluation.task);
        let environment = environment.blame(ExitCode::WrongInput)?;
        let others = opponents(&args.baseline, environment.as_ref());
        players.extend(others.blame(ExitCode::WrongInput)?);
        let mut checks = players.iter().map(|player| player.check(environment.as_ref()));
        checks.try_for_each(|check| check.blame(ExitCode::WrongInput))?;
        Ok(Self { policy, action, players })
    }

    /// Writes every step of the policy's episodes.
    fn record_steps(&self, tasks: &Tasks, args: &EvalArgs, path: &Path) -> Result<(), Failure> {
        let mut steps = GrowingFile::begin(path).blame(ExitCode::WrongInput)?;
        let make = || tasks.registry.build(&self.policy.config.evaluation.task);
        let n_episodes = u64::from(self.n_episodes(args));
        let settings = PlaySettings::new(n_episodes, args.acting.choosing.eval_seed);
        let settings = settings.threads(n_cores());
        let add = |lines: &str| steps.add(lines.as_bytes()).blame(ExitCode::WrongInput);
        record_steps(&make, &self.players[0], &settings, add)?;
        steps.end().blame(ExitCode::WrongInput)
    }

    fn n_episodes(&self, args: &EvalArgs) -> u32 {
        args.episodes.unwrap_or(self.policy.config.evaluation.episodes)
    }

    fn evaluate(&self, tasks: &Tasks, args: &EvalArgs) -> Result<EvaluationRecord, Failure> {
        let (config, players, seed) =
            (&self.policy.config, &self.players, args.acting.choosing.eval_seed);
        let n_episodes = self.n_episodes(args);
        tracing::info!(policy = %self.policy.path.display(), n_episodes, "evaluating");
        let evaluations = evaluate_all(tasks, config, players, n_episodes, seed)?;
        let comparison = compare(config, &evaluations, &args.measure);
        Ok(EvaluationRecord::new(&self.policy, self.action, seed, comparison))
    }

    /// Returns the directory of the policy's run.
    fn run(&self) -> Result<&Path, Failure> {
        let path = &self.policy.path;
        let run = path.parent().filter(|parent| RunRecord::read(parent).is_ok());
        let sentence = format!("--save: {} is not in the directory of a run", path.display());
        run.ok_or_else(|| Failure::input(sentence))
    }
}

/// Prints the same episodes of every player, word by word.
fn transcript(tasks: &Tasks, args: &EvalArgs, task: &EvalTask) -> Result<(), Failure> {
    let config = &task.policy.config;
    if tasks.topics(&config.evaluation.task).is_empty() {
        let domain = config.domain.as_str();
        let sentence = format!("no messages are sent in `{domain}`, so there is nothing to hear");
        return Err(Failure::input(sentence));
    }
    let voice = episode::voice(tasks, config, args.words.as_deref())?;
    for player in &task.players {
        for index in 0..u64::from(args.episodes.unwrap_or(1)) {
            let (voice, seed) = (voice.as_ref(), args.acting.choosing.eval_seed);
            let played = record(tasks, config, player, voice, seed, index);
            output::line(&played.blame(ExitCode::WrongInput)?.transcript());
        }
    }
    Ok(())
}
