//! Ego attention in the learner: the bits of an actor, which has the reference's numbers, and gradients through the
//! whole history.

use leadtime_numerics::Pcg64;
use leadtime_policy::Parameters;
use leadtime_policy::attention::AttentionEncoder;
use leadtime_proto::{ActionSpec, EgoAttention, Encoder, EnvSpec};

use super::*;
use crate::network::ActorCritic;

const SMALL: EgoAttention =
    EgoAttention { n_frames: 3, n_entities: 4, n_features: 3, action_dim: 2, width: 8, n_heads: 2 };

fn policy(attention: EgoAttention, rest: usize) -> PolicySpec {
    let obs_dim = attention.n_frames * attention.frame_dim() + rest;
    let actions = ActionSpec::discrete("initiate", 2);
    let plain = PolicySpec::dense(&EnvSpec { obs_dim, actions, metrics: Vec::new() }, &[16]);
    PolicySpec { encoder: Encoder::EgoAttention(attention), ..plain }
}

/// What actor and critic see.
fn encode(spec: &PolicySpec, parameters: &Parameters, observations: &[f32]) -> Vec<f32> {
    forward(&mut packed(spec, parameters), spec, observations).to_vec()
}

fn forward<'a>(encoder: &'a mut EncoderPass, spec: &PolicySpec, observations: &[f32]) -> &'a [f32] {
    let samples: Vec<usize> = (0..observations.len() / spec.obs_dim).collect();
    let input = EncoderInput { observations, samples: &samples, obs_dim: spec.obs_dim };
    encoder.forward(input, Sequences::default(), &Team::default())
}

fn packed(spec: &PolicySpec, parameters: &Parameters) -> EncoderPass {
    let network = ActorCritic::new(spec, parameters).unwrap();
    let mut encoder = EncoderPass::new(spec).unwrap();
    encoder.pack(&network.vars).unwrap();
    encoder
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
        let Encoder::EgoAttention(attention) = &spec.encoder else { panic!("it is attention") };
        let mut encoder = AttentionEncoder::new(attention, spec.obs_dim, &parameters).unwrap();
        let mut features = vec![f32::NAN; 70 * encoder.feature_dim()];
        encoder.encode(&raw, &mut features);
        assert_eq!(encode(&spec, &parameters, &raw), features);
    }
}

#[test]
fn gradients_go_through_every_frame_and_are_those_of_small_steps() {
    let spec = policy(SMALL, 3);
    let parameters = Parameters::initialize(&spec, 5).unwrap();
    let raw = observations(20, &spec);
    let feature_dim = encode(&spec, &parameters, &raw).len() / 20;
    for frame in 0..SMALL.n_frames {
        // A loss that looks at the encoding of one frame only: the sum of its squares.
        let start = frame * (SMALL.width + SMALL.action_dim);
        let of_frame = |i: usize| (start..start + SMALL.width).contains(&(i % feature_dim));
        let loss = |parameters: &Parameters| -> f64 {
            let features = encode(&spec, parameters, &raw).into_iter().enumerate();
            features.filter(|(i, _)| of_frame(*i)).map(|(_, x)| f64::from(x) * f64::from(x)).sum()
        };
        let mut encoder = packed(&spec, &parameters);
        let features = forward(&mut encoder, &spec, &raw).iter().enumerate();
        let slopes: Vec<f32> =
            features.map(|(i, x)| if of_frame(i) { 2.0 * x } else { 0.0 }).collect();
        let mut gradients = Gradients::new();
        encoder.backward(&slopes, &mut gradients, &Team::default());
        for (name, gradient) in &gradients {
            let steepest = (0..gradient.len())
                .max_by(|&a, &b| gradient[a].abs().total_cmp(&gradient[b].abs()))
                .unwrap();
            let moved = |step: f32| {
                let all = parameters.tensors().keys();
                let all = all.map(|other| (other.clone(), parameters.values(other).unwrap()));
                let mut all: BTreeMap<_, _> = all.collect();
                all.get_mut(name).unwrap()[steepest] += step;
                let moved = Parameters::from_values(&spec, all, None).unwrap();
                loss(&moved)
            };
            let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
            let found = f64::from(gradient[steepest]);
            let tolerance = 0.03 * found.abs() + 2e-2;
            assert!(found.abs() > 1e-3, "{name}, frame {frame}: no gradient");
            assert!((found - slope).abs() < tolerance, "{name}, frame {frame}: {found} {slope}");
        }
    }
}
