//! How fast speech is: from words to seconds.

use serde::{Deserialize, Serialize};

use crate::error::TaxonomyError;

/// How fast sentences are spoken.
///
/// # Source
///
/// arXiv:2509.07438 takes 0.3 s per word. A speech synthesiser took 0.335 s per word over sentences of two to
/// five words (20 sentences, three voices), people read at about 0.4.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pace {
    /// Seconds per word (above 0, at most 5), where no recording is known. Default 0.3.
    pub seconds_per_word: f64,
    /// Seconds from the decision to the first sound (0 to 10). Default 0.
    pub startup_seconds: f64,
}

impl Default for Pace {
    fn default() -> Self {
        Self { seconds_per_word: 0.3, startup_seconds: 0.0 }
    }
}

impl Pace {
    /// Checks ranges.
    ///
    /// # Errors
    ///
    /// [`TaxonomyError::Header`] naming the setting.
    pub fn check(&self) -> Result<(), TaxonomyError> {
        let refuse = |key, given: f64, allowed| {
            Err(TaxonomyError::Header { key, given: given.to_string(), allowed })
        };
        let (word, startup) = (self.seconds_per_word, self.startup_seconds);
        if !(word > 0.0 && word <= 5.0) {
            return refuse("pace.seconds_per_word", word, "above 0 and at most 5 seconds");
        }
        if !(0.0..=10.0).contains(&startup) {
            return refuse("pace.startup_seconds", startup, "0 to 10 seconds");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_impossible_pace_is_named() {
        let error = Pace { seconds_per_word: 0.0, ..Pace::default() }.check().unwrap_err();
        let says = "`pace.seconds_per_word` is 0; allowed: above 0 and at most 5 seconds";
        assert_eq!(error.to_string(), says);
        Pace { startup_seconds: -1.0, ..Pace::default() }.check().unwrap_err();
        Pace::default().check().unwrap();
    }
}
