//! The notifier without its world: what it has seen and done, what it is saying, what it may choose.
//!
//! [`NotifierEnv`](super::NotifierEnv) holds one and a simulated listener; a notifier at work holds one and nothing else. So
//! the row that a policy sees and the choices that it has are the same in training and at work, bit for bit.
//!
//! ```text
//! begin(first observation)
//! loop  mask, write_row  ->  the policy's choices  ->  speech_act  ->  initiation_of  ->  carry_out
//!       hear_word        what was said takes a step, one word of it
//!       observe          what the world looks like after the step
//! ```
//!
//! # What it knows
//!
//! Only what a speaker can know: observations, its own words, and the rules by which it may start and stop. Whether a message
//! that was understood is about to be carried out, or is being carried out, it does not know. With `repeat = "continue"` a
//! simulated listener refuses to hear such a message again; at work it is said.

use leadtime_proto::Mask;
use serde::{Deserialize, Serialize};

use super::actions::{Actions, Offered};
use super::history::History;
use super::settings::NotifierSettings;
use crate::Message;
use crate::check::SettingError;
use crate::description::Quantity;
use crate::human::{
    BlockedInitiation, HumanSettings, Initiation, Repeat, SpeechAct, SpokenMessage,
};

/// A notifier's side of the conversation.
///
/// # Shapes
///
/// A row is `[n * (D + A)]`, the last n pairs of the world's observation (D) and the own action (A = 1 + topics + 2 * words,
/// and 1 more with `can_stop`), oldest first. With `observe_utterance` 1 + topics numbers about the running utterance follow:
/// the share of its words that was spoken, and its topic one-hot.
#[derive(Clone, Debug)]
pub struct Session {
    topics: Vec<&'static str>,
    actions: Actions,
    history: History,
    observe_utterance: bool,
    /// Who listens, of whom only the rules of speech are used.
    rules: HumanSettings,
    speech: Option<SpokenMessage>,
    /// What was done since the last observation.
    started: Option<Message>,
    stopped: bool,
}

/// Everything that the future of a [`Session`] depends on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionState {
    history: Vec<f32>,
    speech: Option<SpokenMessage>,
    started: Option<Message>,
    stopped: bool,
}

impl Session {
    pub(super) fn new(
        obs_dim: usize,
        topics: &[&'static str],
        human: &HumanSettings,
        notifier: &NotifierSettings,
    ) -> Result<Self, SettingError> {
        let actions = Actions::new(notifier, topics, human.can_stop)?;
        Ok(Self {
            topics: topics.to_vec(),
            history: History::new(notifier.history, obs_dim, actions.encoded_dim()),
            actions,
            observe_utterance: notifier.observe_utterance,
            rules: human.clone(),
            speech: None,
            started: None,
            stopped: false,
        })
    }

    pub(super) fn actions(&self) -> &Actions {
        &self.actions
    }

    pub(super) fn history(&self) -> &History {
        &self.history
    }

    /// Says what the numbers after the history are.
    pub(super) fn utterance_quantities(&self, topics: &[&str]) -> Vec<Quantity> {
        if !self.observe_utterance {
            return Vec::new();
        }
        let spoken = "share of the running message spoken so far";
        let topic = self.actions.topic_quantities("utterance", "the running message", topics);
        [Quantity::flag("utterance.spoken", spoken)].into_iter().chain(topic).collect()
    }

    /// Names the topics, in the order of their ids.
    pub fn topics(&self) -> &[&'static str] {
        &self.topics
    }

    /// Returns the length of one observation of the world, D.
    pub fn obs_dim(&self) -> usize {
        self.history.obs_dim()
    }

    /// Returns the length of a row, the policy's input.
    pub fn row_dim(&self) -> usize {
        let utterance = if self.observe_utterance { 1 + self.actions.n_topics() } else { 0 };
        self.history.row().len() + utterance
    }

    /// Returns whether it may say something again that the listener is carrying out, without knowing that they are.
    pub fn is_blind_to_repeats(&self) -> bool {
        self.rules.repeat == Repeat::Continue
    }

    /// Starts an episode: silent, with no past. `observe` writes the first observation, `[D]`.
    pub fn begin(&mut self, observe: impl FnOnce(&mut [f32])) {
        (self.speech, self.started, self.stopped) = (None, None, false);
        self.history.begin(observe);
    }

    /// Returns the choices that are offered in the coming step.
    pub fn mask(&self) -> Mask {
        let is_masked = self.rules.blocked_initiation == BlockedInitiation::Mask;
        let start = !is_masked || self.rules.may_start(self.speech);
        self.actions.mask(Offered { start, stop: self.rules.may_stop(self.speech) })
    }

    /// Writes what the policy sees. Shape `[row_dim]`.
    pub fn write_row(&self, row: &mut [f32]) {
        let (pairs, utterance) = row.split_at_mut(self.history.row().len());
        pairs.copy_from_slice(self.history.row());
        utterance.fill(0.0);
        if self.observe_utterance
            && let Some(SpokenMessage { message, heard, .. }) = self.speech
        {
            utterance[0] = heard as f32 / message.conveyance as f32;
            self.actions.encode_topic(message.topic, &mut utterance[1..]);
        }
    }

    /// Reads the policy's choices. Shape `[n_heads]`.
    ///
    /// # Panics
    ///
    /// If a choice is not one of its head's.
    pub fn speech_act(&self, choices: &[u8]) -> SpeechAct {
        self.actions.speech_act(choices)
    }

    /// Says what becomes of a speech act by the rules of speech, as far as a speaker knows.
    pub fn initiation_of(&self, act: SpeechAct) -> Initiation {
        let repeats = |message: Message| {
            self.rules.repeat == Repeat::Continue
                && self.speech.is_some_and(|utterance| utterance.message.topic == message.topic)
        };
        match act {
            SpeechAct::Stop if self.rules.may_stop(self.speech) => Initiation::Stopped,
            SpeechAct::Continue | SpeechAct::Stop => Initiation::None,
            SpeechAct::Start(message) if repeats(message) => Initiation::Continued,
            SpeechAct::Start(_) if self.rules.may_start(self.speech) => Initiation::Started,
            SpeechAct::Start(_) => Initiation::Blocked,
        }
    }

    /// Records what became of a speech act; returns the message that starts.
    pub fn carry_out(&mut self, act: SpeechAct, initiation: Initiation) -> Option<Message> {
        self.stopped = initiation == Initiation::Stopped;
        self.started = match (act, initiation) {
            (SpeechAct::Start(message), Initiation::Started) => Some(message),
            _ => None,
        };
        if self.stopped {
            self.speech = None;
        }
        if let Some(message) = self.started {
            self.speech = Some(SpokenMessage::new(message, &self.rules));
        }
        self.started
    }

    /// Cuts the running utterance for a reason that is not the policy's: nobody who listens is there any more.
    pub fn fall_silent(&mut self) {
        self.speech = None;
    }

    /// Counts one more word as heard; returns the message that ends with it.
    pub fn hear_word(&mut self) -> Option<Message> {
        let utterance = self.speech.as_mut()?;
        let is_last = utterance.hear_word(&self.rules).is_last;
        let message = utterance.message;
        is_last.then(|| {
            self.speech = None;
            message
        })
    }

    /// Takes the observation after a step. `observe` writes it, `[D]`.
    pub fn observe(&mut self, observe: impl FnOnce(&mut [f32])) {
        let (actions, started, stopped) = (&self.actions, self.started, self.stopped);
        self.history.push(observe, |out| actions.encode(started, stopped, out));
        (self.started, self.stopped) = (None, false);
    }

    /// Returns the running utterance.
    pub fn speech(&self) -> Option<SpokenMessage> {
        self.speech
    }

    /// Returns everything that the future depends on.
    pub fn state(&self) -> SessionState {
        let history = self.history.row().to_vec();
        let Self { speech, started, stopped, .. } = *self;
        SessionState { history, speech, started, stopped }
    }

    /// Continues from a state, bit for bit; `false`, with nothing changed, if it is another notifier's.
    pub fn restore(&mut self, state: &SessionState) -> bool {
        let SessionState { history, speech, started, stopped } = state;
        let n_topics = self.topics.len();
        let known = started.is_none_or(|message| message.fits(n_topics));
        let fits = known && self.resume(history, *speech);
        if fits {
            (self.started, self.stopped) = (*started, *stopped);
        }
        fits
    }

    /// Continues between two steps; `false`, with nothing changed, if this is another notifier's past.
    pub(super) fn resume(&mut self, history: &[f32], speech: Option<SpokenMessage>) -> bool {
        let finite = history.iter().all(|value| value.is_finite());
        let known = speech.is_none_or(|speech| speech.fits(self.topics.len()));
        let fits = finite && known && self.history.restore(history);
        if fits {
            (self.speech, self.started, self.stopped) = (speech, None, false);
        }
        fits
    }
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
