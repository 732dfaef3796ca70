//! Ego attention against the reference network: weights from a closed form, one absent entity.
//!
//! Weights, input and expected output are those of the script that recorded `tests/data/highway_traces.json.gz`
//! (key `unit_attention`), which follows rl-agents (84df15ea). With
//! h(n, i, j) = ((31 i² + 17 j² + 13 ij + 57 i + 101 j + 211 n) mod 1009) / 1009 - 0.5,
//! weight `[i][j]` of layer n is g h(n, i, j) / √inputs with g = 3.5 (the query's: 40), bias `[i]` is 0.4 h(n, i, 500).

use std::collections::BTreeMap;
use std::io::Read as _;

use flate2::read::GzDecoder;
use leadtime_policy::Parameters;
use leadtime_policy::attention::{Attention, AttentionEncoder};
use leadtime_policy::parameters::shapes;
use leadtime_proto::{ActionSpec, EgoAttention, Encoder, EnvSpec, PolicySpec};
use serde_json::Value;

const SPEC: EgoAttention = EgoAttention {
    n_frames: 1,
    n_entities: 5,
    n_features: 5,
    action_dim: 0,
    width: 64,
    n_heads: 2,
};

/// Layers of the closed form, numbered from 1.
const LAYERS: [&str; 8] =
    ["ego.0", "ego.1", "others.0", "others.1", "key", "value", "query", "combine"];

fn h(n: usize, i: usize, j: usize) -> f64 {
    let sum = 31 * i * i + 17 * j * j + 13 * i * j + 57 * i + 101 * j + 211 * n;
    (sum % 1009) as f64 / 1009.0 - 0.5
}

fn policy(n_frames: usize, action_dim: usize) -> PolicySpec {
    let attention = EgoAttention { n_frames, action_dim, ..SPEC };
    let (obs_dim, actions) =
        (n_frames * attention.frame_dim(), ActionSpec::discrete("initiate", 2));
    let plain = PolicySpec::dense(&EnvSpec { obs_dim, actions, metrics: Vec::new() }, &[8]);
    PolicySpec { encoder: Encoder::EgoAttention(attention), ..plain }
}

fn parameters(spec: &PolicySpec) -> Parameters {
    let mut values = BTreeMap::new();
    for (name, shape) in shapes(spec) {
        let number = LAYERS.iter().position(|layer| name.starts_with(&format!("encoder.{layer}.")));
        let numbers: Vec<f32> = match (number.map(|n| n + 1), &shape[..]) {
            (None, shape) => vec![0.0; shape.iter().product()],
            (Some(n), &[n_out, n_in]) => {
                let gain = if n == 7 { 40.0 } else { 3.5 } / (n_in as f64).sqrt();
                let weight = |i, j| (gain * h(n, i, j)) as f32;
                (0..n_out).flat_map(|i| (0..n_in).map(move |j| weight(i, j))).collect()
            }
            (Some(n), shape) => (0..shape[0]).map(|i| (0.4 * h(n, i, 500)) as f32).collect(),
        };
        values.insert(name, numbers);
    }
    Parameters::from_values(spec, values, None).expect("the closed form fits")
}

fn vector() -> Value {
    let packed = include_bytes!("../../../tests/data/highway_traces.json.gz");
    let mut text = String::new();
    GzDecoder::new(packed.as_slice()).read_to_string(&mut text).expect("the traces are gzip");
    serde_json::from_str::<Value>(&text).expect("the traces are JSON")["unit_attention"].clone()
}

fn numbers(value: &Value) -> Vec<f32> {
    match value {
        Value::Array(values) => values.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().expect("a number") as f32],
    }
}

fn assert_close(found: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(found.len(), expected.len());
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() < tolerance, "{i}: {found} {expected}");
    }
}

#[test]
fn the_encoding_is_that_of_the_reference() {
    let (spec, vector) = (policy(1, 0), vector());
    let mut encoder = AttentionEncoder::new(&SPEC, 25, &parameters(&spec)).unwrap();
    let mut features = vec![f32::NAN; 64];
    encoder.encode(&numbers(&vector["input"]), &mut features);
    assert_close(&features, &numbers(&vector["output"]), 1e-6);
    assert_close(&features[..3], &[0.062_944_32, -0.075_193_07, -0.142_027_99], 1e-6);
}

#[test]
fn every_frame_of_a_history_is_encoded_alike_and_actions_are_passed_on() {
    let (mut spec, vector) = (policy(3, 2), vector());
    spec.obs_dim += 1;
    let Encoder::EgoAttention(attention) = &spec.encoder else { panic!("it is attention") };
    let mut encoder = AttentionEncoder::new(attention, spec.obs_dim, &parameters(&spec)).unwrap();
    let mut observation = Vec::new();
    for action in [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]] {
        observation.extend(numbers(&vector["input"]));
        observation.extend(action);
    }
    observation.push(6.0);
    let mut features = vec![f32::NAN; encoder.feature_dim()];
    encoder.encode(&observation, &mut features);
    assert_eq!(features.pop(), Some(6.0), "what follows the frames");
    for (frame, action) in features.chunks_exact(66).zip([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]) {
        assert_close(&frame[..64], &numbers(&vector["output"]), 1e-6);
        assert_eq!(frame[64..], action);
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let spec = policy(1, 0);
    let error = AttentionEncoder::new(&SPEC, 24, &parameters(&spec)).unwrap_err();
    assert_eq!(error.to_string(), "impossible architecture");
    let encoder = Encoder::EgoAttention(EgoAttention { n_heads: 3, ..SPEC });
    let odd = PolicySpec { encoder, ..policy(1, 0) };
    assert!(Parameters::initialize(&odd, 1).is_err());
    assert_eq!(Attention { width: 64, n_heads: 2 }.head_width(), 32);
}
