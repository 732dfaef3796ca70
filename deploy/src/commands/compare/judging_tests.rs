use std::fs;
use std::path::{Path, PathBuf};

use leadtime_policy::Parameters;

use super::super::naming::told_apart;
use super::super::plan::Plan;
use super::super::test_support::{args, study};
use super::*;
use leadtime_runs::policy_file::{self, LAST_POLICY};
use leadtime_runs::{LoadedPolicy, ProgramBuild};
use leadtime_runs::{RunRecord, RunResult};

const STUDY: &str = r#"
title = "t"
lead = "l"
[[parts]]
name = "piloting"
title = "Piloting"
profile = "lander"
quick_steps = 4096
columns = ["success"]
evaluations = [
    { name = "real", title = "real", set.human.reaction_delay = { fixed = 2 } },
]
[[parts.rows]]
name = "script"
title = "Script"
script = "heuristic"
[[parts.rows]]
name = "trained"
title = "Trained"
"#;

/// Writes the study's part: what it found, and how many cells were played and taken for it.
fn written(runs: &Path, more: &[&str]) -> (PartResult, String) {
    let args = args(runs, &[&["--seeds", "7..8"], more].concat());
    let program = Tasks::new();
    let plan = Plan::new(&program, study("t", STUDY), &args).unwrap();
    for training in plan.trainings() {
        finish(&training.directory(), &training.config);
    }
    let shutdown = CancellationToken::new();
    let cells = Cells::new().unwrap();
    let mut judge = Judge::new(&program, &args, WhichPolicy::Last, &shutdown, cells);
    let part = judge.part(&plan.parts[0]).unwrap();
    (part, judge.cells.sentence())
}

/// Makes a finished run out of an untrained policy, unless there is one.
fn finish(directory: &Path, config: &Config) {
    if directory.exists() {
        return;
    }
    fs::create_dir_all(directory).unwrap();
    put_policy(directory, config, config.seed);
    let result = RunResult {
        finished: String::new(),
        updates: 1,
        steps: 1,
        weights_sha256: "0".to_owned(),
        reproducible: true,
        books: serde_json::Value::Null,
    };
    let record = RunRecord {
        result: Some(result),
        ..RunRecord::begin("a", "lander", 7, &ProgramBuild::default())
    };
    record.write(directory).unwrap();
}

fn put_policy(directory: &Path, config: &Config, seed: u64) {
    let parameters = Parameters::initialize(&config.policy, seed).unwrap();
    let file = parameters.to_safetensors(&policy_file::metadata(config, "a")).unwrap();
    fs::write(directory.join(LAST_POLICY), file).unwrap();
}

fn run_of(runs: &Path) -> PathBuf {
    let entries = fs::read_dir(runs).unwrap().map(|entry| entry.unwrap().path());
    { entries }.find(|path| path.join("run.json").exists()).unwrap()
}

const TWO: &[&str] = &["--episodes", "2"];
/// The script's two cells (the unaided person is one), and two ways of choosing.
const ALL: &str = "judged 4 cells, and took 0 that were judged before";
const NONE: &str = "judged 0 cells, and took 3 that were judged before";

#[test]
fn a_measure_that_there_is_not_is_told_with_those_there_are() {
    let runs = tempfile::tempdir().unwrap();
    let (part, _) = written(runs.path(), &[]);
    let args = args(runs.path(), &["--seeds", "7..8"]);
    let check = |from: &str, to: &str| {
        let named = study("t", &STUDY.replace(from, to));
        let plan = Plan::new(&Tasks::new(), named, &args).unwrap();
        check_measures(&plan.parts[0], &part.rows)
    };
    check("[\"success\"]", "[\"success\", \"mean_l\"]").unwrap();
    let differences = "columns = [\"success\"]\n\
        differences = [{ of = \"script\", minus = \"trained\", on = \"real\", measure = \"mean\" }]";
    for (to, told) in [("columns = [\"happiness\"]", "`happiness`"), (differences, "`mean`")] {
        let text = check("columns = [\"success\"]", to).unwrap_err().to_string();
        assert!(
            text.contains(told) && text.contains("known: ") && text.contains("success"),
            "{text}"
        );
    }
}

#[test]
fn a_study_that_is_written_again_plays_nothing_and_says_the_same() {
    let runs = tempfile::tempdir().unwrap();
    let (first, played) = written(runs.path(), TWO);
    assert_eq!(played, ALL);
    let (again, played) = written(runs.path(), TWO);
    assert_eq!((again, played.as_str()), (first.clone(), NONE));
    // Without what is kept beside the scripts and the run: the same again.
    fs::remove_dir_all(runs.path().join("evaluations")).unwrap();
    fs::remove_dir_all(run_of(runs.path()).join("evaluations")).unwrap();
    assert_eq!(written(runs.path(), TWO), (first, ALL.to_owned()));
}

#[test]
fn another_policy_seed_setting_or_number_of_episodes_is_played() {
    let runs = tempfile::tempdir().unwrap();
    written(runs.path(), TWO);
    assert_eq!(written(runs.path(), &["--episodes", "2", "--eval-seed", "5"]).1, ALL);
    assert_eq!(written(runs.path(), &["--episodes", "3"]).1, ALL);
    assert_eq!(
        written(runs.path(), &["--episodes", "2", "--set", "evaluation.world.wind=true"]).1,
        ALL
    );
    assert_eq!(written(runs.path(), TWO).1, NONE);
    let program = Tasks::new();
    let run = run_of(runs.path());
    let file = run.join(LAST_POLICY);
    let loaded = LoadedPolicy::load(&program.registry, runs.path(), &file, &[]).unwrap();
    put_policy(&run, &loaded.config, 99);
    let two = "judged 2 cells, and took 2 that were judged before";
    assert_eq!(written(runs.path(), TWO).1, two, "the script and the unaided person stay");
}

#[test]
fn a_damaged_cell_is_played_again_and_written_again() {
    let runs = tempfile::tempdir().unwrap();
    let (first, _) = written(runs.path(), TWO);
    let kept = fs::read_dir(run_of(runs.path()).join("evaluations")).unwrap();
    for path in kept.map(|entry| entry.unwrap().path()) {
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(&path, bytes).unwrap();
    }
    let two = "judged 2 cells, and took 2 that were judged before";
    assert_eq!(written(runs.path(), TWO), (first.clone(), two.to_owned()));
    assert_eq!(written(runs.path(), TWO), (first, NONE.to_owned()));
}

#[test]
fn rows_of_the_same_title_are_told_apart_by_what_they_choose() {
    let runs = tempfile::tempdir().unwrap();
    let more = r#"
[[parts.rows]]
name = "topics"
title = "Trained"
set.notifier.notification = "topic_only"
"#;
    let named = study("t", &format!("{STUDY}{more}"));
    let plan = Plan::new(&Tasks::new(), named, &args(runs.path(), &[])).unwrap();
    let [script, trained, topics] = &plan.parts[0].rows[..] else { panic!() };
    assert_eq!(told_apart([script, trained]), ["script", "trained"]);
    let expected = ["trained (incrementally actionable)", "trained (topic only)"];
    assert_eq!(told_apart([trained, topics]), expected);
}
