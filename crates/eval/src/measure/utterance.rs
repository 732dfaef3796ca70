//! The messages of an episode, and when each was spoken.

use leadtime_episodes::{EnvSlot, EpisodeObserver, Observer};
use leadtime_sims::{End, Word};

/// A message that was spoken, whole or in part.
///
/// Moment 0 is the start of the episode, moment i the one after its i-th step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoggedMessage {
    /// Index of the topic in the task.
    pub topic: usize,
    /// Moment at which it was started.
    pub start: usize,
    /// Words that it needs to be understood, k.
    pub comprehension: usize,
    /// Words that it has, l.
    pub conveyance: usize,
    /// Words after which its listener has understood it: k, unless they understand sooner; 0 if before the first.
    pub needed: usize,
    /// Moment at which it ended or was cut off.
    pub end: usize,
}

impl LoggedMessage {
    /// Returns the moment at which it has been understood; `None` if it was cut off before.
    pub fn understood(&self) -> Option<usize> {
        Some(self.start + self.needed).filter(|understood| *understood <= self.end)
    }

    /// Finds the messages of an episode, given for each of its moments the word that was heard in the step before.
    pub fn all(moments: &[Option<Word>]) -> Vec<Self> {
        let mut all = Vec::new();
        for (i, word) in moments.iter().enumerate().skip(1) {
            let Some(word) = word.filter(|word| word.started) else { continue };
            let Word { topic, comprehension, conveyance, needed, .. } = word;
            let [comprehension, conveyance, needed] =
                [comprehension, conveyance, needed].map(|words| words as usize);
            // Up to its last word, a silence, or the first word of another message.
            let goes_on = |later: &&Option<Word>| later.is_some_and(|later| !later.started);
            let end = i + moments[i + 1..].iter().take_while(goes_on).count();
            all.push(Self { topic, start: i - 1, comprehension, conveyance, needed, end });
        }
        all
    }
}

/// Observes the messages of an episode; a task without a listener has none.
#[derive(Debug, Default)]
pub struct SpeechLog {
    moments: Vec<Option<Word>>,
}

impl Observer for SpeechLog {
    fn on_moment(&mut self, slot: &EnvSlot) {
        self.moments.push(slot.env().insight().and_then(|insight| insight.word));
    }
}

impl EpisodeObserver for SpeechLog {
    type Output = Vec<LoggedMessage>;

    fn finish(self, _slot: &EnvSlot, _end: End) -> Self::Output {
        LoggedMessage::all(&self.moments)
    }
}

#[cfg(test)]
mod tests {
    use leadtime_sims::human::{Comprehension, HumanSettings, SpeechAct};

    use super::*;
    use crate::playthrough::synthetic::{ascend, lander};

    const GO_ON: SpeechAct = SpeechAct::Continue;

    fn said(change: impl FnOnce(&mut HumanSettings), acts: &[SpeechAct]) -> Vec<LoggedMessage> {
        let scenes = lander(change, acts);
        LoggedMessage::all(&scenes.iter().map(|scene| scene.listener.word).collect::<Vec<_>>())
    }

    fn spans(said: &[LoggedMessage]) -> Vec<[usize; 2]> {
        said.iter().map(|message| [message.start, message.end]).collect()
    }

    #[test]
    fn a_message_that_is_stopped_ends_with_the_last_word_that_was_heard() {
        let can_stop = |human: &mut HumanSettings| human.can_stop = true;
        let stopped = said(can_stop, &[ascend(3, 3), GO_ON, SpeechAct::Stop, GO_ON]);
        assert_eq!(spans(&stopped), [[0, 2]]);
        assert_eq!(stopped[0].understood(), None);
        let whole = said(can_stop, &[GO_ON, ascend(3, 3), GO_ON, GO_ON, GO_ON, ascend(2, 3)]);
        assert_eq!(spans(&whole), [[1, 4], [5, 6]]);
        assert_eq!(whole[0].understood(), Some(4));
        assert_eq!(whole[1].understood(), None, "the episode ends with its first word");
    }

    #[test]
    fn messages_of_one_step_are_messages() {
        assert_eq!(spans(&said(|_| {}, &[ascend(1, 1), ascend(1, 1)])), [[0, 1], [1, 2]]);
        let at_once = |human: &mut HumanSettings| {
            (human.comprehension, human.occupies) = (Comprehension::Immediate, false);
        };
        let [message] = said(at_once, &[GO_ON, ascend(2, 4), GO_ON])[..] else { panic!("one") };
        assert_eq!((message.start, message.end, message.conveyance), (1, 2, 4));
    }

    #[test]
    fn a_message_is_understood_when_its_listener_has_understood_it() {
        let acts = [ascend(2, 5), GO_ON, GO_ON];
        let understood = |change: fn(&mut HumanSettings)| said(change, &acts)[0].understood();
        assert_eq!(understood(|_| {}), Some(2));
        assert_eq!(understood(|human| human.words_from = 0), Some(1));
        assert_eq!(understood(|human| human.comprehension = Comprehension::Immediate), Some(0));
    }
}
