use leadtime_proto::phrase::with_causes;

use super::*;
use crate::journal::Journal;
use crate::layout::is_finished;
use crate::naming::{Naming, Reservation, check_place};
use crate::{ResultCause, RunRecorder};
use leadtime_config::{Catalog, ConfigSource, Override};
use leadtime_policy::Parameters;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::symlink;

fn config(runs: &Path, name: Option<&str>, set: &[&str]) -> Config {
    let catalog = Catalog::built_in();
    let source = ConfigSource {
        file: catalog.file("cartpole"),
        set: set.iter().map(|text| Override::parse(text).unwrap()).collect(),
        runs: Some(runs.to_owned()),
        name: name.map(str::to_owned),
        ..ConfigSource::default()
    };
    Config::load(&source, &catalog, &leadtime_worlds::builtin()).unwrap()
}

fn build(program: &str) -> ProgramBuild {
    ProgramBuild { program: program.to_owned(), ..ProgramBuild::default() }
}

fn open(runs: &Path, name: Option<&str>, set: &[&str]) -> Result<(RunDir, RunState), RunDirError> {
    open_by("a", &config(runs, name, set))
}

/// Opens a run, and notes that, as a learner that can be reached does.
fn open_by(program: &str, config: &Config) -> Result<(RunDir, RunState), RunDirError> {
    let (run, state) = RunDir::open(config, None, &build(program))?;
    if run.is_to_be_noted {
        let recorder = RunRecorder::open(&run.path, config, run.name.as_str()).unwrap();
        recorder.keeping(&run).note_start().unwrap();
    }
    Ok((run, state))
}

/// Leaves what a learner does after its first updates; with a checkpoint, if it got that far.
fn train(run: &RunDir, n_updates: u64, checkpoint: bool) {
    Journal::open(&run.path).unwrap().append(&json!({"update": n_updates})).unwrap();
    if checkpoint {
        fs::write(run.checkpoints().join(format!("{n_updates:012}.checkpoint")), "state").unwrap();
        for file in [LAST_POLICY, BEST_POLICY] {
            fs::write(run.path.join(file), "weights").unwrap();
        }
    }
}

/// Begins a run and leaves it after 20 updates.
fn begun(runs: &Path, name: Option<&str>, set: &[&str]) -> RunName {
    let (run, state) = open(runs, name, set).unwrap();
    assert_eq!(state, RunState::Fresh);
    train(&run, 20, true);
    run.name.clone()
}

fn result() -> RunResult {
    RunResult { updates: 20, steps: 1, reproducible: true, ..RunResult::default() }
}

fn fork(runs: &Path, run: &str, seed: u64) -> Fork {
    let policy = config(runs, None, &[]).policy;
    let parameters = Parameters::initialize(&policy, seed).unwrap();
    let bytes = parameters.to_safetensors(&BTreeMap::new()).unwrap();
    let weights_sha256 = weights_digest(&bytes, &policy).unwrap();
    Fork { origin: ForkOrigin { run: run.to_owned(), weights_sha256 }, bytes }
}

#[test]
fn an_unfinished_run_of_the_same_configuration_is_taken_up_again() {
    let runs = tempfile::tempdir().unwrap();
    let name = begun(runs.path(), None, &[]);
    let (first, state) = open(runs.path(), None, &[]).unwrap();
    assert_eq!((&first.name, state), (&name, RunState::Unfinished));
    let (other, _) = open(runs.path(), None, &[]).unwrap();
    assert_ne!(other.name, name, "a run that is being trained is left alone");
    drop((first, other));
    let (changed, state) = open(runs.path(), None, &["learner.clip=0.1"]).unwrap();
    assert_eq!(state, RunState::Fresh);
    assert_ne!(changed.name, name);
    let (longer, state) = open(runs.path(), None, &["learner.total_steps=600000"]).unwrap();
    assert_eq!(state, RunState::Fresh, "its learning rate would fall over another length");
    drop(longer);
    let (again, state) = open(runs.path(), Some(name.as_str()), &[]).unwrap();
    assert_eq!((state, again.record.resumed), (RunState::Unfinished, 2));
    // A score at which it ends changes nothing of what has been trained.
    let runs = tempfile::tempdir().unwrap();
    let name = begun(runs.path(), None, &["evaluation.stop_at=0.9"]);
    let (higher, state) = open(runs.path(), None, &["evaluation.stop_at=0.95"]).unwrap();
    assert_eq!((&higher.name, state), (&name, RunState::Unfinished));
}

#[test]
fn starts_in_the_same_second_choose_runs_of_their_own() {
    let runs = tempfile::tempdir().unwrap();
    let config = config(runs.path(), None, &[]);
    let reserve = || Reservation::make(&config, &Naming::Resume).unwrap();
    let reserved: Vec<Reservation> = std::thread::scope(|scope| {
        let starts: Vec<_> = (0..8).map(|_| scope.spawn(reserve)).collect();
        starts.into_iter().map(|start| start.join().unwrap()).collect()
    });
    let names: BTreeSet<_> = reserved.iter().map(|reserved| &reserved.name).collect();
    assert_eq!(names.len(), 8);
    drop(reserved);
    assert_eq!(fs::read_dir(runs.path()).unwrap().count(), 0, "nothing was begun");
    // Two supervisors and a learner of one configuration: one of them takes up the unfinished run.
    let unfinished = begun(runs.path(), None, &[]);
    let (first, second) = (reserve(), reserve());
    let (third, _) = open(runs.path(), None, &[]).unwrap();
    assert_eq!(first.name, unfinished);
    assert!(second.name != unfinished && ![&first.name, &second.name].contains(&&third.name));
}

#[test]
fn a_supervisor_waits_for_the_learner_of_one_that_was_killed_and_for_no_other() {
    let runs = tempfile::tempdir().unwrap();
    begun(runs.path(), Some("r"), &[]);
    let reserve =
        || Reservation::make(&config(runs.path(), Some("r"), &[]), &Naming::Resume).map(drop);
    let (own, _) = open(runs.path(), Some("r"), &[]).unwrap();
    assert!(matches!(reserve(), Err(RunDirError::Locked(_))), "it was started by hand");
    drop(own);
    let (orphan, _) = open(runs.path(), Some("r"), &[]).unwrap();
    orphan.note_supervisor();
    assert!(matches!(reserve(), Err(RunDirError::Orphaned(_))), "it is about to end");
    drop(orphan);
    reserve().unwrap();
    // What it has written counts for it alone.
    assert_eq!(fs::read(runs.path().join("r/lock")).unwrap(), b"");
}

#[test]
fn a_changed_configuration_is_refused_with_the_difference_once_something_was_trained() {
    let runs = tempfile::tempdir().unwrap();
    drop(open(runs.path(), Some("r"), &["learner.clip=0.4"]).unwrap());
    // A learner that was stopped before its first update leaves a state all the same.
    let (run, state) = open(runs.path(), Some("r"), &[]).unwrap();
    assert_eq!(state, RunState::Fresh, "nothing was trained, so nothing binds");
    fs::write(run.checkpoints().join("000000000000.checkpoint"), "state").unwrap();
    drop(run);
    let (run, _) = open(runs.path(), Some("r"), &["seed=3"]).unwrap();
    assert!(checkpoints(&run.path).unwrap().is_empty());
    drop(run);
    begun(runs.path(), Some("r"), &[]);
    let error = open(runs.path(), Some("r"), &["learner.clip=0.1", "seed=5"]).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("learner.clip: 0.2 -> 0.1; seed: 1 -> 5"), "{text}");
    let (_, state) = open(runs.path(), Some("r"), &["run.actors_min=3", "actor.window=5"]).unwrap();
    assert_eq!(state, RunState::Unfinished, "how a run is carried out may change");
}

#[test]
fn a_run_from_before_a_setting_came_stays_the_same_run() {
    let runs = tempfile::tempdir().unwrap();
    begun(runs.path(), Some("r"), &[]);
    let file = runs.path().join("r/config.toml");
    let now = fs::read_to_string(&file).unwrap();
    let before: Vec<&str> = now.lines().filter(|line| !line.contains("length_bias")).collect();
    assert_eq!(before.len() + 1, now.lines().count());
    fs::write(&file, before.join("\n")).unwrap();
    assert_eq!(open(runs.path(), Some("r"), &[]).unwrap().1, RunState::Unfinished);
    fs::write(&file, before.join("\n")).unwrap();
    let error = open(runs.path(), Some("r"), &["policy.length_bias=-1"]).unwrap_err();
    assert!(error.to_string().contains("policy.length_bias: (none) -> -1.0"), "{error}");
}

#[test]
fn a_finished_run_stays_finished_unless_it_may_go_on_for_longer() {
    let runs = tempfile::tempdir().unwrap();
    begun(runs.path(), Some("r"), &[]);
    open(runs.path(), Some("r"), &[]).unwrap().0.finish(result()).unwrap();
    assert_eq!(open(runs.path(), Some("r"), &[]).unwrap().1, RunState::Finished);
    let longer = ["learner.total_steps=600000"];
    assert_eq!(open(runs.path(), Some("r"), &longer).unwrap().1, RunState::Unfinished);
    let error = open(runs.path(), Some("r"), &["learner.total_steps=1000"]).unwrap_err();
    assert!(error.to_string().contains("began with another configuration"), "{error}");
}

#[test]
fn a_change_with_which_nothing_would_be_trained_is_refused() {
    let runs = tempfile::tempdir().unwrap();
    let change = |set: &[&str]| {
        let keys = ["learner.clip".to_owned()];
        let opened = RunDir::open_changed(&config(runs.path(), Some("r"), set), &keys, &build("a"));
        opened.map(|(_, state)| state).map_err(|error| error.to_string())
    };
    let finish = |end: ResultCause, set: &[&str]| {
        let (mut run, _) = open(runs.path(), Some("r"), set).unwrap();
        run.finish(RunResult { end, ..result() }).unwrap();
    };
    begun(runs.path(), Some("r"), &["evaluation.stop_at=0.5"]);
    finish(ResultCause::StopAt, &["evaluation.stop_at=0.5"]);
    let refused =
        "--change: run `r` is finished, so nothing is trained with `learner.clip = 0.1`: ";
    let further = "raise `evaluation.stop_at`, or leave it out";
    let told = change(&["evaluation.stop_at=0.5", "learner.clip=0.1"]);
    assert_eq!(told, Err(format!("{refused}{further}")));
    // The value that it has anyway.
    let same = change(&["evaluation.stop_at=0.5", "learner.clip=0.2"]);
    assert_eq!(same, Ok(RunState::Finished));
    finish(ResultCause::TotalSteps, &[]);
    let told = change(&["learner.clip=0.1"]);
    assert_eq!(told, Err(format!("{refused}add --steps above 500000")));
    let further = change(&["learner.clip=0.1", "learner.total_steps=600000"]);
    assert_eq!(further, Ok(RunState::Unfinished));
}

#[test]
fn the_score_at_which_a_run_ends_may_rise_or_go_and_nothing_else() {
    let runs = tempfile::tempdir().unwrap();
    let at = |mark: &str| format!("evaluation.stop_at={mark}");
    begun(runs.path(), Some("r"), &[&at("0.5")]);
    let state = |mark: Option<&str>| {
        let set = mark.map(at);
        let set: Vec<&str> = set.iter().map(String::as_str).collect();
        open(runs.path(), Some("r"), &set).map(|(_, state)| state)
    };
    let refused = |mark: &str| state(Some(mark)).unwrap_err().to_string();
    assert!(refused("0.3").contains("evaluation.stop_at: 0.5 -> 0.3"), "{}", refused("0.3"));
    let finish = |end: ResultCause, mark: &str| {
        let (mut run, _) = open(runs.path(), Some("r"), &[&at(mark)]).unwrap();
        run.finish(RunResult { end, ..result() }).unwrap();
    };
    finish(ResultCause::StopAt, "0.5");
    assert_eq!(state(Some("0.5")).unwrap(), RunState::Finished);
    assert_eq!(state(Some("0.7")).unwrap(), RunState::Unfinished);
    finish(ResultCause::StopAt, "0.7");
    assert_eq!(state(None).unwrap(), RunState::Unfinished, "it goes on to its last step");
    assert!(refused("0.9").contains("evaluation.stop_at: (none) -> 0.9"));
    // How policies are evaluated on the way decides where it ends, so only a run without a score may change that.
    begun(runs.path(), Some("t"), &[&at("0.5")]);
    let more = "evaluation.during_training=20";
    let text = open(runs.path(), Some("t"), &[&at("0.5"), more]).unwrap_err().to_string();
    assert!(text.contains("evaluation.during_training: 4 -> 20"), "{text}");
    open(runs.path(), Some("t"), &[&at("0.5"), "evaluation.episodes=9"]).unwrap();
    open(runs.path(), Some("t"), &[more]).unwrap();
    // All steps are made: a higher score makes no more of them.
    begun(runs.path(), Some("s"), &[&at("0.5")]);
    open(runs.path(), Some("s"), &[&at("0.5")]).unwrap().0.finish(result()).unwrap();
    let again = open(runs.path(), Some("s"), &[&at("0.7")]).unwrap();
    assert_eq!(again.1, RunState::Finished);
}

#[test]
fn a_directory_that_is_not_a_run_is_left_alone_and_one_that_was_hardly_begun_is_used() {
    let runs = tempfile::tempdir().unwrap();
    for (name, file) in [("r", "novel.txt"), ("s", "checkpoints/000000000001.checkpoint")] {
        let path = runs.path().join(name).join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, "mine").unwrap();
        let reserved = Reservation::make(&config(runs.path(), Some(name), &[]), &Naming::Resume);
        for error in [open(runs.path(), Some(name), &[]).unwrap_err(), reserved.unwrap_err()] {
            assert!(error.to_string().contains("is not a run directory"), "{error}");
        }
        assert_eq!(fs::read_dir(runs.path().join(name)).unwrap().count(), 1);
    }
    // Killed before the configuration was written.
    fs::create_dir_all(runs.path().join("k/checkpoints")).unwrap();
    for file in ["lock", "run.json", "config.toml.partial", "config.toml.12.partial"] {
        fs::write(runs.path().join("k").join(file), "").unwrap();
    }
    assert_eq!(open(runs.path(), Some("k"), &[]).unwrap().1, RunState::Fresh);
}

#[test]
fn a_run_that_lost_its_checkpoints_is_refused_and_one_killed_before_the_first_begins_anew() {
    let runs = tempfile::tempdir().unwrap();
    let (run, _) = open(runs.path(), Some("early"), &[]).unwrap();
    train(&run, 10, false);
    drop(run);
    let again = RunDir::open(&config(runs.path(), Some("early"), &[]), None, &build("b")).unwrap();
    assert_eq!((again.1, again.0.record.builds.len()), (RunState::Unfinished, 1));
    let (run, _) = open(runs.path(), Some("late"), &[]).unwrap();
    train(&run, 21, false);
    fs::write(run.path.join(LAST_POLICY), "weights").unwrap();
    drop(run);
    begun(runs.path(), Some("gone"), &[]);
    open(runs.path(), Some("gone"), &[]).unwrap().0.finish(result()).unwrap();
    fs::remove_file(runs.path().join("gone/checkpoints/000000000020.checkpoint")).unwrap();
    for (name, on_record) in [("late", "21 updates on record"), ("gone", "20 updates on record")] {
        let error = open(runs.path(), Some(name), &["learner.total_steps=600000"]).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(on_record) && text.contains(&format!("--fork {name}")), "{text}");
        assert!(!text.contains("begin anew"), "{text}");
        assert_eq!(fs::read(runs.path().join(name).join(LAST_POLICY)).unwrap(), b"weights");
    }
    assert_eq!(open(runs.path(), Some("gone"), &[]).unwrap().1, RunState::Finished);
    // No checkpoint could ever be written: that may be, and only the person who runs it knows.
    let (run, _) = open(runs.path(), Some("full"), &[]).unwrap();
    train(&run, 37, false);
    let journal = run.path.join("metrics.jsonl");
    drop(run);
    let text = open(runs.path(), Some("full"), &[]).unwrap_err().to_string();
    let anew = format!("if none could be written, remove {} to begin anew", journal.display());
    assert!(text.contains("37 updates on record") && text.ends_with(&anew), "{text}");
    fs::remove_file(journal).unwrap();
    assert_eq!(open(runs.path(), Some("full"), &[]).unwrap().1, RunState::Fresh);
    // Without a name, another run is begun instead.
    let another = open(runs.path(), None, &["learner.total_steps=600000"]).unwrap();
    assert_eq!(another.1, RunState::Fresh);
}

#[test]
fn a_damaged_file_is_named_with_what_helps() {
    let runs = tempfile::tempdir().unwrap();
    begun(runs.path(), Some("r"), &[]);
    let path = runs.path().join("r");
    let says = || open(runs.path(), Some("r"), &[]).unwrap_err();
    let helps = "put a copy of the file back, or begin a new run under another --name, from the policy of this one by --fork r";
    for (file, last, fault) in [
        ("config.toml", '=', "r/config.toml is not a configuration: "),
        ("run.json", ':', "r/run.json is not the record of a run: "),
    ] {
        let whole = fs::read_to_string(path.join(file)).unwrap();
        fs::write(path.join(file), &whole[..=whole.rfind(last).unwrap()]).unwrap();
        let text = says().to_string();
        assert!(text.contains(fault) && text.ends_with(helps), "{text}");
        assert!(!text.contains("is not a run directory"), "{text}");
        fs::write(path.join(file), whole).unwrap();
    }
    let whole = fs::read(path.join("config.toml")).unwrap();
    let faults = [(b"\n\n", "config.toml is empty"), (b"\xff\xfe", "it is no text in UTF-8")];
    for (bytes, fault) in faults {
        fs::write(path.join("config.toml"), bytes).unwrap();
        let text = says().to_string();
        assert!(text.contains(fault) && text.ends_with(helps), "{text}");
    }
    fs::remove_file(path.join("config.toml")).unwrap();
    let read = read_config(&path).unwrap_err();
    for text in [says().to_string(), read.to_string()] {
        assert!(text.contains("has no config.toml any more") && text.ends_with(helps), "{text}");
    }
    fs::write(path.join("config.toml"), whole).unwrap();
    fs::remove_file(path.join("lock")).unwrap();
    fs::create_dir(path.join("lock")).unwrap();
    let text = with_causes(&says());
    assert!(text.ends_with("r/lock cannot be used: lock is not a file"), "{text}");
    fs::remove_dir(path.join("lock")).unwrap();
    std::os::unix::fs::symlink(path.join("config.toml"), path.join("lock")).unwrap();
    let text = with_causes(&says());
    assert!(text.ends_with("r/lock cannot be used: lock is a link"), "{text}");
    assert!(fs::metadata(path.join("config.toml")).unwrap().len() > 0);
    fs::remove_file(path.join("lock")).unwrap();
    fs::remove_file(path.join("metrics.jsonl")).unwrap();
    fs::create_dir(path.join("metrics.jsonl")).unwrap();
    let text = with_causes(&says());
    assert!(text.ends_with("r cannot be used: metrics.jsonl is not a file"), "{text}");
}

#[test]
fn a_file_in_the_way_of_a_directory_is_named_and_a_link_says_where_it_leads() {
    let runs = tempfile::tempdir().unwrap();
    begun(runs.path(), Some("r"), &[]);
    let says = |name: &str| with_causes(&open(runs.path(), Some(name), &[]).unwrap_err());
    let folder = runs.path().join("r/checkpoints");
    fs::rename(&folder, runs.path().join("away")).unwrap();
    // A disk that is not mounted.
    symlink("/nowhere/scratch", &folder).unwrap();
    let dead = "r/checkpoints cannot be used: checkpoints is a link to /nowhere/scratch, and nothing is there";
    assert!(says("r").ends_with(dead), "{}", says("r"));
    fs::remove_file(&folder).unwrap();
    fs::write(&folder, "").unwrap();
    let other = "r/checkpoints cannot be used: it is not a directory";
    assert!(says("r").ends_with(other), "{}", says("r"));
    symlink("/nowhere/s", runs.path().join("s")).unwrap();
    let dead = "s cannot be used: s is a link to /nowhere/s, and nothing is there";
    assert!(says("s").ends_with(dead), "{}", says("s"));
    symlink("/nowhere/runs", runs.path().join("runs")).unwrap();
    let listed = crate::ListedRun::all(&runs.path().join("runs")).unwrap_err().to_string();
    assert_eq!(listed, "runs is a link to /nowhere/runs, and nothing is there");
}

#[test]
fn a_run_that_was_renamed_goes_on_under_its_new_name() {
    let runs = tempfile::tempdir().unwrap();
    begun(runs.path(), Some("old"), &[]);
    fs::rename(runs.path().join("old"), runs.path().join("new")).unwrap();
    let (run, state) = open(runs.path(), Some("new"), &[]).unwrap();
    assert_eq!((state, run.record.name.as_str()), (RunState::Unfinished, "new"));
    assert_eq!(RunRecord::read(&run.path).unwrap().name, "new");
}

#[test]
fn the_configuration_of_a_run_leads_to_that_run_or_is_refused() {
    let place = tempfile::tempdir().unwrap();
    let runs = place.path().join("runs");
    begun(&runs, Some("r"), &[]);
    let wanted = config(&runs, Some("r"), &[]);
    let check = |directory: &Path, is_named: bool| {
        let file = directory.join("config.toml");
        check_place(&file, &wanted, is_named).map_err(|error| error.to_string())
    };
    let copy = |to: &str| {
        let directory = place.path().join(to);
        fs::create_dir_all(&directory).unwrap();
        for file in ["config.toml", "run.json"] {
            fs::copy(runs.join("r").join(file), directory.join(file)).unwrap();
        }
        directory
    };
    assert_eq!(check(&runs.join("r"), false), Ok(()));
    symlink(&runs, place.path().join("link")).unwrap();
    assert_eq!(check(&place.path().join("link/r"), false), Ok(()));
    let (renamed, moved) = (copy("away/copy"), copy("backup/r"));
    let text = check(&renamed, false).unwrap_err();
    let away = place.path().join("away");
    let go_on = format!("go on with the one there by --runs {} --name copy,", away.display());
    assert!(text.contains(&go_on), "{text}");
    assert!(text.contains(&format!("leads to {}: ", runs.join("r").display())), "{text}");
    // It is said that another run is meant.
    assert_eq!(check(&renamed, true), Ok(()));
    // The name alone does not say that.
    let text = check(&moved, true).unwrap_err();
    assert!(text.contains("--name r,"), "{text}");
    let nameless = check(&copy("away/My Run"), false).unwrap_err();
    assert!(nameless.contains("a name of a-z"), "{nameless}");
    // A configuration of one's own that has the name of a run's.
    fs::remove_file(renamed.join("run.json")).unwrap();
    assert_eq!(check(&renamed, false), Ok(()));
}

#[test]
fn a_finished_run_that_lost_its_policies_is_opened_again_to_write_them() {
    let runs = tempfile::tempdir().unwrap();
    begun(runs.path(), Some("r"), &[]);
    open(runs.path(), Some("r"), &[]).unwrap().0.finish(result()).unwrap();
    let path = runs.path().join("r");
    assert!(is_finished(&path));
    for file in [BEST_POLICY, LAST_POLICY] {
        fs::remove_file(path.join(file)).unwrap();
        assert!(!is_finished(&path));
        let (mut run, state) = open(runs.path(), Some("r"), &[]).unwrap();
        assert_eq!(state, RunState::Unfinished, "{file}");
        run.finish(result()).unwrap();
    }
    fs::remove_file(path.join("checkpoints/000000000020.checkpoint")).unwrap();
    let error = open(runs.path(), Some("r"), &[]).unwrap_err().to_string();
    assert!(error.contains("put the checkpoints back"), "{error}");
    assert!(!error.contains("--fork"), "there are no weights to fork: {error}");
    fs::write(path.join(BEST_POLICY), "weights").unwrap();
    assert_eq!(open(runs.path(), Some("r"), &[]).unwrap().1, RunState::Finished);
}

#[test]
fn a_fork_begins_with_its_weights_or_not_at_all() {
    let runs = tempfile::tempdir().unwrap();
    let wanted = config(runs.path(), Some("f"), &[]);
    let (from_a, from_b) = (fork(runs.path(), "a", 1), fork(runs.path(), "b", 2));
    let start = |fork| RunDir::open(&wanted, fork, &build("a"));
    let (run, _) = start(Some(&from_a)).unwrap();
    assert_eq!(RunRecord::read(&run.path).unwrap().origin.as_ref(), Some(&from_a.origin));
    assert_eq!(run.initial(&wanted).unwrap().as_deref(), Some(&from_a.bytes[..]));
    let initial = run.path.join(INITIAL_POLICY);
    drop(run);
    // Nothing was trained yet: the same weights without --fork, others with it.
    let (run, _) = start(None).unwrap();
    assert_eq!(run.initial(&wanted).unwrap().as_deref(), Some(&from_a.bytes[..]));
    drop(run);
    let (run, _) = start(Some(&from_b)).unwrap();
    assert_eq!(run.initial(&wanted).unwrap().as_deref(), Some(&from_b.bytes[..]));
    train(&run, 5, false);
    drop(run);
    let error = start(Some(&from_a)).unwrap_err().to_string();
    assert!(error.contains("already begun, from the weights of `b`"), "{error}");
    for damage in ["", "text"] {
        fs::write(&initial, damage).unwrap();
        let (run, state) = start(Some(&from_b)).unwrap();
        assert_eq!(state, RunState::Unfinished);
        let error = run.initial(&wanted).unwrap_err().to_string();
        assert!(
            error.contains("does not hold the weights that run `f` was forked from"),
            "{error}"
        );
        // Without a checkpoint these updates were forgotten.
        train(&run, 5, false);
    }
    fs::write(&initial, &from_a.bytes).unwrap();
    assert!(start(None).unwrap().0.initial(&wanted).is_err(), "other weights are none");
    begun(runs.path(), Some("r"), &[]);
    let scratch = config(runs.path(), Some("r"), &[]);
    let error = RunDir::open(&scratch, Some(&from_a), &build("a")).unwrap_err().to_string();
    assert!(error.contains("from fresh weights"), "{error}");
}

#[test]
fn a_setting_that_changes_before_the_first_checkpoint_is_that_of_the_whole_run() {
    let runs = tempfile::tempdir().unwrap();
    let keys = ["learner.clip".to_owned()];
    let changed = config(runs.path(), Some("r"), &["learner.clip=0.1"]);
    let (run, _) = open(runs.path(), Some("r"), &[]).unwrap();
    train(&run, 5, false);
    drop(run);
    let (run, state) = RunDir::open_changed(&changed, &keys, &build("a")).unwrap();
    assert_eq!((state, run.record.changes), (RunState::Unfinished, Vec::new()));
    begun(runs.path(), Some("s"), &[]);
    let changed = config(runs.path(), Some("s"), &["learner.clip=0.1"]);
    let (run, _) = RunDir::open_changed(&changed, &keys, &build("a")).unwrap();
    assert_eq!(run.record.changes.len(), 1);
}

#[test]
fn a_record_lists_every_build_that_took_the_run_up() {
    let runs = tempfile::tempdir().unwrap();
    for (second, n_builds) in [("a", 1), ("b", 2)] {
        let name = format!("r-{second}");
        begun(runs.path(), Some(&name), &[]);
        let config = config(runs.path(), Some(&name), &[]);
        drop(open_by(second, &config).unwrap());
        let record = RunRecord::read(&runs.path().join(&name)).unwrap();
        assert_eq!(record.builds.len(), n_builds, "{name}");
    }
}
