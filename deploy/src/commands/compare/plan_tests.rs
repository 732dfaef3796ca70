use super::super::test_support::{args, study};
use super::*;
use leadtime_runs::{ProgramBuild, RunResult};

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

fn named(name: &str) -> Named {
    study(name, STUDY)
}

fn plan(runs: &Path, more: &[&str]) -> anyhow::Result<Plan> {
    Plan::new(&Tasks::new(), named("t"), &args(runs, more))
}

fn names(plan: &Plan) -> Vec<String> {
    plan.trainings().iter().map(|training| training.name.to_string()).collect()
}

#[test]
fn a_training_per_row_and_seed_named_by_what_it_computes() {
    let runs = tempfile::tempdir().unwrap();
    let plan = plan(runs.path(), &["--seeds", "7..9"]).unwrap();
    let names = names(&plan);
    let stems: Vec<(&str, &str)> =
        names.iter().map(|n| (&n[..n.len() - 14], &n[n.len() - 3..])).collect();
    let expected = [
        ("t-piloting-prompt", "-s7"),
        ("t-piloting-prompt", "-s8"),
        ("t-piloting-real-one", "-s7"),
        ("t-piloting-real-one", "-s8"),
    ];
    assert_eq!(stems, expected);
    assert_eq!(plan.trainings()[1].config.seed, 8);
    let again = super::plan_part(
        &Tasks::new(),
        "t",
        &plan.named.study.parts[0],
        &args(runs.path(), &["--seeds", "7..9", "--jobs", "3"]),
    );
    assert_eq!(again.unwrap().rows[1].trainings[0].name.as_str(), names[0]);
}

#[test]
fn a_part_has_seeds_of_its_own_unless_the_command_line_says() {
    let runs = tempfile::tempdir().unwrap();
    let later = STUDY.replace("quick_steps", "first_seed = 301\nquick_steps");
    let seeds = |text: &str, more: &[&str]| {
        let args = args(runs.path(), more);
        let plan = Plan::new(&Tasks::new(), study("t", text), &args).unwrap();
        plan.parts[0].seeds.clone()
    };
    assert_eq!(seeds(STUDY, &[]), [201, 202, 203, 204, 205]);
    assert_eq!(seeds(&later, &[]), [301, 302, 303, 304, 305]);
    assert_eq!(seeds(&later, &["--quick"]), [301]);
    assert_eq!(seeds(&later, &["--seeds", "7..9"]), [7, 8]);
}

#[test]
fn what_a_training_computes_decides_its_hash_and_nothing_else_does() {
    let runs = tempfile::tempdir().unwrap();
    let hash = |more: &[&str]| plan(runs.path(), more).unwrap().trainings()[0].hash.clone();
    let before = hash(&[]);
    assert_eq!(
        before,
        hash(&["--set", "run.checkpoint_every=3", "--set", "evaluation.episodes=9"])
    );
    assert_eq!(before, hash(&["--seeds", "1..2"]));
    for change in [["--set", "learner.clip=0.1"], ["--steps", "9000"], ["--set", "world.wind=true"]]
    {
        assert_ne!(before, hash(&change), "{change:?}");
    }
    assert_ne!(before, hash(&["--quick"]));
}

#[test]
fn a_run_that_computes_the_same_is_taken_whatever_it_is_called() {
    let runs = tempfile::tempdir().unwrap();
    let first = plan(runs.path(), &["--seeds", "7..8"]).unwrap();
    let training = first.trainings()[0].clone();
    let other = format!("elsewhere-{}-s7", training.hash);
    let directory = runs.path().join(&other);
    std::fs::create_dir_all(&directory).unwrap();
    assert_eq!(names(&plan(runs.path(), &["--seeds", "7..8"]).unwrap()), names(&first));
    RunRecord::begin(&other, "lander", 7, &ProgramBuild::default()).write(&directory).unwrap();
    let again = plan(runs.path(), &["--seeds", "7..8"]).unwrap();
    assert_eq!(names(&again)[0], other);
    assert!(!again.trainings()[0].is_finished(), "it was only begun");
    let later = format!("later-{}-s7", training.hash);
    std::fs::create_dir_all(runs.path().join(&later)).unwrap();
    let mut finished = RunRecord::begin(&later, "lander", 7, &ProgramBuild::default());
    finished.result = Some(RunResult {
        finished: String::new(),
        updates: 1,
        steps: 1,
        weights_sha256: String::new(),
        reproducible: true,
        books: serde_json::Value::Null,
    });
    finished.write(&runs.path().join(&later)).unwrap();
    let again = plan(runs.path(), &["--seeds", "7..8"]).unwrap();
    assert_eq!(names(&again)[0], later, "a finished one is taken before one that was begun");
}

#[test]
fn studies_share_what_they_have_in_common() {
    let runs = tempfile::tempdir().unwrap();
    let args = args(runs.path(), &["--seeds", "7..9"]);
    let one = |name: &str| Plan::new(&Tasks::new(), named(name), &args).unwrap();
    let mut plans = vec![one("first"), one("second")];
    let shared = share(&mut plans);
    assert_eq!(shared.len(), 4);
    assert_eq!(names(&plans[0]), names(&plans[1]));
}

#[test]
fn people_that_come_to_the_same_are_judged_once() {
    let runs = tempfile::tempdir().unwrap();
    let plan = plan(runs.path(), &[]).unwrap();
    let names: Vec<Vec<Vec<String>>> = plan.parts[0]
        .rows
        .iter()
        .map(|row| row.evaluations.iter().map(|e| e.names.clone()).collect())
        .collect();
    let list = |names: &[&[&str]]| -> Vec<Vec<String>> {
        names.iter().map(|n| n.iter().map(|&n| n.to_owned()).collect()).collect()
    };
    assert_eq!(names[0], list(&[&["real"]]), "a script was trained on nobody");
    assert_eq!(names[1], list(&[&["own"], &["real"]]));
    assert_eq!(names[2], list(&[&["own", "real"]]));
}

#[test]
fn one_row_with_one_setting_changed() {
    let runs = tempfile::tempdir().unwrap();
    let more = ["--row", "piloting/prompt", "--set", "human.reaction_delay.fixed=3", "--quick"];
    let plan = plan(runs.path(), &more).unwrap();
    let [training] = plan.trainings()[..] else { panic!("one row, one seed") };
    let table = &training.config.table;
    assert_eq!(table["human"]["reaction_delay"]["fixed"].as_integer(), Some(3));
    assert_eq!(training.config.learner.total_steps, 4096);
    let row = &plan.parts[0].rows[0];
    let told = plan.parts[0].profile.differences(&row.config);
    assert!(told.contains(&"human.reaction_delay.fixed = 3".to_owned()), "{told:?}");
}

#[test]
fn maps_and_flights_are_for_piloting_alone() {
    let runs = tempfile::tempdir().unwrap();
    let plan = |change: &str| {
        let text = STUDY.replace("quick_steps = 4096", &format!("quick_steps = 4096\n{change}"));
        let named = study("t", &text);
        Plan::new(&Tasks::new(), named, &args(runs.path(), &[]))
    };
    let maps = |profile: &str| format!("maps = [{{ profile = \"{profile}\", title = \"a\" }}]");
    assert_eq!(plan(&maps("lander_hard")).unwrap().parts[0].maps.len(), 1);
    let text = format!("{:#}", plan(&maps("highway")).unwrap_err());
    assert!(
        text.contains("`maps`: `highway` is a configuration of the domain `highway`"),
        "{text}"
    );
    let text = format!("{:#}", plan(&maps("nowhere")).unwrap_err());
    assert!(text.contains("`maps`: ") && text.contains("nowhere"), "{text}");
    let steakhouse = STUDY.replace("profile = \"lander\"", "profile = \"steakhouse\"");
    let text =
        steakhouse.replace("quick_steps = 4096", "quick_steps = 4096\ntrajectories_on = \"real\"");
    let named = study("t", &text);
    let error = Plan::new(&Tasks::new(), named, &args(runs.path(), &[])).unwrap_err();
    let text = format!("{error:#}");
    assert!(text.contains("`trajectories_on`: `steakhouse`") && text.contains("flights"), "{text}");
}

#[test]
fn a_rows_own_steps_are_above_the_parts_and_below_the_command_lines() {
    let runs = tempfile::tempdir().unwrap();
    let text = STUDY
        .replace("quick_steps = 4096", "quick_steps = 4096\nsteps = 20480")
        .replace("name = \"real_one\"", "name = \"real_one\"\nset.learner.total_steps = 61440");
    let steps = |more: &[&str]| -> Vec<u64> {
        let named = study("t", &text);
        let plan = Plan::new(&Tasks::new(), named, &args(runs.path(), more)).unwrap();
        plan.parts[0].rows.iter().skip(1).map(|row| row.config.learner.total_steps).collect()
    };
    assert_eq!(steps(&[]), [20_480, 61_440]);
    assert_eq!(steps(&["--quick"]), [4_096, 4_096]);
    assert_eq!(steps(&["--steps", "9000"]), [9_000, 9_000]);
    assert_eq!(steps(&["--set", "learner.total_steps=8192"]), [8_192, 8_192]);
}

#[test]
fn what_is_not_there_is_told_with_what_is() {
    let runs = tempfile::tempdir().unwrap();
    let check = |more: &[&str]| check_choice(&[named("t")], &args(runs.path(), more));
    assert!(check(&["--row", "prompt", "--part", "piloting"]).is_ok());
    let text = check(&["--row", "driving/prompt"]).unwrap_err().to_string();
    assert!(text.contains("`driving/prompt`") && text.contains("piloting/real_one"), "{text}");
    let text = check(&["--part", "driving"]).unwrap_err().to_string();
    assert!(text.contains("`driving`") && text.contains("known: piloting"), "{text}");
    let text = format!("{:#}", plan(runs.path(), &["--set", "human.patience=2"]).unwrap_err());
    assert!(text.contains("--set human.patience") && text.contains("`repeat`"), "{text}");
    let text = format!("{:#}", plan(runs.path(), &["--set", "seed=2"]).unwrap_err());
    assert!(text.contains("--set seed") && text.contains("see --seeds"), "{text}");
    let profile = |more: &[&str]| {
        let args = args(runs.path(), more);
        configure::check_profiles(&Tasks::new(), &[named("t")], &args)
    };
    profile(&["--profile", "paper_lander"]).unwrap();
    let text = profile(&["--profile", "highway"]).unwrap_err().to_string();
    assert!(
        text.contains(
            "--profile highway: no part that was asked for is about the domain `highway`"
        ),
        "{text}"
    );
    let twice = ["--profile", "lander", "--profile", "paper_lander"];
    let text = profile(&twice).unwrap_err().to_string();
    assert!(text.contains("there is another one for the domain `lander`"), "{text}");
}
