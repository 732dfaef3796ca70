//! Tests of the pilot's file format and forward pass.

use std::collections::BTreeMap;

use leadtime_numerics::{Purpose, stream};
use safetensors::tensor::TensorView;

use super::*;

type Tensors = BTreeMap<&'static str, (Vec<usize>, Vec<f32>)>;

/// Makes a well-formed pilot of seeded random weights.
fn seeded(seed: u64) -> Tensors {
    let mut rng = stream(seed, Purpose::Initialise, 0, 0);
    let mut tensor = |shape: &[usize]| {
        let n = shape.iter().product();
        (shape.to_vec(), (0..n).map(|_| rng.uniform(-0.3, 0.3) as f32).collect())
    };
    BTreeMap::from([
        ("actor.0.weight", tensor(&[WIDTH, N_INPUTS])),
        ("actor.0.bias", tensor(&[WIDTH])),
        ("actor.1.weight", tensor(&[WIDTH, WIDTH])),
        ("actor.1.bias", tensor(&[WIDTH])),
        ("actor.head.weight", tensor(&[N_ENGINES, WIDTH])),
        ("actor.head.bias", tensor(&[N_ENGINES])),
        ("critic.head.bias", tensor(&[1])),
    ])
}

fn bytes(tensors: &Tensors) -> Vec<u8> {
    let little_endian = |numbers: &Vec<f32>| numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    let raw: Vec<Vec<u8>> = tensors.values().map(|(_, numbers)| little_endian(numbers)).collect();
    let views = tensors.iter().zip(&raw).map(|((name, (shape, _)), bytes)| {
        (*name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap())
    });
    safetensors::serialize(views, None).unwrap()
}

/// The network written down plainly, in double precision.
fn plain_logits(tensors: &Tensors, observation: &[f32; 8]) -> Vec<f64> {
    let mut x: Vec<f64> = observation.iter().map(|&v| f64::from(v)).collect();
    for prefix in ["actor.0", "actor.1", "actor.head"] {
        let find = |suffix: &str| {
            tensors.iter().find(|(name, _)| **name == format!("{prefix}.{suffix}")).unwrap().1
        };
        let (weight, bias) = (&find("weight").1, &find("bias").1);
        x = (0..bias.len())
            .map(|row| {
                let weights = &weight[row * x.len()..(row + 1) * x.len()];
                let sum: f64 = weights.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum();
                let y = sum + f64::from(bias[row]);
                if prefix == "actor.head" { y } else { libm::tanh(y) }
            })
            .collect();
    }
    x
}

#[test]
fn the_logits_are_those_of_the_plain_network() {
    let tensors = seeded(3);
    let pilot = Pilot::from_safetensors(&bytes(&tensors)).unwrap();
    let mut rng = stream(4, Purpose::World, 0, 0);
    for _ in 0..100 {
        let observation: [f32; 8] = std::array::from_fn(|_| rng.uniform(-1.5, 1.5) as f32);
        let plain = plain_logits(&tensors, &observation);
        for (ours, plain) in pilot.logits(&observation).iter().zip(&plain) {
            assert!((f64::from(*ours) - plain).abs() < 1e-5, "{ours} {plain}");
        }
        let best = plain.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
        assert!(plain[pilot.engine(&observation) as usize] > best - 1e-5);
    }
}

#[test]
fn a_normalizer_in_the_file_is_applied() {
    let mut tensors = seeded(3);
    let plain = Pilot::from_safetensors(&bytes(&tensors)).unwrap();
    tensors.insert("normalizer.mean", (vec![8], vec![0.5; 8]));
    tensors.insert("normalizer.variance", (vec![8], vec![4.0; 8]));
    let normalizing = Pilot::from_safetensors(&bytes(&tensors)).unwrap();
    let logits = normalizing.logits(&[1.0, 2.5, 0.5, -1.5, 100.0, -100.0, 0.5, 0.5]);
    let expected = plain.logits(&[0.25, 1.0, 0.0, -1.0, 10.0, -10.0, 0.0, 0.0]);
    for (found, expected) in logits.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    }
}

#[test]
fn a_file_that_is_not_a_pilot_is_named() {
    let refused = |bytes: &[u8]| Pilot::from_safetensors(bytes).unwrap_err().to_string();
    assert_eq!(refused(b"nothing"), "pilot weights cannot be read");
    let mut tensors = seeded(1);
    tensors.remove("actor.1.bias");
    assert_eq!(refused(&bytes(&tensors)), "pilot weights have no tensor `actor.1.bias`");
    tensors.insert("actor.1.bias", (vec![2], vec![0.0; 2]));
    let text = "tensor `actor.1.bias` is F32 [2], expected F32 [64]";
    assert_eq!(refused(&bytes(&tensors)), text);
    tensors.insert("actor.1.bias", (vec![WIDTH], vec![f32::NAN; WIDTH]));
    let text = "tensor `actor.1.bias` holds a number that cannot be used";
    assert_eq!(refused(&bytes(&tensors)), text);
}

#[test]
fn the_embedded_pilot_is_well_formed_and_says_where_it_comes_from() {
    let pilot = Pilot::embedded();
    assert!(pilot.logits(&[0.0; 8]).iter().all(|logit| logit.is_finite()));
    let (_, metadata) = SafeTensors::read_metadata(include_bytes!("pilot.safetensors")).unwrap();
    assert!(metadata.metadata().as_ref().is_some_and(|provenance| !provenance.is_empty()));
}

#[test]
fn engines_rest_only_on_two_still_legs() {
    assert!(engines_off(&[0.3, 0.0, 0.01, -0.01, 0.2, 0.1, 1.0, 1.0]));
    assert!(!engines_off(&[0.3, 0.0, 0.01, -0.01, 0.2, 0.1, 1.0, 0.0]));
    assert!(!engines_off(&[0.3, 0.0, 0.01, -0.09, 0.2, 0.1, 1.0, 1.0]));
}
