use std::fs;
use std::path::{Path, PathBuf};

use leadtime_config::Override;
use leadtime_policy::Parameters;
use leadtime_runs::policy_file::{self, LAST_POLICY};
use leadtime_runs::{LoadedPolicy, ProgramBuild};

use super::*;
use crate::request::StudyRequest;
use crate::test_support::{STUDY, plan, record, request};

/// Evaluates the study's part: what it found, and how many evaluations were made and taken for it.
fn evaluated(request: &StudyRequest) -> (PartResult, String) {
    evaluated_text(STUDY, request)
}

fn evaluated_text(text: &str, request: &StudyRequest) -> (PartResult, String) {
    let tasks = Tasks::new();
    let plan = plan(text, request).unwrap();
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
    if !directory.exists() {
        record(directory, config, true);
        put_policy(directory, config, config.seed);
    }
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

/// Asks for two episodes of one training seed, of the script and of one trained row.
fn two(runs: &Path) -> StudyRequest {
    let rows = ["script", "real_one"].map(str::to_owned).to_vec();
    StudyRequest { seeds: Some(7..8), episodes: 2, rows, ..request(runs) }
}

/// Two of the script (one is the unaided listener), and one per way of choosing.
const ALL: &str = "made 4 evaluations, took 0 from the cache";
/// Those of the trained row.
const HALF: &str = "made 2 evaluations, took 2 from the cache";
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
fn trainings_are_told_apart_with_the_listener_they_trained_with_whether_or_not_a_table_shows_it() {
    let runs = tempfile::tempdir().unwrap();
    let rows = ["script", "prompt"].map(str::to_owned).to_vec();
    let request = StudyRequest { seeds: Some(7..10), episodes: 2, rows, ..request(runs.path()) };
    let (shown, _) = evaluated(&request);
    let [script, prompt] = &shown.rows[..] else { panic!("two rows") };
    assert_eq!(script.trainings, None);
    let trainings = prompt.trainings.as_ref().unwrap();
    let own = prompt.result("own", Choice::Sample).unwrap().summary.get("success").unwrap();
    assert_eq!(trainings.success, own.by_seed);
    assert_eq!(trainings.success.len(), 3);
    // A script has no trainings, so its batches are one evaluation.
    let measured = script.results[0].summary.get("success").unwrap();
    assert_eq!((measured.by_seed.len(), measured.n), (1, 6));
    let text = STUDY.replace("title = \"Prompt\"", "title = \"Prompt\"\non = [\"real\"]");
    let (hidden, _) = evaluated_text(&text, &request);
    assert!(hidden.rows[1].result("own", Choice::Sample).is_none());
    assert_eq!(hidden.rows[1].trainings.as_ref(), Some(trainings));
}

#[test]
fn success_is_split_by_the_unaided_listener_whose_episodes_are_played_once() {
    let runs = tempfile::tempdir().unwrap();
    let (part, played) = evaluated(&two(runs.path()));
    assert_eq!(played, ALL, "the unaided listener's two episodes once");
    for row in &part.rows {
        let summary = &row.result("real", Choice::Sample).unwrap().summary;
        let [averted, harmed] = ["averted", "harmed"].map(|name| summary.get(name).unwrap().n);
        assert_eq!(averted + harmed, 2, "each episode is one or the other");
    }
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
    assert_eq!(evaluated(&two).1, HALF, "the script and the unaided listener stay");
}

#[test]
fn the_unaided_listener_of_another_world_is_another_one_though_its_settings_are_the_same() {
    let key = |domain: &str, seed| {
        unaided_key(&TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() }, seed)
    };
    assert_eq!(key("mine", 1), key("mine", 1));
    assert_ne!(key("mine", 1), key("yours", 1));
    assert_ne!(key("mine", 1), key("mine", 2));
}

#[test]
fn a_drive_is_measured_up_to_its_arrival() {
    const DRIVE: &str = r#"
        title = "t"
        lead = "l"
        [[parts]]
        name = "driving"
        title = "Driving"
        profile = "highway"
        quick_steps = 4096
        columns = ["success", "length"]
        evaluations = [{ name = "real", title = "real", set.human.reaction_delay = { fixed = 2 } }]
        [[parts.rows]]
        name = "script"
        title = "Script"
        script = "unaided"
    "#;
    let runs = tempfile::tempdir().unwrap();
    let asked = StudyRequest { seeds: Some(7..8), episodes: 8, ..request(runs.path()) };
    let (part, _) = evaluated_text(DRIVE, &asked);
    let mean = |name| part.rows[0].results[0].summary.get(name).unwrap().interval.unwrap().estimate;
    // A driver who has arrived would stand there until step 200.
    assert!(mean("arrived") > 0.2 && mean("length") < 115.0, "{part:?}");
}

#[test]
fn a_script_is_searched_once_and_the_oracle_mends_it() {
    let runs = tempfile::tempdir().unwrap();
    let rows = "[[parts.rows]]\nname = \"searched\"\ntitle = \"S\"\nscript = \"searched\"\non = [\"real\"]\n\
                [[parts.rows]]\nname = \"oracle\"\ntitle = \"O\"\nscript = \"oracle\"\non = [\"real\"]\n";
    let text = format!("{STUDY}{rows}");
    let rows = ["searched", "oracle"].map(str::to_owned).to_vec();
    let request = StudyRequest { rows, quick: true, steps: Some(2_000), ..two(runs.path()) };
    assert!(plan(&text, &request).unwrap().trainings().is_empty());
    let evaluated = || evaluated_text(&text, &request).0;
    let part = evaluated();
    let kept = || fs::read_dir(runs.path().join("scripts")).unwrap().map(|it| it.unwrap().path());
    let file = kept().next().unwrap();
    let written = fs::metadata(&file).unwrap().modified().unwrap();
    assert_eq!(kept().count(), 1, "both rows need the same script");
    let success =
        |row: &RowResult| row.results[0].summary.get("success").unwrap().interval.unwrap().estimate;
    assert!(success(&part.rows[1]) >= success(&part.rows[0]));
    assert!(part.rows[0].settings.last().unwrap().starts_with("a script searched with 2000 steps"));
    assert!(
        part.rows[1].settings.last().unwrap().starts_with("mends, on the episode itself, a script")
    );
    assert_eq!(evaluated(), part);
    assert_eq!(fs::metadata(&file).unwrap().modified().unwrap(), written, "it is searched once");
}
