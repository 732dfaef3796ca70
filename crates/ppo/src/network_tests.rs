//! Ego attention in the learner: the reference's numbers, an actor's bits, and gradients through the whole history.

use std::io::Read as _;

use candle_core::{DType, Device};
use flate2::read::GzDecoder;
use leadtime_numerics::Pcg64;
use leadtime_policy::Policy;
use leadtime_policy::attention::AttentionEncoder;
use leadtime_policy::parameters::shapes;
use leadtime_proto::{ActionSpec, EgoAttention, Encoder, HeadCredit};
use serde_json::Value;

use super::*;

const REFERENCE: EgoAttention = EgoAttention {
    n_frames: 1,
    n_entities: 5,
    n_features: 5,
    action_dim: 0,
    width: 64,
    n_heads: 2,
};

const SMALL: EgoAttention =
    EgoAttention { n_frames: 3, n_entities: 4, n_features: 3, action_dim: 2, width: 8, n_heads: 2 };

fn policy(attention: EgoAttention, rest: usize) -> PolicySpec {
    PolicySpec {
        obs_dim: attention.n_frames * attention.frame_dim() + rest,
        encoder: Encoder::EgoAttention(attention),
        hidden: vec![16],
        actions: ActionSpec::discrete("initiate", 2),
        head_credit: HeadCredit::All,
        logit_bias: Vec::new(),
        normalize_observations: false,
    }
}

fn flat(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// The closed form of the reference's weights; see `crates/policy/tests/ego_attention.rs`.
fn reference_weights(spec: &PolicySpec) -> Parameters {
    let layers = ["ego.0", "ego.1", "others.0", "others.1", "key", "value", "query", "combine"];
    let h = |n: usize, i: usize, j: usize| {
        let sum = 31 * i * i + 17 * j * j + 13 * i * j + 57 * i + 101 * j + 211 * n;
        (sum % 1009) as f64 / 1009.0 - 0.5
    };
    let numbers = |(name, shape): (String, Vec<usize>)| {
        let n = layers.iter().position(|layer| name.starts_with(&format!("encoder.{layer}.")));
        let numbers: Vec<f32> = match (n.map(|n| n + 1), &shape[..]) {
            (None, shape) => vec![0.0; shape.iter().product()],
            (Some(n), &[n_out, n_in]) => {
                let gain = if n == 7 { 40.0 } else { 3.5 } / (n_in as f64).sqrt();
                let row = |i| (0..n_in).map(move |j| (gain * h(n, i, j)) as f32);
                (0..n_out).flat_map(row).collect()
            }
            (Some(n), shape) => (0..shape[0]).map(|i| (0.4 * h(n, i, 500)) as f32).collect(),
        };
        (name, numbers)
    };
    Parameters::from_values(spec, shapes(spec).into_iter().map(numbers).collect(), None).unwrap()
}

fn vector() -> Value {
    let packed = include_bytes!("../../../tests/data/highway_traces.json.gz");
    let mut text = String::new();
    GzDecoder::new(packed.as_slice()).read_to_string(&mut text).unwrap();
    serde_json::from_str::<Value>(&text).unwrap()["unit_attention"].clone()
}

fn numbers(value: &Value) -> Vec<f32> {
    match value {
        Value::Array(values) => values.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().unwrap() as f32],
    }
}

#[test]
fn the_encoding_is_that_of_the_reference() {
    let (spec, vector) = (policy(REFERENCE, 0), vector());
    let network = ActorCritic::new(&spec, &reference_weights(&spec)).unwrap();
    let input = Tensor::from_vec(numbers(&vector["input"]), (1, 25), &Device::Cpu).unwrap();
    let found = flat(&network.encode(&input, &Arc::default()).unwrap());
    let expected = numbers(&vector["output"]);
    assert_eq!(found.len(), expected.len());
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() < 1e-6, "{i}: {found} {expected}");
    }
}

/// Observations of which one entity in five is absent.
fn observations(n: usize, spec: &PolicySpec) -> Vec<f32> {
    let mut generator = Pcg64::seed_from_u64(4);
    let mut draw = || generator.uniform(-1.5, 1.5) as f32;
    let mut values: Vec<f32> = (0..n * spec.obs_dim).map(|_| draw()).collect();
    let Encoder::EgoAttention(attention) = &spec.encoder else { panic!("it is attention") };
    for (i, observation) in values.chunks_exact_mut(spec.obs_dim).enumerate() {
        let frames = observation.chunks_exact_mut(attention.frame_dim());
        for (f, frame) in frames.take(attention.n_frames).enumerate() {
            for entity in 0..attention.n_entities {
                let there = (i + f + entity) % 5 != 3;
                frame[entity * attention.n_features] = f32::from(u8::from(there));
            }
        }
    }
    values
}

#[test]
fn learner_and_actor_compute_the_same_bits() {
    let wide = EgoAttention { n_entities: 10, n_features: 7, width: 64, ..SMALL };
    for spec in [policy(SMALL, 3), policy(wide, 0)] {
        let parameters = Parameters::initialize(&spec, 5).unwrap();
        let raw = observations(70, &spec);
        let input = Tensor::from_slice(&raw, (70, spec.obs_dim), &Device::Cpu).unwrap();
        let network = ActorCritic::new(&spec, &parameters).unwrap();
        let Encoder::EgoAttention(attention) = &spec.encoder else { panic!("it is attention") };
        let mut encoder = AttentionEncoder::new(attention, spec.obs_dim, &parameters).unwrap();
        let mut features = vec![f32::NAN; 70 * encoder.feature_dim()];
        encoder.encode(&raw, &mut features);
        assert_eq!(flat(&network.encode(&input, &Arc::default()).unwrap()), features);
        let (logits, values) = network.forward(&input, &Arc::default()).unwrap();
        let mut acting = Policy::new(&spec, &parameters).unwrap();
        let (mut acted, mut valued) = (vec![0.0; 140], vec![0.0; 70]);
        acting.evaluate(&raw, &mut [], &mut acted, &mut valued);
        assert_eq!((flat(&logits), flat(&values)), (acted, valued));
    }
}

#[test]
fn gradients_go_through_every_frame_and_are_those_of_small_steps() {
    let spec = policy(SMALL, 3);
    let parameters = Parameters::initialize(&spec, 5).unwrap();
    let raw = observations(20, &spec);
    let input = Tensor::from_slice(&raw, (20, spec.obs_dim), &Device::Cpu).unwrap();
    for frame in 0..SMALL.n_frames {
        // A loss that looks at the encoding of one frame only.
        let loss = |network: &ActorCritic| {
            let start = frame * (SMALL.width + SMALL.action_dim);
            let encoded = network
                .encode(&input, &Arc::default())
                .unwrap()
                .narrow(1, start, SMALL.width)
                .unwrap();
            (encoded.sqr().unwrap().to_dtype(DType::F64).unwrap()).sum_all().unwrap()
        };
        let network = ActorCritic::new(&spec, &parameters).unwrap();
        let gradients = network.gradients(&loss(&network)).unwrap();
        for name in network.vars().keys().filter(|name| name.starts_with("encoder.")) {
            let gradient = flat(&gradients[name]);
            let steepest = (0..gradient.len())
                .max_by(|&a, &b| gradient[a].abs().total_cmp(&gradient[b].abs()))
                .unwrap();
            let moved = |step: f32| {
                let all = parameters.tensors().keys();
                let all = all.map(|other| (other.clone(), parameters.values(other).unwrap()));
                let mut all: BTreeMap<_, _> = all.collect();
                all.get_mut(name).unwrap()[steepest] += step;
                let moved = Parameters::from_values(&spec, all, None).unwrap();
                let network = ActorCritic::new(&spec, &moved).unwrap();
                loss(&network).to_scalar::<f64>().unwrap()
            };
            let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
            let found = f64::from(gradient[steepest]);
            let tolerance = 0.03 * found.abs() + 2e-2;
            assert!(found.abs() > 1e-3, "{name}, frame {frame}: no gradient");
            assert!((found - slope).abs() < tolerance, "{name}, frame {frame}: {found} {slope}");
        }
    }
}
