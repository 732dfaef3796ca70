//! What pages show of the program's output is what it prints.
//!
//! A page has `<!-- begin COMMAND -->`, the output, `<!-- end -->`. `UPDATE_DOCS=1 cargo test -p leadtime --test docs` writes the
//! outputs anew. What README's tables say of whole trainings is in `docs/results/smoke_*.json`, which `docs/check.sh --write`
//! writes anew.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

const BEGIN: &str = "<!-- begin ";
const END: &str = "<!-- end -->";

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs")
}

fn output(arguments: &[&str]) -> String {
    let mut program = Command::new(env!("CARGO_BIN_EXE_leadtime"));
    let finished = program.args(arguments).output().expect("the program starts");
    let error = String::from_utf8_lossy(&finished.stderr);
    assert!(finished.status.success(), "{arguments:?}: {error}");
    String::from_utf8(finished.stdout).expect("it prints text")
}

/// Returns the page with every marked part as the program prints it now, and how many there are.
fn renewed(page: &str) -> (String, usize) {
    let (mut new, mut rest, mut n_parts) = (String::new(), page, 0);
    while let Some((before, marked)) = rest.split_once(BEGIN) {
        let (command, marked) = marked.split_once(" -->\n").expect("a marker ends with its line");
        let (_, after) = marked.split_once(END).expect("a marked part has an end");
        let arguments: Vec<&str> = command.split(' ').skip(1).collect();
        new += &[before, BEGIN, command, " -->\n", &output(&arguments), END].concat();
        (rest, n_parts) = (after, n_parts + 1);
    }
    (new + rest, n_parts)
}

#[test]
fn the_pages_show_what_the_program_prints() {
    let pages = fs::read_dir(docs().join("worlds")).unwrap().map(|entry| entry.unwrap().path());
    let mut n_all = 0;
    for path in pages {
        let page = fs::read_to_string(&path).unwrap();
        let (new, n_parts) = renewed(&page);
        n_all += n_parts;
        if std::env::var_os("UPDATE_DOCS").is_some() {
            fs::write(&path, &new).unwrap();
            continue;
        }
        let told = "is not what the program prints; UPDATE_DOCS=1 updates it";
        assert!(page == new, "{} {told}", path.display());
    }
    assert!(n_all >= 6, "{n_all} parts");
}

#[test]
fn every_page_of_results_says_what_made_its_figures() {
    let pages = fs::read_dir(docs().join("results")).unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.filter(|path| path.extension().is_some_and(|end| end == "md"));
    // The index has a line for every table, and the verdict is a part of it.
    let stands_alone =
        |path: &PathBuf| !path.ends_with("README.md") && !path.ends_with("verdict.md");
    let mut n_pages = 0;
    for path in pages.filter(stands_alone) {
        let page = fs::read_to_string(&path).unwrap();
        let (_, said) = page.split_once("## Where these numbers are from\n").unwrap_or_default();
        let is_table = said.contains("* command: `leadtime ") && said.contains("* program: ");
        let is_told = said.contains(", commit ") || said.contains("the build");
        assert!(is_table || is_told, "{}: which command, which build?", path.display());
        n_pages += 1;
    }
    assert!(n_pages >= 18, "{n_pages} pages");
}

/// The rows of README's tables of `smoke`: the domain, how the row begins, and its measure.
const SMOKE_ROWS: [(&str, &str, &str); 6] = [
    ("lander", "success: on the pad", "success"),
    ("lander", "enters danger", "enter_danger"),
    ("lander", "notifications per step", "notifications_per_step"),
    ("lander", "follow-through, of initiated", "followed_of_initiated"),
    ("highway", "`highway`: ", "success"),
    ("steakhouse", "`steakhouse`: ", "success"),
];
/// The columns of these tables; in some there is the first minus the second as well.
const PLAYERS: [&str; 4] = ["trained", "unaided", "heuristic", "untrained"];

/// Returns what `smoke` found in a domain.
fn smoke_result(domain: &str) -> Value {
    let path = docs().join(format!("results/smoke_{domain}.json"));
    let text = fs::read_to_string(&path);
    let remedy = "docs/check.sh --write writes it";
    let text = text.unwrap_or_else(|error| panic!("{}: {error}; {remedy}", path.display()));
    serde_json::from_str::<Value>(&text).expect("it is JSON")["comparison"].take()
}

/// Finds the object of a list whose keys have these values.
fn find<'a>(list: &'a Value, keys: &[(&str, &str)]) -> &'a Value {
    let has = |item: &&Value| keys.iter().all(|(key, value)| item[*key] == **value);
    let list = list.as_array().expect("it is a list");
    list.iter().find(has).unwrap_or_else(|| panic!("{keys:?} is not there"))
}

/// Returns by how much training raises success.
fn gain(found: &Value) -> &Value {
    let keys = [("measure", "success"), ("of", "trained"), ("minus", "unaided")];
    &find(&found["differences"], &keys)["interval"]
}

/// Returns whether a cell has an estimate, and the bounds if it gives them, each as it is when rounded to the digits that are given.
fn is_shown(cell: &str, interval: &Value) -> bool {
    if cell == "–" {
        return interval.is_null();
    }
    let plain = cell.replace(['*', '[', ']', ','], " ");
    let said: Vec<&str> = plain.split_whitespace().collect();
    let fits = |(word, name): (&&str, &str)| {
        // A whole number stands for one with two decimals.
        let n_digits = word.split_once('.').map_or(2, |(_, decimals)| decimals.len());
        let slack = 0.51 * 10_f64.powi(-(n_digits as i32));
        let (number, value) = (word.parse::<f64>().ok(), interval[name].as_f64());
        number.zip(value).is_some_and(|(number, value)| (number - value).abs() <= slack)
    };
    matches!(said.len(), 1 | 3) && said.iter().zip(["estimate", "low", "high"]).all(fits)
}

#[test]
fn the_readme_has_what_smoke_found() {
    let readme = fs::read_to_string(docs().join("../README.md")).unwrap();
    for (domain, row, measure) in SMOKE_ROWS {
        let found = smoke_result(domain);
        let of = |player: &&str| {
            let summary = find(&found["summaries"], &[("player", *player)]);
            &find(&summary["measures"], &[("name", measure)])["interval"]
        };
        let line = readme.lines().find(|line| line.starts_with(&format!("| {row}")));
        let line = line.unwrap_or_else(|| panic!("README has no row `{row}`"));
        let cells: Vec<&str> = line.trim_matches('|').split('|').skip(1).map(str::trim).collect();
        assert!(matches!(cells.len(), 4 | 5), "{line}");
        for (cell, interval) in cells.iter().zip(PLAYERS.iter().map(of).chain([gain(&found)])) {
            assert!(is_shown(cell, interval), "README says {cell} in `{row}`, it is {interval}");
        }
    }
    let found = smoke_result("lander");
    let (_, said) = readme.split_once("Success rises by ").unwrap();
    let (said, _) = said.split_once(']').unwrap();
    let risen = gain(&found);
    assert!(is_shown(said, risen), "README says that success rises by {said}], it is {risen}");
}

#[test]
fn cells_are_compared_by_the_digits_that_they_show() {
    let interval = serde_json::json!({"estimate": 0.985, "low": 0.0, "high": 1.0});
    for same in ["**.99** [.00, 1]", ".985", "+0.99 [0, 1.00]"] {
        assert!(is_shown(same, &interval), "{same}");
    }
    for other in [".98 [.01, 1]", ".99 [.00, .99]", "1", "–", "", ".99 [.00]", "none"] {
        assert!(!is_shown(other, &interval), "{other}");
    }
    assert!(is_shown("–", &Value::Null) && !is_shown("0", &Value::Null));
}

#[test]
fn a_policy_is_described_as_its_task() {
    let policy = concat!(env!("CARGO_MANIFEST_DIR"), "/policies/piloting.safetensors");
    let described = output(&["describe", policy]);
    assert!(described.starts_with("Observation: 89 numbers"), "{described}");
}

#[test]
fn a_description_fits_the_terminal() {
    let tasks = [
        "lander",
        "paper_lander_hard",
        "paper_letter_lander",
        "highway",
        "steakhouse",
        "cartpole",
        "cue_recall",
        "pilot",
    ];
    for task in tasks {
        for line in output(&["describe", task]).lines() {
            assert!(line.chars().count() <= 80, "{task}: {line}");
        }
    }
}
