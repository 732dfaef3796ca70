//! What tests of several steps begin with.

use std::path::Path;

use leadtime_config::Config;
use leadtime_runs::{LAST_POLICY, ProgramBuild, ResultCause, RunRecord, RunResult, Tasks};

use crate::catalog::NamedStudy;
use crate::error::Error;
use crate::plan::StudyPlan;
use crate::request::{EPISODES, EVAL_SEED, StudyRequest};
use crate::study::Study;

/// Asks for whole studies, as `leadtime compare` does without options.
pub(crate) fn request(runs: &Path) -> StudyRequest {
    StudyRequest {
        episodes: EPISODES,
        eval_seed: EVAL_SEED,
        runs: runs.to_owned(),
        command: "leadtime compare t".to_owned(),
        ..StudyRequest::default()
    }
}

/// A small study: what a row trains on and is evaluated on differs, and comes to the same for the last row.
pub(crate) const STUDY: &str = r#"
title = "t"
lead = "l"
[[parts]]
name = "piloting"
title = "Piloting"
profile = "lander"
quick_steps = 4096
columns = ["success"]
evaluations = [
    { name = "own", title = "own" },
    { name = "real", title = "real", set.human.reaction_delay = { fixed = 2 } },
]
[[parts.rows]]
name = "script"
title = "Script"
script = "heuristic"
[[parts.rows]]
name = "prompt"
title = "Prompt"
set.human.reaction_delay = { fixed = 0 }
[[parts.rows]]
name = "real_one"
title = "Real"
"#;

/// A study of a task without scripted players.
pub(crate) const CART: &str = r#"
title = "t"
lead = "l"
[[parts]]
name = "cart"
title = "Cart"
profile = "cartpole"
quick_steps = 512
columns = ["return"]
evaluations = [{ name = "own", title = "own" }, { name = "long", title = "long", set.world.max_steps = 300 }]
differences = [{ of = "b", minus = "a", on = "long", measure = "return" }]
[[parts.rows]]
name = "a"
title = "A"
paper = { return = [490.0, 6.0] }
[[parts.rows]]
name = "b"
title = "B"
on = ["long"]
set.learner.gamma = 0.9
paper_on.long = { return = [1.0] }
"#;

/// Writes the record and the configuration of a run that was begun, or has ended.
pub(crate) fn record(directory: &Path, config: &Config, is_finished: bool) {
    std::fs::create_dir_all(directory).unwrap();
    std::fs::write(directory.join("config.toml"), config.table.to_string()).unwrap();
    let mut record = RunRecord::begin("a", "lander", 7, &ProgramBuild::default());
    record.result = is_finished.then(|| RunResult {
        finished: String::new(),
        end: ResultCause::TotalSteps,
        updates: 1,
        steps: 1,
        weights_sha256: "0".to_owned(),
        reproducible: true,
        books: serde_json::Value::Null,
    });
    record.write(directory).unwrap();
    if is_finished {
        // One that has lost its policy is brought to its end once more.
        std::fs::write(directory.join(LAST_POLICY), "").unwrap();
    }
}

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
