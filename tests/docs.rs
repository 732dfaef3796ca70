//! What pages show of the program's output is what it prints.
//!
//! A page has `<!-- begin COMMAND -->`, the output, `<!-- end -->`. `UPDATE_DOCS=1 cargo test -p leadtime --test docs` writes the
//! outputs anew.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

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
