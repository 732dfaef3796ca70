//! A supervisor and its processes: they live together, and none is left behind.

use crate::support::{
    BEFORE_DEADLINE, PATIENCE, Place, Running, SOON, checkpoints, children, family, is_alive,
    result, signal, updates, wait_for_updates, wait_for_words, wait_until,
};

/// A run that does not end by itself while a test looks at it.
const LONG: &str = "up -c cartpole --name r --actors 2 --set learner.n_steps=32 --set learner.total_steps=100000000 \
                    --set run.checkpoint_every=4";

/// Starts a long run; returns its supervisor and every process of it, the learner first, once it is under way.
fn start(place: &Place) -> (Running, Vec<u32>) {
    let mut command = place.program(&[LONG]);
    command.env("TMPDIR", place.path());
    let supervisor = place.start_with(command);
    let (learner, actors) = family(supervisor.id());
    wait_for_updates(&place.run("r"), 2);
    (supervisor, [vec![learner], actors].concat())
}

fn are_gone(processes: &[u32]) -> bool {
    processes.iter().all(|process| !is_alive(*process))
}

#[test]
fn a_killed_supervisor_leaves_no_orphan() {
    let place = Place::new();
    let (supervisor, processes) = start(&place);
    supervisor.kill();
    wait_until("every process is gone", PATIENCE, || are_gone(&processes));
    let names = std::fs::read_dir(place.path()).unwrap().map(|entry| entry.unwrap().file_name());
    let is_ours = |name: &std::ffi::OsString| name.to_string_lossy().starts_with("leadtime-");
    let left: Vec<_> = names.filter(is_ours).collect();
    assert!(left.is_empty(), "temporary files are left: {left:?}");
}

#[test]
fn an_interrupted_supervisor_takes_everything_down_in_time() {
    let place = Place::new();
    let (supervisor, processes) = start(&place);
    signal("INT", supervisor.id());
    let ended = supervisor.finish(SOON).with_code(130);
    assert!(!ended.stderr.contains("did not end in time"), "{}", ended.stderr);
    assert!(are_gone(&processes));
    assert!(!checkpoints(&place.run("r")).is_empty());
}

#[test]
fn actors_yield_to_a_learner_that_has_no_core_of_its_own() {
    // One more than there are cores.
    let place = Place::new();
    let n_threads = std::thread::available_parallelism().unwrap().get() - 1;
    let n_threads = format!("--set learner.threads={}", n_threads.max(1));
    let supervisor = place.start(&[LONG, &n_threads]);
    let (learner, actors) = family(supervisor.id());
    // The run is under way with the first actor that joins; the other may not have begun to collect.
    for actor in actors {
        wait_until("the thread that collects is nicer than the others", PATIENCE, || {
            let (collects, others): (Vec<_>, Vec<_>) =
                niceness(actor).into_iter().partition(|(name, _)| name == "actor-collect");
            matches!(collects[..], [(_, nice)] if others.iter().all(|(_, other)| *other < nice))
        });
    }
    assert!(niceness(learner).windows(2).all(|two| two[0].1 == two[1].1));
    signal("TERM", supervisor.id());
    supervisor.finish(PATIENCE).with_code(130);
}

/// Returns the names of a process's threads, and how nice each is (`proc_pid_stat(5)`).
fn niceness(process: u32) -> Vec<(String, i32)> {
    let read = |thread: std::fs::DirEntry| {
        let stat = std::fs::read_to_string(thread.path().join("stat")).ok()?;
        let (name, rest) = stat.split_once(" (")?.1.rsplit_once(") ")?;
        // The name is the second field, and this the nineteenth.
        Some((name.to_owned(), rest.split(' ').nth(16)?.parse().ok()?))
    };
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).unwrap();
    threads.filter_map(|thread| read(thread.unwrap())).collect()
}

#[test]
fn a_drained_supervisor_ends_well_and_its_run_can_go_on() {
    let place = Place::new();
    let (supervisor, processes) = start(&place);
    signal("USR1", supervisor.id());
    let ended = supervisor.finish(PATIENCE).with_code(0);
    let told = ended.saying(&["asked to drain", "To go on from update"]).stderr;
    assert_eq!(told.matches("To go on from update").count(), 1, "{told}");
    assert!(are_gone(&processes));
    assert!(!checkpoints(&place.run("r")).is_empty());
    assert!(result(&place.run("r")).is_null(), "it is not finished");
}

#[test]
fn a_supervisor_that_is_drained_while_it_chooses_a_lag_ends_well_and_begins_no_run() {
    let place = Place::new();
    let supervisor = place.start(&[LONG, "--choose-lag --set learner.mode=lag"]);
    wait_for_words(&supervisor, "Trying learner.lag = 1");
    signal("USR1", supervisor.id());
    let ended = supervisor.finish(PATIENCE).with_code(0);
    ended.saying(&["asked to drain", "No lag is chosen, and no run is begun."]);
    assert!(!place.run("r").exists());
}

#[test]
fn the_trials_of_a_lag_are_no_runs_of_the_directory_that_is_named() {
    let place = Place::new();
    let choose = "--choose-lag --set learner.mode=lag --runs elsewhere";
    let supervisor = place.start(&[LONG, choose]);
    wait_for_words(&supervisor, "Trying learner.lag = 2");
    signal("USR1", supervisor.id());
    supervisor.finish(PATIENCE).with_code(0);
    assert!(!place.path().join("elsewhere").exists());
}

#[test]
fn a_lag_is_tried_for_a_fork_and_without_the_actors_that_are_to_join_the_run() {
    let place = Place::new();
    place.finish(&[&LONG.replace("--name r", "--name a"), "--stop-after 2"]).with_code(0);
    let fork = "--choose-lag --set learner.mode=lag --set run.actors_min=3 --fork a --listen";
    let supervisor = place.start(&[LONG, fork, &place.endpoint("others")]);
    // The first trial has found the weights, and made updates.
    wait_for_words(&supervisor, "Trying learner.lag = 2");
    signal("USR1", supervisor.id());
    supervisor.finish(PATIENCE).with_code(0);
    place.finish(&[LONG, "--choose-lag --set learner.mode=lag --fork nobody"]).with_code(2);
}

#[test]
fn a_smoke_that_is_drained_ends_in_order_and_has_not_passed() {
    let place = Place::new();
    let smoke = place.start(&["smoke --set learner.total_steps=100000000"]);
    let under_way = || {
        let mut runs = std::fs::read_dir(place.path().join("runs")).into_iter().flatten();
        runs.any(|run| updates(&run.unwrap().path()) >= 1)
    };
    wait_until("a run is under way", PATIENCE, under_way);
    let processes = children(smoke.id());
    signal("USR1", smoke.id());
    let ended = smoke.finish(PATIENCE).with_code(130);
    ended.saying(&["asked to drain", "To go on from update"]);
    assert!(are_gone(&processes));
}

#[test]
fn a_process_that_hangs_is_killed_before_the_supervisor_ends() {
    let place = Place::new();
    let (supervisor, processes) = start(&place);
    signal("STOP", processes[0]);
    signal("INT", supervisor.id());
    supervisor.finish(PATIENCE).with_code(130).saying(&["did not end in time and are killed"]);
    assert!(are_gone(&processes));
}

/// Returns the CPUs that a process may use, as the system writes them: `0-3,7`.
fn cpus(process: u32) -> String {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let mut lines = status.lines();
    lines.find_map(|line| line.strip_prefix("Cpus_allowed_list:")).unwrap().trim().to_owned()
}

#[test]
fn pinned_processes_keep_to_cpus_of_their_own() {
    let place = Place::new();
    let supervisor = place.start(&[LONG, "--pin --set learner.threads=1"]);
    let (learner, actors) = family(supervisor.id());
    wait_for_updates(&place.run("r"), 2);
    let all = cpus(supervisor.id());
    let [learner, actor] = [learner, actors[0]].map(cpus);
    if all.contains(['-', ',']) {
        let one_each = [&learner, &actor].iter().all(|cpus| !cpus.contains(['-', ',']));
        assert!(one_each && learner != actor, "{learner} and {actor} of {all}");
        wait_for_words(&supervisor, "Pinned: the learner to CPU");
    } else {
        assert_eq!([&learner, &actor], [&all, &all]);
        wait_for_words(&supervisor, "Nothing is pinned: ");
    }
    signal("TERM", supervisor.id());
    supervisor.finish(PATIENCE).with_code(130);
}

#[test]
fn a_learner_that_leaves_no_cpu_to_actors_is_not_pinned_and_trains() {
    let in_range = |range: &str| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        last.parse::<usize>().unwrap() + 1 - first.parse::<usize>().unwrap()
    };
    let n_cpus: usize = cpus(std::process::id()).split(',').map(in_range).sum();
    // A learner has no more threads than that.
    if n_cpus > 64 {
        return;
    }
    let place = Place::new();
    let threads = format!("--pin --stop-after 2 --set learner.threads={n_cpus}");
    let ended = place.start(&[LONG, &threads]).finish(PATIENCE).with_code(0);
    ended.saying(&["Nothing is pinned: ", "leaves none of ", "`learner.threads`"]);
    assert_eq!(updates(&place.run("r")), 2);
}

#[test]
fn crashed_processes_are_started_again() {
    let place = Place::new();
    let (supervisor, processes) = start(&place);
    // A checkpoint has been passed.
    wait_for_updates(&place.run("r"), 6);
    let crashed = [processes[1], processes[0]];
    for process in crashed {
        signal("KILL", process);
    }
    wait_until("the old ones are gone", PATIENCE, || are_gone(&crashed));
    let (new_learner, new_actors) = family(supervisor.id());
    assert!(!crashed.contains(&new_learner) && !new_actors.contains(&crashed[0]));
    wait_for_words(&supervisor, "resumed");
    wait_for_updates(&place.run("r"), updates(&place.run("r")) + 1);
    signal("TERM", supervisor.id());
    supervisor.finish(PATIENCE).with_code(130);
}

#[test]
fn a_program_whose_file_is_gone_restarts_its_processes() {
    let place = Place::new();
    let copy = place.copy_of_program("leadtime");
    let supervisor = place.start_with(place.program_at(&copy, &[LONG]));
    let (_, actors) = family(supervisor.id());
    wait_for_updates(&place.run("r"), 2);
    std::fs::remove_file(&copy).unwrap();
    signal("KILL", actors[0]);
    wait_until("the old one is gone", PATIENCE, || !is_alive(actors[0]));
    let (_, actors) = family(supervisor.id());
    wait_for_updates(&place.run("r"), updates(&place.run("r")) + 6);
    assert!(actors.iter().all(|actor| is_alive(*actor)));
    signal("TERM", supervisor.id());
    supervisor.finish(PATIENCE).with_code(130).saying(&["process died; restarting it"]);
}

#[test]
fn an_interrupted_evaluation_ends_at_once() {
    let place = Place::new();
    let smoke = place.start(&["smoke --quick --episodes 1000000"]);
    let finished =
        |run: std::path::PathBuf| run.join("run.json").exists() && !result(&run).is_null();
    wait_until("the training is over", 2 * PATIENCE, || {
        let runs = std::fs::read_dir(place.path().join("runs")).into_iter().flatten();
        children(smoke.id()).is_empty() && { runs }.any(|run| finished(run.unwrap().path()))
    });
    signal("INT", smoke.id());
    smoke.finish(BEFORE_DEADLINE).with_code(130);
}

#[test]
fn a_directory_that_is_not_the_supervisors_is_never_removed() {
    let place = Place::new();
    let notes = place.file("leadtime-notes");
    std::fs::create_dir(&notes).unwrap();
    let mine = place.write("leadtime-notes/mine", "");
    let endpoint = place.endpoint("learner");
    let args = ["learner -c cartpole --listen", &endpoint, "--scratch", &notes];
    let learner = place.start(&args);
    wait_for_words(&learner, "listening");
    signal("INT", learner.id());
    learner.finish(PATIENCE).with_code(130);
    assert!(std::path::Path::new(&mine).exists());
}
