//! Episodes as numbers, a line of JSON per step: what the player saw, what it chose and what that paid.

use leadtime_episodes::{
    Decision, EnvSlot, EpisodeObserver, MakeEnvironment, Observer, PlaySettings, Player, play,
};
use leadtime_sims::{End, NamedHead, StepOutcome};
use serde::Serialize;

use crate::error::Error;

/// Episodes that are played before their lines are handed on: what bounds the memory.
const EPISODES_AT_A_TIME: u64 = 64;

/// One step; its fields are those of the line.
#[derive(Debug, Default, Serialize)]
struct StepRecord {
    episode: u64,
    step: u32,
    /// What the policy saw, not normalised. `[D]`
    observation: Vec<f32>,
    /// Whether the mask offers a choice, over all heads in order. `[C]`
    offered: Vec<bool>,
    /// `[C]`, before the mask; empty for a script.
    logits: Vec<f32>,
    value: f32,
    /// The choice of each head, as a number and by name; heads behind a closed gate have choices, too, that mean nothing.
    action: Vec<u8>,
    choices: Vec<String>,
    reward: f32,
    end: Option<&'static str>,
}

struct StepLog<'a> {
    heads: &'a [NamedHead],
    n_choices: usize,
    record: StepRecord,
    lines: String,
}

impl Observer for StepLog<'_> {
    fn on_decision(&mut self, slot: &EnvSlot, decision: &Decision<'_>) {
        let record = &mut self.record;
        record.observation = slot.observation().to_vec();
        record.offered = (0..self.n_choices).map(|i| decision.mask.0 >> i & 1 == 1).collect();
        record.logits = decision.logits.to_vec();
        record.value = decision.value;
        record.action = decision.choices.to_vec();
        let name =
            |(head, &choice): (&NamedHead, &u8)| head.choices.get(usize::from(choice)).cloned();
        record.choices = self.heads.iter().zip(decision.choices).filter_map(name).collect();
    }

    fn on_step(&mut self, _slot: &EnvSlot, outcome: StepOutcome) {
        self.record.reward = outcome.reward;
        self.record.end = outcome.end.map(|end| match end {
            End::Terminated => "terminated",
            End::Truncated => "truncated",
        });
        // Names and numbers always are JSON.
        self.lines += &serde_json::to_string(&self.record).unwrap_or_default();
        self.lines.push('\n');
        self.record.step += 1;
    }
}

impl EpisodeObserver for StepLog<'_> {
    type Output = String;

    fn finish(self, _slot: &EnvSlot, _end: End) -> String {
        self.lines
    }
}

/// Plays the episodes that [`crate::measure::evaluate`] plays under the same settings, and hands their lines to `write`, episode
/// by episode in order.
///
/// # Errors
///
/// [`Error`] in the cases of [`play`]: the task cannot be built, the player does not fit it, or an episode does not
/// end. An error of `write` ends the playing and is passed on.
pub fn record_steps<E: From<Error>>(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &PlaySettings<'_>,
    mut write: impl FnMut(&str) -> Result<(), E>,
) -> Result<(), E> {
    let environment = make().map_err(Error::from)?;
    let heads = environment.describe().actions;
    let n_choices = environment.spec().actions.n_choices();
    let observe = |episode| StepLog {
        heads: &heads,
        n_choices,
        record: StepRecord { episode, ..StepRecord::default() },
        lines: String::new(),
    };
    let end = settings.first + settings.n_episodes;
    for first in (settings.first..end).step_by(EPISODES_AT_A_TIME as usize) {
        let n_episodes = EPISODES_AT_A_TIME.min(end - first);
        let part = PlaySettings { first, n_episodes, ..*settings };
        let lines = play(make, player, &part, observe).map_err(Error::from)?;
        lines.iter().try_for_each(|lines| write(lines))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use leadtime_episodes::Choice;
    use leadtime_proto::PolicySpec;
    use leadtime_sims::classic::{CartPole, CartPoleSettings};
    use leadtime_sims::{Environment, TaskError};
    use serde_json::Value;

    use super::*;

    #[test]
    fn every_step_is_a_line_that_says_what_was_seen_and_chosen() {
        let make = || -> Result<Box<dyn Environment>, TaskError> {
            Ok(Box::new(CartPole::new(&CartPoleSettings { max_steps: 3 })?))
        };
        let spec = PolicySpec::dense(make().unwrap().spec(), &[4]);
        let player = Player::untrained(&spec, 1, Choice::Greedy).unwrap();
        let mut lines = Vec::new();
        let settings = PlaySettings::new(EPISODES_AT_A_TIME + 1, 7);
        record_steps::<Error>(&make, &player, &settings, |part| {
            lines.extend(part.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()));
            Ok(())
        })
        .unwrap();
        assert_eq!(lines.len(), 3 * (EPISODES_AT_A_TIME as usize + 1));
        for (i, line) in lines.iter().enumerate() {
            assert_eq!((&line["episode"], &line["step"]), (&(i / 3).into(), &(i % 3).into()));
            let logits = line["logits"].as_array().unwrap();
            let action = line["action"][0].as_u64().unwrap() as usize;
            assert!(logits[action].as_f64() >= logits[1 - action].as_f64(), "greedy: {line}");
            assert_eq!(line["choices"][0], ["left", "right"][action]);
            assert_eq!(line["end"], if i % 3 == 2 { "truncated".into() } else { Value::Null });
        }
    }
}
