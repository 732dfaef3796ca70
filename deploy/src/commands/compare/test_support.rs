//! What tests of several steps of a comparison begin with.

use std::path::Path;

use clap::Parser as _;

use super::catalog::Named;
use super::study::Study;
use crate::cli::{Cli, Command, CompareArgs};

/// Parses `leadtime compare t --runs RUNS` with more arguments.
pub(super) fn args(runs: &Path, more: &[&str]) -> CompareArgs {
    let runs = runs.to_str().unwrap();
    let words = ["leadtime", "compare", "t", "--runs", runs];
    let line = words.iter().chain(more);
    let Command::Compare(args) = Cli::try_parse_from(line).unwrap().command else { panic!() };
    args
}

/// Reads a study.
pub(super) fn study(name: &str, text: &str) -> Named {
    Named { name: name.to_owned(), study: Study::parse(text).unwrap() }
}
