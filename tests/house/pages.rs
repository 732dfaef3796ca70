//! What pages name is there: files on every page, and on ARCHITECTURE.md types and functions as well.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use crate::code::{all_sources, root};
use crate::glossary::words;

/// The page that leads a reader to the sources.
const MAP: &str = "ARCHITECTURE.md";
/// The pages, and folders of pages. Those of results are left out: they tell what was there when they were made.
const PAGES: [&str; 6] = [MAP, "GLOSSARY.md", "README.md", "docs", "docs/decisions", "docs/worlds"];
/// What a path begins with that is meant to be one of ours.
const FOLDERS: [&str; 13] = [
    "actor", "bench", "crates", "deploy", "docs", "examples", "fuzz", "learner", "proto", "python",
    "sims", "tests", "vendor",
];

/// Lists the pages, each with its text.
fn pages() -> Vec<(PathBuf, String)> {
    let files = |path: PathBuf| {
        if path.is_file() {
            return vec![path];
        }
        let entries = fs::read_dir(path).expect("the folder is there");
        let paths = entries.map(|entry| entry.expect("it can be listed").path());
        paths.filter(|path| path.extension().is_some_and(|end| end == "md")).collect()
    };
    let paths = PAGES.iter().flat_map(|page| files(root().join(page)));
    paths.map(|path| (path.clone(), fs::read_to_string(path).expect("pages are text"))).collect()
}

/// Lists what stands between backticks, each with its line; blocks of code are left out.
fn quoted(page: &str) -> Vec<(usize, &str)> {
    let (mut found, mut is_block) = (Vec::new(), false);
    for (i, line) in page.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            is_block = !is_block;
        } else if !is_block {
            found.extend(line.split('`').skip(1).step_by(2).map(|text| (i + 1, text)));
        }
    }
    found
}

/// Returns whether a word is the path of a file or folder of ours, without a placeholder in it.
fn is_path(word: &str) -> bool {
    let is_plain = word.chars().all(|c| c.is_ascii_alphanumeric() || "._-/".contains(c));
    is_plain && word.split_once('/').is_some_and(|(folder, _)| FOLDERS.contains(&folder))
}

/// Returns whether a text is a name, or names joined by `::` or dots.
fn is_name(text: &str) -> bool {
    let is_plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "_:.".contains(c));
    is_plain && text.starts_with(|c: char| c.is_ascii_alphabetic())
}

#[test]
fn every_file_that_a_page_names_is_there() {
    let (root, pages) = (root(), pages());
    let mut missing = Vec::new();
    for (path, page) in &pages {
        for (line, text) in quoted(page) {
            let paths = text.split_whitespace().filter(|word| is_path(word));
            let gone = paths.filter(|word| !root.join(word).exists());
            missing.extend(gone.map(|word| format!("{}:{line}: {word}", path.display())));
        }
    }
    assert_eq!(missing, [""; 0], "pages with their lines, and what they name that is nowhere");
    assert!(pages.len() >= 25, "{} pages", pages.len());
}

#[test]
fn every_name_of_the_architecture_is_in_the_sources() {
    let product = all_sources().iter().filter(|source| source.is_product());
    let known: BTreeSet<&str> = product.flat_map(|source| words(&source.text)).collect();
    let files: BTreeSet<&OsStr> =
        all_sources().iter().filter_map(|source| source.path.file_name()).collect();
    let page = fs::read_to_string(root().join(MAP)).expect("it is there");
    let is_file = |name: &str| Path::new(name).extension().is_some_and(|end| end == "rs");
    let is_there = |name: &str| {
        if is_file(name) {
            files.contains(OsStr::new(name))
        } else {
            words(name).all(|word| known.contains(word))
        }
    };
    let names: Vec<(usize, &str)> =
        quoted(&page).into_iter().filter(|(_, text)| is_name(text)).collect();
    assert!(names.len() > 100, "{} names", names.len());
    let missing: Vec<&(usize, &str)> = names.iter().filter(|(_, name)| !is_there(name)).collect();
    assert!(missing.is_empty(), "lines of {MAP}, and what they name that is nowhere: {missing:?}");
}

#[test]
fn paths_and_names_are_read_off_a_page() {
    let page = "`a b` and `sims/src`.\n```console\nleadtime `x`\n```\n``Rollout::check``";
    assert_eq!(quoted(page), [(1, "a b"), (1, "sims/src"), (5, ""), (5, "")]);
    assert!(is_path("crates/link/src/wire.rs") && is_path("docs/decisions/"));
    assert!(!is_path("runs/NAME") && !is_path("crates/taxonomy/data/<domain>/"));
    assert!(is_name("Rollout::check") && is_name("machine.rs") && !is_name("--trace"));
}
