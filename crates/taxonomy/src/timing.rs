//! How fast speech is: from words to seconds.

/// How fast sentences are spoken.
///
/// # Source
///
/// arXiv:2509.07438 takes 0.3 s per word. A speech synthesiser took 0.335 s per word over sentences of two to
/// five words (20 sentences, three voices), people read at about 0.4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Seconds per word, where no recording is known. Default 0.3.
    pub seconds_per_word: f64,
    /// Seconds from the decision to the first sound. Default 0.
    pub startup_seconds: f64,
}

impl Default for Pace {
    fn default() -> Self {
        Self { seconds_per_word: 0.3, startup_seconds: 0.0 }
    }
}
