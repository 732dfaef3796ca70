//! Every setting of training. `Default` is what CleanRL trains CartPole with; runs take theirs from the configuration files.
//!
//! They are checked once ([`LearnerSettings::check`]); the rest of the crate relies on it.

use leadtime_proto::{Schedule, limits};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How acting and learning interleave; see [`Schedule`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Every update waits for rollouts of its own policy: staleness 0, reproducible.
    #[default]
    Sync,
    /// Acting runs `lag` updates ahead: reproducible, and acting and learning overlap.
    Lag,
    /// The first rollouts to arrive, corrected by V-trace: elastic, not reproducible.
    Async,
}

/// What a time limit means for the return.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Truncation {
    /// The value of the true final observation stands for what would have come.
    #[default]
    Bootstrap,
    /// As a true end: nothing comes after it. For comparison with `CleanRL`, which does so.
    Cleanrl,
}

/// The settings of PPO, its normalisers and its schedule.
#[expect(clippy::struct_excessive_bools, reason = "independent switches of a configuration file")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnerSettings {
    /// Environments of the run, over all actors, 1..=65536; more make larger, smoother updates.
    pub n_envs: usize,
    /// Steps per rollout, 1..=65536; longer ones see further before they bootstrap.
    pub n_steps: usize,
    /// Environment steps of the whole run, at least 1; rounded down to whole updates, but at least one update.
    pub total_steps: u64,
    /// Adam's step size, above 0.
    pub learning_rate: f64,
    /// Whether the learning rate falls linearly over the run.
    pub anneal: bool,
    /// Discount per step, 0..=1.
    pub gamma: f64,
    /// Decay of generalised advantages, 0..=1: 1 trusts returns, 0 trusts the critic. V-trace ignores it.
    pub gae_lambda: f64,
    /// Minibatches per epoch, 1..=`n_envs * n_steps`.
    pub n_minibatches: usize,
    /// Passes over the data per update, 1..=1000.
    pub n_epochs: usize,
    /// Clip range of the probability ratio, and of the value where it is clipped; above 0.
    pub clip: f64,
    /// Whether the value's change is clipped too.
    pub value_clip: bool,
    /// Whether advantages are normalised per minibatch.
    pub normalize_advantages: bool,
    /// Weight of the entropy bonus, at least 0; more keeps the policy random for longer.
    pub entropy_coef: f64,
    /// Weight of the value loss, at least 0.
    pub value_coef: f64,
    /// Largest global gradient norm, above 0; longer gradients are shortened to it.
    pub max_grad_norm: f64,
    /// Ends the epochs of an update early once the approximate KL, a mean over an epoch's minibatches, exceeds it; `None`: never.
    pub target_kl: Option<f64>,
    /// What a time limit means for the return.
    pub truncation: Truncation,
    /// Factor on every reward, before normalisation; above 0.
    pub reward_scale: f64,
    /// Whether rewards are divided by the running deviation of the discounted return.
    pub normalize_rewards: bool,
    /// How acting and learning interleave.
    pub mode: Mode,
    /// Updates that acting runs ahead in mode `lag`, 1..=64; in the other modes it decides nothing, and may be 0.
    pub lag: u64,
    /// Oldest rollouts, in versions, that mode `async` trains on, 0..=10000.
    pub staleness_max: u64,
    /// Threads that share an update, 0..=[`MAX_THREADS`]; 0: the program chooses, and a [`Trainer`](crate::Trainer) alone takes
    /// one. They change no bit.
    pub threads: usize,
}

impl Default for LearnerSettings {
    fn default() -> Self {
        Self {
            n_envs: 4,
            n_steps: 128,
            total_steps: 500_000,
            learning_rate: 2.5e-4,
            anneal: true,
            gamma: 0.99,
            gae_lambda: 0.95,
            n_minibatches: 4,
            n_epochs: 4,
            clip: 0.2,
            value_clip: true,
            normalize_advantages: true,
            entropy_coef: 0.01,
            value_coef: 0.5,
            max_grad_norm: 0.5,
            target_kl: None,
            truncation: Truncation::Bootstrap,
            reward_scale: 1.0,
            normalize_rewards: false,
            mode: Mode::Sync,
            lag: 1,
            staleness_max: 8,
            threads: 0,
        }
    }
}

/// A setting that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`learner.{key}` must be {requirement}")]
pub struct SettingsError {
    /// The key in the section `learner`.
    pub key: &'static str,
    /// The values that the key may have.
    pub requirement: &'static str,
}

/// The most threads that share an update: more blocks than that has no minibatch in use.
pub const MAX_THREADS: usize = 64;

/// The most passes over the data of one update: with more of them a run would seem to stand still.
const MAX_EPOCHS: usize = 1_000;
const ABOVE_0: &str = "above 0 and at most 1000000";

impl LearnerSettings {
    /// Checks ranges, and that the numbers fit together.
    ///
    /// # Errors
    ///
    /// [`SettingsError`] if a number is out of its range, or does not fit another one; it names the first such key.
    pub fn check(&self) -> Result<(), SettingsError> {
        let unit = |x: f64| (0.0..=1.0).contains(&x);
        // Beyond it a single-precision loss overflows, and the run would blame its actors.
        let positive = |x: f64| x > 0.0 && x <= 1e6;
        let not_negative = |x: f64| (0.0..=1e6).contains(&x);
        let n_samples = self.n_envs.saturating_mul(self.n_steps);
        let minibatches_fit = (1..=n_samples).contains(&self.n_minibatches);
        // In the other modes it decides nothing, and old configurations may have 0 there.
        let lag_fits = self.lag <= limits::MAX_LAG && (self.lag > 0 || self.mode != Mode::Lag);
        let rules: [(bool, &'static str, &'static str); 17] = [
            ((1..=limits::MAX_ENVS).contains(&self.n_envs), "n_envs", "from 1 to 65536"),
            ((1..=limits::MAX_ROLLOUT_STEPS).contains(&self.n_steps), "n_steps", "from 1 to 65536"),
            (self.total_steps > 0, "total_steps", "at least 1"),
            (positive(self.learning_rate), "learning_rate", ABOVE_0),
            (unit(self.gamma), "gamma", "from 0 to 1"),
            (unit(self.gae_lambda), "gae_lambda", "from 0 to 1"),
            (minibatches_fit, "n_minibatches", "from 1 to n_envs * n_steps"),
            ((1..=MAX_EPOCHS).contains(&self.n_epochs), "n_epochs", "from 1 to 1000"),
            (positive(self.clip), "clip", ABOVE_0),
            (not_negative(self.entropy_coef), "entropy_coef", "from 0 to 1000000"),
            (not_negative(self.value_coef), "value_coef", "from 0 to 1000000"),
            (positive(self.max_grad_norm), "max_grad_norm", ABOVE_0),
            (self.target_kl.is_none_or(positive), "target_kl", ABOVE_0),
            (positive(self.reward_scale), "reward_scale", ABOVE_0),
            (lag_fits, "lag", "from 1 to 64"),
            (self.staleness_max <= 10_000, "staleness_max", "at most 10000"),
            (self.threads <= MAX_THREADS, "threads", "from 0 to 64"),
        ];
        match rules.into_iter().find(|(holds, _, _)| !holds) {
            None => Ok(()),
            Some((_, key, requirement)) => Err(SettingsError { key, requirement }),
        }
    }

    /// Returns the order between acting and learning that the mode means.
    pub fn schedule(&self) -> Schedule {
        match self.mode {
            Mode::Sync => Schedule::Lag(0),
            Mode::Lag => Schedule::Lag(self.lag),
            Mode::Async => Schedule::Async { staleness_max: self.staleness_max },
        }
    }

    /// Returns the number of updates of the whole run.
    pub fn n_updates(&self) -> u64 {
        (self.total_steps / (self.n_envs as u64 * self.n_steps as u64)).max(1)
    }

    /// Returns the learning rate of the update that leads to version `index + 1`: never 0.
    pub fn learning_rate_at(&self, index: u64) -> f64 {
        if !self.anneal {
            return self.learning_rate;
        }
        let n_updates = self.n_updates();
        let index = index.min(n_updates - 1);
        (1.0 - index as f64 / n_updates as f64) * self.learning_rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_learning_rate_falls_to_one_nth_and_not_to_zero() {
        let settings = LearnerSettings { total_steps: 4 * 512 + 7, ..LearnerSettings::default() };
        assert_eq!(settings.n_updates(), 4);
        let rates: Vec<f64> = (0..6).map(|i| settings.learning_rate_at(i) / 2.5e-4).collect();
        assert_eq!(rates, [1.0, 0.75, 0.5, 0.25, 0.25, 0.25]);
    }

    #[test]
    fn an_impossible_setting_is_named() {
        let good = LearnerSettings::default();
        assert_eq!(good.check(), Ok(()));
        let error = LearnerSettings { n_minibatches: 513, ..good.clone() }.check().unwrap_err();
        let says = "`learner.n_minibatches` must be from 1 to n_envs * n_steps";
        assert_eq!(error.to_string(), says);
        let error = LearnerSettings { gamma: f64::NAN, ..good.clone() }.check().unwrap_err();
        assert_eq!(error.key, "gamma");
        let error = LearnerSettings { reward_scale: 1e38, ..good }.check().unwrap_err();
        assert_eq!(error.key, "reward_scale");
    }

    #[test]
    fn a_lag_and_passes_that_no_run_could_make_are_refused_in_every_mode() {
        for mode in [Mode::Sync, Mode::Lag, Mode::Async] {
            let with = |lag, n_epochs| LearnerSettings {
                n_epochs,
                mode,
                lag,
                ..LearnerSettings::default()
            };
            assert_eq!(with(1, MAX_EPOCHS).check(), Ok(()));
            assert_eq!(with(0, 1).check().is_err(), mode == Mode::Lag);
            assert_eq!(with(limits::MAX_LAG, 1).check(), Ok(()));
            let error = with(limits::MAX_LAG + 1, 1).check().unwrap_err();
            assert_eq!(error.key, "lag");
            assert_eq!(error.requirement, format!("from 1 to {}", limits::MAX_LAG));
            let error = with(1, 4_000_000_000).check().unwrap_err();
            assert_eq!((error.key, error.requirement), ("n_epochs", "from 1 to 1000"));
        }
    }

    #[test]
    fn modes_become_schedules() {
        let with = |mode| LearnerSettings { mode, ..LearnerSettings::default() }.schedule();
        assert_eq!(with(Mode::Sync), Schedule::Lag(0));
        assert_eq!(with(Mode::Lag), Schedule::Lag(1));
        assert_eq!(with(Mode::Async), Schedule::Async { staleness_max: 8 });
    }
}
