//! Stepping the notifier problem allocates nothing: not the listener, not the history, not the batch.
//!
//! It steps the lander in free flight (the contact world near the ground belongs to the physics engine, which keeps
//! its own memory), the highway past its first merge, and the steakhouse through words, directions and disclosures. This
//! is a program of its own (no test harness), so that nobody else allocates beside it.

use std::alloc::System;

use leadtime_proto::{EnvId, TaskSpec};
use leadtime_sims::{EpisodeSeed, Registry, Vectorized};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const N_ENVS: usize = 4;

fn main() {
    steps_allocate_nothing("lander", 8);
    steps_allocate_nothing("highway", 16);
    steps_allocate_nothing("steakhouse", 25);
}

fn steps_allocate_nothing(domain: &str, n_steps: usize) {
    let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
    let registry = Registry::builtin();
    let build = |_| registry.build(&task).expect("the default task can be built");
    let mut rows = Vectorized::new((0..N_ENVS).map(build).collect());
    let mut actions = [0_u8; N_ENVS * 4];
    for row in 0..N_ENVS {
        let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(row as u32), episode: 0 };
        rows.reset(row, seed);
        // Start a message in every step: speech, comprehension, reaction and cuts all happen.
        actions[row * 4] = 1;
        actions[row * 4 + 1] = row as u8;
    }
    rows.step(&actions);
    let region = Region::new(ALLOCATOR);
    for _ in 0..n_steps {
        rows.step(&actions);
    }
    let change = region.change();
    let goes_on = rows.outcomes().iter().all(|outcome| outcome.end.is_none());
    assert!(goes_on, "all episodes of {domain} go on");
    assert_eq!((change.allocations, change.reallocations), (0, 0), "{domain}: {change:?}");
}
