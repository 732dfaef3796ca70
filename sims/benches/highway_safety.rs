//! How dangerous the highway is, over 1,000 seeds: `cargo bench -p leadtime-sims --bench highway_safety`.
//!
//! Prints one line per plan: the share of episodes in which the ego crashes, its 95 % interval, crashes by merge.

#![expect(clippy::print_stdout, reason = "a table is all it makes")]

use leadtime_sims::driving::{Plan, WorldSettings, measure};

const N_EPISODES: u64 = 1_000;

fn main() {
    let settings = WorldSettings::default();
    let early = [190.0, 150.0, 110.0, 70.0].map(|from| Plan::SlowDown { from });
    for plan in [Plan::Unaided].into_iter().chain(early) {
        let found =
            measure(&settings, plan, 0..N_EPISODES).expect("the default world can be built");
        let [low, high] = found.interval();
        println!(
            "{plan:?}: {:.3} crash [{low:.3}, {high:.3}], by merge {:?}, {:.1} steps on average",
            found.crash_rate(),
            found.crashes,
            found.mean_steps
        );
    }
}
