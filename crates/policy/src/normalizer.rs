//! Running mean and variance of observations: part of the parameters, frozen wherever the policy acts.
//!
//! Only the learner updates it, in the order of environment ids; actors get it with the weights, so that both compute
//! the same inputs from the same raw observation, bit for bit.
//!
//! What ego attention reads as presence is left as it is. A flag that is always 1 would else become 0, and an entity
//! that is always there would count as absent.
//!
//! # Source
//!
//! The update is Chan, Golub and `LeVeque`'s (1979); start count and the small constant are those of Gymnasium's
//! `NormalizeObservation`.

use leadtime_proto::{Encoder, PolicySpec};
use serde::{Deserialize, Serialize};

use crate::attention::presence_flags;

/// Normalised inputs are clipped to this range.
pub const CLIP: f32 = 10.0;
/// Added to the variance before its root.
const EPSILON: f64 = 1e-8;
/// Weight of the initial mean 0 and variance 1.
const INITIAL_COUNT: f64 = 1e-4;

/// Running moments of each component of an observation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObservationNormalizer {
    /// Mean per component. `[D]`
    pub mean: Vec<f64>,
    /// Population variance per component. `[D]`
    pub variance: Vec<f64>,
    /// How many observations are in them.
    pub count: f64,
}

/// Moments of a batch of raw observations, which depend on no other batch.
#[derive(Clone, Debug, Default)]
pub struct ObservationMoments {
    n: f64,
    /// `[D]`
    mean: Vec<f64>,
    /// Sums of squared differences from the mean. `[D]`
    squares: Vec<f64>,
}

impl ObservationMoments {
    /// Computes the moments of observations of `dim` components.
    ///
    /// # Shapes
    ///
    /// `observations`: `[N, D]`.
    pub fn of(dim: usize, observations: &[f32]) -> Self {
        let n = observations.len().checked_div(dim).unwrap_or(0) as f64;
        if n == 0.0 {
            return Self::default();
        }
        let mut mean = vec![0.0; dim];
        for row in observations.chunks_exact(dim) {
            mean.iter_mut().zip(row).for_each(|(sum, &x)| *sum += f64::from(x));
        }
        for sum in &mut mean {
            *sum /= n;
        }
        let mut squares = vec![0.0; dim];
        for row in observations.chunks_exact(dim) {
            for ((sum, &x), mean) in squares.iter_mut().zip(row).zip(&mean) {
                *sum += (f64::from(x) - mean) * (f64::from(x) - mean);
            }
        }
        Self { n, mean, squares }
    }
}

impl ObservationNormalizer {
    /// Starts with mean 0 and variance 1, which the first observations replace.
    pub fn new(dim: usize) -> Self {
        Self { mean: vec![0.0; dim], variance: vec![1.0; dim], count: INITIAL_COUNT }
    }

    /// Updates the moments with a batch of raw observations. Flags of presence keep mean 0 and variance 1; statistics
    /// that have others for them, of an older run, lose them here.
    ///
    /// # Shapes
    ///
    /// `observations`: `[N, D]`.
    pub fn update(&mut self, spec: &PolicySpec, observations: &[f32]) {
        self.merge(spec, &ObservationMoments::of(self.mean.len(), observations));
    }

    /// Updates the moments with those of a batch, as [`Self::update`] does.
    pub fn merge(&mut self, spec: &PolicySpec, batch: &ObservationMoments) {
        let ObservationMoments { n, mean, squares } = batch;
        if *n == 0.0 {
            return;
        }
        let total = self.count + n;
        for i in 0..self.mean.len() {
            let delta = mean[i] - self.mean[i];
            let square = self.variance[i] * self.count
                + squares[i]
                + delta * delta * (self.count * n / total);
            self.mean[i] += delta * (n / total);
            self.variance[i] = square / total;
        }
        self.count = total;
        if let Encoder::EgoAttention(attention) = &spec.encoder {
            for flag in presence_flags(attention) {
                (self.mean[flag], self.variance[flag]) = (0.0, 1.0);
            }
        }
    }

    /// Prepares the statistics for use.
    pub fn freeze(&self) -> FrozenNormalizer {
        FrozenNormalizer {
            mean: self.mean.iter().map(|&mean| mean as f32).collect(),
            scale: self.variance.iter().map(|v| (1.0 / (v + EPSILON).sqrt()) as f32).collect(),
        }
    }
}

/// Statistics at one moment, ready to be applied.
#[derive(Clone, Debug)]
pub struct FrozenNormalizer {
    mean: Vec<f32>,
    scale: Vec<f32>,
}

impl FrozenNormalizer {
    /// Writes `clip((x - mean) / sqrt(variance), ±10)` for each row.
    ///
    /// # Shapes
    ///
    /// Both: `[N, D]`.
    pub fn apply(&self, raw: &[f32], out: &mut [f32]) {
        let dim = self.mean.len().max(1);
        for (raw, out) in raw.chunks_exact(dim).zip(out.chunks_exact_mut(dim)) {
            let statistics = self.mean.iter().zip(&self.scale);
            for ((out, &x), (mean, scale)) in out.iter_mut().zip(raw).zip(statistics) {
                *out = ((x - mean) * scale).clamp(-CLIP, CLIP);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attention::{PresentEntities, TWO_FRAMES};
    use crate::tests::notifier;

    #[test]
    fn batches_add_up_to_the_moments_of_all() {
        let all: Vec<f32> = (0..60).map(|i| ((i * 37) % 23) as f32 * 0.5 + 3.0).collect();
        let mut normalizer = ObservationNormalizer { count: 0.0, ..ObservationNormalizer::new(2) };
        normalizer.update(&notifier(2), &all[..14]);
        normalizer.update(&notifier(2), &all[14..]);
        for component in 0..2 {
            let values: Vec<f64> =
                all.iter().skip(component).step_by(2).map(|&x| f64::from(x)).collect();
            let mean = values.iter().sum::<f64>() / 30.0;
            let variance = values.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 30.0;
            assert!((normalizer.mean[component] - mean).abs() < 1e-12);
            assert!((normalizer.variance[component] - variance).abs() < 1e-12);
        }
        assert_eq!(normalizer.count, 30.0);
    }

    /// Other implementations have the same numbers: `python/tests`.
    #[test]
    fn a_number_far_from_zero_is_normalised_in_32_bits() {
        let (mean, variance) = (vec![10_000.000_3], vec![1e-4]);
        let mut out = [0.0];
        ObservationNormalizer { mean, variance, count: 1.0 }.freeze().apply(&[10_000.01], &mut out);
        assert!((out[0] - 0.976_514).abs() < 1e-5, "{}", out[0]);
    }

    #[test]
    fn far_outliers_are_clipped() {
        let mut out = [0.0; 2];
        ObservationNormalizer::new(2).freeze().apply(&[1e6, -0.5], &mut out);
        assert_eq!(out, [10.0, -0.5]);
    }

    /// Two frames of three entities of two numbers and an action, and one number more. The ego is always there, the
    /// first of the others nine times of ten, the second never.
    fn road(n: usize) -> (PolicySpec, Vec<f32>) {
        let spec = PolicySpec { encoder: Encoder::EgoAttention(TWO_FRAMES), ..notifier(15) };
        let frame = |i: usize| {
            let there = f32::from(u8::from(i % 10 != 9));
            [1.0, i as f32, there, there * 3.0 * i as f32, 0.0, 0.0, 2.0]
        };
        let row = |i: usize| [frame(i).as_slice(), &frame(i + 5), &[i as f32]].concat();
        (spec, (0..n).flat_map(row).collect())
    }

    #[test]
    fn an_entity_that_is_always_there_stays_present() {
        let (spec, rows) = road(40);
        let Encoder::EgoAttention(attention) = &spec.encoder else { panic!("it is attention") };
        let flags: Vec<usize> = presence_flags(attention).collect();
        // Statistics of an older run, in which flags were normalised as everything else was, are mended by the first update.
        let mut older = ObservationNormalizer::new(15);
        older.update(&notifier(15), &rows);
        assert!(older.mean[0] > 0.99 && older.variance[0] < 0.01);
        for mut normalizer in [ObservationNormalizer::new(15), older] {
            for batch in rows.chunks(15 * 8) {
                normalizer.update(&spec, batch);
            }
            let mut normalized = vec![f32::NAN; rows.len()];
            normalizer.freeze().apply(&rows, &mut normalized);
            for (row, raw) in normalized.chunks_exact(15).zip(rows.chunks_exact(15)) {
                assert!(row != raw && flags.iter().all(|&i| row[i] == raw[i]), "{row:?}");
                let (mut found, mut expected) =
                    (PresentEntities::default(), PresentEntities::default());
                found.list(&row[..14], attention);
                expected.list(&raw[..14], attention);
                assert_eq!(found.frames, expected.frames);
                assert!(found.frames.iter().all(|frame| frame.ego && frame.n_others < 2));
            }
        }
    }
}
