//! The messages of an episode, and when each was spoken.

use leadtime_episodes::{EnvSlot, EpisodeObserver, Observer};
use leadtime_sims::{End, Speech};

/// A message that was spoken, whole or in part.
///
/// Moment 0 is the start of the episode, moment i the one after its i-th step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoggedMessage {
    /// Index of the topic in the task.
    pub topic: usize,
    /// Moment at which it was started.
    pub start: usize,
    /// Words that it needs to be understood.
    pub comprehension: usize,
    /// Words that it has.
    pub conveyance: usize,
    /// Moment at which it ended or was cut off.
    pub end: usize,
}

impl LoggedMessage {
    /// Returns the moment at which it has been understood; `None` if it was cut off before.
    pub fn understood(&self) -> Option<usize> {
        Some(self.start + self.comprehension).filter(|understood| *understood <= self.end)
    }

    /// Finds the utterances of an episode, given the running utterance at each of its moments.
    pub fn all(moments: &[Option<Speech>]) -> Vec<Self> {
        let mut all = Vec::new();
        for (i, speech) in moments.iter().enumerate().skip(1) {
            let Some(speech) = speech.filter(|speech| speech.started) else { continue };
            let start = i - 1;
            // Up to the last word, or until it is no longer the running utterance.
            let goes_on = |later: &&Option<Speech>| {
                later.is_some_and(|later| !later.started && later.topic == speech.topic)
            };
            let heard = 1 + moments[i + 1..].iter().take_while(goes_on).count();
            let next = moments.get(i + heard).copied().flatten();
            // A finished utterance is gone at the moment after its last word.
            let words = heard + usize::from(!next.is_some_and(|next| next.started));
            let [comprehension, conveyance] =
                [speech.comprehension, speech.conveyance].map(|words| words as usize);
            let end = (start + words.min(conveyance)).min(moments.len() - 1);
            all.push(Self { topic: speech.topic, start, comprehension, conveyance, end });
        }
        all
    }
}

/// Observes the messages of an episode; a task without a listener has none.
#[derive(Debug, Default)]
pub struct SpeechLog {
    moments: Vec<Option<Speech>>,
}

impl Observer for SpeechLog {
    fn on_moment(&mut self, slot: &EnvSlot) {
        self.moments.push(slot.env().insight().and_then(|insight| insight.speech));
    }
}

impl EpisodeObserver for SpeechLog {
    type Output = Vec<LoggedMessage>;

    fn finish(self, _slot: &EnvSlot, _end: End) -> Self::Output {
        LoggedMessage::all(&self.moments)
    }
}
