use leadtime_eval::measure::Difference;
use leadtime_learner::write_atomically;
use leadtime_numerics::stats::{Bootstrap, Interval};
use leadtime_policy::Parameters;
use leadtime_proto::{DomainName, hex};
use serde_json::json;

use super::*;
use crate::journal::Journal;
use crate::policy_file::{Fork, PolicyFileError, VERSION, WEIGHTS_SHA256, metadata};
use crate::{ProgramBuild, QUICK_UPDATES, RunDir};

fn config(runs: &Path, base: &str, set: &[&str]) -> Config {
    crate::test_support::config(runs, base, "a", set)
}

/// Trains a run from update `first` to `last`, and writes its policy.
fn train(config: &Config, first: u64, last: u64) -> RunFiles {
    let directory = config.run.directory.join("a");
    if first == 1 {
        RunDir::open(config, None, &ProgramBuild::default()).unwrap();
    }
    let mut journal = Journal::open(&directory).unwrap();
    for update in first..=last {
        journal.append(&json!({"update": update, "steps": 100 * update})).unwrap();
    }
    let mut entries = metadata(config, "a");
    entries.insert(VERSION.to_owned(), last.to_string());
    let parameters = Parameters::initialize(&config.policy, 1).unwrap();
    entries.insert(WEIGHTS_SHA256.to_owned(), hex::encode(&parameters.digest().unwrap()));
    let bytes = parameters.to_safetensors(&entries).unwrap();
    write_atomically(&directory.join(LAST_POLICY), &bytes).unwrap();
    RunFiles::read(&directory).unwrap()
}

fn load(run: &RunFiles) -> LoadedPolicy {
    let registry = Tasks::new().registry;
    LoadedPolicy::load(&registry, &run.directory, &run.directory, &[]).unwrap()
}

#[test]
fn a_policy_in_which_a_bit_has_changed_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let config = config(dir.path(), "cartpole", &[]);
    let run = train(&config, 1, 5);
    load(&run);
    let path = run.directory.join(LAST_POLICY);
    let mut bytes = std::fs::read(&path).unwrap();
    let n = bytes.len();
    bytes[n - 400] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let registry = Tasks::new().registry;
    let refused = LoadedPolicy::load(&registry, &run.directory, &run.directory, &[]);
    assert!(matches!(refused, Err(PolicyFileError::Damaged(_))), "{refused:?}");
    let forked = Fork::read(&config, Path::new("a"));
    assert!(matches!(forked, Err(PolicyFileError::Damaged(_))), "{forked:?}");
}

const REQUEST: EvaluationRequest = EvaluationRequest { episodes: Some(2), action: None, seed: 1 };

#[test]
fn a_page_tells_how_far_the_run_is_and_which_policy_was_evaluated() {
    let dir = tempfile::tempdir().unwrap();
    let (tasks, config) = (Tasks::new(), config(dir.path(), "cartpole", &[]));
    let n = config.learner.n_updates();
    let run = train(&config, 1, 5);
    let lead = Findings::of_training(&config, &run, "leadtime").lead;
    for part in [&format!("for 5 of {n} updates"), "not been evaluated yet", "leadtime report "] {
        assert!(lead.contains(part), "{lead}");
    }
    let evaluated = evaluate_run(&tasks, &run, &load(&run), &REQUEST).unwrap();
    let lead = evaluated.findings.lead;
    for part in [&format!("for 5 of {n} updates"), "policy.safetensors, from update 5"] {
        assert!(lead.contains(part), "{lead}");
    }
    let leads = |seed: u64| {
        let (request, policy) = (EvaluationRequest { seed, ..REQUEST }, load(&run));
        let one = evaluate_run(&tasks, &run, &policy, &request).unwrap().findings.lead;
        let runs = std::slice::from_ref(&run);
        [one, evaluate_runs(&tasks, runs, &[policy], &request).unwrap().lead]
    };
    let unseen = |leads: [String; 2]| leads.map(|lead| lead.contains("training never saw"));
    assert_eq!(unseen(leads(config.seed + 1)), [true, true]);
    assert_eq!(unseen(leads(config.seed)), [false, false]);
    evaluated.record.write(&run.directory, &config).unwrap();
    let found = Findings::of_training(&config, &run, "leadtime");
    assert!(found.lead.contains("the last evaluation of policy.safetensors"), "{}", found.lead);
    assert_eq!(found.comparison.as_ref(), Some(&evaluated.record.comparison));
    assert_eq!(found.verdict, evaluated.findings.verdict);
    let found = Findings::of_training(&config, &train(&config, 6, n), "leadtime");
    for part in [&format!("for {n} updates"), "of an earlier policy, from update 5"] {
        assert!(found.lead.contains(part), "{}", found.lead);
    }
    assert!(found.comparison.is_none() && found.verdict.is_none());
}

#[test]
fn a_quick_run_is_called_so_until_it_trains_on() {
    let dir = tempfile::tempdir().unwrap();
    let (tasks, config) = (Tasks::new(), config(dir.path(), "cartpole", &[]));
    let mut run = train(&config, 1, QUICK_UPDATES);
    let judge = |run: &RunFiles| {
        let findings = evaluate_run(&tasks, run, &load(run), &REQUEST).unwrap().findings;
        // The last note says which episodes are drawn.
        (findings.verdict.unwrap().sentence, findings.notes.len() - 1)
    };
    assert!(judge(&run).0.starts_with("The trained policy "));
    run.record.quick = true;
    assert_eq!(
        judge(&run),
        ("The mechanics work; learning was not checked (--quick).".to_owned(), 1)
    );
    run.record.write(&run.directory).unwrap();
    let run = train(&config, QUICK_UPDATES + 1, QUICK_UPDATES + 1);
    assert!(run.record.quick && judge(&run).0.starts_with("The trained policy "));
}

#[test]
fn success_is_split_by_what_the_listener_does_alone() {
    let dir = tempfile::tempdir().unwrap();
    let (tasks, config) = (Tasks::new(), config(dir.path(), "lander", &[]));
    let run = train(&config, 1, 5);
    let policy = load(&run);
    let split = |comparison: &Comparison, player: &str| {
        let mut summaries = comparison.summaries.iter();
        let summary = summaries.find(|summary| summary.player == player).unwrap();
        Some(summary.get("averted")?.n + summary.get("harmed")?.n)
    };
    let beside = evaluate_run(&tasks, &run, &policy, &REQUEST).unwrap().record.comparison;
    assert_eq!([TRAINED, UNAIDED].map(|player| split(&beside, player)), [Some(2), None]);
    let player = [policy.player("alone", None).unwrap()];
    let own = evaluate_all(&tasks, &config, &player, 2, 1).unwrap();
    assert_eq!(own.len(), 1, "the listener alone played, and is not asked for");
    assert_eq!(split(&compare(&config, &own, &[]), "alone"), Some(2));
    let runs = evaluate_runs(&tasks, &[run], &[policy], &REQUEST).unwrap().comparison.unwrap();
    assert_eq!(["a", UNAIDED].map(|player| split(&runs, player)), [Some(2), None]);
}

#[test]
fn a_shipped_world_asks_for_more_than_ones_own() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = config(dir.path(), "lander", &[]);
    let difference = |measure: &str, minus: &str, low: f64| Difference {
        measure: measure.to_owned(),
        of: TRAINED.to_owned(),
        minus: minus.to_owned(),
        interval: Interval { estimate: low + 0.1, low, high: low + 0.2 },
    };
    let judge = |config: &Config, low: f64| {
        let differences = vec![
            difference("success", UNTRAINED, -0.5),
            difference("return", UNAIDED, -0.5),
            difference("success", UNAIDED, low),
        ];
        let comparison =
            Comparison { bootstrap: Bootstrap::new(1), summaries: Vec::new(), differences };
        let Verdict { holds, sentence } = verdict(config, &comparison, false).unwrap();
        (holds, sentence.split(':').next().unwrap().to_owned())
    };
    let says = |holds: bool, sentence: &str| (holds, format!("The trained policy {sentence}"));
    assert_eq!(judge(&config, 0.4), says(true, "gained more than 0.3 in success"));
    assert_eq!(judge(&config, 0.2), says(false, "did not gain more than 0.3 in success"));
    config.domain = DomainName::new("corridor").unwrap();
    assert_eq!(judge(&config, 0.2), says(true, "gained in success"));
    assert_eq!(judge(&config, -0.1), says(false, "did not gain in success"));
}
