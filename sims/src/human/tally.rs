//! What became of an episode's messages, in numbers.

use serde::{Deserialize, Serialize};

/// No episode counts further than this.
const MAX_COUNT: u32 = 1 << 30;

/// Counts messages by their fate.
///
/// A started message is first comprehended or `preempted`; a comprehended one is acted upon, or dropped before
/// (`overwritten`), or comes to nothing (`unheeded`). What is still under way is in none of these.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Messages that the notifier started.
    pub started: u32,
    /// Initiations that were blocked.
    pub ignored: u32,
    /// Initiations that repeated what was under way, and so changed nothing.
    pub continued: u32,
    /// Messages cut before their k-th word.
    pub preempted: u32,
    /// Messages heard up to their k-th word.
    pub comprehended: u32,
    /// Messages heard to their last word.
    pub delivered: u32,
    /// Comprehended messages dropped before a single step of reaction.
    pub overwritten: u32,
    /// Messages that were followed for at least one step.
    pub followed: u32,
    /// Messages whose time came and of which the world let no step happen.
    pub unheeded: u32,
    /// Sum of k over started messages.
    pub sum_k: u32,
    /// Sum of l over started messages.
    pub sum_l: u32,
    /// Started messages of at least four words.
    pub long: u32,
}

impl Tally {
    /// Returns whether an episode could have come to these numbers, with room to count on.
    pub(super) fn is_plausible(&self) -> bool {
        let said = [self.started, self.ignored, self.continued, self.sum_k, self.sum_l, self.long];
        let heard = [self.preempted, self.comprehended, self.delivered];
        let done = [self.overwritten, self.followed, self.unheeded];
        said.iter().chain(&heard).chain(&done).all(|&count| count <= MAX_COUNT)
    }
}
