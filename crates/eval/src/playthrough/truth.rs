//! How often what is said is true: every sentence against the facts of the moment at which it starts.
//!
//! The check looks at the names of what a sentence presupposes and of what the world states, and not at how the
//! sentence was found. Each message is spoken twice: as sentences take turns whatever holds, and as those take turns
//! that hold.

use leadtime_episodes::{
    EnvSlot, EpisodeObserver, MakeEnvironment, Observer, PlaySettings, Player, play,
};
use leadtime_sims::{End, Word};
use serde::Serialize;

use super::voice::{Choosing, Chosen, Voice};
use crate::error::Error;
use crate::measure::LoggedMessage;

/// The most examples of false sentences that are kept.
const MAX_EXAMPLES: usize = 3;

/// A sentence that was false when it was begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FalseSentence {
    /// Number of the episode in its evaluation.
    pub episode: u64,
    /// The step at which it was begun.
    pub step: usize,
    /// As it is spoken.
    pub text: String,
    /// A fact that it presupposes and that did not hold.
    pub fact: String,
}

/// How the sentences of many episodes stood to the world.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Truthfulness {
    /// Sentences that were said.
    pub said: usize,
    /// Those that presuppose something.
    pub presupposing: usize,
    /// Those of which something did not hold when they were begun.
    pub false_at_start: usize,
    /// Those that were true when they were begun, and of which something did not hold any more when they ended.
    pub false_by_end: usize,
    /// Those of another k or l than the message.
    pub stand_ins: usize,
    /// Messages for which there was nothing true to say.
    pub without_words: usize,
    /// The first false sentences, each text once.
    pub examples: Vec<FalseSentence>,
}

impl Truthfulness {
    /// Plays episodes, and compares the sentences that a choice gives with the world, for every choice in order.
    ///
    /// # Errors
    ///
    /// [`Error::NoScene`] if the task describes no moments; [`Error::Words`] if the voice is for other topics; any
    /// other [`Error`] in the cases of [`play`].
    pub fn measure<const N: usize>(
        make: &MakeEnvironment<'_>,
        player: &Player,
        settings: &PlaySettings<'_>,
        voice: &Voice,
        choices: [Choosing; N],
    ) -> Result<[Self; N], Error> {
        let logs = play(make, player, settings, |_| FactLog::default())?;
        let mut all = choices.map(|choice| (choice, Self::default()));
        for (index, log) in (settings.first..).zip(logs) {
            let log = log.ok_or(Error::NoScene)?;
            let messages = log.messages();
            let told = messages.iter().map(|it| (it, &log.moments[it.start].1[..]));
            let told: Vec<(&LoggedMessage, &[&str])> = told.collect();
            for (choice, truth) in &mut all {
                let chosen = voice.choose(settings.seed, index, &told, *choice)?;
                for (message, chosen) in messages.iter().zip(chosen) {
                    truth.count(&log, index, message, chosen.as_ref(), voice);
                }
            }
        }
        Ok(all.map(|(_, truth)| truth))
    }

    fn count(
        &mut self,
        log: &FactLog,
        episode: u64,
        message: &LoggedMessage,
        chosen: Option<&Chosen<'_>>,
        voice: &Voice,
    ) {
        let Some(Chosen { utterance, fallback }) = chosen else {
            self.without_words += 1;
            return;
        };
        let presupposed: Vec<&str> = voice.taxonomy().fact_names(utterance.facts).collect();
        let missing = |moment: usize| {
            let told = &log.moments[moment].1;
            presupposed.iter().find(|fact| !told.contains(fact)).copied()
        };
        self.said += 1;
        self.presupposing += usize::from(!presupposed.is_empty());
        self.stand_ins += usize::from(*fallback);
        let Some(fact) = missing(message.start) else {
            self.false_by_end += usize::from(missing(message.end).is_some());
            return;
        };
        self.false_at_start += 1;
        let is_new = self.examples.iter().all(|example| example.text != utterance.text);
        if is_new && self.examples.len() < MAX_EXAMPLES {
            let (text, fact) = (utterance.text.clone(), fact.to_owned());
            self.examples.push(FalseSentence { episode, step: message.start, text, fact });
        }
    }
}

/// Observes, at each moment of an episode, the word that was heard in the step before and the facts that hold.
#[derive(Debug, Default)]
struct FactLog {
    moments: Vec<(Option<Word>, Vec<&'static str>)>,
}

impl FactLog {
    fn messages(&self) -> Vec<LoggedMessage> {
        let words: Vec<_> = self.moments.iter().map(|(word, _)| *word).collect();
        LoggedMessage::all(&words)
    }
}

impl Observer for FactLog {
    fn on_moment(&mut self, slot: &EnvSlot) {
        let insight = slot.env().insight();
        self.moments.extend(insight.map(|insight| (insight.word, slot.env().facts_that_hold())));
    }
}

impl EpisodeObserver for FactLog {
    type Output = Option<Self>;

    fn finish(self, _slot: &EnvSlot, _end: End) -> Self::Output {
        (!self.moments.is_empty()).then_some(self)
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{PolicySpec, TaskSpec};

    use super::*;
    use crate::measure::Choice;
    use crate::playthrough::Spoken;

    fn measure(domain: &str, n_episodes: u64) -> [Truthfulness; 2] {
        let registry = leadtime_worlds::builtin();
        let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
        let make = || registry.build(&task);
        let topics = make().unwrap().scriptable().unwrap().topics().to_vec();
        let voice = Voice::shipped(domain, &topics).unwrap();
        // Untrained, it says everything at any time.
        let policy = PolicySpec::dense(make().unwrap().spec(), &[8]);
        let player = Player::untrained(&policy, 1, Choice::Sample).unwrap();
        let settings = PlaySettings::new(n_episodes, 3);
        let choices = [Choosing::InTurn, Choosing::TrueInTurn];
        Truthfulness::measure(&make, &player, &settings, &voice, choices).unwrap()
    }

    #[test]
    fn what_the_paper_says_to_the_cook_is_true() {
        let spoken = Spoken::demonstration().unwrap();
        let start = spoken.timeline.utterances[0].start;
        assert!(spoken.played.scenes[start].facts.contains(&"stations_occupied"));
    }

    #[test]
    fn what_is_said_is_true_and_would_not_be_without_a_look_at_the_world() {
        for (domain, n_episodes) in [("lander", 8), ("highway", 4), ("steakhouse", 6)] {
            let [any, those_that_hold] = measure(domain, n_episodes);
            assert!(any.said > 10 && any.false_at_start > 0, "{domain}: {any:?}");
            assert!(any.examples.iter().all(|it| !it.fact.is_empty()));
            let Truthfulness { said, false_at_start, stand_ins, without_words, .. } =
                those_that_hold;
            assert_eq!((said, false_at_start), (any.said, 0), "{domain}");
            assert_eq!((stand_ins, without_words), (0, 0), "{domain}");
        }
    }
}
