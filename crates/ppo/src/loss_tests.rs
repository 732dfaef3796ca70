use std::ops::Range;

use candle_core::{Device, Var};
use leadtime_numerics::Pcg64;
use leadtime_proto::{ActionSpec, Conditional, Gate, Head, HeadCredit};

use super::*;
include!("../golden/loss.rs");

fn var(values: &[f32], shape: impl Into<Shape>) -> Var {
    let shape: Shape = shape.into();
    Var::from_tensor(&Tensor::from_slice(values, shape, &Device::Cpu).unwrap()).unwrap()
}

fn settings(value_clip: bool) -> LossSettings {
    LossSettings { clip: 0.2, value_clip, entropy_coef: 0.01, value_coef: 0.5 }
}

/// Some of the golden samples.
fn golden_samples(rows: Range<usize>) -> Samples {
    Samples {
        masks: vec![u64::MAX; rows.len()],
        actions: ACTIONS[rows.clone()].to_vec(),
        log_probs: OLD_LOG_PROBS[rows.clone()].to_vec(),
        advantages: ADVANTAGES[rows.clone()].to_vec(),
        returns: RETURNS[rows.clone()].to_vec(),
        values: OLD_VALUES[rows].to_vec(),
    }
}

/// The loss of a minibatch in one piece, advantages normalised.
fn whole(
    distribution: Arc<ActionDistribution>,
    settings: LossSettings,
    mut samples: Samples,
) -> Arc<PpoLoss> {
    AdvantageScale::of(samples.advantages.iter().copied()).apply(&mut samples.advantages);
    let n_samples = samples.masks.len();
    PpoLoss::new(distribution, settings, samples, n_samples)
}

#[test]
fn loss_gradients_and_diagnostics_equal_cleanrls() {
    // crates/ppo/golden/golden.py, `loss`: the lines of CleanRL's ppo.py under PyTorch's autograd.
    let distribution = ActionDistribution::new(&ActionSpec::discrete("a", 5), HeadCredit::All);
    let loss = whole(Arc::new(distribution), settings(true), golden_samples(0..9));
    let (logits, values) = (var(&LOGITS, (9, 5)), var(&VALUES, (9, 1)));
    let total = logits.apply_op2(&values, LossOp(Arc::clone(&loss))).unwrap();
    let gradients = total.backward().unwrap();
    let check = |var: &Var, expected: &[f32]| {
        let found = gradients.get(var).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        for (i, (a, b)) in found.iter().zip(expected).enumerate() {
            assert!((a - b).abs() < 2e-6, "{i}: {a} {b}");
        }
    };
    check(&logits, &LOGIT_GRADIENT);
    check(&values, &VALUE_GRADIENT);
    let LossReport { total, policy_loss, value_loss, entropy, .. } = loss.report();
    let LossReport { old_approx_kl, approx_kl, clip_fraction, .. } = loss.report();
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
        let distribution = Arc::new(ActionDistribution::new(&notifier(), credit));
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
        let loss = whole(distribution, settings(value_clip), samples);
        let outcome = loss.compute(&logits, &values);
        let step = 2e-3_f32;
        let slope = |i: usize, of_logit: bool| {
            let at = |sign: f32| {
                let (mut logits, mut values) = (logits.clone(), values.clone());
                let slot = if of_logit { &mut logits[i] } else { &mut values[i] };
                *slot += sign * step;
                loss.compute(&logits, &values).report.total
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
    let distribution =
        Arc::new(ActionDistribution::new(&ActionSpec::discrete("a", 2), HeadCredit::All));
    let samples = Samples {
        masks: vec![u64::MAX; 2],
        actions: vec![0, 1],
        log_probs: vec![-1e4, 0.0],
        advantages: vec![-1.0, 1.0],
        returns: vec![0.0; 2],
        values: vec![0.0; 2],
    };
    let loss = whole(distribution, settings(true), samples);
    let outcome = loss.compute(&[0.0; 4], &[0.0; 2]);
    assert!(outcome.d_logits.iter().all(|slope| slope.is_finite()), "{:?}", outcome.d_logits);
    assert!(outcome.report.total.is_finite() && outcome.report.approx_kl.is_finite());
}

#[test]
fn nothing_offered_twice_moves_nothing() {
    let spec = ActionSpec::discrete("a", 3);
    let distribution = Arc::new(ActionDistribution::new(&spec, HeadCredit::All));
    let samples = Samples {
        masks: vec![0b100],
        actions: vec![2],
        log_probs: vec![0.0],
        advantages: vec![5.0],
        returns: vec![1.0],
        values: vec![1.0],
    };
    let loss = whole(distribution, settings(true), samples);
    let outcome = loss.compute(&[3.0, -1.0, 0.5], &[1.0]);
    assert_eq!(outcome.d_logits, [0.0; 3]);
    assert_eq!((outcome.report.entropy, outcome.report.clip_fraction), (0.0, 0.0));
    assert_eq!(outcome.report.policy_loss, -5.0);
}

#[test]
fn the_parts_of_a_minibatch_add_up_to_it() {
    let distribution = ActionDistribution::new(&ActionSpec::discrete("a", 5), HeadCredit::All);
    let distribution = Arc::new(distribution);
    let scale = AdvantageScale::of(ADVANTAGES.iter().copied());
    let all = whole(Arc::clone(&distribution), settings(true), golden_samples(0..9));
    let all = all.compute(&LOGITS, &VALUES);
    let (mut report, mut d_logits) = (LossReport::default(), Vec::new());
    for part in [0..4, 4..9] {
        let mut samples = golden_samples(part.clone());
        scale.apply(&mut samples.advantages);
        let loss = PpoLoss::new(Arc::clone(&distribution), settings(true), samples, 9);
        let found = loss.compute(&LOGITS[part.start * 5..part.end * 5], &VALUES[part]);
        report.add(&found.report);
        d_logits.extend(found.d_logits);
    }
    assert_eq!(d_logits, all.d_logits);
    assert!((report.total - all.report.total).abs() < 1e-12);
}
