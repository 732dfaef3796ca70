//! Tests of the masked, gated, conditional distribution over actions.

use leadtime_proto::{ActionSpec, HeadCredit, Mask};

use super::*;
use crate::tests::notifier;

const CREDITS: [HeadCredit; 2] = [HeadCredit::All, HeadCredit::Active];
/// Offers everything; nothing may start; and k = 2, 3 are not offered.
const MASKS: [Mask; 3] = [Mask::ALL, Mask(!0b10), Mask(!(0b11 << 6))];

fn logits(seed: u64) -> Vec<f32> {
    let mut generator = Pcg64::seed_from_u64(seed);
    (0..14).map(|_| generator.uniform(-2.0, 2.0) as f32).collect()
}

fn actions(spec: &ActionSpec, mask: Mask) -> Vec<[u8; 4]> {
    let all = (0..2 * 4 * 4 * 4).map(|i: u8| [i / 64, i / 16 % 4, i / 4 % 4, i % 4]);
    all.filter(|action| spec.allows(mask, action)).collect()
}

fn terms(of: &ActionDistribution, logits: &[f32], mask: Mask, action: &[u8]) -> ActionTerms {
    let mut terms = ActionTerms::default();
    of.terms(logits, mask, action, &mut terms);
    terms
}

#[test]
fn probabilities_of_all_possible_actions_sum_to_one() {
    let spec = notifier(1).actions;
    for (credit, mask) in CREDITS.into_iter().flat_map(|c| MASKS.map(|m| (c, m))) {
        let distribution = ActionDistribution::new(&spec, credit);
        let logits = logits(1);
        // With active credit all actions behind a closed gate are one: count it once.
        let same = |a: &[u8; 4]| credit == HeadCredit::Active && a[0] == 0;
        let mut total = 0.0;
        let mut closed = None;
        for action in actions(&spec, mask) {
            let p = distribution.log_prob(&logits, mask, &action).exp();
            if same(&action) {
                assert!(closed.is_none_or(|earlier: f32| earlier == p));
                closed = Some(p);
            } else {
                total += p;
            }
        }
        total += closed.unwrap_or(0.0);
        assert!((total - 1.0).abs() < 1e-5, "{credit:?} {mask:?}: {total}");
    }
}

#[test]
fn samples_come_as_often_as_their_probability_says() {
    let spec = notifier(1).actions;
    for mask in MASKS {
        let distribution = ActionDistribution::new(&spec, HeadCredit::All);
        let logits = logits(2);
        let mut generator = Pcg64::seed_from_u64(3);
        let n = 40_000;
        let mut counts = [0_u32; 128];
        for _ in 0..n {
            let mut action = [0; 4];
            let log_prob = distribution.sample(&logits, mask, &mut generator, &mut action);
            assert!(spec.allows(mask, &action));
            assert_eq!(log_prob, distribution.log_prob(&logits, mask, &action));
            let [a, b, c, d] = action.map(usize::from);
            counts[((a * 4 + b) * 4 + c) * 4 + d] += 1;
        }
        // Pearson's statistic: mean = degrees of freedom, so five deviations above it is a failure.
        let possible = actions(&spec, mask);
        let statistic: f64 = possible
            .iter()
            .map(|action| {
                let p = f64::from(distribution.log_prob(&logits, mask, action)).exp();
                let [a, b, c, d] = action.map(usize::from);
                let found = f64::from(counts[((a * 4 + b) * 4 + c) * 4 + d]);
                (found - p * f64::from(n)).powi(2) / (p * f64::from(n))
            })
            .sum();
        let freedom = possible.len() as f64 - 1.0;
        assert!(statistic < freedom + 5.0 * (2.0 * freedom).sqrt(), "{mask:?}: {statistic}");
    }
}

#[test]
fn greedy_takes_the_likeliest_choice_left() {
    let distribution = ActionDistribution::new(&notifier(1).actions, HeadCredit::All);
    let mut logits = [0.0; 14];
    (logits[1], logits[4], logits[8], logits[10]) = (1.0, 1.0, 1.0, 5.0);
    let mut action = [0; 4];
    distribution.greedy(&logits, Mask::ALL, &mut action);
    // l = 0 has the highest logit of its head, but k = 2 leaves only l >= 2.
    assert_eq!(action, [1, 2, 2, 2]);
    distribution.greedy(&logits, Mask(!0b10), &mut action);
    assert_eq!(action, [0, 2, 2, 2]);
}

#[test]
fn entropy_is_that_of_the_offered_choices() {
    let spec = notifier(1).actions;
    let all = ActionDistribution::new(&spec, HeadCredit::All);
    let active = ActionDistribution::new(&spec, HeadCredit::Active);
    let uniform = [0.0; 14];
    let (two, four) = (2.0_f32.ln(), 4.0_f32.ln());
    let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} {b}");
    close(terms(&all, &uniform, Mask::ALL, &[1, 0, 2, 3]).entropy, two + four + four + two);
    close(terms(&all, &uniform, Mask::ALL, &[0, 0, 3, 3]).entropy, two + four + four);
    close(terms(&all, &uniform, Mask(!0b10), &[0, 0, 0, 0]).entropy, 3.0 * four);
    close(terms(&active, &uniform, Mask::ALL, &[0, 0, 0, 0]).entropy, two);
    close(terms(&active, &uniform, Mask::ALL, &[1, 0, 2, 3]).entropy, two + four + four + two);
}

#[test]
fn gradients_are_the_slopes() {
    let spec = notifier(1).actions;
    for (credit, mask) in CREDITS.into_iter().flat_map(|c| MASKS.map(|m| (c, m))) {
        let distribution = ActionDistribution::new(&spec, credit);
        for (seed, action) in actions(&spec, mask).into_iter().enumerate().step_by(3) {
            let logits = logits(seed as u64);
            let (d_log_prob, d_entropy) = (0.7, -1.3);
            let objective = |logits: &[f32]| {
                f64::from(d_log_prob * distribution.log_prob(logits, mask, &action))
                    + f64::from(d_entropy * terms(&distribution, logits, mask, &action).entropy)
            };
            let terms = terms(&distribution, &logits, mask, &action);
            let mut gradient = [f32::NAN; 14];
            terms.gradient(&distribution, &action, d_log_prob, d_entropy, &mut gradient);
            for choice in 0..14 {
                let step = 1e-2;
                let (mut above, mut below) = (logits.clone(), logits.clone());
                above[choice] += step;
                below[choice] -= step;
                let slope = (objective(&above) - objective(&below)) / f64::from(2.0 * step);
                let error = (slope - f64::from(gradient[choice])).abs();
                // Central differences in 32 bits: 1e-4 of truncation and 2e-5 of rounding.
                assert!(error < 3e-4, "{credit:?} {mask:?} {action:?} {choice}: {error}");
            }
        }
    }
}

#[test]
fn huge_logits_stay_finite() {
    let distribution = ActionDistribution::new(&notifier(1).actions, HeadCredit::All);
    let mut logits = [1e30; 14];
    logits[0] = -1e30;
    let action = [0, 0, 0, 0];
    let log_prob = distribution.log_prob(&logits, Mask::ALL, &action);
    assert!(log_prob.is_finite(), "{log_prob}");
    assert!(terms(&distribution, &logits, Mask::ALL, &action).entropy.is_finite());
}
