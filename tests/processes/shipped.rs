//! The policies that come with the program do what their table says.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{PATIENCE, Place};

/// Episodes per policy and way to choose.
const N_EPISODES: u32 = 60;
/// Standard errors by which so few episodes may miss the table's figure.
const N_ERRORS: f64 = 3.5;
/// Standard errors in the width of a 95 % interval.
const INTERVAL_ERRORS: f64 = 3.92;
/// What the table's digits may be off by, and means of few episodes most of which are alike.
const SLACK: f64 = 0.005;
/// The table's columns after file and task: how they are headed, how choices are made, and what `eval` calls the measure.
const COLUMNS: [(&str, &str, &str); 4] = [
    ("greedy", "greedy", "success"),
    ("sampled", "sample", "success"),
    ("messages per step, greedy", "greedy", "notifications_per_step"),
    ("followed, greedy", "greedy", "followed_of_initiated"),
];

fn policies() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("policies")
}

/// The table's rows: a file, and its figures in the order of [`COLUMNS`].
fn rows() -> Vec<(String, [f64; COLUMNS.len()])> {
    let text = fs::read_to_string(policies().join("README.md")).unwrap();
    let headings = COLUMNS.map(|(heading, ..)| heading).join(" | ");
    assert!(text.contains(&format!("| file | task | {headings} |\n")), "other columns: {headings}");
    let row = |line: &str| {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let figure = |column: usize| -> f64 {
            let (figure, _) = cells[column].split_once(' ').unwrap_or((cells[column], ""));
            figure.parse().unwrap()
        };
        (cells[1].trim_matches('`').to_owned(), [figure(3), figure(4), figure(5), figure(6)])
    };
    text.lines().filter(|line| line.starts_with("| `")).map(row).collect()
}

/// A measure of a policy's evaluation: its mean, and the width of its interval.
fn measured(evaluated: &Value, name: &str) -> (f64, f64) {
    let measures = evaluated["comparison"]["summaries"][0]["measures"].as_array().unwrap();
    let measure = measures.iter().find(|measure| measure["name"] == name).unwrap();
    let number = |key: &str| measure["interval"][key].as_f64().unwrap();
    (number("estimate"), number("high") - number("low"))
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
        let running = ["greedy", "sample"].map(|action| {
            let more =
                format!("--action {action} --json --episodes {N_EPISODES} --eval-seed 3000000");
            (action, place.start(&["eval", path.to_str().unwrap(), &more]))
        });
        let evaluated =
            running.map(|(action, run)| (action, run.finish(PATIENCE).with_code(0).json()));
        for ((heading, action, measure), expected) in COLUMNS.into_iter().zip(expected) {
            let (_, evaluated) = evaluated.iter().find(|(made, _)| *made == action).unwrap();
            let (mean, width) = measured(evaluated, measure);
            let tolerance = N_ERRORS * width / INTERVAL_ERRORS + SLACK;
            let is_near = (mean - expected).abs() <= tolerance;
            assert!(is_near, "{file}, {heading}: {mean}, not {expected} (within {tolerance:.3})");
        }
    }
}
