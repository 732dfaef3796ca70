//! The policies that come with the program do what their table says.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::Place;

/// Episodes per policy.
const N_EPISODES: u32 = 60;
/// Standard errors by which so few episodes may miss the table's figure.
const N_ERRORS: f64 = 3.5;

fn policies() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("policies")
}

/// The table's rows: a file and its success with greedy choices.
fn rows() -> Vec<(String, f64)> {
    let text = fs::read_to_string(policies().join("README.md")).unwrap();
    let cells = |line: &str| line.split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>();
    let row = |row: Vec<String>| {
        let (success, _) = row[3].split_once(' ').unwrap();
        (row[1].trim_matches('`').to_owned(), success.parse().unwrap())
    };
    text.lines().filter(|line| line.starts_with("| `")).map(cells).map(row).collect()
}

#[test]
fn a_policy_says_what_it_sees_and_chooses() {
    for (file, _) in rows() {
        let bytes = fs::read(policies().join(&file)).unwrap();
        let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
        let metadata = |key: &str| -> Value {
            serde_json::from_str(header["__metadata__"][key].as_str().unwrap()).unwrap()
        };
        let (architecture, actions) = (metadata("architecture"), metadata("actions"));
        let names = metadata("observation");
        assert_eq!(architecture["obs_dim"], names.as_array().unwrap().len(), "{file}");
        let heads = architecture["actions"]["heads"].as_array().unwrap();
        assert_eq!(heads.len(), actions.as_array().unwrap().len(), "{file}");
        for (head, named) in heads.iter().zip(actions.as_array().unwrap()) {
            assert_eq!(head["name"], named["name"], "{file}");
            assert_eq!(head["n_choices"], named["choices"].as_array().unwrap().len(), "{file}");
        }
    }
}

#[test]
fn every_policy_that_is_shipped_reproduces_its_row() {
    let place = Place::new();
    let rows = rows();
    let files = fs::read_dir(policies()).unwrap().count();
    assert_eq!(rows.len(), files - 1, "a row for every file but the page itself");
    for (file, expected) in rows {
        let path = policies().join(&file);
        let more = format!("--action greedy --json --episodes {N_EPISODES} --eval-seed 3000000");
        let evaluated = place.finish(&["eval", path.to_str().unwrap(), &more]).with_code(0).json();
        let measures = evaluated["comparison"]["summaries"][0]["measures"].as_array().unwrap();
        let success = measures.iter().find(|measure| measure["name"] == "success").unwrap();
        let success = success["interval"]["estimate"].as_f64().unwrap();
        let error = (expected * (1.0 - expected) / f64::from(N_EPISODES)).sqrt();
        let is_near = (success - expected).abs() <= N_ERRORS * error;
        assert!(is_near, "{file}: {success}, not {expected}");
    }
}
