//! Exact intervals for shares: how much lower than "200 of 200" may the truth be?
//!
//! The bootstrap resamples what was seen. From nothing but successes it makes an interval without width, which says
//! that failure is impossible. The exact interval has the smallest and the largest share under which what was seen, or
//! anything further out, is not too improbable.
//!
//! Means of other numbers between 0 and 1 may use the same bounds where all of them are 0, or all are 1: if the mean
//! is m, then a single one is 1 with probability m at most, and all n of them with m^n at most.
//!
//! # Source
//!
//! Clopper and Pearson, *The use of confidence or fiducial limits illustrated in the case of the binomial*, Biometrika
//! 26, 1934. The incomplete beta function is the continued fraction of Press et al., *Numerical Recipes*, section 6.4.

use crate::stats::Interval;

/// Halvings of the interval in which a bound lies: beyond the precision of the numbers.
const N_HALVINGS: usize = 60;
/// Terms of the continued fraction; it needs some square root of the larger parameter.
const MAX_TERMS: u32 = 10_000;
/// Relative change at which the continued fraction has converged.
const CONVERGED: f64 = 1e-15;
/// What stands for 0 in a denominator of the continued fraction.
const TINY: f64 = 1e-300;

/// Computes the exact interval of a share; `None` without trials, or with more successes than trials.
///
/// # Units
///
/// `confidence`: 0 to 1, the probability that the interval covers the true share at least.
///
/// # Example
///
/// ```
/// use leadtime_numerics::proportion::clopper_pearson;
///
/// let three_of_three = clopper_pearson(3, 3, 0.95).expect("there are trials");
/// assert_eq!((three_of_three.estimate, three_of_three.high), (1.0, 1.0));
/// assert!((three_of_three.low - 0.292).abs() < 1e-3);
/// ```
pub fn clopper_pearson(n_successes: u64, n: u64, confidence: f64) -> Option<Interval> {
    if n == 0 || n_successes > n {
        return None;
    }
    let tail = (1.0 - confidence.clamp(0.0, 1.0)) / 2.0;
    let (k, n) = (n_successes as f64, n as f64);
    // At least k successes have probability I_p(k, n - k + 1), which grows with p.
    let low = if k == 0.0 { 0.0 } else { root(|p| incomplete_beta(k, n - k + 1.0, p) > tail) };
    let more = |p: f64| incomplete_beta(k + 1.0, n - k, p);
    let high = if k == n { 1.0 } else { root(|p| 1.0 - more(p) < tail) };
    Some(Interval { estimate: k / n, low, high })
}

/// Replaces an interval that has no width, because all `n` numbers were 0 or all were 1, by the exact one; returns every
/// other interval as it is.
///
/// # Shapes
///
/// `interval`: of the mean of `n` numbers between 0 and 1.
pub fn with_width(interval: Interval, n: usize, confidence: f64) -> Interval {
    let Interval { estimate, low, high } = interval;
    let n_successes = match estimate {
        _ if low < high => None,
        0.0 => Some(0),
        1.0 => Some(n as u64),
        _ => None,
    };
    let exact = n_successes.and_then(|k| clopper_pearson(k, n as u64, confidence));
    exact.unwrap_or(interval)
}

/// Finds where a condition on 0..=1 begins to hold.
fn root(holds: impl Fn(f64) -> bool) -> f64 {
    let (mut below, mut above) = (0.0, 1.0);
    for _ in 0..N_HALVINGS {
        let middle = f64::midpoint(below, above);
        *if holds(middle) { &mut above } else { &mut below } = middle;
    }
    f64::midpoint(below, above)
}

/// Computes the regularised incomplete beta function `I_x(a, b)`.
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    // On the other side of the mean the fraction hardly converges.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(b, a, 1.0 - x);
    }
    if x <= 0.0 {
        return 0.0;
    }
    let scale = libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b);
    let front = libm::exp(scale + a * libm::log(x) + b * libm::log1p(-x)) / a;
    front * continued_fraction(a, b, x)
}

/// Evaluates the continued fraction of the incomplete beta function from the front (Lentz).
fn continued_fraction(a: f64, b: f64, x: f64) -> f64 {
    let no_zero = |value: f64| if value.abs() < TINY { TINY } else { value };
    let mut c = 1.0;
    let mut d = 1.0 / no_zero(1.0 - (a + b) * x / (a + 1.0));
    let mut value = d;
    for m in (1..=MAX_TERMS).map(f64::from) {
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let before = value;
        for term in [even, odd] {
            d = 1.0 / no_zero(1.0 + term * d);
            c = no_zero(1.0 + term / c);
            value *= d * c;
        }
        if (value - before).abs() <= CONVERGED * value.abs() {
            break;
        }
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    // Golden numbers: `scipy.stats.binomtest(k, n).proportion_ci(0.95, "exact")` of SciPy 1.17, made by
    // crates/numerics/golden/golden_stats.py.
    const TOLERANCE: f64 = 1e-10;
    const COUNTS: [[u64; 2]; 8] =
        [[0, 1], [3, 3], [0, 20], [2, 20], [17, 20], [192, 200], [200, 200], [9_871, 10_000]];
    const CLOPPER_PEARSON: [[f64; 2]; 8] = [
        [0.0, 0.975],
        [0.292_401_773_821_286_7, 1.0],
        [0.0, 0.168_433_470_983_085_48],
        [0.012_348_527_170_295_887, 0.316_982_714_019_079_2],
        [0.621_073_173_454_704_4, 0.967_929_062_814_455_2],
        [0.922_708_031_773_984, 0.982_575_191_005_179],
        [0.981_724_659_644_851_2, 1.0],
        [0.984_690_790_881_292_5, 0.989_218_942_127_937_8],
    ];

    #[test]
    fn exact_intervals_equal_scipys() {
        for ([k, n], [low, high]) in COUNTS.into_iter().zip(CLOPPER_PEARSON) {
            let interval = clopper_pearson(k, n, 0.95).unwrap();
            assert_eq!(interval.estimate, k as f64 / n as f64);
            assert!((interval.low - low).abs() < TOLERANCE, "{k} of {n}: {interval:?}");
            assert!((interval.high - high).abs() < TOLERANCE, "{k} of {n}: {interval:?}");
        }
    }

    #[test]
    fn more_confidence_is_wider_and_a_share_and_its_rest_mirror_each_other() {
        let [narrow, wide] = [0.8, 0.99].map(|c| clopper_pearson(7, 10, c).unwrap());
        assert!(wide.low < narrow.low && narrow.high < wide.high);
        let rest = clopper_pearson(3, 10, 0.8).unwrap();
        assert!((narrow.low + rest.high - 1.0).abs() < TOLERANCE);
    }

    #[test]
    fn nothing_tried_and_more_than_all_have_no_interval() {
        assert_eq!(clopper_pearson(0, 0, 0.95), None);
        assert_eq!(clopper_pearson(4, 3, 0.95), None);
    }

    #[test]
    fn only_an_interval_without_width_at_a_bound_is_replaced() {
        let flat = |at: f64| Interval { estimate: at, low: at, high: at };
        assert_eq!(with_width(flat(1.0), 200, 0.95), clopper_pearson(200, 200, 0.95).unwrap());
        assert_eq!(with_width(flat(0.0), 3, 0.95), clopper_pearson(0, 3, 0.95).unwrap());
        for other in [flat(0.5), Interval { estimate: 1.0, low: 0.9, high: 1.0 }] {
            assert_eq!(with_width(other, 200, 0.95), other);
        }
    }
}
