//! Messages of which only the newest counts, beside a queue of those that all count.
//!
//! Credit and announcements are cumulative. In a queue that is full, the newest would be the one that is dropped; here
//! it replaces the one before it, so a consumer that was busy finds exactly what it needs and nothing else.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use tokio::sync::Notify;

use crate::lock::lock;
use crate::queue::EventQueue;

/// The most keys whose newest message is kept: an observer hears of as many domains as somebody invents.
const MAX_KEYS: usize = 1_024;

/// The newest message by key.
#[derive(Debug)]
pub(crate) struct Latest<T> {
    newest: Mutex<BTreeMap<String, T>>,
    arrived: Notify,
}

impl<T> Latest<T> {
    /// Replaces the message kept under the key, without waiting.
    pub(crate) fn put(&self, key: &str, message: T) {
        let mut newest = lock(&self.newest);
        if newest.len() < MAX_KEYS || newest.contains_key(key) {
            newest.insert(key.to_owned(), message);
            self.arrived.notify_one();
        }
    }

    async fn next(&self) -> T {
        loop {
            if let Some((_, message)) = lock(&self.newest).pop_first() {
                // There may be another message: wake the next caller too.
                self.arrived.notify_one();
                return message;
            }
            self.arrived.notified().await;
        }
    }
}

/// The consumer's end: events in their order, and the newest of the cumulative ones.
#[derive(Debug)]
pub struct Events<T> {
    queue: flume::Receiver<T>,
    /// Presence, if it has a queue of its own.
    presence: Option<flume::Receiver<T>>,
    latest: Arc<Latest<T>>,
}

impl<T> Events<T> {
    /// Makes both ends, with `n_bulk` places in the queue beside its reserve.
    pub(crate) fn new(n_bulk: usize) -> (EventQueue<T>, Arc<Latest<T>>, Self) {
        let (sender, queue) = EventQueue::new(n_bulk);
        let latest = Arc::new(Latest { newest: Mutex::default(), arrived: Notify::new() });
        let events = Self { queue, presence: None, latest: Arc::clone(&latest) };
        (sender, latest, events)
    }

    /// Gives presence a queue of its own, so that it can be heard while everything else waits; returns its other end.
    pub(crate) fn part_presence(&mut self) -> EventQueue<T> {
        let (sender, presence) = EventQueue::new(0);
        self.presence = Some(presence);
        sender
    }

    /// Waits for the next event; `None` once the link is gone.
    pub async fn recv(&self) -> Option<T> {
        // In random order: no kind can keep out another.
        tokio::select! {
            event = self.queue.recv_async() => event.ok(),
            event = self.latest.next() => Some(event),
            event = self.recv_presence() => event,
        }
    }

    /// Waits for the next event of presence, and leaves everything else where it is; `None` once the link is gone.
    pub async fn recv_presence(&self) -> Option<T> {
        match &self.presence {
            Some(presence) => presence.recv_async().await.ok(),
            None => std::future::pending().await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::Class;

    #[tokio::test]
    async fn the_newest_replaces_the_one_before_it_even_if_the_queue_is_full() {
        let (queue, latest, events) = Events::new(1);
        while queue.offer(0, Class::Presence).is_none() {}
        for credit in 1..=3 {
            latest.put("credit", credit);
        }
        latest.put("weights", 9);
        let mut heard = Vec::new();
        while heard.len() < 2 {
            heard.extend(events.recv().await.filter(|event| *event > 0));
        }
        assert_eq!(heard, [3, 9]);
    }

    #[tokio::test]
    async fn presence_is_heard_while_everything_else_waits() {
        let (queue, latest, mut events) = Events::new(1);
        let presence = events.part_presence();
        queue.offer(1, Class::Request);
        latest.put("credit", 2);
        presence.offer(3, Class::Presence);
        assert_eq!(events.recv_presence().await, Some(3));
        presence.offer(4, Class::Presence);
        let mut heard = Vec::new();
        while heard.len() < 3 {
            heard.extend(events.recv().await);
        }
        heard.sort_unstable();
        assert_eq!(heard, [1, 2, 4]);
    }
}
