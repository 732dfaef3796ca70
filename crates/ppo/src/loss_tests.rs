use leadtime_numerics::Pcg64;
use leadtime_proto::{ActionSpec, Conditional, Gate, Head, HeadCredit};

use super::*;
include!("../golden/loss.rs");

fn settings(value_clip: bool) -> LossSettings {
    LossSettings { clip: 0.2, value_clip, entropy_coef: 0.01, value_coef: 0.5 }
}

fn golden_samples() -> Samples {
    Samples {
        masks: vec![u64::MAX; 9],
        actions: ACTIONS.to_vec(),
        log_probs: OLD_LOG_PROBS.to_vec(),
        advantages: ADVANTAGES.to_vec(),
        returns: RETURNS.to_vec(),
        values: OLD_VALUES.to_vec(),
    }
}

/// The loss of a minibatch of all samples, advantages normalised.
fn whole<'a>(
    distribution: &'a ActionDistribution,
    settings: LossSettings,
    samples: &'a Samples,
) -> PpoLoss<'a> {
    let scale = Some(AdvantageScale::of(samples.advantages.iter().copied()));
    PpoLoss { distribution, settings, samples, scale, n_rows: samples.masks.len() }
}

/// What some rows give.
struct Computed {
    report: LossReport,
    d_logits: Vec<f32>,
    d_values: Vec<f32>,
}

fn compute(loss: &PpoLoss<'_>, rows: &[usize], logits: &[f32], values: &[f32]) -> Computed {
    let n_choices = loss.distribution.n_choices();
    let logits = Panels::from_rows(logits, rows.len(), n_choices);
    let values = Panels::from_rows(values, rows.len(), 1);
    let (mut d_logits, mut d_values) = (Panels::default(), Panels::default());
    let (mut terms, mut losses) = (Vec::new(), Vec::new());
    loss.policy_rows(rows, &logits, &mut d_logits, &mut terms);
    loss.value_rows(rows, &values, &mut d_values, &mut losses);
    let flat = |panels: &Panels| {
        let mut rows = vec![0.0; panels.depth() * panels.n_columns()];
        let by_row = rows.chunks_exact_mut(panels.n_columns());
        by_row.enumerate().for_each(|(k, row)| panels.copy_row(k, row));
        rows
    };
    let report = loss.report(&terms, &losses);
    Computed { report, d_logits: flat(&d_logits), d_values: flat(&d_values) }
}

#[test]
fn loss_gradients_and_diagnostics_equal_cleanrls() {
    // crates/ppo/golden/golden.py, `loss`: the lines of CleanRL's ppo.py under PyTorch's autograd.
    let distribution = ActionDistribution::new(&ActionSpec::discrete("a", 5), HeadCredit::All);
    let samples = golden_samples();
    let loss = whole(&distribution, settings(true), &samples);
    let found = compute(&loss, &[0, 1, 2, 3, 4, 5, 6, 7, 8], &LOGITS, &VALUES);
    for (found, expected) in
        [(&found.d_logits, &LOGIT_GRADIENT[..]), (&found.d_values, &VALUE_GRADIENT[..])]
    {
        for (i, (a, b)) in found.iter().zip(expected).enumerate() {
            assert!((a - b).abs() < 2e-6, "{i}: {a} {b}");
        }
    }
    let LossReport { total, policy_loss, value_loss, entropy, .. } = found.report;
    let LossReport { old_approx_kl, approx_kl, clip_fraction, .. } = found.report;
    let found = [total, policy_loss, value_loss, entropy, old_approx_kl, approx_kl, clip_fraction];
    for (i, (a, b)) in found.iter().zip(EXPECTED).enumerate() {
        assert!((a - f64::from(b)).abs() < 2e-6, "{i}: {a} {b}");
    }
}

/// A notifier's heads with a mask, a gate and a conditional.
fn notifier() -> ActionSpec {
    let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
    ActionSpec {
        heads: vec![head("initiate", 2), head("k", 3), head("l", 3)],
        gate: Some(Gate { head: 0, choice: 1 }),
        conditionals: vec![Conditional { head: 2, given: 1, allowed: vec![7, 6, 4] }],
    }
}

#[test]
fn gradients_are_the_slopes_of_the_masked_loss() {
    let n = 40;
    let mut generator = Pcg64::seed_from_u64(11);
    let mut draws = |n: usize, scale: f64| -> Vec<f32> {
        (0..n).map(|_| generator.uniform(-scale, scale) as f32).collect()
    };
    for (credit, value_clip) in [(HeadCredit::All, false), (HeadCredit::Active, true)] {
        let distribution = ActionDistribution::new(&notifier(), credit);
        let (logits, values) = (draws(n * 8, 1.5), draws(n, 1.0));
        let mut pick = Pcg64::seed_from_u64(12);
        let mut samples = Samples { masks: vec![u64::MAX; n], ..Samples::default() };
        samples.masks[3] = !0b10;
        for (i, logits) in logits.chunks_exact(8).enumerate() {
            let mut action = [0; 3];
            let mask = Mask(samples.masks[i]);
            let log_prob = distribution.sample(logits, mask, &mut pick, &mut action);
            samples.actions.extend(action);
            samples.log_probs.push(log_prob);
        }
        // Off-policy by up to ±0.6: ratios on both sides of the clip range.
        samples.log_probs.iter_mut().zip(draws(n, 0.6)).for_each(|(old, noise)| *old += noise);
        samples.advantages = draws(n, 1.0);
        samples.returns = draws(n, 2.0);
        samples.values = values.iter().zip(draws(n, 0.4)).map(|(v, noise)| v + noise).collect();
        let loss = whole(&distribution, settings(value_clip), &samples);
        let rows: Vec<usize> = (0..n).collect();
        let outcome = compute(&loss, &rows, &logits, &values);
        let step = 2e-3_f32;
        let slope = |i: usize, of_logit: bool| {
            let at = |sign: f32| {
                let (mut logits, mut values) = (logits.clone(), values.clone());
                let slot = if of_logit { &mut logits[i] } else { &mut values[i] };
                *slot += sign * step;
                compute(&loss, &rows, &logits, &values).report.total
            };
            (at(1.0) - at(-1.0)) / f64::from(2.0 * step)
        };
        // One or two samples may sit on a kink of max or clip, where a central difference averages both sides.
        let far = |gradient: &[f32], of_logit: bool| {
            let n = gradient.len();
            (0..n).filter(|&i| (slope(i, of_logit) - f64::from(gradient[i])).abs() > 2e-4).count()
        };
        assert!(far(&outcome.d_logits, true) <= 6, "{credit:?}: {}", far(&outcome.d_logits, true));
        assert!(far(&outcome.d_values, false) <= 1, "{credit:?}");
    }
}

#[test]
fn a_ratio_beyond_all_reason_leaves_the_gradient_finite() {
    let distribution = ActionDistribution::new(&ActionSpec::discrete("a", 2), HeadCredit::All);
    let samples = Samples {
        masks: vec![u64::MAX; 2],
        actions: vec![0, 1],
        log_probs: vec![-1e4, 0.0],
        advantages: vec![-1.0, 1.0],
        returns: vec![0.0; 2],
        values: vec![0.0; 2],
    };
    let loss = whole(&distribution, settings(true), &samples);
    let outcome = compute(&loss, &[0, 1], &[0.0; 4], &[0.0; 2]);
    assert!(outcome.d_logits.iter().all(|slope| slope.is_finite()), "{:?}", outcome.d_logits);
    assert!(outcome.report.total.is_finite() && outcome.report.approx_kl.is_finite());
}

#[test]
fn nothing_offered_twice_moves_nothing() {
    let spec = ActionSpec::discrete("a", 3);
    let distribution = ActionDistribution::new(&spec, HeadCredit::All);
    let samples = Samples {
        masks: vec![0b100],
        actions: vec![2],
        log_probs: vec![0.0],
        advantages: vec![5.0],
        returns: vec![1.0],
        values: vec![1.0],
    };
    let loss = whole(&distribution, settings(true), &samples);
    let outcome = compute(&loss, &[0], &[3.0, -1.0, 0.5], &[1.0]);
    assert_eq!(outcome.d_logits, [0.0; 3]);
    assert_eq!((outcome.report.entropy, outcome.report.clip_fraction), (0.0, 0.0));
    assert_eq!(outcome.report.policy_loss, -5.0);
}

#[test]
fn the_parts_of_a_minibatch_add_up_to_it() {
    let distribution = ActionDistribution::new(&ActionSpec::discrete("a", 5), HeadCredit::All);
    let samples = golden_samples();
    let loss = whole(&distribution, settings(true), &samples);
    let rows: Vec<usize> = (0..9).collect();
    let all = compute(&loss, &rows, &LOGITS, &VALUES);
    let (mut report, mut d_logits) = (LossReport::default(), Vec::new());
    for part in [0..4, 4..9] {
        let logits = &LOGITS[part.start * 5..part.end * 5];
        let found = compute(&loss, &rows[part.clone()], logits, &VALUES[part]);
        report.add(&found.report);
        d_logits.extend(found.d_logits);
    }
    assert_eq!(d_logits, all.d_logits);
    assert!((report.total - all.report.total).abs() < 1e-12);
}
