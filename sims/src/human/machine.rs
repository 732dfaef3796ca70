//! The state machine of the listener: one place for speech, one (or a queue) for what was understood, one for what
//! is being done.
//!
//! A step is driven in this order; `t` is the step's index and the time at its start:
//!
//! 1. [`Human::begin_step`]: is a reaction due?
//! 2. [`Human::apply`]: the notifier starts a message, stops its own, or does neither.
//! 3. [`Human::reaction`], if there is one, is carried out in the world, and
//! 4. [`Human::acted`] records how that went.
//! 5. [`Human::hear_word`]: one more word is heard, and the time is `t + 1`.
//!
//! # Transitions
//!
//! `k'` is the effective comprehension time, `l'` the effective conveyance time (`k'` but at least 1 if speech does
//! not occupy the channel), `d` the delay drawn for the message. "Over" means that the world is notified
//! ([`Human::take_reaction_over`]). Everything that no row names stays as it is.
//!
//! | row | event | state and setting | becomes |
//! |---|---|---|---|
//! | D1 | step begins | pending, not due | - |
//! | D2 | step begins | pending, due; nothing running | running, `d_f` steps left; not pending |
//! | D3 | step begins | pending, due; a reaction running | that one over; as D2 |
//! | D4 | step begins | pending, due; `d_f` is 0 | unheeded; not pending |
//! | I1 | initiation | silent | spoken, 0 words heard |
//! | I2 | initiation | spoken, not understood; `interrupt = replace` | old one preempted; as I1 |
//! | I3 | initiation | spoken, understood; `replace` or `until_comprehended` | old one's tail cut; as I1 |
//! | I4 | initiation | spoken, not understood; `until_comprehended` | blocked |
//! | I5 | initiation | spoken; `finish` | blocked |
//! | I6 | initiation | its topic spoken, pending or running; `repeat = continue` | continued: nothing changes |
//! | I7 | a message starts | pending; `pending = cancel_on_initiation` | pending overwritten |
//! | I8 | a message starts | running; `running = cancel_on_initiation` | running over |
//! | I9 | a message starts | `k'` = 0 | understood at once (C rows, then D rows) |
//! | S1 | stop | spoken, not understood | preempted; silent |
//! | S2 | stop | spoken, understood | tail cut; silent |
//! | S3 | stop | silent, or `can_stop = false` | - |
//! | A1 | acted | followed or refused, steps left | one step fewer |
//! | A2 | acted | followed or refused, last step | running over |
//! | A3 | acted | the world ended it | running over |
//! | C1 | `k'`-th word | nothing pending | pending, due at now + `d` |
//! | C2 | `k'`-th word | pending, due later; one slot | old one overwritten; as C1 |
//! | C5 | `k'`-th word | pending, due now | it still starts with the next step, unless the new one is due now too; as C1 |
//! | C3 | `k'`-th word | pending; `pending = queue` | both pending; the older one is due first |
//! | C4 | `k'`-th word | running; `running = cancel_on_comprehension` | running over |
//! | C6 | `k'`-th word | its topic only informs | nothing but understood |
//! | L1 | `l'`-th word | | delivered; silent |
//! | L2 | delivery cancels | running | running over |
//! | L3 | `l'`-th word | its topic only informs | followed |
//!
//! # When somebody else decides
//!
//! After [`Human::hand_over`] the model only hears: what was understood waits, in a queue, until [`Human::decide`] has the
//! listener act upon its topic, and a reaction lasts for as long as that is so. Rows D, I6, I7, I8, C2 and C4 never come to pass.
//!
//! # Invariants
//!
//! * started = preempted + comprehended + (1 if one is spoken and not understood yet);
//! * comprehended = overwritten + followed + unheeded + pending + (1 if one runs and was not followed yet) + (1 if one
//!   is spoken, understood, and only informs); cut before its last word, such a one is unheeded.

use std::collections::VecDeque;

use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};

use super::delay::DelaySource;
use super::reasons::ReasonTable;
use super::settings::{HumanSettings, PendingRule, ReactionReward, Repeat, RunningRule};
use super::speech::SpokenMessage;
use super::tally::Tally;
use crate::{Message, ReactionStatus, ReactionStep};

/// The most messages that can wait in a queue; a further one is dropped as overwritten.
pub const MAX_PENDING: usize = 64;

/// From how many words on a message counts as long.
pub const LONG_FROM_WORDS: u32 = 4;

/// The most dangers of an episode that are kept apart; the last one stands for all beyond.
pub const MAX_DANGERS: usize = 64;

/// The longest episode that is counted, in steps.
const MAX_TIME: u32 = 1 << 30;

/// What the notifier wants in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpeechAct {
    /// Nothing new: a running utterance goes on.
    Continue,
    /// To start a message.
    Start(Message),
    /// To break off the running utterance.
    Stop,
}

/// What became of the notifier's speech act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Initiation {
    /// The notifier did not speak.
    None,
    /// The message was begun in this step.
    Started,
    /// The message could not start.
    Blocked,
    /// What it repeats goes on; nothing started.
    Continued,
    /// The utterance was broken off.
    Stopped,
}

/// A message that was understood, and the time of its reaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Pending {
    message: Message,
    due: u32,
}

/// A message that is being acted upon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct RunningReaction {
    message: Message,
    steps_left: u32,
    /// At least one step was asked of the world.
    begun: bool,
    /// At least one step was not refused.
    followed: bool,
}

/// Everything about a listener that the future depends on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HumanState {
    now: u32,
    speech: Option<SpokenMessage>,
    pending: VecDeque<Pending>,
    running: Option<RunningReaction>,
    delay: DelaySource,
    tally: Tally,
    /// The dangers for which a reason was paid, a bit each.
    explained: u64,
}

impl HumanState {
    pub(crate) fn speech(&self) -> Option<SpokenMessage> {
        self.speech
    }

    /// Returns whether a listener of `n_topics` topics could be in this state.
    ///
    /// States come back from other processes, so nothing about them is taken on trust.
    pub fn fits(&self, n_topics: usize) -> bool {
        let known = |message: Message| message.fits(n_topics);
        let mut pending = self.pending.iter();
        self.pending.len() <= MAX_PENDING
            && self.now <= MAX_TIME
            && self.tally.is_plausible()
            && pending.all(|pending| known(pending.message) && pending.due <= 2 * MAX_TIME)
            && self.speech.is_none_or(|speech| speech.fits(n_topics))
            && self.running.is_none_or(|running| known(running.message) && running.steps_left > 0)
    }
}

/// A listener who reacts late.
#[derive(Clone, Debug)]
pub struct Human {
    settings: HumanSettings,
    /// Topics that only inform.
    informative: Vec<usize>,
    /// Which messages state a reason.
    reasons: ReasonTable,
    state: HumanState,
    /// A reaction ended since this was last asked.
    reaction_over: bool,
    /// What somebody else has the listener do; `None` while the model decides.
    chosen: Option<ChosenReaction>,
}

/// What somebody else has the listener do in a step.
#[derive(Clone, Copy, Debug, Default)]
struct ChosenReaction {
    /// The topic that they carry out; `None` for their own plan.
    topic: Option<usize>,
    first: bool,
}

impl Human {
    /// Creates a listener who has heard nothing; [`Human::reset`] gives it an episode's generator.
    ///
    /// The `informative` topics ask for no action: they only inform, when they are heard to their end.
    pub(crate) fn new(
        settings: &HumanSettings,
        informative: Vec<usize>,
        reasons: ReasonTable,
    ) -> Self {
        let state = HumanState {
            now: 0,
            speech: None,
            pending: VecDeque::with_capacity(MAX_PENDING),
            running: None,
            delay: DelaySource::new(settings.reaction_delay, Pcg64::seed_from_u64(0)),
            tally: Tally::default(),
            explained: 0,
        };
        let (settings, reaction_over, chosen) = (settings.clone(), false, None);
        Self { settings, informative, reasons, state, reaction_over, chosen }
    }

    fn only_informs(&self, message: Message) -> bool {
        self.informative.contains(&message.topic)
    }

    /// Forgets everything and starts an episode; `generator` gives its delays.
    pub fn reset(&mut self, generator: Pcg64) {
        self.state.now = 0;
        self.state.speech = None;
        self.state.pending.clear();
        self.state.running = None;
        self.state.delay = DelaySource::new(self.settings.reaction_delay, generator);
        self.state.tally = Tally::default();
        self.state.explained = 0;
        self.reaction_over = false;
        self.chosen = self.chosen.map(|_| ChosenReaction::default());
    }

    /// Lets somebody else decide what the listener does, from the next episode on.
    pub(crate) fn hand_over(&mut self) {
        self.settings.pending = PendingRule::Queue;
        self.settings.running = RunningRule::UntilNextDue;
        // What is understood waits for as long as somebody else likes, and has to be allowed to be said again.
        self.settings.repeat = Repeat::Restart;
        self.chosen = Some(ChosenReaction::default());
    }

    /// Has the listener carry out a topic in this step, or act by their own plan. It takes the place of
    /// [`Human::begin_step`] after [`Human::hand_over`], and comes after [`Human::apply`].
    ///
    /// The oldest message on the topic that was understood counts as acted upon, for as long as they keep to the topic. Without
    /// one they act on their own, which no message is paid for.
    pub(crate) fn decide(&mut self, topic: Option<usize>) {
        let before = self.chosen.and_then(|chosen| chosen.topic);
        let first = topic.is_some() && topic != before;
        if topic != before {
            // One that no message asked for has changed the world as well, and a plan may be invalid after it.
            self.reaction_over |= before.is_some();
            self.end_running();
        }
        self.chosen = Some(ChosenReaction { topic, first });
        if self.state.running.is_some() {
            return;
        }
        let mut pending = self.state.pending.iter();
        let Some(i) = pending.position(|it| topic == Some(it.message.topic)) else { return };
        if let Some(Pending { message, .. }) = self.state.pending.remove(i) {
            let (begun, followed, steps_left) = (!first, false, MAX_TIME);
            self.state.running = Some(RunningReaction { message, steps_left, begun, followed });
        }
    }

    /// Returns the state between two steps.
    pub fn state(&self) -> &HumanState {
        &self.state
    }

    /// Continues from a state, bit for bit.
    pub fn restore(&mut self, state: HumanState) {
        self.state = state;
        self.reaction_over = false;
    }

    /// Returns what became of the episode's messages so far.
    pub fn tally(&self) -> &Tally {
        &self.state.tally
    }

    /// Returns the running utterance and how many of its words were heard.
    pub fn speech(&self) -> Option<(Message, u32)> {
        self.state.speech.map(|utterance| (utterance.message, utterance.heard))
    }

    /// Returns the running utterance, and whether it is understood.
    pub(crate) fn spoken(&self) -> Option<SpokenMessage> {
        self.state.speech
    }

    /// Returns the running utterance as the coming word will leave it.
    pub(crate) fn next_word(&self) -> Option<SpokenMessage> {
        let mut utterance = self.state.speech?;
        utterance.hear_word(&self.settings);
        Some(utterance)
    }

    /// Returns the words after which a message is understood; 0 if before the first.
    pub(crate) fn words_needed(&self, message: Message) -> u32 {
        self.settings.effective_comprehension(message)
    }

    /// Returns the message that will be acted upon next.
    pub fn pending(&self) -> Option<Message> {
        self.state.pending.front().map(|pending| pending.message)
    }

    /// Returns the reaction delay of a message that would be understood now, in steps; `None` where every message
    /// draws its own.
    pub fn reaction_delay(&self) -> Option<u32> {
        self.state.delay.known(self.settings.reaction_delay, self.state.now)
    }

    /// Returns the message that the coming step acts upon unless something new is said, and for how many steps more.
    pub fn upcoming(&self) -> Option<(Message, u32)> {
        let due = self.state.pending.front().filter(|pending| pending.due <= self.state.now);
        let steps = |due: &Pending| (due.message, self.reaction_steps(due.message));
        let starting = due.map(steps).filter(|(_, steps)| *steps > 0);
        starting.or(self.state.running.map(|running| (running.message, running.steps_left)))
    }

    /// Returns whether a message (of another topic) would start now.
    pub fn may_start(&self) -> bool {
        self.settings.may_start(self.state.speech)
    }

    /// Returns whether there is an utterance that may be broken off.
    pub fn may_stop(&self) -> bool {
        self.settings.may_stop(self.state.speech)
    }

    /// Returns whether a reaction ended since this was last asked.
    pub fn take_reaction_over(&mut self) -> bool {
        std::mem::take(&mut self.reaction_over)
    }

    /// Begins a step: a reaction whose time has come starts, and replaces one that runs (rows D).
    pub fn begin_step(&mut self) {
        if self.chosen.is_some() {
            return;
        }
        let now = self.state.now;
        let due = self.state.pending.pop_front_if(|pending| pending.due <= now);
        let Some(Pending { message, .. }) = due else { return };
        let steps_left = self.reaction_steps(message);
        // Row D4: it asks for nothing, so what runs goes on.
        if steps_left == 0 {
            self.state.tally.unheeded += 1;
            return;
        }
        self.end_running();
        let (begun, followed) = (false, false);
        self.state.running = Some(RunningReaction { message, steps_left, begun, followed });
    }

    /// Applies the notifier's speech act, as far as the settings let it (rows I and S).
    pub fn apply(&mut self, act: SpeechAct) -> Initiation {
        match act {
            SpeechAct::Stop if self.may_stop() => {
                self.cut_speech();
                Initiation::Stopped
            }
            SpeechAct::Continue | SpeechAct::Stop => Initiation::None,
            SpeechAct::Start(message) => self.initiate(message),
        }
    }

    fn initiate(&mut self, message: Message) -> Initiation {
        if self.settings.repeat == Repeat::Continue && self.is_under_way(message.topic) {
            self.state.tally.continued += 1;
            Initiation::Continued
        } else if self.may_start() {
            self.start(message);
            Initiation::Started
        } else {
            self.state.tally.ignored += 1;
            Initiation::Blocked
        }
    }

    fn is_under_way(&self, topic: usize) -> bool {
        self.state.speech.is_some_and(|utterance| utterance.message.topic == topic)
            || self.state.pending.iter().any(|pending| pending.message.topic == topic)
            || self.state.running.is_some_and(|running| running.message.topic == topic)
    }

    fn start(&mut self, message: Message) {
        self.cut_speech();
        // Before the new message can become pending itself, which with k' = 0 happens below.
        if self.settings.pending == PendingRule::CancelOnInitiation {
            self.drop_pending_after(None);
        }
        if self.settings.running == RunningRule::CancelOnInitiation {
            self.end_running();
        }
        let tally = &mut self.state.tally;
        tally.started += 1;
        tally.sum_k += message.comprehension;
        tally.sum_l += message.conveyance;
        tally.long += u32::from(message.conveyance >= LONG_FROM_WORDS);
        let speech = SpokenMessage::new(message, &self.settings);
        self.state.speech = Some(speech);
        // Row I9: `begin_step` of this step is past, so a reaction that is due at once starts here, and not a step late.
        if speech.understood {
            self.comprehend(message);
            self.begin_step();
        }
    }

    /// Returns what the listener is to do in this step, if not what they planned themselves.
    pub fn reaction(&self) -> Option<ReactionStep> {
        if let Some(ChosenReaction { topic, first }) = self.chosen {
            return topic.map(|topic| ReactionStep { topic, first });
        }
        let running = self.state.running?;
        Some(ReactionStep { topic: running.message.topic, first: !running.begun })
    }

    /// Records how this step of the running reaction went (rows A); returns `R_react` of the step.
    ///
    /// A world that says nothing about a reaction it was asked for has refused it. A reason is paid once per danger
    /// ([`Domain::danger`](crate::Domain::danger)): the listener knows it by then, and a notifier cannot live on saying it.
    pub fn acted(&mut self, status: Option<ReactionStatus>, danger: usize) -> f64 {
        let Some(running) = self.state.running.as_mut() else { return 0.0 };
        let status = status.unwrap_or(ReactionStatus::Refused);
        // A refused step uses up time as a followed one does: the listener tried for `d_f` steps.
        let follows = status != ReactionStatus::Refused;
        let first_followed = follows && !running.followed;
        running.begun = true;
        running.followed |= follows;
        running.steps_left -= 1;
        let (message, is_last) = (running.message, running.steps_left == 0);
        self.state.tally.followed += u32::from(first_followed);
        if is_last || status == ReactionStatus::Ended {
            self.end_running();
        }
        let pays = match self.settings.reaction_reward {
            ReactionReward::Off => false,
            ReactionReward::Once => first_followed,
            ReactionReward::PerStep => follows,
        };
        if !pays {
            return 0.0;
        }
        let danger = 1 << danger.min(MAX_DANGERS - 1);
        let stated = self.reasons.share(message);
        let reason = if self.state.explained & danger == 0 { stated } else { 0.0 };
        if stated > 0.0 {
            self.state.explained |= danger;
        }
        self.settings.informativeness_of(message, reason) - 2.0
    }

    fn reaction_steps(&self, message: Message) -> u32 {
        self.settings.reaction_steps(message, self.reasons.share(message))
    }

    pub(crate) fn reaction_reward(&self) -> ReactionReward {
        self.settings.reaction_reward
    }

    /// Hears one more word, if one is spoken, and ends the step (rows C and L1); returns the message that was heard to
    /// its end.
    pub fn hear_word(&mut self) -> Option<Message> {
        // Time moves even in silence, and before comprehension: a delay counts from the end of the k-th word's step.
        self.state.now += 1;
        let utterance = self.state.speech.as_mut()?;
        let word = utterance.hear_word(&self.settings);
        let message = utterance.message;
        // Comprehension comes first: with k = l the message is pending before its delivery may cancel a reaction.
        if word.understood {
            self.comprehend(message);
        }
        word.is_last.then(|| {
            self.state.speech = None;
            self.state.tally.delivered += 1;
            self.state.tally.followed += u32::from(self.only_informs(message));
            message
        })
    }

    fn comprehend(&mut self, message: Message) {
        self.state.tally.comprehended += 1;
        // Row C6, before any draw: a message without a reaction must not use up the stream of delays.
        if self.only_informs(message) {
            return;
        }
        if self.settings.running == RunningRule::CancelOnComprehension {
            self.end_running();
        }
        let delay = self.state.delay.next(self.settings.reaction_delay, self.state.now);
        let is_queue = self.settings.pending == PendingRule::Queue;
        // After the draw, so that a full queue does not shift the delays of later messages.
        if is_queue && self.state.pending.len() == MAX_PENDING {
            self.state.tally.overwritten += 1;
            return;
        }
        if !is_queue {
            // Row C5: what is due now has waited its full delay and starts with the next step, unless the new one is
            // due in that very step too: one step starts one reaction.
            self.drop_pending_after(if delay == 0 { None } else { Some(self.state.now) });
        }
        self.state.pending.push_back(Pending { message, due: self.state.now + delay });
    }

    /// Drops what is due later than `time`; everything for `None`.
    fn drop_pending_after(&mut self, time: Option<u32>) {
        let before = self.state.pending.len();
        self.state.pending.retain(|pending| time.is_some_and(|time| pending.due <= time));
        self.state.tally.overwritten += (before - self.state.pending.len()) as u32;
    }

    fn cut_speech(&mut self) {
        if let Some(utterance) = self.state.speech.take() {
            let in_vain = utterance.understood && self.only_informs(utterance.message);
            self.state.tally.preempted += u32::from(!utterance.understood);
            self.state.tally.unheeded += u32::from(in_vain);
        }
    }

    /// Ends the running reaction, as a delivery that makes the listener think again does (row L2).
    pub fn end_running(&mut self) {
        if let Some(running) = self.state.running.take() {
            // A reaction of which the world has seen no step has left nothing behind that a plan could miss.
            self.reaction_over |= running.begun;
            self.state.tally.overwritten += u32::from(!running.begun);
            self.state.tally.unheeded += u32::from(running.begun && !running.followed);
        }
    }
}

#[cfg(test)]
#[path = "machine_tests.rs"]
mod tests;
