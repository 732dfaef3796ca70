//! Draws the next token, from a seeded generator of ours: the tensor library's own may change with its version.

use leadtime_numerics::Pcg64;

use crate::pipeline::backend::Sampling;

/// Draws an index in proportion to exp(logit / temperature), from the likeliest that make up `top_p`.
///
/// Temperature 0 takes the likeliest; of equals, the first.
pub(super) fn sample(logits: &[f32], sampling: Sampling, generator: &mut Pcg64) -> usize {
    let mut order: Vec<usize> = (0..logits.len()).collect();
    order.sort_by(|&a, &b| logits[b].total_cmp(&logits[a]).then(a.cmp(&b)));
    let Some(&best) = order.first() else { return 0 };
    if sampling.temperature <= 0.0 {
        return best;
    }
    let weight = |i: usize| (f64::from(logits[i] - logits[best]) / sampling.temperature).exp();
    let total: f64 = order.iter().map(|&i| weight(i)).sum();
    let mut mass = 0.0;
    let mut n = 0;
    while n < order.len() && mass < sampling.top_p * total {
        mass += weight(order[n]);
        n += 1;
    }
    let mut left = generator.unit() * mass;
    for &i in &order[..n] {
        left -= weight(i);
        if left < 0.0 {
            return i;
        }
    }
    order[n.saturating_sub(1)]
}

/// Computes the natural logarithm of a token's probability at temperature 1.
pub(super) fn log_probability(logits: &[f32], token: usize) -> f64 {
    let most = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let total: f64 = logits.iter().map(|&logit| f64::from(logit - most).exp()).sum();
    logits.get(token).map_or(f64::NEG_INFINITY, |&logit| f64::from(logit - most) - total.ln())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_follow_temperature_and_nucleus() {
        let logits = [0.0, 2.0, 1.0, -9.0];
        let mut generator = Pcg64::seed_from_u64(1);
        let mut shares = |temperature, top_p| {
            let sampling = Sampling { temperature, top_p, max_tokens: 1 };
            let mut counts = [0_u32; 4];
            for _ in 0..2000 {
                counts[sample(&logits, sampling, &mut generator)] += 1;
            }
            counts.map(|count| f64::from(count) / 2000.0)
        };
        assert_eq!(shares(0.0, 1.0)[1], 1.0);
        let all = shares(1.0, 1.0);
        // exp(2) / (exp(0) + exp(2) + exp(1)) = 0.665
        assert!((all[1] - 0.665).abs() < 0.04, "{all:?}");
        let nucleus = shares(1.0, 0.7);
        assert_eq!(nucleus[0] + nucleus[3], 0.0);
        assert!(nucleus[2] > 0.2);
    }

    #[test]
    fn a_probability_is_its_share_of_all() {
        // exp(1) / (exp(0) + exp(1)) = 0.731
        assert!((log_probability(&[0.0, 1.0], 1).exp() - 0.731_058_58).abs() < 1e-6);
        assert_eq!(log_probability(&[0.0, 1.0], 2), f64::NEG_INFINITY);
    }
}
