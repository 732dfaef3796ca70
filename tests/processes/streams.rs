//! Output that cannot be written, limits of the system, names that are not text.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt as _;
use std::process::{Command, Stdio};

use crate::support::{PATIENCE, Place, signal, updates, wait_for_words};

const FULL: &str = "/dev/full";
/// A run of four updates.
const SHORT: &str = "-c cartpole --set learner.n_steps=32 --set learner.total_steps=512";

#[test]
fn results_that_cannot_be_written_are_wrong_input_and_a_closed_pipe_is_none() {
    let place = Place::new();
    for args in [
        "config lander",
        "--help",
        "--version",
        "completions bash",
        "runs --json",
        "check -c cartpole",
        "pilot eval --seeds 0..1",
        "pilot eval --seeds 0..1 --json",
    ] {
        let done = place.start_to(place.program(&[args]), Some(FULL), None).finish(PATIENCE);
        done.with_code(2).saying(&["standard output cannot be written"]);
        let mut reader = place.program(&[args]).stdout(Stdio::piped()).spawn().unwrap();
        drop(reader.stdout.take());
        let closed = reader.wait_with_output().unwrap();
        assert_eq!(closed.status.code(), Some(0), "{args:?}");
        assert!(closed.stderr.is_empty(), "{}", String::from_utf8_lossy(&closed.stderr));
    }
    let up = place.program(&["up --name r", SHORT]);
    place.start_to(up, Some(FULL), None).finish(PATIENCE).with_code(2);
    assert!(!crate::support::result(&place.run("r")).is_null(), "the run is finished all the same");
}

#[test]
fn a_log_that_cannot_be_written_ends_nothing() {
    let place = Place::new();
    let up = place.program(&["up --name r", SHORT]);
    let done = place.start_to(up, None, Some(FULL)).finish(PATIENCE).with_code(0);
    assert!(done.stdout.contains("updates  4 "), "{}", done.stdout);
    let wrong = place.program(&["config moon"]);
    place.start_to(wrong, None, Some(FULL)).finish(PATIENCE).with_code(2);
}

#[test]
fn a_log_filter_that_does_not_parse_is_refused() {
    let place = Place::new();
    let mut command = place.program(&["config lander"]);
    command.env("RUST_LOG", "leadtime=loud");
    let done = place.start_with(command).finish(PATIENCE).with_code(2);
    assert!(done.saying(&["RUST_LOG is `leadtime=loud`"]).stdout.is_empty());
}

#[test]
fn a_limit_that_is_too_small_ends_the_process_with_a_sentence() {
    let place = Place::new();
    let endpoint = place.endpoint("learner");
    let mut shell = Command::new("sh");
    shell.current_dir(place.path()).args(["-c", "ulimit -n 12; exec \"$0\" \"$@\""]);
    shell
        .args([env!("CARGO_BIN_EXE_leadtime"), "learner", "--listen", &endpoint])
        .args(SHORT.split(' '));
    let done = place.start_with(shell).finish(PATIENCE);
    assert!(done.code.is_some_and(|code| [1, 2].contains(&code)), "{done:?}");
    assert!(done.stderr.contains("Too many open files"), "{done:?}");
    assert!(!done.stderr.contains("panicked"), "{done:?}");
}

#[test]
fn paths_need_not_be_text() {
    let place = Place::new();
    let odd = OsStr::from_bytes(b"odd-\xff");
    let runs = place.path().join(odd);
    let with = |args: &[&str]| {
        let mut command = place.program(args);
        command.arg("--runs").arg(&runs);
        command
    };
    let up = with(&["up --name r", SHORT]);
    place.start_with(up).finish(PATIENCE).with_code(0);
    fs::copy(runs.join("r/policy.safetensors"), place.path().join(odd).join(odd)).unwrap();
    let mut eval = with(&["eval --episodes 2 --json"]);
    eval.arg(runs.join(odd));
    let evaluated = place.start_with(eval).finish(PATIENCE).with_code(0).json();
    assert!(evaluated["policy"].as_str().is_some_and(|path| path.contains("odd-")), "{evaluated}");
    let listed = place.start_with(with(&["runs --json"])).finish(PATIENCE).with_code(0).json();
    assert_eq!(listed[0]["name"], "r");
    let mut learner = with(&["learner -c cartpole --listen", &place.endpoint("l")]);
    learner.arg("--fork").arg(runs.join(odd));
    let learner = place.start_with(learner);
    wait_for_words(&learner, "listening");
    signal("INT", learner.id());
    learner.finish(PATIENCE).with_code(130);
    assert_eq!(updates(&runs.join("r")), 4);
}
