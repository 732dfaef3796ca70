//! Which choices an environment offers in one step, as one word.

use serde::{Deserialize, Serialize};

/// The choices that an environment offers in one step: bit `offset(head) + choice`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mask(pub u64);

impl Mask {
    /// Offers every choice.
    pub const ALL: Self = Self(u64::MAX);

    /// Returns the offered choices of the head that starts at `offset`, bit 0 for its first choice.
    pub fn of_head(self, offset: usize, n_choices: usize) -> u64 {
        (self.0 >> offset) & bits(n_choices)
    }
}

/// Returns a word whose lowest `n` bits are set.
pub(super) fn bits(n: usize) -> u64 {
    if n >= 64 { u64::MAX } else { (1 << n) - 1 }
}
