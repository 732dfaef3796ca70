//! Cutting an update's samples into shuffled minibatches.

use leadtime_numerics::{Pcg64, Purpose, stream};

/// The order in which one update visits its samples: reshuffled every epoch, every sample once per epoch.
///
/// Samples move in *units*: single steps, or whole sequences where the policy is recurrent.
#[derive(Clone, Debug)]
pub(crate) struct Minibatches {
    units: Vec<usize>,
    unit_len: usize,
    n_parts: usize,
    generator: Pcg64,
}

impl Minibatches {
    /// Prepares the order of one update; samples must fill whole units, and units all minibatches.
    pub(crate) fn new(
        n_samples: usize,
        unit_len: usize,
        n_parts: usize,
        run_seed: u64,
        update: u64,
    ) -> Self {
        assert!(n_samples.is_multiple_of(unit_len), "{n_samples} samples in units of {unit_len}");
        let n_units = n_samples / unit_len;
        assert!((1..=n_units).contains(&n_parts), "{n_parts} minibatches of {n_units}");
        let generator = stream(run_seed, Purpose::Shuffle, 0, update);
        Self { units: (0..n_units).collect(), unit_len, n_parts, generator }
    }

    /// Shuffles for the next epoch.
    pub(crate) fn shuffle(&mut self) {
        self.generator.shuffle(&mut self.units);
    }

    /// Writes the sample indices of one minibatch. Sizes differ by at most one unit.
    pub(crate) fn indices(&self, minibatch: usize, out: &mut Vec<usize>) {
        let bound = |i: usize| i * self.units.len() / self.n_parts;
        out.clear();
        for unit in &self.units[bound(minibatch)..bound(minibatch + 1)] {
            out.extend(unit * self.unit_len..(unit + 1) * self.unit_len);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn epoch(order: &mut Minibatches) -> Vec<usize> {
        order.shuffle();
        let mut all = Vec::new();
        let mut one = Vec::new();
        for minibatch in 0..order.n_parts {
            order.indices(minibatch, &mut one);
            all.extend(&one);
        }
        all
    }

    #[test]
    fn every_sample_comes_once_per_epoch_in_a_new_order() {
        let mut order = Minibatches::new(103, 1, 4, 1, 0);
        let (first, second) = (epoch(&mut order), epoch(&mut order));
        assert_ne!(first, second);
        for mut samples in [first, second] {
            samples.sort_unstable();
            assert_eq!(samples, (0..103).collect::<Vec<_>>());
        }
    }

    #[test]
    fn sequences_stay_whole() {
        let samples = epoch(&mut Minibatches::new(24, 6, 2, 1, 0));
        for sequence in samples.chunks_exact(6) {
            assert!(sequence[0] % 6 == 0 && sequence.windows(2).all(|w| w[1] == w[0] + 1));
        }
    }

    #[test]
    fn the_order_depends_on_seed_and_update_alone() {
        let order = |seed, update| epoch(&mut Minibatches::new(50, 1, 5, seed, update));
        assert_eq!(order(1, 2), order(1, 2));
        assert_ne!(order(1, 2), order(1, 3));
        assert_ne!(order(1, 2), order(2, 2));
    }
}
