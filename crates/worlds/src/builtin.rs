//! The registry of everything that comes with the program.

use leadtime_sims::{Registry, classic};

/// Knows every built-in task.
///
/// | name | task |
/// |---|---|
/// | `cartpole`, `cue_recall` | [classic control](leadtime_sims::classic) |
/// | `lander`, `pilot` | [the lander](leadtime_lander) and its pilot's training task |
/// | `highway` | [the highway](leadtime_highway) |
/// | `steakhouse` | [the steakhouse](leadtime_steakhouse) |
pub fn builtin() -> Registry {
    classic::entries()
        .into_iter()
        .chain(leadtime_lander::entries())
        .chain([leadtime_highway::entry(), leadtime_steakhouse::entry()])
        .fold(Registry::default(), Registry::with_domain)
}
