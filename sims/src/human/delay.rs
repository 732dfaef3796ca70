//! Drawing reaction delays, in steps: once per episode or once per message, as the setting says.

use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};

use super::settings::{DelayDraw, MAX_REACTION_DELAY, ReactionDelay};

/// A listener's reaction delay in one episode: what was drawn at its start, and the stream for what is drawn later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct DelaySource {
    generator: Pcg64,
    /// The delay, in steps, as drawn for the episode; not rounded.
    of_episode: f64,
}

impl DelaySource {
    /// Draws what is drawn once per episode.
    pub(super) fn new(setting: ReactionDelay, mut generator: Pcg64) -> Self {
        let of_episode = draw(setting, &mut generator);
        Self { generator, of_episode }
    }

    /// Returns the delay, in steps, of a message comprehended at time `now`.
    pub(super) fn next(&mut self, setting: ReactionDelay, now: u32) -> u32 {
        let delay = self.standing(setting, now);
        whole(delay.unwrap_or_else(|| draw(setting, &mut self.generator)))
    }

    /// Returns the delay, in steps, that a message comprehended at time `now` would have; `None` where it is not drawn
    /// before there is one.
    pub(super) fn known(&self, setting: ReactionDelay, now: u32) -> Option<u32> {
        self.standing(setting, now).map(whole)
    }

    fn standing(&self, setting: ReactionDelay, now: u32) -> Option<f64> {
        match setting {
            ReactionDelay::Normal { drawn: DelayDraw::PerNotification, .. }
            | ReactionDelay::Uniform { drawn: DelayDraw::PerNotification, .. } => None,
            ReactionDelay::Person { drift, .. } => Some(self.of_episode + drift * f64::from(now)),
            _ => Some(self.of_episode),
        }
    }
}

fn whole(delay: f64) -> u32 {
    (libm::round(delay).max(0.0) as u32).min(MAX_REACTION_DELAY)
}

fn draw(setting: ReactionDelay, generator: &mut Pcg64) -> f64 {
    match setting {
        ReactionDelay::Fixed(steps) => f64::from(steps),
        ReactionDelay::Normal { mean, deviation, .. } => mean + deviation * generator.normal(),
        ReactionDelay::Uniform { low, high, .. } => {
            generator.integers(i64::from(low), i64::from(high) + 1) as f64
        }
        ReactionDelay::Person { mean, spread, .. } => mean + spread * generator.normal(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn delays(setting: ReactionDelay, seed: u64) -> Vec<u32> {
        let mut source = DelaySource::new(setting, Pcg64::seed_from_u64(seed));
        (0..400).map(|now| source.next(setting, now)).collect()
    }

    #[test]
    fn a_delay_drawn_per_episode_stays() {
        let drawn = DelayDraw::PerEpisode;
        let setting = ReactionDelay::Normal { mean: 2.0, deviation: 1.0, drawn };
        let episodes: Vec<_> = (0..50).map(|seed| delays(setting, seed)).collect();
        assert!(episodes.iter().flat_map(|delays| delays.windows(2)).all(|two| two[0] == two[1]));
        assert!(episodes.iter().any(|delays| delays != &episodes[0]));
    }

    #[test]
    fn a_delay_drawn_per_notification_has_its_distribution() {
        let drawn = DelayDraw::PerNotification;
        let uniform = delays(ReactionDelay::Uniform { low: 1, high: 3, drawn }, 7);
        assert_eq!((uniform.iter().min(), uniform.iter().max()), (Some(&1), Some(&3)));
        let normal = delays(ReactionDelay::Normal { mean: 4.0, deviation: 1.0, drawn }, 7);
        let mean = f64::from(normal.iter().sum::<u32>()) / 400.0;
        // Four standard errors of a unit deviation over 400 draws.
        assert!((mean - 4.0).abs() < 0.2, "{mean}");
    }

    #[test]
    fn a_delay_is_known_before_the_message_unless_every_message_draws_its_own() {
        let per_episode = ReactionDelay::Uniform { low: 0, high: 5, drawn: DelayDraw::PerEpisode };
        let tiring = ReactionDelay::Person { mean: 2.0, spread: 1.0, drift: 0.1 };
        for (setting, seed) in [(per_episode, 3), (per_episode, 4), (tiring, 3)] {
            let mut source = DelaySource::new(setting, Pcg64::seed_from_u64(seed));
            for now in 0..50 {
                let known = source.known(setting, now);
                assert_eq!(known, Some(source.next(setting, now)), "time {now}");
            }
        }
        let anew = ReactionDelay::Uniform { low: 0, high: 5, drawn: DelayDraw::PerNotification };
        assert_eq!(DelaySource::new(anew, Pcg64::seed_from_u64(3)).known(anew, 0), None);
    }

    #[test]
    fn a_person_tires() {
        let drawn = delays(ReactionDelay::Person { mean: 2.0, spread: 0.0, drift: 0.01 }, 7);
        assert_eq!([drawn[0], drawn[49], drawn[50], drawn[200], drawn[399]], [2, 2, 3, 4, 6]);
    }
}
