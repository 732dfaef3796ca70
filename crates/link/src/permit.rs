//! Room in the learner's event queue: what holds it, and how it is given back.

use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How much of the queue somebody uses.
#[derive(Debug, Default)]
pub(crate) struct QueueUsage {
    pub(crate) n_messages: AtomicUsize,
    pub(crate) n_bytes: AtomicUsize,
}

/// A place (and some bytes) in the event queue, given back when dropped.
#[derive(Debug)]
pub struct QueuePermit {
    of_sender: Arc<QueueUsage>,
    of_all: Arc<QueueUsage>,
    n_bytes: usize,
}

impl QueuePermit {
    /// Takes room for a message. The caller holds the lock under which all room is taken; giving back needs none.
    pub(crate) fn take(
        of_sender: &Arc<QueueUsage>,
        of_all: &Arc<QueueUsage>,
        n_bytes: usize,
    ) -> Self {
        for usage in [of_sender, of_all] {
            usage.n_messages.fetch_add(1, Ordering::Relaxed);
            usage.n_bytes.fetch_add(n_bytes, Ordering::Relaxed);
        }
        Self { of_sender: Arc::clone(of_sender), of_all: Arc::clone(of_all), n_bytes }
    }
}

impl Drop for QueuePermit {
    fn drop(&mut self) {
        for usage in [&self.of_sender, &self.of_all] {
            usage.n_messages.fetch_sub(1, Ordering::Relaxed);
            usage.n_bytes.fetch_sub(self.n_bytes, Ordering::Relaxed);
        }
    }
}

/// The body of a rollout message: bytes that count against their sender's share until dropped.
#[derive(Debug)]
pub struct Payload {
    bytes: Vec<u8>,
    _permit: QueuePermit,
}

impl Payload {
    pub(crate) fn new(bytes: Vec<u8>, permit: QueuePermit) -> Self {
        Self { bytes, _permit: permit }
    }
}

impl Deref for Payload {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}
