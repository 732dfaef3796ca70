//! The steakhouse, ready to be registered.

use leadtime_sims::DomainEntry;

use crate::task::SteakhouseWorldSettings;

/// Describes the notifier task `steakhouse`.
pub fn entry() -> DomainEntry {
    DomainEntry::notifier::<SteakhouseWorldSettings>("steakhouse")
}
