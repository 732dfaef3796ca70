//! `leadtime eval`: a policy over many episodes, beside scripted players if wanted.

use leadtime_eval::measure::Player;
use leadtime_taxonomy::Pace;

use super::{judge, policy_file};
use crate::cli::EvalArgs;
use crate::config::Config;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::{Program, output};

pub(super) fn run(program: &Program, args: &EvalArgs) -> Result<(), Failure> {
    let loaded = policy_file::load(program, &args.runs, &args.policy, &args.set)
        .blame(ExitCode::WrongInput)?;
    let config = &loaded.config;
    let action = args.action.unwrap_or(config.evaluation.action);
    let n_episodes = args.episodes.unwrap_or(config.evaluation.episodes);
    let mut players = vec![judge::policy("policy", config, &loaded.parameters, action)?];
    players.extend(args.baseline.iter().map(|name| Player::baseline(name)));
    let environment =
        program.registry.build(&config.evaluation.task).blame(ExitCode::WrongInput)?;
    for player in &players {
        player.check(environment.as_ref()).blame(ExitCode::WrongInput)?;
    }
    if args.transcript {
        return transcript(program, args, config, &players);
    }
    tracing::info!(policy = %loaded.path.display(), n_episodes, "judging");
    let evaluations = judge::evaluate_all(program, config, &players, n_episodes, args.eval_seed)?;
    let comparison = judge::compare(config, &evaluations);
    if args.json {
        output::json(&serde_json::json!({
            "policy": loaded.path,
            "domain": config.domain.as_str(),
            "action": action,
            "seed": args.eval_seed,
            "comparison": comparison,
        }));
    } else {
        output::line(comparison.text().trim_end());
    }
    Ok(())
}

/// Prints the same episodes of every player, word by word.
fn transcript(
    program: &Program,
    args: &EvalArgs,
    config: &Config,
    players: &[Player],
) -> Result<(), Failure> {
    let voice = judge::voice(program, config, args.words.as_deref())?;
    for player in players {
        for index in 0..u64::from(args.episodes.unwrap_or(1)) {
            let played =
                judge::record(program, config, player, voice.as_ref(), (args.eval_seed, index))
                    .blame(ExitCode::WrongInput)?;
            output::line(&played.transcript(&Pace::default()));
        }
    }
    Ok(())
}
