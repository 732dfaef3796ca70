//! What tests of several steps begin with.

use std::path::Path;

use leadtime_runs::{ProgramBuild, Tasks};

use crate::catalog::NamedStudy;
use crate::error::Error;
use crate::plan::StudyPlan;
use crate::request::{EPISODES, EVAL_SEED, StudyRequest};
use crate::study::Study;

/// Asks for whole studies, as `leadtime compare` does without options.
pub(crate) fn request(runs: &Path) -> StudyRequest {
    StudyRequest {
        quick: false,
        rows: Vec::new(),
        parts: Vec::new(),
        set: Vec::new(),
        profiles: Vec::new(),
        seeds: None,
        steps: None,
        episodes: EPISODES,
        eval_seed: EVAL_SEED,
        runs: runs.to_owned(),
        out: None,
        command: "leadtime compare t".to_owned(),
        build: ProgramBuild::default(),
    }
}

/// Reads a study.
pub(crate) fn study(name: &str, text: &str) -> NamedStudy {
    NamedStudy { name: name.to_owned(), study: Study::parse(name, text).unwrap() }
}

/// Writes the chain of an error as the program prints it.
pub(crate) fn sentence<T>(result: Result<T, Error>) -> String {
    let error = result.err().expect("it is refused");
    let first: &dyn std::error::Error = &error;
    let chain = std::iter::successors(Some(first), |error| error.source());
    chain.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// Plans the study `t`.
pub(crate) fn plan(text: &str, request: &StudyRequest) -> Result<StudyPlan, Error> {
    StudyPlan::new(&Tasks::new(), study("t", text), request)
}
