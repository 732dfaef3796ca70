use std::fs;
use std::path::{Path, PathBuf};

use leadtime_config::Override;
use leadtime_policy::Parameters;
use leadtime_runs::policy_file::{self, LAST_POLICY};
use leadtime_runs::{LoadedPolicy, ProgramBuild, RunRecord, RunResult};

use super::*;
use crate::request::StudyRequest;
use crate::test_support::{plan, request};

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

/// Evaluates the study's part: what it found, and how many evaluations were made and taken for it.
fn evaluated(request: &StudyRequest) -> (PartResult, String) {
    let tasks = Tasks::new();
    let plan = plan(STUDY, request).unwrap();
    for training in plan.trainings() {
        finish(&training.directory(), &training.config);
    }
    let shutdown = CancellationToken::new();
    let mut evaluator = Evaluator::new(&tasks, &shutdown, EvalCache::new(&ProgramBuild::default()));
    let part = evaluator.part(&plan.parts[0]).unwrap();
    (part, evaluator.cache.sentence())
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
    let begun = RunRecord::begin("a", "lander", 7, &ProgramBuild::default());
    RunRecord { result: Some(result), ..begun }.write(directory).unwrap();
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

/// Asks for two episodes of one training seed.
fn two(runs: &Path) -> StudyRequest {
    StudyRequest { seeds: Some(7..8), episodes: 2, ..request(runs) }
}

/// Two of the script (one is the unaided listener), and one per way of choosing.
const ALL: &str = "made 4 evaluations, took 0 from the cache";
const NONE: &str = "made 0 evaluations, took 3 from the cache";

#[test]
fn a_study_that_is_evaluated_again_plays_nothing_and_finds_the_same() {
    let runs = tempfile::tempdir().unwrap();
    let two = two(runs.path());
    let (first, played) = evaluated(&two);
    assert_eq!(played, ALL);
    let (again, played) = evaluated(&two);
    assert_eq!((again, played.as_str()), (first.clone(), NONE));
    // Without what is kept beside the scripts and the run: the same again.
    fs::remove_dir_all(runs.path().join("evaluations")).unwrap();
    fs::remove_dir_all(run_of(runs.path()).join("evaluations")).unwrap();
    assert_eq!(evaluated(&two), (first, ALL.to_owned()));
}

#[test]
fn another_policy_seed_setting_or_number_of_episodes_is_evaluated() {
    let runs = tempfile::tempdir().unwrap();
    let two = two(runs.path());
    evaluated(&two);
    let set = vec![Override::parse("evaluation.world.wind=true").unwrap()];
    for changed in [
        StudyRequest { eval_seed: 5, ..two.clone() },
        StudyRequest { episodes: 3, ..two.clone() },
        StudyRequest { set, ..two.clone() },
    ] {
        assert_eq!(evaluated(&changed).1, ALL, "{changed:?}");
    }
    assert_eq!(evaluated(&two).1, NONE);
    let run = run_of(runs.path());
    let file = run.join(LAST_POLICY);
    let loaded = LoadedPolicy::load(&Tasks::new().registry, runs.path(), &file, &[]).unwrap();
    put_policy(&run, &loaded.config, 99);
    let half = "made 2 evaluations, took 2 from the cache";
    assert_eq!(evaluated(&two).1, half, "the script and the unaided listener stay");
}

#[test]
fn a_damaged_evaluation_is_made_and_kept_again() {
    let runs = tempfile::tempdir().unwrap();
    let two = two(runs.path());
    let (first, _) = evaluated(&two);
    let kept = fs::read_dir(run_of(runs.path()).join("evaluations")).unwrap();
    for path in kept.map(|entry| entry.unwrap().path()) {
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(&path, bytes).unwrap();
    }
    let half = "made 2 evaluations, took 2 from the cache";
    assert_eq!(evaluated(&two), (first.clone(), half.to_owned()));
    assert_eq!(evaluated(&two), (first, NONE.to_owned()));
}
