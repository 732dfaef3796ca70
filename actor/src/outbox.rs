//! Rollouts on their way: numbered, sent within the credit, kept until they are acknowledged.
//!
//! ```text
//! acknowledged │ sent, kept │ not sent yet │ not made yet
//!              └────────── entries ────────┘
//!                           ↑ at most up to the credit's limit
//! ```
//!
//! A lost message is noticed by the missing acknowledgement; [`Outbox::resume`] then sends everything that is
//! kept once more, in order, and the learner drops what it has.

use std::collections::VecDeque;

use bytes::Bytes;
use leadtime_proto::{Header, Schedule, Sequence};

/// One encoded rollout. Cloning is cheap: the clones share one reference-counted payload.
#[derive(Clone, Debug)]
pub struct EncodedRollout {
    /// What the learner reads before it looks at the rollout; the sequence is given by the outbox.
    pub header: Header,
    /// The encoded [`leadtime_proto::Rollout`].
    pub payload: Bytes,
}

/// The rollouts of one start of an actor.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    entries: VecDeque<EncodedRollout>,
    /// The highest sequence given out.
    pub(crate) made: Sequence,
    /// The highest sequence acknowledged.
    pub(crate) acknowledged: Sequence,
    /// The highest sequence sent.
    pub(crate) sent: Sequence,
    limit: Sequence,
}

impl Outbox {
    /// Takes a rollout in and gives it the next sequence.
    pub(crate) fn push(&mut self, mut rollout: EncodedRollout) {
        self.made = self.made.next();
        rollout.header.sequence = self.made;
        self.entries.push_back(rollout);
    }

    /// Takes the next rollout that may be sent.
    pub(crate) fn send_next(&mut self) -> Option<EncodedRollout> {
        let index = (self.sent.0 - self.acknowledged.0) as usize;
        let rollout = self.entries.get(index).filter(|_| self.sent < self.limit)?;
        self.sent = self.sent.next();
        Some(rollout.clone())
    }

    /// Tells whether more may be made: under a deterministic schedule a window's worth may be kept, sent or not; in
    /// `async`, where it would grow stale here, only what may be sent.
    pub(crate) fn has_room(&self, schedule: Schedule, window: u32) -> bool {
        if schedule.is_deterministic() {
            self.entries.len() < window as usize
        } else {
            self.made < self.limit
        }
    }

    /// Takes an acknowledgement and a permission. Returns whether anything new was acknowledged.
    pub(crate) fn credit(&mut self, acknowledged: Sequence, limit: Sequence) -> bool {
        // More than was made cannot have been received: such a credit is about something else.
        if acknowledged > self.made {
            return false;
        }
        self.limit = self.limit.max(limit);
        let is_new = acknowledged > self.acknowledged;
        while self.acknowledged < acknowledged {
            self.entries.pop_front();
            self.acknowledged = self.acknowledged.next();
        }
        self.sent = self.sent.max(self.acknowledged);
        is_new
    }

    /// Starts over with a learner that counts from `resend_from` and grants a window.
    pub(crate) fn resume(&mut self, resend_from: Sequence, window: u32) {
        let acknowledged = Sequence(resend_from.0.saturating_sub(1));
        self.limit = Sequence(acknowledged.0 + u64::from(window));
        self.credit(acknowledged, self.limit);
        self.sent = self.acknowledged;
    }

    /// Forgets what comes after this one and was not sent: those sequences are given out again.
    pub(crate) fn forget_after(&mut self, published: Sequence) {
        self.made = self.made.min(published).max(self.sent);
        self.entries.truncate((self.made.0 - self.acknowledged.0) as usize);
    }

    /// Drops what was not sent, because the actor is leaving.
    pub(crate) fn drop_unsent(&mut self) {
        self.entries.truncate((self.sent.0 - self.acknowledged.0) as usize);
    }

    /// Tells whether something was sent and is not acknowledged.
    pub(crate) fn is_waiting(&self) -> bool {
        self.sent > self.acknowledged
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use leadtime_proto::Incarnation;
    use leadtime_proto::header::Schema;

    fn outbox(n: u64, limit: u64) -> Outbox {
        let mut outbox = Outbox::default();
        for _ in 0..n {
            let header = Header::plain(Schema::Rollout, Incarnation(1), &[]);
            outbox.push(EncodedRollout { header, payload: Bytes::new() });
        }
        outbox.credit(Sequence(0), Sequence(limit));
        outbox
    }

    fn send_all(outbox: &mut Outbox) -> Vec<u64> {
        let sent = std::iter::from_fn(|| outbox.send_next());
        sent.map(|rollout| rollout.header.sequence.0).collect()
    }

    #[test]
    fn no_more_is_sent_than_there_is_credit_for() {
        let mut outbox = outbox(5, 2);
        assert_eq!(send_all(&mut outbox), [1, 2]);
        assert!(outbox.credit(Sequence(1), Sequence(4)));
        assert_eq!(send_all(&mut outbox), [3, 4]);
        assert!(!outbox.credit(Sequence(1), Sequence(3)), "an old credit changes nothing");
        assert!(!outbox.credit(Sequence(7), Sequence(9)), "nor one of what was never made");
        assert_eq!(send_all(&mut outbox), [0; 0]);
        assert_eq!(outbox.entries.len(), 4);
        assert!(outbox.is_waiting());
    }

    #[test]
    fn in_async_no_more_is_made_than_may_be_sent() {
        let (lag, free) = (Schedule::Lag(1), Schedule::Async { staleness_max: 8 });
        let mut outbox = outbox(2, 2);
        assert!(outbox.has_room(lag, 3) && !outbox.has_room(lag, 2));
        assert!(!outbox.has_room(free, 64));
        outbox.credit(Sequence(0), Sequence(3));
        assert!(outbox.has_room(free, 64));
    }

    #[test]
    fn a_learner_says_from_where_what_is_not_acknowledged_is_sent_again() {
        let mut outbox = outbox(4, 9);
        send_all(&mut outbox);
        outbox.credit(Sequence(1), Sequence(9));
        outbox.resume(Sequence(2), 9);
        assert_eq!(send_all(&mut outbox), [2, 3, 4]);
        outbox.resume(Sequence(3), 1);
        assert_eq!(send_all(&mut outbox), [3]);
        assert_eq!(outbox.acknowledged, Sequence(2));
    }

    #[test]
    fn rollouts_that_no_hello_named_are_forgotten_and_their_sequences_given_out_again() {
        let mut outbox = outbox(4, 2);
        send_all(&mut outbox);
        outbox.credit(Sequence(1), Sequence(2));
        outbox.forget_after(Sequence(9));
        assert_eq!((outbox.entries.len(), outbox.made), (3, Sequence(4)));
        outbox.forget_after(Sequence(3));
        assert_eq!((outbox.entries.len(), outbox.made), (2, Sequence(3)));
        outbox.resume(Sequence(2), 9);
        assert_eq!(send_all(&mut outbox), [2, 3]);
        outbox.forget_after(Sequence(1));
        assert_eq!((outbox.entries.len(), outbox.made), (2, Sequence(3)), "they were sent");
    }

    #[test]
    fn a_leaving_actor_keeps_only_what_was_sent() {
        let mut outbox = outbox(4, 2);
        send_all(&mut outbox);
        outbox.drop_unsent();
        assert_eq!((outbox.entries.len(), outbox.sent, outbox.made), (2, Sequence(2), Sequence(4)));
        outbox.credit(Sequence(2), Sequence(2));
        assert!(!outbox.is_waiting());
    }
}
