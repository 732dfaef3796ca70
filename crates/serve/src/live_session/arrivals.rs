//! What comes from a client: observations, in their order, and reports of what was heard.

use leadtime_link::live::ArrivalEncoding;
use leadtime_proto::phrase::no_such;
use leadtime_taxonomy::words;

use super::LiveSession;
use crate::heard::{HeardEvent, HeardReport};
use crate::observation::{BadObservation, write_json_with};
use crate::open::StepClock;
use crate::robot::Arrived;
use crate::say::SayTo;
use crate::status::{LiveState, Silence};
use crate::working_policy::LiveDecider;

/// How many unusable messages in a row end a session.
pub const MAX_REFUSED: u32 = 16;
/// The most steps that are taken for observations that never came: more leave no trace in any history.
const MAX_GAP: u64 = 256;
/// How far outside of its range a number may be, in widths of the range.
const WIDTHS: f64 = 3.0;
/// The most unknown facts that are reported by name.
const MAX_UNKNOWN: usize = 16;

/// An observation as it arrived, not read yet.
#[derive(Clone, Copy, Debug)]
pub struct ObservationBytes<'a> {
    /// How it is written.
    pub encoding: &'a ArrivalEncoding,
    /// The bytes of the message.
    pub payload: &'a [u8],
    /// What was attached to it.
    pub beside: Option<&'a [u8]>,
}

impl LiveSession {
    /// Takes an observation that arrived at `at`, in nanoseconds, as `now`.
    pub fn arrive(
        &mut self,
        now: u64,
        at: u64,
        bytes: ObservationBytes<'_>,
        decider: &mut LiveDecider,
        out: &mut impl SayTo,
    ) {
        if self.state == LiveState::Closed {
            return;
        }
        let ObservationBytes { encoding, payload, beside } = bytes;
        let read = match (encoding, &mut self.robot) {
            (ArrivalEncoding::TooLong(n_bytes), _) => Err(BadObservation::TooLong(*n_bytes)),
            (_, Some(robot)) => {
                let last = Arrived { seq: self.last_seq, t: self.last_t, at: self.newest_at };
                let read = robot.read(&mut self.incoming, payload, beside, at, last);
                read.map(|is_first| self.note_clock(is_first))
            }
            (ArrivalEncoding::Json, None) => self.incoming.read_json(payload),
            (ArrivalEncoding::Binary, None) => {
                self.incoming.read_raw(payload, beside.unwrap_or_default())
            }
            (ArrivalEncoding::Other(name), None) => Err(BadObservation::Encoding(name.clone())),
        };
        match read.and_then(|()| self.check_order()) {
            Ok(true) => self.take(now, at, decider, out),
            Ok(false) => self.pass_over(),
            Err(error) => self.refuse(now, &error, out),
        }
        self.tell(now, out);
    }

    /// Notes whether the next observation's time is by another clock than those before.
    pub fn note_clock(&mut self, is_other: bool) {
        self.is_other_clock = is_other;
        self.travel.forget_if(is_other);
    }

    /// Returns whether the last observation's time is by another clock than those before.
    pub(crate) fn is_other_clock(&self) -> bool {
        self.is_other_clock
    }

    /// Returns the newest observation as a client would have sent it; `None` where a client has sent it.
    pub(crate) fn robot_observation(&self) -> Option<Vec<u8>> {
        self.robot.as_ref()?;
        let facts = self.newest.facts().map(|facts| facts.iter().map(str::to_owned).collect());
        let facts: Option<Vec<String>> = facts;
        Some(write_json_with(&self.newest.head, &self.newest.values, facts.as_deref()))
    }

    /// Returns whether the incoming observation is newer than the newest.
    fn check_order(&mut self) -> Result<bool, BadObservation> {
        let Some(last) = self.last_seq else { return Ok(true) };
        let head = self.incoming.head;
        if head.seq < last {
            return Ok(false);
        }
        if head.seq == last {
            // After a restart the content of the last observation is unknown.
            let is_same = self.newest_at.is_none() || self.incoming == self.newest;
            return if is_same { Ok(false) } else { Err(BadObservation::SameSequence(last)) };
        }
        if head.t < self.last_t {
            return Err(BadObservation::BackInTime { before: self.last_t, after: head.t });
        }
        Ok(true)
    }

    /// Drops an observation that is no newer than the newest. Many below it in a row are of somebody who counts anew.
    fn pass_over(&mut self) {
        self.counts.out_of_order += 1;
        let (seq, last) = (self.incoming.head.seq, self.last_seq.unwrap_or(0));
        self.n_late_in_a_row += u32::from(seq < last);
        if self.n_late_in_a_row >= MAX_REFUSED {
            self.told = format!(
                "{} observations in a row have numbers below {last}, which was taken, and are passed over: the last has {seq}; \
                 count on from `last_seq`, or open a new session",
                std::mem::take(&mut self.n_late_in_a_row)
            );
            self.has_news = true;
        }
    }

    fn note_refusal(&mut self, told: String) {
        self.counts.refused += 1;
        self.told = told;
        self.refusals = (self.refusals.0 + 1, self.told.clone());
        self.has_news = true;
    }

    fn refuse(&mut self, now: u64, error: &BadObservation, out: &mut impl SayTo) {
        self.n_refused_in_a_row += 1;
        self.note_refusal(error.to_string());
        if self.n_refused_in_a_row >= MAX_REFUSED && self.robot.is_none() {
            let why = Silence::Refused(self.n_refused_in_a_row, self.told.clone());
            self.close(now, why, out);
        }
    }

    fn take(&mut self, now: u64, at: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        let head = self.incoming.head;
        let gap = self.last_seq.map_or(0, |last| head.seq - last - 1);
        self.counts.taken += 1;
        self.counts.missed += gap;
        (self.n_refused_in_a_row, self.n_late_in_a_row) = (0, 0);
        (self.last_seq, self.last_t) = (Some(head.seq), head.t);
        self.look_for_strange_numbers();
        self.look_for_unknown_facts();
        let is_stepped = self.plan.clock == StepClock::Observation;
        // A simulator's time is its own affair.
        let delay = if is_stepped { 0 } else { self.travel.delay(at, head.t) };
        let is_new = !self.is_begun || head.episode != self.episode || self.is_past_over(now);
        let goes_on = !is_new && !matches!(self.state, LiveState::Ended);
        if goes_on && is_stepped {
            (0..gap.min(MAX_GAP)).for_each(|_| self.pass(now, out));
        }
        std::mem::swap(&mut self.newest, &mut self.incoming);
        self.newest_at = Some(at.saturating_sub(delay));
        self.is_gone = false;
        if is_new {
            self.cut(now, out);
            self.episode = head.episode;
            self.is_begun = true;
        }
        if head.end {
            self.cut(now, out);
            self.next_step = None;
            self.become_state(now, LiveState::Ended, Silence::Ended);
        } else if is_new {
            self.begin(now, decider, out);
        } else if goes_on && (is_stepped || self.next_step.is_none()) {
            // By the clock: back again. The time in between is no time of the conversation.
            self.step(now, decider, out);
            self.next_step = (!is_stepped).then_some(now + self.step_ns);
        }
        if is_stepped {
            self.answer(now, out);
        } else {
            self.release(true, out);
        }
    }

    fn look_for_strange_numbers(&mut self) {
        let mut is_strange = false;
        for (i, (value, quantity)) in self.incoming.values.iter().zip(&*self.ranges).enumerate() {
            let [low, high] = quantity.range.map(f64::from);
            let (value, slack) = (f64::from(*value), WIDTHS * (high - low));
            // Where there is no bound, the comparison with infinity never holds.
            if value < low - slack || value > high + slack {
                is_strange = true;
                if !std::mem::replace(&mut self.was_strange[i], true) {
                    self.told = format!(
                        "`{}` is {value}, far from its range {low} to {high}: is it in another unit?",
                        quantity.name
                    );
                    self.has_news = true;
                }
            }
        }
        self.counts.strange += u64::from(is_strange);
    }

    fn look_for_unknown_facts(&mut self) {
        let Some(facts) = self.incoming.facts() else { return };
        let names = || self.facts.iter().map(|fact| fact.name);
        for fact in facts.iter().filter(|fact| names().all(|name| name != *fact)) {
            self.counts.unknown_facts += 1;
            let is_told = self.unknown.iter().any(|told| told == fact);
            if !is_told && self.unknown.len() < MAX_UNKNOWN {
                self.unknown.push(fact.to_owned());
                self.told = no_such("fact", fact, names());
                self.has_news = true;
            }
        }
    }

    /// Takes a client's report of what its loudspeaker really did; returns it if it can be read.
    pub fn hear(
        &mut self,
        now: u64,
        report: &[u8],
        decider: &mut LiveDecider,
        out: &mut impl SayTo,
    ) -> Option<HeardReport> {
        let report = match HeardReport::read(report) {
            Ok(report) => report,
            Err(fault) => {
                let told = format!("a report of what was heard cannot be read: {fault}");
                self.note_refusal(told);
                return None;
            }
        };
        let is_about_this = report.utterance == self.utterance.number;
        let Some(speech) = self.notifier.speech().filter(|_| is_about_this) else {
            return Some(report);
        };
        self.utterance.is_reported = true;
        let (l, before) = (speech.message.conveyance, self.utterance.heard);
        let n_words = match words::spoken(&self.utterance.text).count() as u32 {
            0 => l,
            n => n,
        };
        let ended = match report.event {
            HeardEvent::Start => 0,
            HeardEvent::Word => report.word.min(n_words) * l / n_words,
            HeardEvent::End => l,
            HeardEvent::Cut => {
                self.fall_silent(now, out);
                return Some(report);
            }
        };
        while self.utterance.heard < ended && self.notifier.speech().is_some() {
            self.hear_word(now, out);
        }
        self.follow(before, now, decider, out);
        Some(report)
    }
}
