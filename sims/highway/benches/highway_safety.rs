//! How dangerous the highway is, over 1,000 seeds: `cargo bench -p leadtime-highway --bench highway_safety`.
//!
//! Prints a line for the unaided ego, and one per distance from which it slows down before each merge: the share of
//! episodes in which it crashes, its 95 % score interval (Wilson), crashes by merge.

#![expect(clippy::print_stdout, reason = "a table is all it makes")]

#[path = "../tests/danger/mod.rs"]
mod danger;

use leadtime_highway::task::HighwayWorldSettings;

const N_EPISODES: u32 = 1_000;
const Z: f64 = 1.959_963_984_540_054;

fn main() {
    for from in [None, Some(190.0), Some(150.0), Some(110.0), Some(70.0)] {
        let found = danger::measure(&HighwayWorldSettings::default(), from, 0..N_EPISODES.into());
        let (n, rate) = (f64::from(N_EPISODES), found.crash_rate());
        let middle = (rate + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
        let half = Z * (rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n)).sqrt() / (1.0 + Z * Z / n);
        println!(
            "slow down from {from:?} m: {rate:.3} crash [{:.3}, {:.3}], {} of {N_EPISODES} arrived, by merge {:?}, \
             {:.1} steps on average",
            middle - half,
            middle + half,
            found.n_arrived,
            found.crashes,
            f64::from(found.n_steps) / n
        );
    }
}
