use std::collections::BTreeMap;
use std::path::Path;

use serde_json::json;

use super::*;
use crate::journal::Journal;
use crate::test_support::config;
use crate::{ForkOrigin, RunDir};

/// Makes a run with two updates.
fn begun(runs: &Path, base: &str, name: &str, set: &[&str]) -> RunFiles {
    let config = config(runs, base, name, set);
    let (run, _) = RunDir::open(&config, None, &ProgramBuild::default()).unwrap();
    let mut journal = Journal::open(&run.path).unwrap();
    for update in 1..=2 {
        let line = json!({
            "update": update, "steps": 100 * update, "staleness": {"0": 8}, "system/train_seconds": 1.0,
            "episodes/return": 10 * update,
        });
        journal.append(&line).unwrap();
    }
    RunFiles::read(&run.path).unwrap()
}

#[test]
fn a_report_of_one_run_names_its_command_and_what_differs() {
    let dir = tempfile::tempdir().unwrap();
    let tasks = Tasks::new();
    let run = begun(dir.path(), "cartpole", "a", &["learner.clip=0.1"]);
    let page = report(&tasks, &[run], Findings::default(), "leadtime");
    assert_eq!(page.title, "Run a");
    let [curve] = &page.curves[..] else { panic!("one number has a curve") };
    assert_eq!((curve.bands.len(), curve.bands[0].label.as_str()), (1, ""));
    assert_eq!(page.staleness, BTreeMap::from([(0, 16)]));
    let [of] = &page.provenance[..] else { panic!("one run") };
    assert_eq!(
        of.command,
        "leadtime up -c cartpole --seed 7 --set learner.clip=0.1 --name a-again"
    );
    assert!(of.settings.contains("clip = 0.1") && of.settings.contains("gamma"));
    assert!(of.details.iter().any(|it| it.name == "seed" && it.value == "7"));
    let changed = page.changed.unwrap().text();
    assert!(changed.contains("learner.clip") && !changed.contains("run.name"), "{changed}");
    assert!(changed.lines().next().unwrap().contains("cartpole"), "{changed}");
}

#[test]
fn a_report_says_which_setting_ended_the_run_and_where_it_stood() {
    let dir = tempfile::tempdir().unwrap();
    let ended = |name: &str, set: &[&str], end: ResultCause| {
        let mut run = begun(dir.path(), "cartpole", name, set);
        let (updates, steps) = (2, 200);
        run.record.result = Some(RunResult { end, updates, steps, ..RunResult::default() });
        let line = json!({"update": 2, "held_out/success": 0.65, "held_out/error": 0.11, "held_out/episodes": 20});
        run.held_out = line.as_object().cloned().into_iter().collect();
        let page = report(&Tasks::new(), &[run], Findings::default(), "leadtime");
        let detail = page.provenance[0].details.iter().find(|it| it.name == "ended by");
        detail.unwrap().value.clone()
    };
    let all = ended("all", &["learner.total_steps=200"], ResultCause::TotalSteps);
    assert_eq!(all, "learner.total_steps = 200");
    let early = ended("early", &["evaluation.stop_at=0.6"], ResultCause::StopAt);
    assert_eq!(
        early,
        "evaluation.stop_at = 0.6: from update 2: success 0.65 \u{b1} 0.11 over 20 held-out episodes"
    );
}

#[test]
fn the_command_gives_the_same_configuration_also_where_a_choice_was_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let tasks = Tasks::new();
    let delay = r#"human.reaction_delay={uniform={low=0,high=5,drawn="per_episode"}}"#;
    for base in ["lander", "paper_lander"] {
        let run = begun(
            dir.path(),
            base,
            &base.replace('_', "-"),
            &[delay, "learner.learning_rate=1e-4"],
        );
        let origin = NearestBuiltIn::of(&tasks, &run.config);
        assert_eq!(origin.name.as_deref(), Some(base));
        let command = command(&tasks, &run, &origin, "leadtime");
        assert!(
            command.starts_with(&format!("leadtime up -c {base} --seed 7 --set ")),
            "{command}"
        );
        assert_eq!(command.matches("--set").count(), 2, "{command}");
        assert!(command.contains("'human.reaction_delay={ uniform = {"), "{command}");
    }
}

#[test]
fn a_run_of_no_built_in_configuration_is_trained_again_from_its_own_file() {
    let dir = tempfile::tempdir().unwrap();
    let mut run = begun(dir.path(), "cartpole", "a", &[]);
    run.config.insert("domain".to_owned(), "elsewhere".into());
    run.record.origin = Some(ForkOrigin { run: "b".to_owned(), weights_sha256: String::new() });
    let command = command(&Tasks::new(), &run, &NearestBuiltIn::default(), "leadtime");
    let file = |name: &str| run.directory.join(name).display().to_string();
    let [config, initial] = [file("config.toml"), file("initial.safetensors")];
    let expected = format!("leadtime up -c {config} --name a-again --fork {initial}");
    assert_eq!(command, expected);
}

#[test]
fn several_runs_share_their_figure_and_show_their_settings_side_by_side() {
    let dir = tempfile::tempdir().unwrap();
    let runs = [
        begun(dir.path(), "cartpole", "a", &["learner.clip=0.1"]),
        begun(dir.path(), "cartpole", "b", &["learner.gamma=0.9"]),
    ];
    let page = report(&Tasks::new(), &runs, Findings::default(), "leadtime");
    assert_eq!(page.title, "Runs a, b");
    let labels: Vec<&str> = page.curves[0].bands.iter().map(|band| band.label.as_str()).collect();
    assert_eq!(labels, ["a", "b"]);
    assert_eq!((page.phases.len(), page.provenance.len()), (2, 2));
    assert!(page.staleness.is_empty() && page.books.is_empty());
    let changed = page.changed.unwrap().text();
    let row = |key: &str| changed.lines().find(|line| line.starts_with(key)).unwrap().to_owned();
    let words = |key: &str| row(key).split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(words("learner.clip"), ["learner.clip", "0.1", "as", "built", "in"]);
    assert_eq!(words("learner.gamma"), ["learner.gamma", "as", "built", "in", "0.9"]);
}

#[test]
fn every_rollout_in_the_books_is_in_a_report() {
    let entries = leadtime_learner::Books::default().entries();
    let rollouts = entries.iter().map(|(name, _)| *name).filter(|name| *name != "steps_redone");
    let shown: Vec<String> = account(&Value::Null).into_iter().map(|book| book.name).collect();
    assert_eq!(shown, rollouts.collect::<Vec<_>>());
}
