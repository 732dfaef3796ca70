//! How dangerous is the road? Drives over many seeds, unaided or with a reaction forced near each merge.

use leadtime_proto::EnvId;

use super::domain::Driving;
use super::reaction::{EGO, SLOW_DOWN};
use super::world_settings::WorldSettings;
use crate::environment::EpisodeSeed;
use crate::highway::{Role, Traffic};
use crate::setting::SettingError;
use crate::{Domain as _, ReactionStep};

/// A merging car this far behind the ego no longer matters, in metres.
const PASSED: f64 = 20.0;

/// What the person does beside driving by their own plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Plan {
    /// Nothing.
    Unaided,
    /// They slow down from `from` metres before each merge until its end, while the merging car is beside or ahead
    /// of them and has not settled; without any delay.
    SlowDown {
        /// In metres before the merge.
        from: f64,
    },
}

/// How episodes ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Safety {
    /// How many there were.
    pub n_episodes: u32,
    /// How many ended in a crash of the ego.
    pub n_crashed: u32,
    /// How many reached the goal.
    pub n_arrived: u32,
    /// Crashes by merge; those before the first are counted in no place.
    pub crashes: Vec<u32>,
    /// Mean number of steps.
    pub mean_steps: f64,
}

impl Safety {
    /// Returns the share of crashes.
    pub fn crash_rate(&self) -> f64 {
        f64::from(self.n_crashed) / f64::from(self.n_episodes.max(1))
    }

    /// Returns the 95 % score interval (Wilson) of the share of crashes.
    pub fn interval(&self) -> [f64; 2] {
        const Z: f64 = 1.959_963_984_540_054;
        let (n, rate) = (f64::from(self.n_episodes.max(1)), self.crash_rate());
        let middle = (rate + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
        let spread = rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n);
        let half = Z * libm::sqrt(spread) / (1.0 + Z * Z / n);
        [middle - half, middle + half]
    }
}

/// Drives one episode per seed. Arriving ends an episode, whatever the settings say.
///
/// # Errors
///
/// [`SettingError`] if the settings are impossible.
pub fn measure(
    settings: &WorldSettings,
    plan: Plan,
    seeds: std::ops::Range<u64>,
) -> Result<Safety, SettingError> {
    let mut task = Driving::new(&WorldSettings { absorb_until: 0, ..settings.clone() })?;
    let crashes = vec![0; task.traffic().road().ramps.len()];
    let mut found = Safety { crashes, ..Safety::default() };
    let mut n_steps: u64 = 0;
    for episode in seeds {
        task.reset(EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode });
        loop {
            n_steps += 1;
            if task.advance(plan.reaction(task.traffic())).end.is_some() {
                break;
            }
        }
        found.n_episodes += 1;
        found.n_arrived += u32::from(task.has_arrived());
        if task.traffic().vehicles()[EGO].crashed {
            found.n_crashed += 1;
            if let Some(ramp) = task.crash_ramp() {
                found.crashes[ramp] += 1;
            }
        }
    }
    found.mean_steps = n_steps as f64 / f64::from(found.n_episodes.max(1));
    Ok(found)
}

impl Plan {
    fn reaction(self, traffic: &Traffic) -> Option<ReactionStep> {
        let Self::SlowDown { from } = self else { return None };
        let x = traffic.vehicles()[EGO].position[0];
        let near = |car: &crate::highway::Vehicle| {
            car.role == Role::Merging && car.position[0] > x - PASSED
        };
        let mut ramps = traffic.road().ramps.iter();
        let at_merge = ramps.any(|ramp| ramp.merge_x - from < x && x < ramp.end_x);
        let slows = at_merge && traffic.vehicles().iter().any(near);
        // A reaction to a speed acts in every step, so it does not matter which is the first.
        slows.then_some(ReactionStep { topic: SLOW_DOWN, first: false })
    }
}
