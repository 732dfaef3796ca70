//! Small statistics: moments, percentiles, and seeded bootstrap intervals.
//!
//! An evaluation is a few hundred numbers of unknown shape (often zeros and ones), so intervals come from the
//! percentile bootstrap and not from a normal approximation. Every interval is a function of its data and of
//! (seed, index): the same evaluation gives the same digits on every machine.
//!
//! Results over several training seeds are resampled in two stages ([`Bootstrap::hierarchical_mean`]): seeds
//! first, then episodes within a seed, because episodes of one policy are not independent evidence about the
//! training. A few trainings say little about the rare one that fails, and then these intervals are too narrow
//! (`examples/coverage.rs` says by how much); [`Bootstrap::cautious_mean`] is the interval that is not.
//!
//! # Source
//!
//! Efron and Tibshirani, *An Introduction to the Bootstrap*, 1993, chapter 13; draw for draw the algorithm of
//! `scipy.stats.bootstrap(method="percentile")`.

use serde::{Deserialize, Serialize};

use crate::{Pcg64, Purpose, stream};

/// Computes the arithmetic mean; NaN without data.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Computes the sample standard deviation (divisor n - 1); NaN for fewer than two values.
pub fn standard_deviation(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return f64::NAN;
    }
    let center = mean(values);
    let squares: f64 = values.iter().map(|x| (x - center) * (x - center)).sum();
    (squares / (values.len() - 1) as f64).sqrt()
}

/// Computes the standard error of the mean; NaN for fewer than two values.
pub fn standard_error(values: &[f64]) -> f64 {
    standard_deviation(values) / (values.len() as f64).sqrt()
}

/// Computes the interquartile mean: the mean without the lowest and the highest quarter, each rounded down to whole
/// values; NaN without data.
///
/// One training that failed among ten does not move it, nor does one that was lucky.
///
/// # Source
///
/// Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical Precipice*, 2021 (arXiv:2108.13264), as
/// their library rliable computes it: `scipy.stats.trim_mean(values, 0.25)`.
pub fn interquartile_mean(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let n_cut = sorted.len() / 4;
    mean(&sorted[n_cut..sorted.len() - n_cut])
}

/// Computes a percentile by linear interpolation between order statistics, as `numpy.percentile`.
///
/// # Units
///
/// `percent`: 0 to 100. `sorted` is in ascending order.
///
/// # Panics
///
/// If `sorted` is empty or `percent` is outside its range.
pub fn percentile(sorted: &[f64], percent: f64) -> f64 {
    assert!(!sorted.is_empty(), "a percentile of nothing");
    assert!((0.0..=100.0).contains(&percent), "percent {percent} outside 0..=100");
    let place = percent / 100.0 * (sorted.len() - 1) as f64;
    let below = place.floor();
    let (low, high) = (sorted[below as usize], sorted[place.ceil() as usize]);
    low + (high - low) * (place - below)
}

/// An estimate between two bounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The statistic of the data itself.
    pub estimate: f64,
    /// Lower bound, at most the estimate or close to it.
    pub low: f64,
    /// Upper bound, at least the estimate or close to it.
    pub high: f64,
}

impl Interval {
    /// Returns whether a value lies within the bounds.
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// Makes the interval of the difference to another, independent estimate: the distances to the bounds are squared
    /// and added.
    ///
    /// # Source
    ///
    /// Newcombe, *Interval estimation for the difference between independent proportions*, Statistics in Medicine 17,
    /// 1998, method 10, with any two intervals (Zou and Donner 2008).
    pub fn minus(&self, other: &Self) -> Self {
        let estimate = self.estimate - other.estimate;
        let below = libm::hypot(self.estimate - self.low, other.high - other.estimate);
        let above = libm::hypot(self.high - self.estimate, other.estimate - other.low);
        Self { estimate, low: estimate - below, high: estimate + above }
    }
}

/// How intervals are made: by resampling with a seed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bootstrap {
    /// Seed of the resampling.
    pub seed: u64,
    /// Number of resamples; more gives steadier bounds.
    pub n_resamples: usize,
    /// Coverage of the interval, between 0 and 1.
    pub confidence: f64,
}

impl Bootstrap {
    /// Plans 95 % intervals from 9,999 resamples.
    pub fn new(seed: u64) -> Self {
        Self { seed, n_resamples: 9_999, confidence: 0.95 }
    }

    /// Computes the interval of a mean; `None` without data.
    ///
    /// `index` names the statistic: two statistics of one report should not share their draws.
    ///
    /// # Example
    ///
    /// ```
    /// use leadtime_numerics::stats::Bootstrap;
    ///
    /// let landed = [1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0];
    /// let interval = Bootstrap::new(1).mean(&landed, 0).expect("there is data");
    /// assert_eq!(interval.estimate, 0.75);
    /// assert!(interval.low < 0.75 && interval.high <= 1.0);
    /// ```
    pub fn mean(&self, values: &[f64], index: u64) -> Option<Interval> {
        (!values.is_empty()).then(|| {
            let draws = self.resample(&mut self.open(index), |rng| resampled_mean(values, rng));
            self.interval(mean(values), draws)
        })
    }

    /// Computes the interval of `mean(a) - mean(b)` of two independent samples; `None` if one is empty.
    pub fn difference(&self, a: &[f64], b: &[f64], index: u64) -> Option<Interval> {
        (!a.is_empty() && !b.is_empty()).then(|| {
            let draws = [a, b].map(|values| move |rng: &mut Pcg64| resampled_mean(values, rng));
            self.difference_of(mean(a) - mean(b), draws, index)
        })
    }

    /// Computes the interval of the mean of group means (training seeds x episodes): groups are resampled
    /// first, then the members of every drawn group. Groups without members are left out; `None` if none is left.
    pub fn hierarchical_mean(&self, groups: &[&[f64]], index: u64) -> Option<Interval> {
        let groups = &filled(groups);
        (!groups.is_empty()).then(|| {
            let draw = |rng: &mut Pcg64| resampled_group_mean(groups, rng);
            self.interval(mean_of_means(groups), self.resample(&mut self.open(index), draw))
        })
    }

    /// Computes the interval of the difference of two hierarchical means; `None` if one has no data.
    pub fn hierarchical_difference(
        &self,
        a: &[&[f64]],
        b: &[&[f64]],
        index: u64,
    ) -> Option<Interval> {
        let (a, b) = (&filled(a), &filled(b));
        (!a.is_empty() && !b.is_empty()).then(|| {
            let draws =
                [a, b].map(|groups| move |rng: &mut Pcg64| resampled_group_mean(groups, rng));
            self.difference_of(mean_of_means(a) - mean_of_means(b), draws, index)
        })
    }

    /// Computes an interval of a mean that is meant to hold for every distribution on 0..=1, also if it has a rare value
    /// that `values` do not show; `None` without data.
    ///
    /// Each bound supposes one more value, the worst possible, and weighs all of them at random. Of zeros and ones it is
    /// the exact interval. That it holds for all distributions is a conjecture: nobody has proved it. For means of a few
    /// trainings it is several times as wide as the bootstrap's.
    ///
    /// # Units
    ///
    /// `values`: 0 to 1.
    ///
    /// # Source
    ///
    /// Gaffke, *Three test statistics for a nonparametric one-sided hypothesis on the mean of a nonnegative variable*,
    /// Mathematical Methods of Statistics 14, 2005; Learned-Miller and Thomas, arXiv:1905.06208, who found no distribution
    /// for which it fails.
    pub fn cautious_mean(&self, values: &[f64], index: u64) -> Option<Interval> {
        (!values.is_empty()).then(|| {
            let draw = |rng: &mut Pcg64| {
                let worst = exponential(rng);
                let (mut sum, mut weight) = (0.0, worst);
                for value in values {
                    let drawn = exponential(rng);
                    sum += drawn * value;
                    weight += drawn;
                }
                [sum / weight, (sum + worst) / weight]
            };
            let mut rng = self.open(index);
            let draws: Vec<[f64; 2]> =
                (0..self.n_resamples.max(1)).map(|_| draw(&mut rng)).collect();
            let side =
                |i: usize| self.interval(mean(values), draws.iter().map(|draw| draw[i]).collect());
            Interval { high: side(1).high, ..side(0) }
        })
    }

    /// Draws all of the first statistic, then all of the second.
    fn difference_of(
        &self,
        estimate: f64,
        statistics: [impl FnMut(&mut Pcg64) -> f64; 2],
        index: u64,
    ) -> Interval {
        let mut rng = self.open(index);
        let [first, second] = statistics.map(|statistic| self.resample(&mut rng, statistic));
        self.interval(estimate, first.iter().zip(&second).map(|(x, y)| x - y).collect())
    }

    fn open(&self, index: u64) -> Pcg64 {
        stream(self.seed, Purpose::Bootstrap, 0, index)
    }

    fn resample(&self, rng: &mut Pcg64, mut statistic: impl FnMut(&mut Pcg64) -> f64) -> Vec<f64> {
        (0..self.n_resamples.max(1)).map(|_| statistic(rng)).collect()
    }

    fn interval(&self, estimate: f64, mut resampled: Vec<f64>) -> Interval {
        resampled.sort_unstable_by(f64::total_cmp);
        let tail = 100.0 * (1.0 - self.confidence.clamp(0.0, 1.0)) / 2.0;
        let low = percentile(&resampled, tail);
        let high = percentile(&resampled, 100.0 - tail);
        Interval { estimate, low, high }
    }
}

/// Draws from the exponential distribution of mean 1.
fn exponential(rng: &mut Pcg64) -> f64 {
    -libm::log1p(-rng.unit())
}

fn filled<'a>(groups: &[&'a [f64]]) -> Vec<&'a [f64]> {
    groups.iter().copied().filter(|group| !group.is_empty()).collect()
}

fn mean_of_means(groups: &[&[f64]]) -> f64 {
    groups.iter().map(|group| mean(group)).sum::<f64>() / groups.len() as f64
}

fn resampled_mean(values: &[f64], rng: &mut Pcg64) -> f64 {
    let sum: f64 = (0..values.len()).map(|_| values[rng.below(values.len())]).sum();
    sum / values.len() as f64
}

fn resampled_group_mean(groups: &[&[f64]], rng: &mut Pcg64) -> f64 {
    let draws = (0..groups.len()).map(|_| {
        let group = groups[rng.below(groups.len())];
        resampled_mean(group, rng)
    });
    draws.sum::<f64>() / groups.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    // Golden numbers: NumPy 2.4.6 and SciPy 1.17, made by crates/numerics/golden/golden_stats.py. The resamples are the
    // same draw for draw; sums are taken in another order, hence the tolerance.
    const TOLERANCE: f64 = 1e-12;
    const A: [f64; 12] = [0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.5];
    const B: [f64; 7] = [-3.25, 10.5, 0.125, 7.0, 2.0, -1.5, 4.75];
    const GROUPS: [&[f64]; 3] = [&[1.0, 2.0, 4.0], &[0.0, 0.5], &[3.0, 3.5, 5.0, 2.5]];
    const MEAN_SD_SEM_OF_B: [f64; 3] =
        [2.803_571_428_571_428_4, 4.892_520_408_989_721, 1.849_198_898_070_688_8];
    const PERCENTILES_OF_B: [f64; 6] = [-3.25, -2.9875, 0.092_499_999_999_999_97, 2.0, 9.975, 10.5];
    const INTERQUARTILE_MEANS: [f64; 4] =
        [0.916_666_666_666_666_6, 2.475, 2.458_333_333_333_333_5, 3.562_5];
    const MEAN_INTERVAL_OF_A: [f64; 2] = [0.458_333_333_333_333_3, 0.916_666_666_666_666_6];
    const MEAN_INTERVAL_OF_B: [f64; 2] = [-0.573_214_285_714_284_8, 6.252_678_571_428_569];
    const DIFFERENCE_INTERVAL: [f64; 2] = [-1.387_202_380_952_380_8, 5.342_261_904_761_901_5];
    const HIERARCHICAL_INTERVAL: [f64; 2] = [0.25, 3.585_416_666_666_665];

    const BOOTSTRAP: Bootstrap = Bootstrap { seed: 11, n_resamples: 999, confidence: 0.95 };

    fn assert_close(got: &[f64], expected: &[f64]) {
        assert_eq!(got.len(), expected.len());
        for (i, (g, e)) in got.iter().zip(expected).enumerate() {
            assert!((g - e).abs() < TOLERANCE, "[{i}]: {g} instead of {e}");
        }
    }

    fn assert_bounds(interval: Option<Interval>, expected: [f64; 2]) {
        let interval = interval.unwrap();
        assert_close(&[interval.low, interval.high], &expected);
    }

    /// Ones with probability 0.7.
    fn coin_flips(n: usize, seed: u64) -> Vec<f64> {
        let mut rng = Pcg64::seed_from_u64(seed);
        (0..n).map(|_| f64::from(u8::from(rng.unit() < 0.7))).collect()
    }

    #[test]
    fn moments_and_percentiles_equal_numpys() {
        assert_close(&[mean(&B), standard_deviation(&B), standard_error(&B)], &MEAN_SD_SEM_OF_B);
        let mut sorted = B;
        sorted.sort_unstable_by(f64::total_cmp);
        let got = [0.0, 2.5, 33.0, 50.0, 97.5, 100.0].map(|p| percentile(&sorted, p));
        assert_close(&got, &PERCENTILES_OF_B);
    }

    #[test]
    fn interquartile_means_equal_scipys_trimmed_means() {
        assert_close(&[&A[..], &B, &B[..3], &B[..4]].map(interquartile_mean), &INTERQUARTILE_MEANS);
        assert!(interquartile_mean(&[]).is_nan());
    }

    #[test]
    fn a_difference_of_intervals_adds_their_squared_distances() {
        let a = Interval { estimate: 0.9, low: 0.6, high: 1.0 };
        let b = Interval { estimate: 0.2, low: 0.1, high: 0.6 };
        let Interval { estimate, low, high } = a.minus(&b);
        assert_close(&[estimate, low, high], &[0.7, 0.7 - 0.5, 0.7 + 0.02_f64.sqrt()]);
    }

    #[test]
    fn a_cautious_interval_of_zeros_and_ones_is_the_exact_one() {
        let bootstrap = Bootstrap::new(4);
        for (n_ones, n) in [(3, 3), (18, 20), (0, 10)] {
            let values: Vec<f64> = (0..n).map(|i| f64::from(u8::from(i < n_ones))).collect();
            let interval = bootstrap.cautious_mean(&values, 0).unwrap();
            let exact = crate::proportion::clopper_pearson(n_ones, n, 0.95).unwrap();
            let off = (interval.low - exact.low).abs().max((interval.high - exact.high).abs());
            assert!(interval.estimate == exact.estimate && off < 0.02, "{interval:?} {exact:?}");
        }
    }

    #[test]
    fn intervals_equal_scipys_draw_for_draw() {
        assert_bounds(BOOTSTRAP.mean(&A, 0), MEAN_INTERVAL_OF_A);
        assert_bounds(BOOTSTRAP.mean(&B, 1), MEAN_INTERVAL_OF_B);
        assert_bounds(BOOTSTRAP.difference(&B, &A, 2), DIFFERENCE_INTERVAL);
        assert_bounds(BOOTSTRAP.hierarchical_mean(&GROUPS, 3), HIERARCHICAL_INTERVAL);
    }

    #[test]
    fn a_hierarchical_difference_to_nothing_but_zeros_is_the_hierarchical_mean() {
        let zeros: [&[f64]; 1] = [&[0.0, 0.0]];
        let difference = BOOTSTRAP.hierarchical_difference(&GROUPS, &zeros, 3).unwrap();
        assert_eq!(difference, BOOTSTRAP.hierarchical_mean(&GROUPS, 3).unwrap());
    }

    #[test]
    fn an_interval_contains_its_estimate_and_repeats() {
        for seed in 0..5 {
            let flips = coin_flips(50, seed);
            let interval = BOOTSTRAP.mean(&flips, seed).unwrap();
            assert!(interval.contains(mean(&flips)), "{interval:?}");
            assert_eq!(Some(interval), BOOTSTRAP.mean(&flips, seed));
        }
        assert_ne!(BOOTSTRAP.mean(&B, 0), Bootstrap { seed: 12, ..BOOTSTRAP }.mean(&B, 0));
        assert_ne!(BOOTSTRAP.mean(&B, 0), BOOTSTRAP.mean(&B, 1));
    }

    #[test]
    fn more_data_gives_a_narrower_interval() {
        let intervals = [20, 200, 2000].map(|n| BOOTSTRAP.mean(&coin_flips(n, 1), 0).unwrap());
        let widths = intervals.map(|interval| interval.high - interval.low);
        assert!(widths[0] > 2.0 * widths[1] && widths[1] > 2.0 * widths[2], "{widths:?}");
    }

    #[test]
    fn without_data_there_is_no_interval() {
        assert_eq!(BOOTSTRAP.mean(&[], 0), None);
        assert_eq!(BOOTSTRAP.cautious_mean(&[], 0), None);
        assert_eq!(BOOTSTRAP.difference(&A, &[], 0), None);
        assert_eq!(BOOTSTRAP.hierarchical_mean(&[&[]], 0), None);
        assert_eq!(BOOTSTRAP.hierarchical_difference(&GROUPS, &[&[]], 0), None);
    }

    #[test]
    fn a_group_without_members_is_left_out() {
        let padded: [&[f64]; 4] = [GROUPS[0], GROUPS[1], &[], GROUPS[2]];
        let unpadded = BOOTSTRAP.hierarchical_mean(&GROUPS, 3);
        assert_eq!(BOOTSTRAP.hierarchical_mean(&padded, 3), unpadded);
    }
}
