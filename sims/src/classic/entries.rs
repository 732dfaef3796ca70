//! The small tasks, ready to be registered.

use super::{CartPole, CueRecall};
use crate::registry::DomainEntry;

/// Describes the small tasks.
pub fn entries() -> [DomainEntry; 2] {
    [
        DomainEntry::world_only("cartpole", CartPole::new),
        DomainEntry::world_only("cue_recall", CueRecall::new),
    ]
}
