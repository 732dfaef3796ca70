//! The bounded queue between the network's callbacks and the consumer.
//!
//! A callback runs on one of the network's few receiving threads, shared by every connection of the process. It must
//! never wait, so it offers and goes on. The queue has a reserve: floods of one kind of message cannot keep out the
//! kinds above it.
//!
//! ```text
//! 0 ────────────── bulk ──────────────┬── requests ──┬── presence ──┐ capacity
//!   rollouts, refusals, metrics …     │ hello, orders│ joined, left │
//! ```

/// Queue places that only requests and presence may use.
const REQUESTS: usize = 1_024;
/// Queue places that only presence may use.
const PRESENCE: usize = 1_024;

/// How far up an event may fill the queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Class {
    Bulk,
    Request,
    Presence,
}

/// The end of a queue into which the network's callbacks put events.
#[derive(Debug)]
pub(crate) struct EventQueue<T> {
    sender: flume::Sender<T>,
    n_bulk: usize,
}

impl<T> Clone for EventQueue<T> {
    fn clone(&self) -> Self {
        Self { sender: self.sender.clone(), n_bulk: self.n_bulk }
    }
}

impl<T> EventQueue<T> {
    /// Makes a queue with `n_bulk` places for bulk and a reserve for the rest.
    pub(crate) fn new(n_bulk: usize) -> (Self, flume::Receiver<T>) {
        let (sender, receiver) = flume::bounded(n_bulk + REQUESTS + PRESENCE);
        (Self { sender, n_bulk }, receiver)
    }

    /// Puts an event into the queue without waiting, or gives it back.
    pub(crate) fn offer(&self, event: T, class: Class) -> Option<T> {
        let limit = match class {
            Class::Bulk => self.n_bulk,
            Class::Request => self.n_bulk + REQUESTS,
            Class::Presence => self.n_bulk + REQUESTS + PRESENCE,
        };
        if self.sender.len() >= limit {
            return Some(event);
        }
        self.sender.try_send(event).err().map(flume::TrySendError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_bulk_leaves_room_for_requests_and_presence() {
        let (queue, receiver) = EventQueue::new(2);
        let fits = |event, class| queue.offer(event, class).is_none();
        assert!(fits(0, Class::Bulk) && fits(1, Class::Bulk));
        assert_eq!(queue.offer(2, Class::Bulk), Some(2), "given back, without waiting");
        assert!(fits(3, Class::Request) && fits(4, Class::Presence));
        assert_eq!(receiver.drain().collect::<Vec<_>>(), [0, 1, 3, 4]);
        assert!((0..2 + REQUESTS + PRESENCE).all(|event| fits(event, Class::Presence)));
        assert_eq!(queue.offer(7, Class::Presence), Some(7));
    }
}
