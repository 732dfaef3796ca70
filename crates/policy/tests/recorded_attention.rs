//! A small policy with attention and a normaliser, and what it computes, for whoever computes the same elsewhere.
//!
//! `tests/data/attention.safetensors` is the policy. Each line of `tests/data/attention.jsonl` has an `observation`, who is
//! present in its frames (`case`), the `logits` and the `value`. `UPDATE_RECORDED=1 cargo test -p leadtime-policy --test
//! recorded_attention` writes both anew.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use leadtime_policy::attention::presence_flags;
use leadtime_policy::parameters::shapes;
use leadtime_policy::{ObservationNormalizer, Parameters, Policy};
use leadtime_proto::{ActionSpec, EgoAttention, Encoder, EnvSpec, PolicySpec};
use serde_json::{Value, json};

const ATTENTION: EgoAttention =
    EgoAttention { n_frames: 2, n_entities: 4, n_features: 3, action_dim: 2, width: 8, n_heads: 2 };

/// Who is present, in the first frame and in the second one, the ego first.
const CASES: [(&str, [u8; 8]); 6] = [
    ("everybody", [1, 1, 1, 1, 1, 1, 1, 1]),
    ("some of the others", [1, 1, 0, 0, 1, 0, 1, 0]),
    ("the ego alone", [1, 0, 0, 0, 1, 0, 0, 0]),
    ("only others", [0, 1, 0, 1, 0, 0, 0, 1]),
    ("nobody", [0, 0, 0, 0, 0, 0, 0, 0]),
    ("nobody, then everybody", [0, 0, 0, 0, 1, 1, 1, 1]),
];

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name)
}

/// Spreads whole numbers over -0.5 to 0.5.
fn spread(n: usize, i: usize, j: usize) -> f32 {
    let sum = 31 * i * i + 17 * j * j + 13 * i * j + 57 * i + 101 * j + 211 * n;
    (sum % 1009) as f32 / 1009.0 - 0.5
}

/// An observation with these flags of presence.
fn observation(n: usize, flags: [u8; 8], obs_dim: usize) -> Vec<f32> {
    let mut row: Vec<f32> = (0..obs_dim).map(|i| 4.0 * spread(n, i, n) + i as f32 / 8.0).collect();
    for (place, flag) in presence_flags(&ATTENTION).zip(flags) {
        row[place] = flag.into();
    }
    row
}

/// The policy, whose normaliser has seen an ego that was always there.
fn policy() -> (PolicySpec, Parameters) {
    let obs_dim = ATTENTION.n_frames * ATTENTION.frame_dim() + 3;
    let env = EnvSpec { obs_dim, actions: ActionSpec::discrete("topic", 5), metrics: Vec::new() };
    let spec = PolicySpec {
        encoder: Encoder::EgoAttention(ATTENTION),
        normalize_observations: true,
        ..PolicySpec::dense(&env, &[8])
    };
    let tensor = |(n, (name, shape)): (usize, (String, Vec<usize>))| {
        let gain = if name == "encoder.query.weight" { 12.0 } else { 3.5 };
        let numbers: Vec<f32> = match shape[..] {
            [n_out, n_in] => {
                let gain = gain / (n_in as f32).sqrt();
                (0..n_out * n_in).map(|i| gain * spread(n, i / n_in, i % n_in)).collect()
            }
            _ => (0..shape[0]).map(|i| 0.4 * spread(n, i, 500)).collect(),
        };
        (name, numbers)
    };
    let values: BTreeMap<_, _> = shapes(&spec).into_iter().enumerate().map(tensor).collect();
    let mut normalizer = ObservationNormalizer::new(obs_dim);
    let seen = (0..50).flat_map(|n| {
        let there = |every: usize| u8::from(n % every != every - 1);
        let flags = [1, there(10), there(4), 0, 1, there(9), there(3), 0];
        observation(n, flags, obs_dim)
    });
    normalizer.update(&spec, &seen.collect::<Vec<f32>>());
    let parameters = Parameters::from_values(&spec, values, Some(normalizer)).expect("they fit");
    (spec, parameters)
}

fn file(spec: &PolicySpec, parameters: &Parameters) -> Vec<u8> {
    let metadata = BTreeMap::from([("architecture".to_owned(), json!(spec).to_string())]);
    parameters.to_safetensors(&metadata).expect("it can be written")
}

/// Lists what the policy computes, a line per case.
fn decisions(spec: &PolicySpec, parameters: &Parameters) -> Vec<Value> {
    let mut policy = Policy::new(spec, parameters).expect("the parameters fit");
    let decision = |(n, &(case, flags)): (usize, &(&str, [u8; 8]))| {
        let observation = observation(100 + n, flags, spec.obs_dim);
        let (mut logits, mut value) = (vec![f32::NAN; policy.n_choices()], [f32::NAN]);
        policy.evaluate(&observation, &mut [], &mut logits, &mut value);
        json!({"case": case, "observation": observation, "logits": logits, "value": value[0]})
    };
    CASES.iter().enumerate().map(decision).collect()
}

fn numbers(value: &Value) -> Vec<f64> {
    let one = |number: &Value| number.as_f64().expect("a number");
    value.as_array().map_or_else(|| vec![one(value)], |all| all.iter().map(one).collect())
}

#[test]
fn what_was_recorded_is_what_the_policy_computes() {
    let (spec, parameters) = policy();
    let (bytes, decisions) = (file(&spec, &parameters), decisions(&spec, &parameters));
    let (policy_file, lines) = (data("attention.safetensors"), data("attention.jsonl"));
    if std::env::var_os("UPDATE_RECORDED").is_some() {
        fs::write(&policy_file, &bytes).expect("the policy is written");
        let text: Vec<String> = decisions.iter().map(ToString::to_string).collect();
        fs::write(&lines, text.join("\n") + "\n").expect("the decisions are written");
    }
    assert!(fs::read(policy_file).expect("there is a policy") == bytes, "it is another policy");
    let recorded = fs::read_to_string(lines).expect("there are decisions");
    assert_eq!(recorded.lines().count(), CASES.len());
    for (line, found) in recorded.lines().zip(&decisions) {
        let recorded: Value = serde_json::from_str(line).expect("a line is JSON");
        assert_eq!(recorded["case"], found["case"]);
        for key in ["observation", "logits", "value"] {
            for (a, b) in numbers(&recorded[key]).into_iter().zip(numbers(&found[key])) {
                assert!((a - b).abs() < 1e-5, "{}, {key}: {a} {b}", found["case"]);
            }
        }
    }
}

#[test]
fn an_absent_entity_changes_nothing_and_a_present_one_does() {
    let (spec, parameters) = policy();
    let mut policy = Policy::new(&spec, &parameters).expect("the parameters fit");
    let mut logits = |observation: &[f32]| {
        let (mut logits, mut value) = (vec![f32::NAN; 5], [f32::NAN]);
        policy.evaluate(observation, &mut [], &mut logits, &mut value);
        logits
    };
    for (n, (case, flags)) in CASES.into_iter().enumerate() {
        let before = observation(100 + n, flags, spec.obs_dim);
        for (entity, flag) in presence_flags(&ATTENTION).enumerate() {
            let mut moved = before.clone();
            moved[flag + 1] += 1.5;
            let of_frame = &flags[entity / 4 * 4..][..4];
            // The ego is always looked from, and where nobody is present everybody counts.
            let counts = entity % 4 == 0 || flags[entity] == 1 || of_frame == [0; 4];
            assert_eq!(logits(&moved) != logits(&before), counts, "{case}, entity {entity}");
        }
    }
}
