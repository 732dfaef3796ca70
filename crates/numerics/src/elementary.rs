//! The hyperbolic tangent, exponential and logarithm in plain arithmetic: vectorisable, the same bits everywhere.
//!
//! The C library's versions differ between machines and are an order of magnitude slower in bulk. These are within a
//! few units in the last place, which is far below what sampling or gradients could notice.
//!
//! | function | range | largest error found (tests) |
//! |---|---|---|
//! | tanh ([`crate::Activation::Tanh`]) | all | 4e-7 absolute; odd, within ±1 |
//! | [`exp`] | -87..88, saturating outside | 2e-7 relative |
//! | [`ln`] | positive normal numbers | 2e-7 relative (absolute near 1) |
//!
//! # Source
//!
//! tanh: the rational minimax approximation of degree 13/6 of the Eigen library (`generic_fast_tanh_float`); exp and
//! ln: Cephes (Moshier), `expf` and `logf`.

#![expect(
    clippy::inline_always,
    reason = "kernels must be compiled inside the dispatched target features"
)]

use pulp::Simd;

/// Beyond this the tangent rounds to one.
const TANH_LIMIT: f32 = 7.905_311;
/// Numerator: coefficients of x^13, x^11 ... x.
const TANH_NUMERATOR: [f32; 7] = [
    -2.760_768_5e-16,
    2.000_188e-13,
    -8.604_672e-11,
    5.122_297e-8,
    1.485_722_4e-5,
    6.372_619e-4,
    4.893_524_6e-3,
];
/// Denominator: coefficients of x^6, x^4, x^2, 1.
const TANH_DENOMINATOR: [f32; 4] = [1.198_258_4e-6, 1.185_347e-4, 2.268_434_6e-3, 4.893_525e-3];

/// Computes the hyperbolic tangent of each lane. NaN stays NaN, and an infinity becomes NaN.
#[inline(always)]
pub(crate) fn tanh_vector<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let (one, minus_one) = (simd.splat_f32s(1.0), simd.splat_f32s(-1.0));
    // A NaN must stay one: both comparisons of min and max would replace it, so it is added back at the end.
    let nan_or_zero = simd.mul_f32s(x, simd.splat_f32s(0.0));
    let limit = simd.splat_f32s(TANH_LIMIT);
    let clamped = simd.max_f32s(simd.min_f32s(x, limit), simd.neg_f32s(limit));
    let square = simd.mul_f32s(clamped, clamped);
    let horner = |coefficients: &[f32]| {
        let first = simd.splat_f32s(coefficients[0]);
        coefficients[1..]
            .iter()
            .fold(first, |sum, &c| simd.mul_add_f32s(sum, square, simd.splat_f32s(c)))
    };
    let numerator = simd.mul_f32s(clamped, horner(&TANH_NUMERATOR));
    let tanh = simd.div_f32s(numerator, horner(&TANH_DENOMINATOR));
    simd.add_f32s(simd.max_f32s(simd.min_f32s(tanh, one), minus_one), nan_or_zero)
}

/// High and low part of ln 2: the high part times an exponent is exact.
const LN_2: (f32, f32) = (0.693_359_4, -2.121_944_4e-4);

/// Computes the exponential; below -87 the result is 0, above 88 it is as for 88.
///
/// # Example
///
/// ```
/// use leadtime_numerics::elementary::{exp, ln};
///
/// assert!((exp(1.0) - 1.0_f32.exp()).abs() < 1e-6);
/// assert!((ln(exp(-3.5)) + 3.5).abs() < 1e-6);
/// ```
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let clamped = x.clamp(-87.0, 88.0);
    // Adding 1.5·2^23 rounds to the nearest integer and leaves it in the lowest bits.
    let magic = 12_582_912.0_f32;
    let shifted = clamped * std::f32::consts::LOG2_E + magic;
    let n = shifted - magic;
    let r = clamped - n * LN_2.0 - n * LN_2.1;
    let p = 1.987_569_1e-4_f32;
    let p = p * r + 1.398_2e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 1.666_666_5e-1;
    let p = p * r + 5e-1;
    let mantissa = p * (r * r) + r + 1.0;
    let power = f32::from_bits(shifted.to_bits().wrapping_sub(magic.to_bits() - 127) << 23);
    if x < -87.0 { 0.0 } else { mantissa * power }
}

/// Computes the natural logarithm of a positive normal number.
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    let bits = x.to_bits() as i32;
    let mantissa = f32::from_bits((bits & 0x007f_ffff | 0x3f00_0000) as u32);
    let exponent = ((bits >> 23) - 126) as f32;
    let below = mantissa < std::f32::consts::FRAC_1_SQRT_2;
    let e = if below { exponent - 1.0 } else { exponent };
    let r = if below { mantissa + mantissa - 1.0 } else { mantissa - 1.0 };
    let square = r * r;
    let p = 7.037_683_6e-2_f32;
    let p = p * r - 1.151_461e-1;
    let p = p * r + 1.167_699_9e-1;
    let p = p * r - 1.242_014_1e-1;
    let p = p * r + 1.424_932_3e-1;
    let p = p * r - 1.666_805_8e-1;
    let p = p * r + 2.000_071_5e-1;
    let p = p * r - 2.499_999_4e-1;
    let p = p * r + 3.333_333e-1;
    let tail = p * r * square + e * LN_2.1 - 0.5 * square;
    r + tail + e * LN_2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Activation, Dense};

    fn grid() -> impl Iterator<Item = f32> {
        let fine = (-100_000..=100_000).map(|i| i as f32 * 1e-4);
        let small = (0..400).map(|i| 10_f32.powf(-(i as f32) / 12.0));
        fine.chain(small)
    }

    /// Computes tangents as layers do: of one input, whose bias keeps the sign of zero.
    fn tanh(values: &[f32]) -> Vec<f32> {
        let mut tangents = vec![f32::NAN; values.len()];
        Dense::new(&[1.0], &[-0.0]).unwrap().forward(values, &mut tangents, Activation::Tanh);
        tangents
    }

    #[test]
    fn tanh_is_close_odd_and_bounded() {
        let inputs: Vec<f32> = grid().collect();
        let negated: Vec<f32> = inputs.iter().map(|x| -x).collect();
        for ((&x, y), odd) in inputs.iter().zip(tanh(&inputs)).zip(tanh(&negated)) {
            let exact = libm::tanh(f64::from(x));
            assert!((f64::from(y) - exact).abs() < 4e-7, "tanh({x}) = {y}, not {exact}");
            assert!((f64::from(y) - exact).abs() <= 1e-6 * exact.abs(), "tanh({x}) relatively");
            assert_eq!(odd.to_bits(), (-y).to_bits(), "tanh(-{x})");
            assert!(y.abs() <= 1.0);
        }
    }

    #[test]
    fn tanh_saturates_and_passes_nan_on() {
        let values = tanh(&[f32::MAX, -f32::MAX, 9.0, f32::NAN]);
        assert!(values[0] > 1.0 - 4e-7 && values[0] <= 1.0, "{}", values[0]);
        assert_eq!(values[..3], [values[0], -values[0], values[0]]);
        assert!(values[3].is_nan());
    }

    #[test]
    fn exp_and_ln_are_close() {
        for x in grid().map(|x| x * 8.6) {
            let exact = libm::exp(f64::from(x));
            let error = (f64::from(exp(x)) - exact).abs() / exact;
            assert!(error < 2e-7, "exp({x}): {error}");
        }
        for x in grid().map(f32::abs).filter(|x| *x > 1e-30) {
            let exact = libm::log(f64::from(x));
            let error = (f64::from(ln(x)) - exact).abs() / exact.abs().max(1.0);
            assert!(error < 2e-7, "ln({x}): {error}");
        }
        assert_eq!((exp(0.0), ln(1.0), exp(-1e30)), (1.0, 0.0, 0.0));
    }
}
