//! How long things take: counts in bins of one per cent, so that a quantile costs no memory and little time.

/// The time at which the first bin begins, in microseconds; shorter ones count there.
const SHORTEST: f64 = 1.0;
/// How much longer each bin's times are than those of the bin before.
const STEP: f64 = 1.01;
/// From a microsecond to some 40 seconds.
const N_BINS: usize = 1_760;

/// A histogram of times.
#[derive(Clone, Debug)]
pub struct LatencyHistogram {
    bins: Vec<u64>,
    n: u64,
    max_us: f64,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self { bins: vec![0; N_BINS], n: 0, max_us: 0.0 }
    }
}

impl LatencyHistogram {
    /// Counts one time, in nanoseconds.
    pub fn record(&mut self, nanoseconds: u64) {
        let us = nanoseconds as f64 * 1e-3;
        let bin = (us.max(SHORTEST) / SHORTEST).ln() / STEP.ln();
        self.bins[(bin as usize).min(N_BINS - 1)] += 1;
        self.n += 1;
        self.max_us = self.max_us.max(us);
    }

    /// Returns how many were counted.
    pub fn n(&self) -> u64 {
        self.n
    }

    /// Returns the longest, in microseconds.
    pub fn max_us(&self) -> f64 {
        self.max_us
    }

    /// Returns the time that a share of all did not exceed, in microseconds, within one per cent; 0 without any.
    pub fn quantile_us(&self, share: f64) -> f64 {
        let wanted = (share * self.n as f64).ceil() as u64;
        let mut below = 0;
        for (bin, n) in self.bins.iter().enumerate() {
            below += n;
            if *n > 0 && below >= wanted {
                let upper = SHORTEST * STEP.powi(bin as i32 + 1);
                return upper.min(self.max_us);
            }
        }
        0.0
    }

    /// Adds what another one has counted.
    pub fn add(&mut self, other: &Self) {
        self.bins.iter_mut().zip(&other.bins).for_each(|(bin, n)| *bin += n);
        self.n += other.n;
        self.max_us = self.max_us.max(other.max_us);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_within_one_per_cent() {
        let mut times = LatencyHistogram::default();
        assert_eq!(times.quantile_us(0.5), 0.0);
        for us in 1..=10_000_u64 {
            times.record(us * 1_000);
        }
        for (share, us) in [(0.5, 5_000.0), (0.99, 9_900.0), (1.0, 10_000.0)] {
            let found = times.quantile_us(share);
            assert!((found / us - 1.0).abs() < 0.011, "{share}: {found}");
        }
        assert_eq!((times.n(), times.max_us()), (10_000, 10_000.0));
        times.record(u64::MAX);
        assert!(times.quantile_us(1.0) > 3e7);
        let mut both = times.clone();
        both.add(&times);
        assert_eq!(both.n(), 20_002);
    }
}
