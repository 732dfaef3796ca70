//! The utterance that runs: when another may start, when it may be broken off, and which word makes it understood.
//!
//! The listener hears by these rules, and who speaks obeys them, so both count the same words.

use serde::{Deserialize, Serialize};

use super::settings::{HumanSettings, Interrupt, MAX_WORDS};
use crate::Message;

/// A message while it is spoken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpokenMessage {
    /// What is said: topic, comprehension and conveyance time.
    pub message: Message,
    /// Words that have been heard to their end.
    pub heard: u32,
    /// Whether that was enough to understand it.
    pub understood: bool,
}

/// What one more word did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HeardWord {
    /// The message is understood with this word.
    pub(crate) understood: bool,
    /// It was the last one.
    pub(crate) is_last: bool,
}

impl SpokenMessage {
    /// Begins a message, of which nothing has been heard yet.
    pub(crate) fn new(message: Message, settings: &HumanSettings) -> Self {
        Self { message, heard: 0, understood: settings.effective_comprehension(message) == 0 }
    }

    pub(crate) fn hear_word(&mut self, settings: &HumanSettings) -> HeardWord {
        let comprehension = settings.effective_comprehension(self.message);
        let (words, brief) = (self.message.conveyance, comprehension.max(1));
        let length = if settings.occupies { words } else { brief };
        self.heard += 1;
        let understood = !self.understood && self.heard >= comprehension;
        self.understood |= understood;
        HeardWord { understood, is_last: self.heard >= length }
    }

    /// Returns whether a message of one of `n_topics` topics could be spoken so far.
    pub(crate) fn fits(&self, n_topics: usize) -> bool {
        self.message.fits(n_topics) && self.heard <= MAX_WORDS
    }
}

impl Message {
    /// Returns whether a notifier of `n_topics` topics could say it.
    pub(crate) fn fits(&self, n_topics: usize) -> bool {
        self.topic < n_topics
            && self.comprehension <= self.conveyance
            && self.conveyance <= MAX_WORDS
    }
}

impl HumanSettings {
    /// Returns whether a message (of another topic) would start now.
    pub(crate) fn may_start(&self, speech: Option<SpokenMessage>) -> bool {
        match (speech, self.interrupt) {
            (None, _) | (Some(_), Interrupt::Replace) => true,
            (Some(utterance), Interrupt::UntilComprehended) => utterance.understood,
            (Some(_), Interrupt::Finish) => false,
        }
    }

    /// Returns whether there is an utterance that may be broken off.
    pub(crate) fn may_stop(&self, speech: Option<SpokenMessage>) -> bool {
        self.can_stop && speech.is_some()
    }
}
