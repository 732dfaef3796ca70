//! The lander's tasks, ready to be registered.

use leadtime_sims::DomainEntry;

use crate::pilot::PilotTask;
use crate::task::LanderWorldSettings;

/// Describes the notifier task `lander`, and the pilot's own training task `pilot`.
pub fn entries() -> [DomainEntry; 2] {
    [
        // An entered zone is a failure of the episode, but its end only where a policy learns from it.
        DomainEntry::notifier::<LanderWorldSettings>("lander")
            .evaluated_with("zone_ends_episode = false")
            .drawn_on_a_map(),
        DomainEntry::world_only("pilot", PilotTask::new),
    ]
}
