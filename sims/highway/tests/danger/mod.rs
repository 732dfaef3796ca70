//! How dangerous is the road? Drives over many seeds, unaided or slowing down near each merge, without any delay.

use leadtime_highway::task::{HighwayDomain, HighwayWorldSettings};
use leadtime_highway::world::{CarRole, Traffic};
use leadtime_proto::EnvId;
use leadtime_sims::{Domain as _, EpisodeSeed, ReactionStep};

/// A merging car this far behind the ego no longer matters, in metres.
const PASSED: f64 = 20.0;
/// Number of the ego among the cars, and of the topic among the topics.
const EGO: usize = 0;
const SLOW_DOWN: usize = 0;

/// How many episodes ended how.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Safety {
    pub n_episodes: u32,
    pub n_crashed: u32,
    pub n_arrived: u32,
    /// Crashes by merge; those before the first are counted in no place.
    pub crashes: Vec<u32>,
    pub n_steps: u32,
}

impl Safety {
    pub(crate) fn crash_rate(&self) -> f64 {
        f64::from(self.n_crashed) / f64::from(self.n_episodes)
    }
}

/// Drives one episode per seed to its arrival, slowing down from so many metres before each merge, if at all.
pub(crate) fn measure(
    settings: &HighwayWorldSettings,
    slow_down_from: Option<f64>,
    seeds: std::ops::Range<u64>,
) -> Safety {
    let settings = HighwayWorldSettings { absorb_until: 0, ..settings.clone() };
    let mut task = HighwayDomain::new(&settings).expect("the settings are possible");
    let crashes = vec![0; task.traffic.road.ramps.len()];
    let mut found = Safety { crashes, ..Safety::default() };
    for episode in seeds {
        task.reset(EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode });
        loop {
            found.n_steps += 1;
            let reaction = slow_down_from.and_then(|from| slow_down(from, &task.traffic));
            if task.advance(reaction).end.is_some() {
                break;
            }
        }
        found.n_episodes += 1;
        found.n_arrived += u32::from(task.has_arrived());
        found.n_crashed += u32::from(task.traffic.vehicles[EGO].crashed);
        if let Some(ramp) = task.crash_ramp() {
            found.crashes[ramp] += 1;
        }
    }
    found
}

/// Slows down until the merge's end while the merging car is beside or ahead and has not settled.
fn slow_down(from: f64, traffic: &Traffic) -> Option<ReactionStep> {
    let x = traffic.vehicles[EGO].position[0];
    let mut ramps = traffic.road.ramps.iter();
    let at_merge = ramps.any(|ramp| ramp.merge_x - from < x && x < ramp.end_x);
    let mut cars = traffic.vehicles.iter().filter(|car| car.role == CarRole::Merging);
    let slows = at_merge && cars.any(|car| car.position[0] > x - PASSED);
    // A reaction to a speed acts in every step, so it does not matter which is the first.
    slows.then_some(ReactionStep { topic: SLOW_DOWN, first: false })
}
