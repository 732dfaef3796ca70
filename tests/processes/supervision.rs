//! A supervisor and its processes: they live together, and none is left behind.

use std::time::Duration;

use crate::support::{
    PATIENCE, Place, arguments, children, is_alive, result, signal, updates, wait_until,
};

const SECOND: Duration = Duration::from_secs(1);

/// A run that does not end by itself while a test looks at it.
const LONG: &[&str] = &[
    "up",
    "-c",
    "cartpole",
    "--name",
    "r",
    "--actors",
    "2",
    "--set",
    "learner.n_steps=32",
    "--set",
    "learner.total_steps=100000000",
    "--set",
    "run.checkpoint_every=4",
];

/// Returns the supervisor's learner and actors, once all are there.
fn family(id: u32) -> (u32, Vec<u32>) {
    let mut found = (0, Vec::new());
    wait_until("learner and actors are there", PATIENCE, || {
        let with = |word: &str| {
            let named = |child: &u32| arguments(*child).contains(word);
            children(id).into_iter().filter(named).collect::<Vec<_>>()
        };
        let (learners, actors) = (with(" learner "), with(" actor "));
        found = (learners.first().copied().unwrap_or(0), actors);
        found.0 != 0 && found.1.len() == 2
    });
    found
}

#[test]
fn a_killed_supervisor_leaves_no_orphan() {
    let place = Place::new();
    let mut command = place.program(LONG);
    command.env("TMPDIR", place.path());
    let supervisor = place.start_with(command);
    let (learner, actors) = family(supervisor.id());
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 2);
    supervisor.kill();
    wait_until("every process is gone", 6 * SECOND, || {
        !is_alive(learner) && actors.iter().all(|actor| !is_alive(*actor))
    });
    let names = std::fs::read_dir(place.path()).unwrap().map(|entry| entry.unwrap().file_name());
    let left: Vec<_> =
        names.filter(|name| name.to_string_lossy().starts_with("leadtime-")).collect();
    assert!(left.is_empty(), "temporary files are left: {left:?}");
}

#[test]
fn an_interrupted_supervisor_takes_everything_down_within_five_seconds() {
    let place = Place::new();
    let supervisor = place.start(LONG);
    let (learner, actors) = family(supervisor.id());
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 2);
    signal("INT", supervisor.id());
    supervisor.finish(6 * SECOND).with_code(130);
    assert!(!is_alive(learner) && actors.iter().all(|actor| !is_alive(*actor)));
    let n_checkpoints = std::fs::read_dir(place.run("r").join("checkpoints")).unwrap().count();
    assert!(n_checkpoints > 0);
}

#[test]
fn a_process_that_hangs_is_killed_before_the_supervisor_ends() {
    let place = Place::new();
    let supervisor = place.start(LONG);
    let (learner, actors) = family(supervisor.id());
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 2);
    signal("STOP", learner);
    signal("INT", supervisor.id());
    supervisor.finish(6 * SECOND).with_code(130).saying(&["did not end in time and are killed"]);
    assert!(!is_alive(learner) && actors.iter().all(|actor| !is_alive(*actor)));
}

#[test]
fn crashed_processes_are_started_again() {
    let place = Place::new();
    let supervisor = place.start(LONG);
    let (learner, actors) = family(supervisor.id());
    wait_until("a checkpoint has been passed", PATIENCE, || updates(&place.run("r")) >= 6);
    signal("KILL", actors[0]);
    signal("KILL", learner);
    let (new_learner, new_actors) = {
        wait_until("the old ones are gone", PATIENCE, || {
            !is_alive(learner) && !is_alive(actors[0])
        });
        family(supervisor.id())
    };
    assert_ne!(new_learner, learner);
    assert!(!new_actors.contains(&actors[0]));
    wait_until("the learner has resumed", PATIENCE, || supervisor.stderr().contains("resumed"));
    let before = updates(&place.run("r"));
    wait_until("the run goes on", PATIENCE, || updates(&place.run("r")) > before);
    signal("TERM", supervisor.id());
    supervisor.finish(6 * SECOND).with_code(130);
}

#[test]
fn a_program_whose_file_is_gone_restarts_its_processes() {
    let place = Place::new();
    let copy = place.copy_of_program("leadtime");
    let supervisor = place.start_with(place.program_at(&copy, LONG));
    let (_, actors) = family(supervisor.id());
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 2);
    std::fs::remove_file(&copy).unwrap();
    signal("KILL", actors[0]);
    wait_until("the old one is gone", PATIENCE, || !is_alive(actors[0]));
    let (_, actors) = family(supervisor.id());
    let before = updates(&place.run("r"));
    wait_until("the run goes on", PATIENCE, || updates(&place.run("r")) > before + 5);
    assert!(actors.iter().all(|actor| is_alive(*actor)));
    signal("TERM", supervisor.id());
    supervisor.finish(6 * SECOND).with_code(130).saying(&["process died; restarting it"]);
}

#[test]
fn an_interrupted_evaluation_ends_at_once() {
    let place = Place::new();
    let smoke = place.start(&["smoke", "--quick", "--episodes", "1000000"]);
    let finished =
        |run: std::path::PathBuf| run.join("run.json").exists() && !result(&run).is_null();
    wait_until("the training is over", 2 * PATIENCE, || {
        let runs = std::fs::read_dir(place.path().join("runs")).into_iter().flatten();
        children(smoke.id()).is_empty() && { runs }.any(|run| finished(run.unwrap().path()))
    });
    signal("INT", smoke.id());
    smoke.finish(2 * SECOND).with_code(130);
}

#[test]
fn a_directory_that_is_not_the_supervisors_is_never_removed() {
    let place = Place::new();
    let notes = place.path().join("leadtime-notes");
    std::fs::create_dir(&notes).unwrap();
    std::fs::write(notes.join("mine"), "").unwrap();
    let (endpoint, notes) = (place.endpoint("learner"), notes.to_str().unwrap().to_owned());
    let args = ["learner", "-c", "cartpole", "--listen", &endpoint, "--scratch", &notes];
    let learner = place.start(&args);
    wait_until("it listens", PATIENCE, || learner.stderr().contains("listening"));
    signal("INT", learner.id());
    learner.finish(5 * SECOND).with_code(130);
    assert!(std::path::Path::new(&notes).join("mine").exists());
}

#[test]
fn a_run_under_supervision_ends_by_itself_and_is_on_record() {
    let place = Place::new();
    let short = ["--set", "learner.total_steps=1280"];
    let done = place.finish(&[LONG, &short].concat()).with_code(0);
    assert!(done.stdout.contains("weights"), "{}", done.stdout);
    let result = result(&place.run("r"));
    assert_eq!(result["updates"], 10);
    let list = place.finish(&["runs", "--json"]).with_code(0).json();
    assert_eq!(list[0]["name"], "r");
    assert_eq!(list[0]["state"], "finished");
    place.finish(&[LONG, &short].concat()).with_code(0).saying(&["finished"]);
}
