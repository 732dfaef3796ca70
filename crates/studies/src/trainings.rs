//! How the trainings of a row came out: how many failed, and what the others reach.
//!
//! A mean over training seeds hides whether every training is a little worse or a few have failed. So each training is
//! evaluated with the listener it trained with, and counts as failed if it stays far below the best one of its row.

use leadtime_numerics::proportion::clopper_pearson;
use leadtime_numerics::stats::{Bootstrap, Interval, interquartile_mean};
use serde::{Deserialize, Serialize};

/// Index of the draws for the mean over trainings: one that no measure of a row uses.
const MEAN: u64 = u32::MAX as u64 - 1;
/// What two shares of whole episodes may differ in by rounding alone.
const ROUNDING: f64 = 1e-9;

/// The trainings of a row, each evaluated with the listener it trained with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RowTrainings {
    /// Success of every training, in the order of the seeds.
    pub(crate) success: Vec<f64>,
    /// How far below the best one a training has failed.
    pub(crate) failed_below: f64,
    /// Number of trainings that failed.
    pub(crate) n_failed: u64,
    /// The share that failed, with its exact interval.
    pub(crate) failed: Interval,
    /// Mean success without the best and the worst quarter.
    pub(crate) interquartile_mean: f64,
    /// Mean success, with a cautious interval: no distribution of trainings is known for which it fails.
    pub(crate) mean: Interval,
}

impl RowTrainings {
    /// Sums trainings up; `None` for fewer than two, of which none can be compared with the best.
    pub(crate) fn new(success: Vec<f64>, failed_below: f64, bootstrap: &Bootstrap) -> Option<Self> {
        if success.len() < 2 {
            return None;
        }
        let best = success.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let failed = success.iter().filter(|success| best - **success > failed_below + ROUNDING);
        let n_failed = failed.count() as u64;
        Some(Self {
            failed_below,
            n_failed,
            failed: clopper_pearson(n_failed, success.len() as u64, bootstrap.confidence)?,
            interquartile_mean: interquartile_mean(&success),
            mean: bootstrap.cautious_mean(&success, MEAN)?,
            success,
        })
    }

    pub(crate) fn best(&self) -> f64 {
        self.success.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trainings(success: &[f64], failed_below: f64) -> RowTrainings {
        RowTrainings::new(success.to_vec(), failed_below, &Bootstrap::new(1)).unwrap()
    }

    #[test]
    fn a_training_has_failed_if_it_stays_below_the_best_by_more_than_the_margin() {
        let success = [0.97, 0.92, 0.91, 0.98, 0.97, 0.96, 0.97, 0.97, 0.97, 0.05];
        let found = trainings(&success, 0.05);
        assert_eq!((found.n_failed, found.best()), (3, 0.98));
        assert_eq!(found.failed, clopper_pearson(3, 10, 0.95).unwrap());
        assert!((found.interquartile_mean - 0.96).abs() < 1e-9, "of the middle six");
        assert!(found.mean.estimate < 0.87 && found.mean.low < 0.7, "{:?}", found.mean);
        assert_eq!(trainings(&success, 0.06).n_failed, 2, "0.92 is no further than that");
        assert_eq!(trainings(&[0.97, 0.92], 0.05).n_failed, 0, "just as far is not further");
    }

    #[test]
    fn nothing_but_good_trainings_do_not_exclude_a_bad_one() {
        let found = trainings(&[0.97; 20], 0.05);
        assert_eq!(found.n_failed, 0);
        assert!((found.failed.high - 0.168).abs() < 1e-3 && found.mean.low < 0.85);
    }

    #[test]
    fn a_single_training_is_not_compared() {
        assert_eq!(RowTrainings::new(vec![0.9], 0.05, &Bootstrap::new(1)), None);
    }
}
