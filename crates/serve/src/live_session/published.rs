//! What a session publishes: events of what is said, each held back until it is known whether it is the last of its step, and statuses.

use super::{LiveSession, STATUS_EVERY, STATUS_PAUSE};
use crate::open::{SayForm, WordClock};
use crate::say::{self, SaidUtterance, SayEvent, SayLine, SayTo};
use crate::status::{LiveState, Silence, StatusLine, seconds};

impl LiveSession {
    /// Writes an event, and puts the one before it, which was not the last.
    pub(super) fn emit(&mut self, now: u64, event: SayEvent, out: &mut impl SayTo) {
        self.release(false, out);
        if event == SayEvent::Cut {
            out.hush();
        }
        let utterance = &self.utterance;
        let message = utterance.message;
        let said = SaidUtterance {
            number: utterance.number,
            topic: message.topic,
            topic_name: self.notifier.topics().get(message.topic).copied().unwrap_or_default(),
            comprehension: message.comprehension,
            conveyance: message.conveyance,
            heard: utterance.heard,
            text: &utterance.text,
            stand_in: utterance.stand_in,
            seconds: f64::from(message.conveyance) * self.plan.seconds_per_step,
            spoken: utterance
                .spoken
                .as_deref()
                .filter(|_| self.plan.word_clock == WordClock::Voice),
        };
        let age = self.newest_at.map_or(0, |at| now.saturating_sub(at));
        let line = SayLine {
            seq: self.last_seq.unwrap_or(0),
            step: self.step,
            episode: self.episode,
            event,
            utterance: (event != SayEvent::Silent).then_some(said),
            age: seconds(age),
        };
        match self.plan.form {
            SayForm::Json => line.write_json(&mut self.held),
            SayForm::Binary => line.write_raw(&mut self.held),
        }
        self.is_held = true;
    }

    /// Puts the event that was written, if there is one.
    pub(super) fn release(&mut self, is_last: bool, out: &mut impl SayTo) {
        if std::mem::take(&mut self.is_held) {
            say::finish(&mut self.held, self.plan.form, is_last);
            out.say(&self.held);
        }
    }

    /// Ends the answer to an observation.
    pub(super) fn answer(&mut self, now: u64, out: &mut impl SayTo) {
        if !self.is_held {
            self.emit(now, SayEvent::Silent, out);
        }
        self.release(true, out);
    }

    /// Publishes the status, if it is time or there is news.
    pub(super) fn tell(&mut self, now: u64, out: &mut impl SayTo) {
        let has_news = self.has_news && now >= self.status_put + STATUS_PAUSE;
        if !has_news && now < self.status_due {
            return;
        }
        let is_mute = self.is_mute && matches!(self.state, LiveState::Silent | LiveState::Speaking);
        let line = StatusLine {
            session: &self.id,
            state: if is_mute { LiveState::Mute } else { self.state },
            since: seconds(now.saturating_sub(self.since)),
            why: if is_mute { &Silence::Mute } else { &self.why },
            last_seq: self.last_seq.unwrap_or(0),
            age: self.newest_at.map(|at| seconds(now.saturating_sub(at))),
            told: &self.told,
            counts: self.counts,
            latency_us: (&self.latency).into(),
        };
        line.write(&mut self.status);
        out.status(&self.status);
        self.told.clear();
        self.has_news = false;
        (self.status_put, self.status_due) = (now, now + STATUS_EVERY);
    }
}
