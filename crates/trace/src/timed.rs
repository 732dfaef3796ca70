//! What somebody made, with the time that it took.

use std::time::{Duration, Instant};

/// A value with the time in which it was made.
#[derive(Clone, Copy, Debug)]
pub struct Timed<T> {
    /// The value that was made.
    pub value: T,
    /// When its making began.
    pub start: Instant,
    /// How long it took.
    pub duration: Duration,
}

impl<T> Timed<T> {
    /// Does the work and measures it.
    pub fn measure(work: impl FnOnce() -> T) -> Self {
        let start = Instant::now();
        Self::since(start, work())
    }

    /// Notes that the value, whose making began at `start`, is made just now.
    pub fn since(start: Instant, value: T) -> Self {
        Self { value, start, duration: start.elapsed() }
    }
}
