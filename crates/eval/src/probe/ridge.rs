//! Ridge regression in closed form, with a penalty that cross-validation chooses.
//!
//! Features are standardised (a constant one counts for nothing), the target is centred, and
//!
//! ```text
//! w = (Xᵀ D X + penalty · I)⁻¹ Xᵀ D y        D: the rows' weights, of sum 1
//! ```
//!
//! minimises the weighted mean squared error plus the penalty on |w|². Everything is in f64 and on one thread.
//!
//! # Source
//!
//! Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*, 2nd edition, 2009, sections 3.4.1 and 7.10.

use nalgebra::{DMatrix, DVector};

use crate::error::Error;

/// The penalties to choose from, heaviest first: from almost a constant to almost least squares.
const PENALTIES: [f64; 8] = [1e2, 1e1, 1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5];
/// Parts of the data of which each is predicted from the others.
const N_FOLDS: u64 = 5;
/// A feature that deviates less from its mean is a constant; observations are of order one.
const LEAST_DEVIATION: f64 = 1e-6;

/// One row of data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case<'a> {
    /// Rows of one group are never on both sides of a split.
    pub(super) group: u64,
    pub(super) features: &'a [f32],
    /// What is to be predicted.
    pub(super) target: f64,
    /// How much the row counts, against the others.
    pub(super) weight: f64,
}

/// A fitted ridge regression: linear in scaled features, with an intercept that is not penalised.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ridge {
    scaling: Scaling,
    weights: DVector<f64>,
    intercept: f64,
    pub(super) penalty: f64,
}

impl Ridge {
    /// Fits with the penalty that predicts best across groups, and among equals the heaviest; [`Error::NoRegression`]
    /// without data, or if a number is not finite.
    pub(super) fn cross_validated(cases: &[Case<'_>]) -> Result<Self, Error> {
        let mut losses = [0.0; PENALTIES.len()];
        for fold in 0..N_FOLDS {
            let is_out = |case: &&Case<'_>| case.group % N_FOLDS == fold;
            let (out, kept): (Vec<_>, Vec<_>) = cases.iter().partition(is_out);
            let equations = Equations::new(&kept)?;
            for (loss, penalty) in losses.iter_mut().zip(PENALTIES) {
                let ridge = equations.solve(penalty)?;
                let error = |case: &Case<'_>| ridge.predict(case.features) - case.target;
                *loss += out.iter().map(|case| case.weight * error(case).powi(2)).sum::<f64>();
            }
        }
        let better = |best, i| if losses[i] < losses[best] { i } else { best };
        Self::with_penalty(cases, PENALTIES[(1..losses.len()).fold(0, better)])
    }

    /// Fits with a given penalty; errors as [`Ridge::cross_validated`].
    pub(super) fn with_penalty(cases: &[Case<'_>], penalty: f64) -> Result<Self, Error> {
        let cases: Vec<&Case<'_>> = cases.iter().collect();
        Equations::new(&cases)?.solve(penalty)
    }

    /// Returns how many numbers it looks at.
    pub(super) fn n_features(&self) -> usize {
        self.weights.len()
    }

    /// Predicts the target from features of the width that was fitted.
    pub(super) fn predict(&self, features: &[f32]) -> f64 {
        let scaled = self.scaling.apply(features);
        self.intercept + scaled.zip(&self.weights).map(|(x, w)| x * w).sum::<f64>()
    }
}

/// Means of features, and what their deviations are multiplied by.
#[derive(Clone, Debug, PartialEq)]
struct Scaling {
    means: Vec<f64>,
    factors: Vec<f64>,
}

impl Scaling {
    fn new(cases: &[&Case<'_>], shares: &[f64]) -> Self {
        let width = cases.first().map_or(0, |case| case.features.len());
        let mut means = vec![0.0; width];
        for (case, share) in cases.iter().zip(shares) {
            means.iter_mut().zip(case.features).for_each(|(m, &x)| *m += share * f64::from(x));
        }
        let mut variances = vec![0.0; width];
        for (case, share) in cases.iter().zip(shares) {
            let deviations = case.features.iter().zip(&means).map(|(&x, m)| f64::from(x) - m);
            variances.iter_mut().zip(deviations).for_each(|(v, d)| *v += share * d * d);
        }
        let factor = |deviation| if deviation < LEAST_DEVIATION { 0.0 } else { 1.0 / deviation };
        let factors = variances.into_iter().map(|variance| factor(variance.sqrt())).collect();
        Self { means, factors }
    }

    fn apply<'a>(&'a self, features: &'a [f32]) -> impl Iterator<Item = f64> + 'a {
        let deviations = features.iter().zip(&self.means).map(|(&x, mean)| f64::from(x) - mean);
        deviations.zip(&self.factors).map(|(deviation, factor)| deviation * factor)
    }
}

/// The normal equations of some data, for any penalty.
struct Equations {
    scaling: Scaling,
    /// `Xᵀ D X`, D being the cases' shares of all weight.
    gram: DMatrix<f64>,
    /// `Xᵀ D y`, y being the targets without their mean.
    moments: DVector<f64>,
    intercept: f64,
}

impl Equations {
    fn new(cases: &[&Case<'_>]) -> Result<Self, Error> {
        let total: f64 = cases.iter().map(|case| case.weight).sum();
        let shares: Vec<f64> = cases.iter().map(|case| case.weight / total).collect();
        let scaling = Scaling::new(cases, &shares);
        let (n, width) = (cases.len(), scaling.means.len());
        if n == 0 || width == 0 || !scaling.factors.iter().all(|factor| factor.is_finite()) {
            return Err(Error::NoRegression { n_rows: n, n_features: width });
        }
        let intercept: f64 = cases.iter().zip(&shares).map(|(case, d)| d * case.target).sum();
        // Half of each weight goes to either factor of a product.
        let rows = cases.iter().zip(&shares).flat_map(|(case, share)| {
            scaling.apply(case.features).map(|value| share.sqrt() * value)
        });
        let x = DMatrix::from_row_iterator(n, width, rows);
        let target = |(case, d): (&&Case<'_>, &f64)| d.sqrt() * (case.target - intercept);
        let y = DVector::from_iterator(n, cases.iter().zip(&shares).map(target));
        let (gram, moments) = (x.tr_mul(&x), x.tr_mul(&y));
        Ok(Self { scaling, gram, moments, intercept })
    }

    fn solve(&self, penalty: f64) -> Result<Ridge, Error> {
        let width = self.moments.len();
        let mut matrix = self.gram.clone();
        for i in 0..width {
            matrix[(i, i)] += penalty;
        }
        // A sum of squares and a positive diagonal: positive definite, whatever the data.
        let refusal = Error::NoRegression { n_rows: 0, n_features: width };
        let solver = matrix.cholesky().ok_or(refusal)?;
        let (scaling, weights) = (self.scaling.clone(), solver.solve(&self.moments));
        Ok(Ridge { scaling, weights, intercept: self.intercept, penalty })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use leadtime_numerics::Pcg64;

    fn cases<'a>(rows: &'a [Vec<f32>], target: impl Fn(&[f32]) -> f64) -> Vec<Case<'a>> {
        let case = |(group, features): (u64, &'a Vec<f32>)| Case {
            group,
            features,
            target: target(features),
            weight: 1.0,
        };
        (0..).zip(rows).map(case).collect()
    }

    fn noise(n: usize, width: usize, seed: u64) -> Vec<Vec<f32>> {
        let mut rng = Pcg64::seed_from_u64(seed);
        (0..n).map(|_| (0..width).map(|_| rng.normal() as f32).collect()).collect()
    }

    #[test]
    fn a_system_that_can_be_solved_by_hand_is_solved() {
        // One feature with mean 2 and deviation 1, a target with mean 5: cov(x, y) is 3, so w = 3 / (1 + penalty).
        let rows = [vec![1.0_f32], vec![3.0], vec![1.0], vec![3.0]];
        let cases = cases(&rows, |x| 3.0 * f64::from(x[0]) - 1.0);
        let free = Ridge::with_penalty(&cases, 0.0).unwrap();
        assert!((free.predict(&[3.0]) - 8.0).abs() < 1e-12);
        let half = Ridge::with_penalty(&cases, 1.0).unwrap();
        assert!((half.predict(&[3.0]) - 6.5).abs() < 1e-12);
        assert!((half.predict(&[2.0]) - 5.0).abs() < 1e-12);
    }

    #[test]
    fn several_features_of_any_size_are_weighed_right() {
        let mut rows = noise(50, 3, 1);
        for row in &mut rows {
            row[2] = 1000.0 * row[2] + 7.0;
        }
        let target = |x: &[f32]| f64::from(x[0]) - 2.0 * f64::from(x[1]) + 0.01 * f64::from(x[2]);
        let ridge = Ridge::with_penalty(&cases(&rows, target), 0.0).unwrap();
        for row in noise(5, 3, 2) {
            assert!((ridge.predict(&row) - target(&row)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_weight_counts_as_often_as_it_says() {
        let rows = noise(6, 2, 7);
        let thrice = [&rows[..], &rows[..1], &rows[..1]].concat();
        let target = |x: &[f32]| f64::from(x[0] * x[1]);
        let mut weighted = cases(&rows, target);
        weighted[0].weight = 3.0;
        let [weighted, repeated] = [weighted, cases(&thrice, target)]
            .map(|cases| Ridge::with_penalty(&cases, 0.1).unwrap());
        assert!((weighted.predict(&[1.0, 2.0]) - repeated.predict(&[1.0, 2.0])).abs() < 1e-9);
    }

    #[test]
    fn the_penalty_fits_the_data() {
        let rows = noise(200, 40, 1);
        let exact = Ridge::cross_validated(&cases(&rows, |x| f64::from(x[7]))).unwrap();
        assert_eq!(exact.penalty, 1e-5);
        let mut rng = Pcg64::seed_from_u64(9);
        let mut cases = cases(&rows, |_| 0.0);
        for case in &mut cases {
            case.target = rng.normal();
        }
        let nothing = Ridge::cross_validated(&cases).unwrap();
        assert!(nothing.penalty >= 10.0, "{}", nothing.penalty);
        let spread = noise(50, 40, 3).iter().map(|x| nothing.predict(x).abs()).fold(0.0, f64::max);
        assert!(spread < 0.3, "{spread}");
    }

    #[test]
    fn groups_are_not_split() {
        // Features name one of 20 people and nothing else: what is learned of one is of no use for another.
        let people = noise(20, 30, 4);
        let targets: Vec<f64> = noise(20, 1, 5).iter().map(|row| f64::from(row[0])).collect();
        let penalty = |group: fn(usize) -> usize| {
            let case = |i: usize| {
                let (group, features) = (group(i) as u64, &people[i % 20][..]);
                Case { group, features, target: targets[i % 20], weight: 1.0 }
            };
            Ridge::cross_validated(&(0..100).map(case).collect::<Vec<_>>()).unwrap().penalty
        };
        let (apart, split) = (penalty(|i| i % 20), penalty(|i| i / 20));
        assert!(apart >= 1.0 && split <= 1e-4, "{apart}, {split}");
    }

    #[test]
    fn constant_features_count_for_nothing_and_bad_ones_are_refused() {
        let rows: Vec<Vec<f32>> = noise(30, 1, 1).iter().map(|row| vec![0.3, row[0]]).collect();
        let ridge = Ridge::with_penalty(&cases(&rows, |x| f64::from(x[1])), 1e-9).unwrap();
        assert!((ridge.predict(&[55.0, 0.5]) - 0.5).abs() < 1e-6);
        let bad = [vec![f32::NAN], vec![1.0]];
        let error = Ridge::with_penalty(&cases(&bad, |_| 1.0), 1.0).unwrap_err();
        assert!(matches!(error, Error::NoRegression { n_rows: 2, n_features: 1 }));
        assert!(Ridge::cross_validated(&[]).is_err());
    }
}
