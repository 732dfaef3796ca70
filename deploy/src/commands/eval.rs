//! `leadtime eval`: a policy over many episodes, beside scripted players if wanted.

use std::path::PathBuf;

use leadtime_eval::measure::{Comparison, Player};
use leadtime_taxonomy::Pace;
use serde_json::{Value, json};

use super::{judge, policy_file};
use crate::cli::EvalArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::{Program, output};
use leadtime_config::{Config, EvaluationAction, Override};

pub(super) fn run(program: &Program, args: &EvalArgs) -> Result<(), Failure> {
    if args.transcript {
        let task = Task::load(program, args, None)?;
        return transcript(program, args, &task);
    }
    let Some(each) = &args.each else {
        let task = Task::load(program, args, None)?;
        let comparison = task.compare(program, args)?;
        if args.json {
            output::json(&task.json(args, &comparison));
        } else {
            output::line(comparison.text().trim_end());
        }
        return Ok(());
    };
    // All of them first: a value that cannot be is told before an hour's work.
    let load = |change| Task::load(program, args, Some(change));
    let tasks = each.overrides().iter().map(load).collect::<Result<Vec<_>, _>>()?;
    let mut results = Vec::new();
    for (task, change) in tasks.iter().zip(each.overrides()) {
        let comparison = task.compare(program, args)?;
        if args.json {
            let mut result = task.json(args, &comparison);
            result["each"] = change.to_string().into();
            results.push(result);
        } else {
            output::line(&format!("{change}\n\n{}", comparison.text()));
        }
    }
    if args.json {
        output::json(&results);
    }
    Ok(())
}

/// A policy, the task that it is judged in, and everybody who plays.
struct Task {
    path: PathBuf,
    config: Config,
    action: EvaluationAction,
    players: Vec<Player>,
}

impl Task {
    /// Loads the policy, with one more change of its task.
    fn load(
        program: &Program,
        args: &EvalArgs,
        change: Option<&Override>,
    ) -> Result<Self, Failure> {
        let changes: Vec<Override> = args.set.iter().chain(change).cloned().collect();
        let loaded = policy_file::load(program, &args.runs, &args.policy, &changes)
            .blame(ExitCode::WrongInput)?;
        let config = loaded.config;
        let action = args.action.unwrap_or(config.evaluation.action);
        let mut players = vec![judge::policy("policy", &config, &loaded.parameters, action)?];
        players.extend(args.baseline.iter().map(|name| Player::baseline(name)));
        let environment =
            program.registry.build(&config.evaluation.task).blame(ExitCode::WrongInput)?;
        for player in &players {
            player.check(environment.as_ref()).blame(ExitCode::WrongInput)?;
        }
        Ok(Self { path: loaded.path, config, action, players })
    }

    fn compare(&self, program: &Program, args: &EvalArgs) -> Result<Comparison, Failure> {
        let n_episodes = args.episodes.unwrap_or(self.config.evaluation.episodes);
        tracing::info!(policy = %self.path.display(), n_episodes, "judging");
        let (config, players) = (&self.config, &self.players);
        let evaluations =
            judge::evaluate_all(program, config, players, n_episodes, args.eval_seed)?;
        judge::compare(config, &evaluations, &args.measure).blame(ExitCode::WrongInput)
    }

    fn json(&self, args: &EvalArgs, comparison: &Comparison) -> Value {
        json!({
            "policy": self.path,
            "domain": self.config.domain.as_str(),
            "action": self.action,
            "seed": args.eval_seed,
            "comparison": comparison,
        })
    }
}

/// Prints the same episodes of every player, word by word.
fn transcript(program: &Program, args: &EvalArgs, task: &Task) -> Result<(), Failure> {
    let config = &task.config;
    let voice = judge::voice(program, config, args.words.as_deref())?;
    for player in &task.players {
        for index in 0..u64::from(args.episodes.unwrap_or(1)) {
            let played =
                judge::record(program, config, player, voice.as_ref(), args.eval_seed, index)
                    .blame(ExitCode::WrongInput)?;
            output::line(&played.transcript(&Pace::default()));
        }
    }
    Ok(())
}
