//! What scripted notifiers come to, over seeded episodes: the rows that a trained one has to beat.

use std::ops::Range;

use leadtime_proto::EnvId;
use serde::Serialize;

use super::domain::Cooking;
use super::settings::{CookingSettings, WorldSettings};
use crate::human::Order;
use crate::registry::TaskError;
use crate::steakhouse::StartFamily;
use crate::{Domain as _, Environment as _, EpisodeSeed, NotifierEnv};

/// Who speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Speaker {
    /// Nobody.
    Silent,
    /// Nobody, and the cook knows what the stations hold from the start: the upper reference.
    Unneeded,
    /// Somebody who informs at the start, in as few words as disclose.
    InformAtStart,
    /// The domain's scripted notifier.
    Heuristic,
}

impl Speaker {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Silent, Self::Unneeded, Self::InformAtStart, Self::Heuristic];

    fn world(self, world: &WorldSettings) -> WorldSettings {
        WorldSettings { aware: world.aware || self == Self::Unneeded, ..world.clone() }
    }

    fn order(self, env: &NotifierEnv<Cooking>) -> Order {
        let message = match self {
            Self::InformAtStart if env.domain().kitchen().n_steps() == 0 => env.domain().briefing(),
            Self::Heuristic if env.human().may_start() => env.domain().heuristic(),
            Self::Silent | Self::Unneeded | Self::InformAtStart | Self::Heuristic => None,
        };
        message.map_or(Order::Continue, Order::Start)
    }
}

/// Means over episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Averages {
    /// Number of episodes.
    pub n_episodes: u64,
    /// Share delivered in time.
    pub success: f64,
    /// Share delivered at all.
    pub delivered: f64,
    /// Steps to delivery; the longest episode where there was none.
    pub steps: f64,
    /// Those beyond the steps of a cook who knows everything.
    pub excess_steps: f64,
    /// Steps of work in vain.
    pub redundant_steps: f64,
    /// Things fetched in vain.
    pub pointless_pickups: f64,
    /// Messages.
    pub notifications: f64,
    /// Sum of rewards.
    pub total_reward: f64,
}

/// Plays episodes with one speaker, the same starts and ties for each.
///
/// # Errors
///
/// [`TaskError`] if a setting is impossible.
///
/// # Example
///
/// ```
/// use leadtime_sims::cooking::{CookingSettings, Speaker, play};
///
/// let settings = CookingSettings::default();
/// let silent = play(&settings, Speaker::Silent, 0..20)?;
/// let informed = play(&settings, Speaker::InformAtStart, 0..20)?;
/// assert!(informed.success > silent.success);
/// # Ok::<(), leadtime_sims::TaskError>(())
/// ```
pub fn play(
    settings: &CookingSettings,
    speaker: Speaker,
    episodes: Range<u64>,
) -> Result<Averages, TaskError> {
    let world = speaker.world(&settings.world);
    let mut env = NotifierEnv::new(Cooking::new(&world)?, &settings.human, &settings.notifier)?;
    let mut observation = vec![0.0; env.spec().obs_dim];
    let mut metrics = vec![0.0; env.spec().metrics.len()];
    let names = env.spec().metrics.clone();
    let mut sums = Averages::default();
    for episode in episodes {
        env.reset(EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode }, &mut observation);
        loop {
            let order = speaker.order(&env);
            let (outcome, _) = env.step_order(order, &mut observation);
            sums.total_reward += f64::from(outcome.reward);
            if outcome.end.is_some() {
                break;
            }
        }
        env.metrics(&mut metrics);
        sums.add(&names, &metrics);
    }
    Ok(sums.over_episodes())
}

impl Averages {
    fn add(&mut self, names: &[String], metrics: &[f32]) {
        self.n_episodes += 1;
        for (name, &value) in names.iter().zip(metrics) {
            let sum = match name.as_str() {
                "success" => &mut self.success,
                "dish_delivered" => &mut self.delivered,
                "steps_to_deliver" => &mut self.steps,
                "excess_steps" => &mut self.excess_steps,
                "redundant_steps" => &mut self.redundant_steps,
                "pointless_pickups" => &mut self.pointless_pickups,
                "notifications" => &mut self.notifications,
                _ => continue,
            };
            *sum += f64::from(value);
        }
    }

    fn over_episodes(self) -> Self {
        let n = self.n_episodes.max(1) as f64;
        Self {
            n_episodes: self.n_episodes,
            success: self.success / n,
            delivered: self.delivered / n,
            steps: self.steps / n,
            excess_steps: self.excess_steps / n,
            redundant_steps: self.redundant_steps / n,
            pointless_pickups: self.pointless_pickups / n,
            notifications: self.notifications / n,
            total_reward: self.total_reward / n,
        }
    }
}

/// Plays episodes of some start families with every speaker.
///
/// # Errors
///
/// [`TaskError`] if a setting is impossible, or a family not to be had in the kitchen.
pub fn compare(
    settings: &CookingSettings,
    families: &[StartFamily],
    episodes: Range<u64>,
) -> Result<Vec<(StartFamily, Speaker, Averages)>, TaskError> {
    let mut rows = Vec::with_capacity(families.len() * Speaker::ALL.len());
    for &family in families {
        let mut settings = settings.clone();
        settings.world.start_families = vec![family];
        for speaker in Speaker::ALL {
            rows.push((family, speaker, play(&settings, speaker, episodes.clone())?));
        }
    }
    Ok(rows)
}
