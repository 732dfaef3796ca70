//! `leadtime eval --truth`: how many of the sentences are false when they are begun.

use leadtime_eval::measure::PlaySettings;
use leadtime_eval::playthrough::{Choosing, FalseSentence, Truthfulness};
use leadtime_proto::phrase::counted;
use leadtime_runs::Tasks;
use leadtime_runs::build::n_cores;
use leadtime_table::Table;
use serde_json::json;

use super::super::episode;
use super::EvalTask;
use crate::cli::EvalArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// How sentences are chosen, and how a table calls it.
const CHOICES: [(Choosing, &str); 2] =
    [(Choosing::InTurn, "in turn, true or not"), (Choosing::TrueInTurn, "in turn, if true")];

pub(super) fn run(tasks: &Tasks, args: &EvalArgs, task: &EvalTask) -> Result<(), Failure> {
    let config = &task.policy.config;
    let Some(voice) = episode::voice(tasks, config, args.words.as_deref())? else {
        let sentence = format!(
            "--truth: there are no sentences for the domain `{}`; name a database with --words",
            config.domain.as_str()
        );
        return Err(Failure::input(sentence));
    };
    let make = || tasks.registry.build(&config.evaluation.task);
    let n_episodes = task.n_episodes(args);
    let settings = PlaySettings::new(u64::from(n_episodes), args.acting.choosing.eval_seed);
    let settings = settings.threads(n_cores());
    let mut results = Vec::new();
    for player in &task.players {
        let choices = CHOICES.map(|(choice, _)| choice);
        let found = Truthfulness::measure(&make, player, &settings, &voice, choices);
        let found = found.blame(ExitCode::WrongInput)?;
        if args.shown.json {
            let [in_turn, true_in_turn] = &found;
            results.push(json!({
                "player": player.name(),
                "episodes": n_episodes,
                "in_turn": in_turn,
                "true_in_turn": true_in_turn,
            }));
        } else {
            output::line(&text(player.name(), n_episodes, &found));
        }
    }
    if args.shown.json {
        output::json(&results);
    }
    Ok(())
}

/// Writes what was found of one player.
fn text(player: &str, n_episodes: u32, found: &[Truthfulness; 2]) -> String {
    let head = ["sentences", "said", "presuppose", "false", "false by the end", "stand-ins"];
    let mut table = Table::new(head).left(&[0]);
    for ((_, name), truth) in CHOICES.iter().zip(found) {
        // None at all is not the same as hardly any.
        let share = |n: usize| match n {
            0 => "0".to_owned(),
            n => format!("{:.1} %", 100.0 * n as f64 / truth.said as f64),
        };
        table.push([
            (*name).to_owned(),
            truth.said.to_string(),
            share(truth.presupposing),
            share(truth.false_at_start),
            share(truth.false_by_end),
            truth.stand_ins.to_string(),
        ]);
    }
    let episodes = counted(n_episodes as usize, "episode");
    let mut lines = vec![format!("{player}, {episodes}\n"), table.text()];
    for ((_, name), truth) in CHOICES.iter().zip(found) {
        if !truth.examples.is_empty() {
            lines.push(format!("False, of those {name}:"));
        }
        lines.extend(truth.examples.iter().map(example));
        if truth.without_words > 0 {
            let silent = counted(truth.without_words, "message");
            lines.push(format!("Nothing true to say, of those {name}: {silent}"));
        }
    }
    lines.join("\n") + "\n"
}

fn example(of: &FalseSentence) -> String {
    let FalseSentence { episode, step, text, fact } = of;
    format!("  \"{text}\" at step {step} of episode {episode}: not {fact}")
}
