//! The generator of numpy, bit for bit: `SeedSequence` seeding and PCG64 (XSL-RR).
//!
//! It is what Gymnasium seeds its environments with, so a world reset from the same seed draws the same
//! terrain, the same start impulse and the same engine dispersion as the original. That makes recorded
//! episodes of the original an oracle for ours. It is also a good generator in its own right, so it
//! serves all our own streams (see [`crate::streams`]).
//!
//! # Source
//!
//! O'Neill, *PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for Random Number
//! Generation*, 2014; numpy's `SeedSequence` (`numpy/random/bit_generator.pyx`).

use serde::{Deserialize, Serialize};

const MULTIPLIER: u128 = 0x2360_ED05_1FC6_5DA4_4385_DF64_9FCC_F645;
const POOL_SIZE: usize = 4;

/// A PCG64 generator whose draws equal those of `numpy.random.Generator(PCG64(seed))`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pcg64 {
    state: u128,
    increment: u128,
    /// The unused upper half of the last 64-bit draw; numpy hands out 32-bit draws in pairs.
    spare: Option<u32>,
}

impl Pcg64 {
    /// Seeds a generator as `numpy.random.default_rng(seed)` does.
    pub fn seed_from_u64(seed: u64) -> Self {
        let (low, high) = (seed as u32, (seed >> 32) as u32);
        if high == 0 { Self::from_entropy(&[low]) } else { Self::from_entropy(&[low, high]) }
    }

    /// Seeds a generator from any number of words, as `SeedSequence` mixes a list of integers.
    pub fn from_entropy(entropy: &[u32]) -> Self {
        let words = seed_sequence(entropy);
        let seed = (u128::from(words[0]) << 64) | u128::from(words[1]);
        let sequence = (u128::from(words[2]) << 64) | u128::from(words[3]);
        let mut generator = Self { state: 0, increment: (sequence << 1) | 1, spare: None };
        generator.advance();
        generator.state = generator.state.wrapping_add(seed);
        generator.advance();
        generator
    }

    fn advance(&mut self) {
        self.state = self.state.wrapping_mul(MULTIPLIER).wrapping_add(self.increment);
    }

    /// Returns the next 64 random bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        self.advance();
        let folded = (self.state >> 64) as u64 ^ self.state as u64;
        folded.rotate_right((self.state >> 122) as u32)
    }

    /// Returns the next 32 random bits; two such draws consume one 64-bit draw, low half first.
    pub fn next_u32(&mut self) -> u32 {
        if let Some(high) = self.spare.take() {
            return high;
        }
        let draw = self.next_u64();
        self.spare = Some((draw >> 32) as u32);
        draw as u32
    }

    /// Returns a uniform draw from `[0, 1)` with 53 random bits.
    #[inline]
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Returns a uniform draw from `[low, high)`, as `Generator.uniform`.
    #[inline]
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a uniform integer from `[low, high)`, as `Generator.integers` (Lemire's method on 32 bits).
    ///
    /// # Panics
    ///
    /// If the range is empty or wider than 2³² - 1.
    pub fn integers(&mut self, low: i64, high: i64) -> i64 {
        assert!(low < high, "empty range {low}..{high}");
        let width = u32::try_from(high - low).expect("the range fits 32 bits");
        let mut product = u64::from(self.next_u32()) * u64::from(width);
        if (product as u32) < width {
            let threshold = width.wrapping_neg() % width;
            while (product as u32) < threshold {
                product = u64::from(self.next_u32()) * u64::from(width);
            }
        }
        low + (product >> 32) as i64
    }

    /// Returns a uniform index below `n`.
    ///
    /// # Panics
    ///
    /// If `n` is zero.
    pub fn below(&mut self, n: usize) -> usize {
        self.integers(0, n as i64) as usize
    }

    /// Returns a standard normal draw (Box-Muller, one of the pair; `libm`, so equal on every machine).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.unit()));
        radius * libm::cos(std::f64::consts::TAU * self.unit())
    }

    /// Shuffles a slice in place (Fisher-Yates, from the back).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }
}

/// Mixes entropy words into the four 64-bit words that seed PCG64.
fn seed_sequence(entropy: &[u32]) -> [u64; 4] {
    let mut hash_constant = 0x43b0_d7e5_u32;
    let mut hash = |mut value: u32| {
        value ^= hash_constant;
        hash_constant = hash_constant.wrapping_mul(0x931e_8875);
        value = value.wrapping_mul(hash_constant);
        value ^ (value >> 16)
    };
    let mut pool = [0_u32; POOL_SIZE];
    for (slot, word) in pool.iter_mut().enumerate() {
        *word = hash(entropy.get(slot).copied().unwrap_or(0));
    }
    for source in 0..POOL_SIZE {
        for target in 0..POOL_SIZE {
            if source != target {
                pool[target] = mix(pool[target], hash(pool[source]));
            }
        }
    }
    for &word in entropy.iter().skip(POOL_SIZE) {
        for slot in &mut pool {
            *slot = mix(*slot, hash(word));
        }
    }
    generate_state(pool)
}

fn mix(x: u32, y: u32) -> u32 {
    let mixed = 0xca01_f9dd_u32.wrapping_mul(x).wrapping_sub(0x4973_f715_u32.wrapping_mul(y));
    mixed ^ (mixed >> 16)
}

fn generate_state(pool: [u32; POOL_SIZE]) -> [u64; 4] {
    let mut hash_constant = 0x8b51_f9dd_u32;
    let mut words = [0_u32; 8];
    for (slot, word) in words.iter_mut().enumerate() {
        let mut value = pool[slot % POOL_SIZE] ^ hash_constant;
        hash_constant = hash_constant.wrapping_mul(0x58f3_8ded);
        value = value.wrapping_mul(hash_constant);
        *word = value ^ (value >> 16);
    }
    std::array::from_fn(|i| u64::from(words[2 * i]) | (u64::from(words[2 * i + 1]) << 32))
}

#[cfg(test)]
#[expect(clippy::unreadable_literal, reason = "golden numbers are as the script writes them")]
mod tests {
    use super::*;

    // Golden numbers: numpy 2.4,
    // python3 -c "import numpy as np; g = np.random.default_rng(S); print([repr(float(g.uniform())) ...])"
    // (full script: crates/numerics/golden/golden_pcg64.py).
    include!("../golden/golden_pcg64.rs");

    #[test]
    fn draws_equal_numpys() {
        for case in GOLDEN {
            let mut generator = Pcg64::from_entropy(case.entropy);
            let units: [f64; 3] = std::array::from_fn(|_| generator.unit());
            assert_eq!(units, case.units, "entropy {:?}", case.entropy);
            let integers: [i64; 4] = std::array::from_fn(|_| generator.integers(-9999, 9999));
            assert_eq!(integers, case.integers, "entropy {:?}", case.entropy);
            assert_eq!(generator.uniform(-1000.0, 1000.0), case.uniform);
        }
    }

    #[test]
    fn a_shuffle_is_a_permutation() {
        let mut items: Vec<usize> = (0..100).collect();
        Pcg64::seed_from_u64(3).shuffle(&mut items);
        assert_ne!(items, (0..100).collect::<Vec<_>>());
        items.sort_unstable();
        assert_eq!(items, (0..100).collect::<Vec<_>>());
    }

    #[test]
    fn normal_draws_have_the_standard_moments() {
        let mut generator = Pcg64::seed_from_u64(5);
        let draws: Vec<f64> = (0..20_000).map(|_| generator.normal()).collect();
        let mean = draws.iter().sum::<f64>() / 20_000.0;
        let variance = draws.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 20_000.0;
        // Four standard errors: 4/sqrt(20000) = 0.028 and 4*sqrt(2/20000) = 0.04.
        assert!(mean.abs() < 0.028 && (variance - 1.0).abs() < 0.04, "{mean} {variance}");
    }
}
