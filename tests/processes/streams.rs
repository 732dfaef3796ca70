//! Output that cannot be written, limits of the system, names that are not text.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{PATIENCE, Place, repository, signal, updates, wait_for_words};

const FULL: &str = "/dev/full";
/// A run of four updates.
const SHORT: &str = "-c cartpole --set learner.n_steps=32 --set learner.total_steps=512";

#[test]
fn results_that_cannot_be_written_are_wrong_input_and_a_closed_pipe_is_not() {
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
fn a_file_behind_standard_output_takes_what_is_written_in_order() {
    let place = Place::new();
    let mut shell = Command::new("sh");
    let script =
        "\"$0\" script-search lander --steps 2000 --episodes 4 --json -o /dev/stdout; echo done";
    shell.current_dir(place.path()).args(["-c", script, env!("CARGO_BIN_EXE_leadtime")]);
    let told = place.start_with(shell).finish(PATIENCE).with_code(0).stdout;
    assert!(told.starts_with('{') && told.contains("\n[search]\n"), "{told}");
    assert!(told.ends_with("\ndone\n"), "{told}");
}

#[test]
fn a_limit_on_the_size_of_files_is_like_a_full_disk_and_kills_nobody() {
    let place = Place::new();
    let endpoint = place.endpoint("learner");
    let mut shell = Command::new("sh");
    let script = "ulimit -f 60; exec \"$0\" \"$@\"";
    shell.current_dir(place.path()).args(["-c", script, env!("CARGO_BIN_EXE_leadtime")]);
    let long = "learner --name r -c cartpole --set learner.n_steps=32 --set learner.total_steps=1000000000";
    shell.args(long.split(' ')).args(["--set", "run.checkpoint_every=2", "--listen", &endpoint]);
    let mut learner = place.start_with(shell);
    let _helper = place.start(&["actor --connect", &endpoint]);
    wait_for_words(&learner, "training continues");
    let n_updates = updates(&place.run("r"));
    assert!(n_updates > 0 && learner.is_running(), "{}", learner.stderr());
    learner.kill();
}

#[test]
fn a_limit_that_is_too_small_ends_the_process_with_a_sentence() {
    let place = Place::new();
    let endpoint = place.endpoint("learner");
    let limited = |n_files: u32, args: &[&str]| {
        let mut shell = Command::new("sh");
        let script = format!("ulimit -n {n_files}; exec \"$0\" \"$@\"");
        shell.current_dir(place.path()).args(["-c", &script, env!("CARGO_BIN_EXE_leadtime")]);
        shell.args(args.iter().flat_map(|text| text.split(' '))).env_remove("RUST_BACKTRACE");
        let done = place.start_with(shell).finish(PATIENCE).with_code(2);
        assert!(done.stderr.contains("see `ulimit -n`"), "{n_files}: {done:?}");
        let bad = ["panicked", "a bug of the program"].iter().find(|it| done.stderr.contains(*it));
        assert_eq!(bad, None, "{n_files}: {done:?}");
    };
    // Fewer than these and the program itself cannot be loaded; with more it may run.
    for n_files in (8..=30).step_by(2) {
        limited(n_files, &["learner --listen", &endpoint, SHORT]);
    }
    for n_files in (10..=30).step_by(10) {
        limited(n_files, &["actor --connect", &endpoint]);
        limited(n_files, &["router --listen", &endpoint]);
    }
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
    // The processes that another one starts write into the same file.
    let log = place.path().join(OsStr::from_bytes(b"log-\xff"));
    let mut up = with(&["up --name logged --log-format json", SHORT]);
    up.arg("--log-file").arg(&log);
    place.start_with(up).finish(PATIENCE).with_code(0);
    let lines = fs::read_to_string(&log).unwrap();
    for said in ["run opened", "actor joined"] {
        assert!(lines.contains(said), "{lines}");
    }
    let mut learner = with(&["learner -c cartpole --listen", &place.endpoint("l")]);
    learner.arg("--fork").arg(runs.join(odd));
    let learner = place.start_with(learner);
    wait_for_words(&learner, "listening");
    signal("INT", learner.id());
    learner.finish(PATIENCE).with_code(130);
    assert_eq!(updates(&runs.join("r")), 4);
}

#[test]
fn no_argument_that_may_be_a_path_need_be_text() {
    let place = Place::new();
    let odd = |name: &str| {
        let name = [name.as_bytes(), b"-\xff"].concat();
        place.path().join(OsStr::from_bytes(&name))
    };
    let runs = odd("runs");
    let run = |args: &[&str], paths: &[&Path]| {
        let mut command = place.program(args);
        command.args(paths.iter().map(|path| path.as_os_str()));
        place.start_with(command).finish(PATIENCE)
    };
    run(&["up --name r", SHORT, "--runs"], &[&runs]).with_code(0);
    let (first, second) = (runs.join("r"), odd("second"));
    // A copy of a run, under a name that is no text.
    let copied = Command::new("cp").arg("-r").args([&first, &second]).status().unwrap();
    assert!(copied.success());
    let page = place.file("page.html");
    let report = ["report --episodes 2 -o", &page];
    let told = run(&report, &[&second]).with_code(0).stdout;
    assert!(told.contains("Report: "), "{told}");
    run(&["watch --once --json"], &[&second]).with_code(0).json();
    let compared = run(&["runs compare --json"], &[&first, &second]).with_code(0).json();
    assert_eq!(compared["weights"], "equal");
    let script = odd("script").with_extension("toml");
    let missing = run(&["eval --episodes 2 --baseline"], &[&script, &first]).with_code(2);
    missing.saying(&["script-", "No such file"]);
    let words = odd("words.toml");
    fs::copy(repository("crates/taxonomy/data/lander/taxonomy.toml"), &words).unwrap();
    let valid = run(&["taxonomy validate --json"], &[&words]).with_code(0).json();
    assert_eq!(valid["domain"], "lander");
    run(&["taxonomy export"], &[&words]).with_code(0);
    let plan = odd("plan.toml");
    fs::copy(repository("crates/taxonomy/data/lander/plan.toml"), &plan).unwrap();
    let log = repository("crates/taxonomy/data/lander/calls.jsonl");
    run(&["taxonomy report --log", &log], &[&plan]).with_code(0);
    // What is not there is named, and is not called text that it is not.
    let nothing = odd("nothing");
    for args in [
        "report",
        "watch --once",
        "runs compare r",
        "compare",
        "config",
        "check -c",
        "describe",
        "eval",
        "eval r --transcript --words",
        "play r --words",
        "serve --describe r --words",
        "taxonomy validate",
        "taxonomy report",
        "taxonomy export",
        "pilot eval --seeds 0..1 --pilot",
        "smoke --domain",
        "play",
    ] {
        let done = run(&[args], &[&nothing]).with_code(2);
        assert!(!done.stderr.contains("invalid UTF-8"), "{args}: {}", done.stderr);
        assert!(done.stderr.contains("error: "), "{args}: {}", done.stderr);
    }
}
