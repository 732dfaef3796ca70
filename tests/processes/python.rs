//! Worlds in Python, stepped by a worker in Python's standard library: whatever happens to workers, the weights are the same; what
//! is wrong with an environment is one sentence; and nobody executes what somebody else wrote.

use std::fs;
use std::process::Command;
use std::time::{Duration, Instant};

use crate::support::{
    Finished, PATIENCE, Place, arguments, children, repository, result, signal, updates,
    wait_for_updates, wait_for_words, wait_until,
};

/// Short enough to be trained again and again.
const SETTINGS: &str = "
[learner]
n_envs = 4
n_steps = 32
total_steps = 2560
";

/// What the environments look like.
const SPEC: &str = "spec = { obs_dim = 4, heads = [{ name = \"action\", n_choices = 2 }] }";

fn fake(mode: &str) -> String {
    format!("python3 {} {mode}", repository("tests/worker/fake.py"))
}

/// Writes the configuration of a run whose worker has a mode.
fn config(place: &Place, name: &str, mode: &str, more: &str) -> String {
    let worker = fake(mode);
    let text = format!(
        "domain = \"python\"\n[world]\nworker = \"{worker}\"\nenv = {{}}\nmetrics = [\"success\"]\nstep_timeout = \"1s\"\n\
         {more}\n{SETTINGS}"
    );
    place.write(&format!("{name}.toml"), &text)
}

/// Trains with one actor and returns the digest of the weights.
fn train(place: &Place, name: &str, mode: &str, more: &str) -> (String, Finished) {
    // Only the actor starts a worker.
    let file = config(place, name, mode, &format!("{SPEC}\n{more}"));
    let finished = place.finish(&["up --actors 1 --name", name, "-c", &file]).with_code(0);
    (weights(place, name), finished)
}

fn weights(place: &Place, name: &str) -> String {
    result(&place.run(name))["weights_sha256"].as_str().unwrap().to_owned()
}

/// Returns whether a process is a worker, and not the shell that started it.
fn is_worker(id: u32) -> bool {
    let arguments = arguments(id);
    arguments.contains("fake.py") && !arguments.starts_with("sh ")
}

/// Lists the worker processes below a process.
fn workers_of(id: u32) -> Vec<u32> {
    let below = children(id).into_iter().flat_map(|child| {
        let further = workers_of(child);
        std::iter::once(child).chain(further).collect::<Vec<_>>()
    });
    below.filter(|id| is_worker(*id)).collect()
}

#[test]
fn the_same_seed_gives_the_same_weights_however_many_workers_and_whoever_is_killed() {
    let place = Place::new();
    let file = config(&place, "several", "", "batch = 2");
    let long = "--set learner.total_steps=25600";
    place.finish(&["up --actors 1 --name alone -c", &file, long]).with_code(0);
    let up = place.start(&["up --actors 3 --name several -c", &file, long]);
    wait_for_updates(&place.run("several"), 5);
    let workers = workers_of(up.id());
    assert!(workers.len() >= 3, "{workers:?}");
    signal("KILL", workers[0]);
    let now = updates(&place.run("several"));
    wait_for_updates(&place.run("several"), now + 5);
    let actor = children(up.id()).into_iter().find(|id| arguments(*id).contains("--id actor-2"));
    signal("KILL", actor.unwrap());
    up.finish(PATIENCE).with_code(0).saying(&["is started again"]);
    let compared = place.finish(&["runs compare alone several"]).with_code(0);
    assert!(compared.stdout.contains("weights: equal"), "{}", compared.stdout);
    // One actor with two workers.
    let at = place.endpoint("two");
    let learner = place.start(&["learner --name two --listen", &at, "-c", &file, long]);
    wait_for_words(&learner, "run opened");
    let actor = place.start(&["actor --trust-worker --workers 2 --connect", &at]);
    wait_for_updates(&place.run("two"), 2);
    assert_eq!(workers_of(actor.id()).len(), 2);
    learner.finish(PATIENCE).with_code(0);
    assert_eq!(weights(&place, "two"), weights(&place, "alone"));
}

#[test]
fn a_worker_that_fails_once_is_replaced_and_no_bit_changes() {
    let place = Place::new();
    let (expected, clean) = train(&place, "clean", "", "");
    assert!(clean.stderr.contains("a worker prints this"), "{}", clean.stderr);
    for (mode, told) in [
        ("exits", "out of fuel"),
        (
            "hangs",
            "it said nothing for 2s; where a step or a reset takes longer, raise world.step_timeout",
        ),
        ("garbage", "started again"),
        ("huge-frame", "a frame of 2147483648 bytes"),
        ("raises", "its step is taken again"),
        ("killed-at-once", "is started again: it ended before it said hello"),
        // Whether its connection was noticed before its end is a matter of luck.
        ("killed-before-hello", "is started again: it ended"),
    ] {
        let flag = place.file(&format!("{mode}.flag"));
        let (found, finished) = train(&place, mode, &format!("{mode} {flag}"), "");
        finished.saying(&[told]);
        assert_eq!(found, expected, "{mode}");
    }
    // A second environment that is made in more than `step_timeout` is waited for, as the first one is.
    let (slow, finished) = train(&place, "slow", "makes-slowly", "");
    assert!(!finished.stderr.contains("is started again"), "{}", finished.stderr);
    assert_eq!(slow, expected);
    let (pickled, _) = train(&place, "pickled", "", "snapshot = \"pickle\"");
    assert_eq!(pickled, expected, "a pickle puts an environment where its actions do");
}

/// Returns the most memory that a process has held so far, in bytes.
fn peak_memory(id: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    let kilobytes: u64 = peak.trim().trim_end_matches(" kB").parse().unwrap();
    kilobytes << 10
}

#[test]
fn what_a_worker_claims_to_send_costs_its_actor_no_memory() {
    let place = Place::new();
    for mode in ["garbage", "huge-frame"] {
        let flag = place.file(&format!("{mode}.flag"));
        let file = config(&place, mode, &format!("{mode} {flag}"), SPEC);
        let up = place.start(&["up --actors 1 --steps 1e9 --name", mode, "-c", &file]);
        wait_for_words(&up, "started again");
        let now = updates(&place.run(mode));
        wait_for_updates(&place.run(mode), now + 2);
        let actor = children(up.id()).into_iter().find(|id| arguments(*id).contains(" actor "));
        let peak = peak_memory(actor.unwrap());
        // The program itself included.
        assert!(peak < 64 << 20, "{mode}: {peak} bytes");
        signal("TERM", up.id());
        up.finish(PATIENCE).with_code(130);
    }
}

/// Runs a learner, and an actor that is expected to end.
fn actor_of(place: &Place, name: &str, mode: &str, options: &str) -> Finished {
    // The learner is told what the environments look like, and starts no worker.
    let file = config(place, name, mode, SPEC);
    let at = place.endpoint(name);
    let learner = place.start(&["learner --listen", &at, "--name", name, "-c", &file]);
    wait_for_words(&learner, "run opened");
    let mut command = place.program(&["actor --connect", &at]);
    command.args(options.split('|').filter(|option| !option.is_empty()));
    let actor = place.start_with(command).finish(PATIENCE);
    assert!(workers_of(learner.id()).is_empty(), "a learner starts no worker");
    actor
}

#[test]
fn an_environment_that_keeps_failing_ends_its_actor_with_a_sentence() {
    let place = Place::new();
    let words = "environment 0 fails: IndexError: list index out of range (my_envs.py:40)";
    actor_of(&place, "raises", "raises", "--trust-worker").with_code(1).saying(&[words]);
    let moves = ["environment 0 was put back in episode", "shows something else than before"];
    actor_of(&place, "moves", "raises-and-moves", "--trust-worker").with_code(1).saying(&moves);
    let nan = "observation[3] is nan after action [";
    actor_of(&place, "nan", "nan", "--trust-worker").with_code(1).saying(&[nan, "step "]);
    let huge = "the reward is 2e9 after action [";
    actor_of(&place, "huge", "huge-reward", "--trust-worker").with_code(1).saying(&[huge]);
    let exits = ["died 3 times within a minute", "its last words: out of fuel"];
    actor_of(&place, "exits", "exits", "--trust-worker").with_code(1).saying(&exits);
}

#[test]
fn an_environment_that_cannot_be_put_back_fails_with_its_first_exception() {
    let (place, more) = (Place::new(), format!("{SPEC}\nsnapshot = \"none\""));
    let flag = place.file("raises.flag");
    let file = config(&place, "none", &format!("raises {flag}"), &more);
    let at = place.endpoint("none");
    let asynchronous = "learner --name none --set learner.mode=async --listen";
    let learner = place.start(&[asynchronous, &at, "-c", &file]);
    wait_for_words(&learner, "run opened");
    let actor = place.finish(&["actor --trust-worker --connect", &at]).with_code(1);
    let actor = actor.saying(&["environment 0 fails: IndexError: list index out of range"]);
    assert!(!actor.stderr.contains("is taken again"), "{}", actor.stderr);
}

#[test]
fn environments_are_closed_when_a_run_is_over() {
    let place = Place::new();
    let flag = place.file("closes.flag");
    train(&place, "closes", &format!("closes {flag}"), "");
    let closed = format!("{flag}.closed");
    assert!(fs::exists(&closed).unwrap(), "the worker was killed before it had closed anything");
}

#[test]
fn workers_that_never_close_are_waited_for_together_and_not_one_after_the_other() {
    const N_WORKERS: usize = 8;
    let place = Place::new();
    let asked = place.file("asked");
    let mode = format!("never-closes {asked}");
    let file = config(&place, "n", &mode, &format!("{SPEC}\nbatch = 1"));
    let (at, long) =
        (place.endpoint("n"), "--set learner.n_envs=8 --set learner.total_steps=2560000");
    let learner = place.start(&["learner --name n --listen", &at, "-c", &file, long]);
    wait_for_words(&learner, "run opened");
    let actor = place.start(&["actor --trust-worker --workers 8 --connect", &at]);
    wait_for_updates(&place.run("n"), 2);
    assert_eq!(workers_of(actor.id()).len(), N_WORKERS);
    signal("TERM", actor.id());
    actor.finish(PATIENCE);
    learner.kill();
    // Each has two seconds from when it is asked: one after the other, the second would be asked when those of the first are over.
    let asked = fs::read_to_string(asked).unwrap();
    let mut asked: Vec<f64> = asked.lines().map(|at| at.parse().unwrap()).collect();
    asked.sort_unstable_by(f64::total_cmp);
    assert!(asked.len() > 1 && asked[asked.len() - 1] - asked[0] < 1.9, "{asked:?}");
}

#[test]
fn a_worker_that_does_not_begin_is_wrong_input() {
    let place = Place::new();
    for (mode, told) in [
        ("cannot-import", "ModuleNotFoundError: No module named 'my_envs'"),
        ("ends-at-once", "its last words: no module named my_envs"),
        ("garbage-hello", "it sent a frame"),
    ] {
        actor_of(&place, mode, mode, "--trust-worker").with_code(2).saying(&[told]);
    }
    let missing = "--worker|nobody-has-this-program";
    actor_of(&place, "missing", "", missing).with_code(2).saying(&["nobody-has-this-program"]);
    let file = config(&place, "asked", "cannot-import", "");
    let told = ["ModuleNotFoundError: No module named 'my_envs'"];
    let began = Instant::now();
    place.finish(&["up --actors 1 -c", &file]).with_code(2).saying(&told);
    // Three seconds are promised. A busy machine takes longer; a retry or a wait in vain takes much longer.
    println!("an import that fails is told after {:?}", began.elapsed());
    assert!(began.elapsed() < Duration::from_secs(25), "{:?}", began.elapsed());
}

#[test]
fn an_actor_whose_worker_is_missing_ends_alone() {
    let place = Place::new();
    let (file, at) = (config(&place, "others", "", SPEC), place.endpoint("others"));
    let learner = place.start(&["learner --steps 1e9 --listen", &at, "--name others -c", &file]);
    wait_for_words(&learner, "run opened");
    let mut other = place.start(&["actor --id other --trust-worker --connect", &at]);
    wait_for_updates(&place.run("others"), 2);
    let began = Instant::now();
    let missing = ["actor --id lost --worker nobody-has-this-program --connect", &at];
    place.finish(&missing).with_code(2).saying(&["nobody-has-this-program"]);
    assert!(began.elapsed() < Duration::from_secs(25), "{:?}", began.elapsed());
    let now = updates(&place.run("others"));
    wait_for_updates(&place.run("others"), now + 2);
    assert!(other.is_running(), "{}", other.stderr());
    other.kill();
    learner.kill();
}

#[test]
fn an_environment_that_never_works_is_wrong_input_and_its_actor_is_not_started_again() {
    let place = Place::new();
    for (mode, told) in [
        ("cannot-import", "ModuleNotFoundError: No module named 'my_envs'"),
        ("cannot-reset", "environment 0 fails: ValueError: no display"),
        (
            "raises-at-once",
            "environment 0 fails: IndexError: list index out of range (my_envs.py:40)",
        ),
    ] {
        let alone = format!("{mode}-alone");
        actor_of(&place, &alone, mode, "--trust-worker").with_code(2).saying(&[told]);
        let file = config(&place, mode, mode, SPEC);
        let up = place.finish(&["up --actors 1 --name", mode, "-c", &file]).with_code(1);
        let up = up.saying(&["actor 1 ended and is not restarted (exit status: 2)"]);
        let errors = up.stderr.lines().filter(|line| line.starts_with("error: "));
        let errors: Vec<&str> = errors.collect();
        assert!(matches!(errors[..], [only] if only.ends_with(told)), "{}", up.stderr);
        assert!(!up.stderr.contains("restarting it"), "{}", up.stderr);
    }
}

#[test]
fn a_foreign_configuration_executes_nothing() {
    let place = Place::new();
    let flag = place.file("executed");
    let text = format!(
        "domain = \"python\"\n[world]\nworker = \"touch {flag}\"\nmetrics = [\"success\"]\n{SPEC}\n{SETTINGS}"
    );
    let file = place.write("theirs.toml", &text);
    let at = place.endpoint("theirs");
    let learner = place.start(&["learner --listen", &at, "--name theirs -c", &file]);
    wait_for_words(&learner, "run opened");
    let refused = place.finish(&["actor --connect", &at]).with_code(2);
    refused.saying(&["--worker COMMAND", "--trust-worker"]);
    // With a command of its own it takes part.
    let mut command = place.program(&["actor --connect", &at]);
    command.args(["--worker", &fake("")]);
    place.start_with(command).finish(PATIENCE).with_code(0);
    learner.finish(PATIENCE).with_code(0);
    assert!(!fs::exists(&flag).unwrap(), "the learner's command was executed");
    // A policy that may come from anywhere is not evaluated with its own command; the run on this disk is.
    let policy = place.file("policy.safetensors");
    fs::copy(place.run("theirs").join("policy.safetensors"), &policy).unwrap();
    let eval = |what: &str, options: &[&str]| {
        let mut command: Command = place.program(&["eval --episodes 4", what]);
        command.args(options);
        place.start_with(command).finish(PATIENCE)
    };
    eval(&policy, &[]).with_code(1).saying(&["--trust-worker"]);
    assert!(!fs::exists(&flag).unwrap(), "a policy's command was executed");
    eval(&policy, &["--worker", &fake("")]).with_code(0);
}

#[test]
fn check_compares_two_processes_and_a_pickle_with_what_it_stands_for() {
    let place = Place::new();
    let check = |name: &str, mode: &str, more: &str| {
        let file = config(&place, name, mode, more);
        place.finish(&["check -c", &file])
    };
    let good = check("good", "", "").with_code(0);
    assert!(good.stdout.contains("200 steps, equal in every byte"), "{}", good.stdout);
    let random = check("random", "random", "");
    assert_eq!(random.code, Some(1), "{}", random.stderr);
    assert!(random.stdout.contains("two processes differ in observation[0]"), "{}", random.stdout);
    // What fails is told as what it is, and not by what follows from it.
    let raises = check("raises", "raises-at-once", "");
    assert_eq!(raises.code, Some(1), "{}", raises.stderr);
    let told = "step 1 of episode 0 cannot be played: environment 0 fails:";
    assert!(raises.stdout.contains(told), "{}", raises.stdout);
    for follows in ["`reset` leaves", "not deterministic", "two processes differ"] {
        assert!(!raises.stdout.contains(follows), "{}", raises.stdout);
    }
    let n_told = raises.stderr.matches("its step is taken again").count();
    assert!(n_told <= 2, "{n_told}: {}", raises.stderr);
    check("empty", "empty-pickle", "snapshot = \"pickle\"")
        .with_code(2)
        .saying(&["a pickle of the environment is not all of it", "snapshot = \"replay\""]);
    check("none", "", "snapshot = \"none\"").with_code(2).saying(&["learner.mode", "async"]);
    let file = config(&place, "async", "", "snapshot = \"none\"");
    place.finish(&["check --set learner.mode=async -c", &file]).with_code(0);
}

#[test]
fn a_worker_ends_with_its_actor() {
    let place = Place::new();
    let file = config(&place, "killed", "", "");
    let up = place.start(&["up --actors 1 --name killed --steps 1e9 -c", &file]);
    wait_for_updates(&place.run("killed"), 2);
    let workers = workers_of(up.id());
    assert!(!workers.is_empty());
    for id in children(up.id()) {
        signal("KILL", id);
    }
    up.kill();
    wait_until("the workers are gone", PATIENCE, || !workers.iter().any(|id| is_worker(*id)));
}
