//! The highway, ready to be registered.

use leadtime_sims::DomainEntry;

use crate::task::HighwayWorldSettings;

/// Describes the notifier task `highway`.
pub fn entry() -> DomainEntry {
    // A policy is evaluated to the arrival: what is counted per step is counted while driving.
    DomainEntry::notifier::<HighwayWorldSettings>("highway").evaluated_with("absorb_until = 0")
}
