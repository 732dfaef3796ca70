//! A world of one's own that is slow on purpose: each step costs as many rounds of arithmetic as `world.rounds` says.
//!
//! It is what `bench/scale.sh` measures runs with. A policy sees a number of eight bits and is paid for naming the exclusive
//! or of the first two; the arithmetic makes the next number. Nothing sleeps, and the same seed gives the same episode.
//!
//! ```bash
//! cargo run --release --example slow_world -- up -c slow --set world.rounds=60000    # every command works as in `leadtime`
//! cargo run --release --example slow_world -- bare 10000 60000                       # 10,000 steps of the world by itself
//! cargo run --release --example slow_world -- line 127.0.0.1:7448 HOST:7447 5        # a line that delays each byte by 5 ms
//! ```

use std::env;
use std::hint::black_box;
use std::process::ExitCode;
use std::time::Duration;

use leadtime::Program;
use leadtime_numerics::Purpose;
use leadtime_proto::{ActionSpec, EnvId, EnvSpec};
use leadtime_sims::check::require_within;
use leadtime_sims::environment::{
    End, Environment, EpisodeSeed, StepOutcome, read_snapshot, write_snapshot,
};
use leadtime_sims::{DomainEntry, SettingError, SnapshotError};
use serde::{Deserialize, Serialize};

#[path = "../tests/hosts/relay.rs"]
mod relay;

/// Bits of the number that are shown.
const N_BITS: usize = 8;
/// Steps of an episode.
const N_STEPS: u32 = 100;

/// Nothing differs from the general defaults.
const SETTINGS: &str = "domain = \"slow\"\n";

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["bare", n_steps, rounds] => bare(number(n_steps), number(rounds)),
        ["line", listen, target, delay_ms] => {
            relay::run(listen, target, Duration::from_millis(number(delay_ms)));
        }
        _ => {
            let slow = DomainEntry::world_only::<World, _>("slow", Slow::new);
            return Program::new().with_domain(slow).with_defaults("slow", SETTINGS).run();
        }
    }
    ExitCode::SUCCESS
}

fn number<T: std::str::FromStr>(text: &str) -> T {
    text.parse().unwrap_or_else(|_| panic!("`{text}` is no number that can be used here"))
}

/// Steps the world and nothing else.
fn bare(n_steps: u64, rounds: u32) {
    let mut world = Slow::new(&World { rounds }).unwrap_or_else(|error| panic!("{error}"));
    let mut observation = [0.0; N_BITS];
    for step in 0..n_steps {
        let (episode, place) = (step / u64::from(N_STEPS), step % u64::from(N_STEPS));
        if place == 0 {
            let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(0), episode };
            world.reset(seed, &mut observation);
        }
        black_box(world.step(&[0], &mut observation));
    }
}

/// The section `[world]` of a configuration: what this world can be told.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
struct World {
    /// Rounds of arithmetic in a step, 0 to 1000000000; each takes some two nanoseconds.
    rounds: u32,
}

impl Default for World {
    fn default() -> Self {
        Self { rounds: 50_000 }
    }
}

/// Everything the future depends on.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
struct State {
    number: u64,
    n_steps: u32,
    n_right: u32,
}

struct Slow {
    spec: EnvSpec,
    rounds: u32,
    state: State,
}

impl Slow {
    fn new(world: &World) -> Result<Self, SettingError> {
        require_within("world.rounds", world.rounds, 0..=1_000_000_000, "rounds")?;
        let spec = EnvSpec {
            obs_dim: N_BITS,
            actions: ActionSpec::discrete("answer", 2),
            metrics: vec!["success".to_owned()],
        };
        Ok(Self { spec, rounds: world.rounds, state: State::default() })
    }

    /// Returns one of the bits that are shown.
    fn bit(&self, place: usize) -> u8 {
        (self.state.number >> (u64::BITS as usize - 1 - place)) as u8 & 1
    }

    fn observe(&self, observation: &mut [f32]) {
        for (place, out) in observation.iter_mut().enumerate() {
            *out = f32::from(self.bit(place)) * 2.0 - 1.0;
        }
    }
}

/// Makes the next number: rounds that cannot be taken at once, because each needs the one before.
fn worked(mut number: u64, rounds: u32) -> u64 {
    for _ in 0..rounds {
        number = (number ^ (number >> 29)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
    number
}

impl Environment for Slow {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
        let number = seed.stream(Purpose::World).next_u64();
        self.state = State { number, ..State::default() };
        self.observe(observation);
    }

    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome {
        let is_right = action[0] == self.bit(0) ^ self.bit(1);
        let state = &mut self.state;
        state.n_right += u32::from(is_right);
        state.n_steps += 1;
        // An odd number added, or 0 would stay 0.
        state.number =
            worked(state.number.wrapping_add(u64::from(2 * state.n_steps + 1)), self.rounds);
        let end = (state.n_steps >= N_STEPS).then_some(End::Terminated);
        self.observe(observation);
        StepOutcome { reward: f32::from(u8::from(is_right)), end }
    }

    /// An episode is a success if nine answers of ten were right.
    fn metrics(&self, out: &mut [f32]) {
        out[0] = f32::from(u8::from(10 * self.state.n_right >= 9 * self.state.n_steps));
    }

    fn write_state(&self, out: &mut Vec<u8>) {
        write_snapshot(&self.state, out);
    }

    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        self.state = read_snapshot(state)?;
        self.observe(observation);
        Ok(())
    }
}
