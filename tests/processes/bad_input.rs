//! Wrong input through the program itself: one sentence with cause and remedy, a documented exit code, nothing lost.

use std::fs;
use std::net::TcpListener;

use crate::support::{Finished, PATIENCE, Place, Running, record, wait_until};

/// Exit code for wrong input.
const WRONG_INPUT: i32 = 2;
/// Exit code for a peer that is not there.
const PEER_LOST: i32 = 3;

/// A small CartPole run that takes a few seconds.
const SMALL: &[&str] = &[
    "-c",
    "cartpole",
    "--set",
    "learner.n_steps=32",
    "--set",
    "learner.total_steps=2560",
    "--set",
    "run.checkpoint_every=4",
];

fn with_config(place: &Place, text: &str) -> Finished {
    let file = place.write("my.toml", text);
    place.finish(&["check", "-c", &file])
}

fn learner(place: &Place, extra: &[&str]) -> Running {
    let endpoint = place.endpoint("learner");
    let args = [&["learner", "--name", "r", "--listen", &endpoint], SMALL, extra].concat();
    place.start(&args)
}

fn actor(place: &Place, extra: &[&str]) -> Running {
    let endpoint = place.endpoint("learner");
    place.start(&[&["actor", "--connect", &endpoint, "--connect-timeout", "10s"], extra].concat())
}

#[test]
fn a_configuration_that_cannot_be_is_told_by_key_and_line() {
    let place = Place::new();
    let cases: &[(&str, &[&str])] = &[
        (
            "domain = \"cartpole\"\n[learner]\nclipp = 0.2",
            &["my.toml", "line 3", "clipp", "expected", "`clip`"],
        ),
        (
            "domain = \"cartpole\"\n[learner]\nclip = \"much\"",
            &["line 3", "clip = \"much\"", "expected f64"],
        ),
        (
            "domain = \"cartpole\"\n[human]\nreaction_delay = 2",
            &["line 2", "unknown field `human`"],
        ),
        ("domain = \"cartpole\"\n[leaner]", &["line 2", "leaner", "`learner`"]),
        ("domain = \"moon\"", &["`domain` is \"moon\"", "lander"]),
        ("domain = \"cartpole\"\nseed = -1", &["line 2", "seed"]),
        ("domain = \"cartpole\"\n[world]\nmax_steps = 0", &["world.max_steps", "allowed"]),
        ("domain = \"cartpole\"\n[run]\nname = \"a/b\"", &["run.name", "a-z"]),
        ("domain = \"cartpole\"\n[policy]\nhidden = []", &["policy.hidden", "allowed: 1 to 8"]),
        ("domain = \"lander\"\n[notifier]\ntopics = []", &["notifier.topics", "allowed", "ascend"]),
        ("domain = \"lander\"\n[notifier]\nwords = []", &["notifier.words", "allowed"]),
        (
            "domain = \"lander\"\n[notifier]\nwords = [5, 2]",
            &["notifier.words", "[5, 2]", "increasing"],
        ),
        ("domain = \"lander\"\n[notifier]\nwords = [0]", &["notifier.words", "allowed"]),
        ("domain = \"lander\"\n[human]\ninterrupt = \"never\"", &["line 3", "never", "finish"]),
        (
            "domain = \"lander\"\n[human]\nreaction_delay = { fixed = 99 }",
            &["human.reaction_delay", "99"],
        ),
        ("domain = ", &["line 1"]),
        (
            "[world]\nwind_power = nan",
            &["my.toml", "line 2", "`world.wind_power` is nan", "allowed: a finite number"],
        ),
        (
            "domain = \"cartpole\"\nseed = 9223372036854775808",
            &["line 2", "`seed` is 9223372036854775808", "up to 9223372036854775807"],
        ),
    ];
    for (text, expected) in cases {
        with_config(&place, text).with_code(WRONG_INPUT).saying(expected);
    }
}

#[test]
fn a_wrong_change_on_the_command_line_is_told_by_its_key() {
    let place = Place::new();
    let check =
        |set: &str| place.finish(&["check", "-c", "cartpole", "--set", set]).with_code(WRONG_INPUT);
    check("learner.clipp=1").saying(&["learner.clipp", "unknown field"]);
    check("learner.clip=much").saying(&["learner.clip", "expected"]);
    check("learner.clip").saying(&["section.key=value"]);
    check("learner.clip=inf").saying(&["`learner.clip` is inf", "allowed: a finite number"]);
    for key in ["seed", "learner.total_steps"] {
        let beyond = "9223372036854775808";
        check(&format!("{key}={beyond}")).saying(&[key, beyond, "up to 9223372036854775807"]);
    }
    place
        .finish(&["check", "--set", "world.near_weight=inf"])
        .with_code(WRONG_INPUT)
        .saying(&["`world.near_weight` is inf", "allowed: a finite number"]);
    place
        .finish(&["check", "-c", "nowhere.toml"])
        .with_code(WRONG_INPUT)
        .saying(&["nowhere.toml", "cartpole"]);
    place.finish(&["lurner"]).with_code(WRONG_INPUT).saying(&["learner"]);
    place.finish(&["actor"]).with_code(WRONG_INPUT).saying(&["--connect"]);
}

#[test]
fn sizes_that_no_message_and_no_file_may_have_are_refused_before_the_run() {
    let place = Place::new();
    let refused = |set: &[&str], texts: &[&str]| {
        let set = set.iter().flat_map(|set| ["--set", set]);
        let args: Vec<&str> = ["check", "-c", "lander"].into_iter().chain(set).collect();
        place.finish(&args).with_code(WRONG_INPUT).saying(texts);
    };
    refused(
        &["learner.n_steps=65536", "learner.n_envs=1"],
        &["`learner.n_steps` is 65536", "at most 16777216 bytes", "steps of this task"],
    );
    let wide = "policy.hidden=[4096, 4096]";
    refused(&[wide], &["`policy.hidden`", "weights", "at most 67108864 bytes"]);
    let wide = "policy.hidden=[1024, 1024]";
    refused(
        &[wide, "learner.lag=16"],
        &["`policy.hidden`", "`learner.lag` is 16", "at most 67108864 bytes"],
    );
    refused(
        &["learner.n_envs=65536", "learner.n_steps=1"],
        &["`learner.n_envs` is 65536", "checkpoint", "at most 67108864 bytes"],
    );
}

#[test]
fn too_few_actors_for_the_run_are_refused_at_once() {
    let place = Place::new();
    for command in [&["up", "-c", "cartpole"][..], &["smoke", "--quick"][..]] {
        let few = ["--actors", "2", "--set", "run.actors_min=5"];
        place.finish(&[command, &few].concat()).with_code(WRONG_INPUT).saying(&[
            "`run.actors_min` is 5",
            "--actors is 2",
            "at least 5",
            "--listen",
        ]);
    }
    assert!(!place.path().join("runs").exists(), "nothing was begun");
}

#[test]
fn a_lone_learner_says_whom_it_waits_for() {
    let place = Place::new();
    let learner = learner(&place, &["--set", "run.actors_min=2"]);
    wait_until("it says so", PATIENCE, || learner.stderr().contains("waiting for actors: 0 of 2"));
    learner.kill();
}

#[test]
fn counts_of_episodes_have_a_range() {
    let place = Place::new();
    for args in [["eval", "r", "--episodes", "0"], ["smoke", "--quick", "--episodes", "0"]] {
        place.finish(&args).with_code(WRONG_INPUT).saying(&["--episodes", "1..=1000000"]);
    }
    let seeds = ["pilot", "eval", "--seeds", "0..99999999999999"];
    place.finish(&seeds).with_code(WRONG_INPUT).saying(&["99999999999999", "1 to 1000000"]);
}

#[test]
fn a_place_that_is_no_run_directory_is_named() {
    let place = Place::new();
    place.write("runs", "a file where the directory should be");
    let endpoint = place.endpoint("learner");
    let args = [&["learner", "--name", "r", "--listen", &endpoint], SMALL].concat();
    place.finish(&args).with_code(WRONG_INPUT).saying(&["runs/r", "cannot be used"]);
    let place = Place::new();
    fs::create_dir_all(place.run("r")).unwrap();
    fs::write(place.run("r").join("novel.txt"), "mine").unwrap();
    let args = [&["learner", "--name", "r", "--listen", &endpoint], SMALL].concat();
    place.finish(&args).with_code(WRONG_INPUT).saying(&["runs/r", "not a run directory"]);
    assert_eq!(fs::read_to_string(place.run("r").join("novel.txt")).unwrap(), "mine");
}

#[test]
fn an_address_that_cannot_be_used_is_reported_as_what_it_is() {
    let place = Place::new();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    let args = [&["learner", "--name", "r", "--listen", &endpoint], SMALL].concat();
    place.finish(&args).with_code(WRONG_INPUT).saying(&["in use", &endpoint]);
    // The directory that is left holds nothing, so another configuration may take it.
    let changed = [&args[..], &["--set", "learner.clip=0.3"]].concat();
    place.finish(&changed).with_code(WRONG_INPUT).saying(&["in use", &endpoint]);
    place
        .finish(&["actor", "--connect", &endpoint, "--connect-timeout", "500ms"])
        .with_code(PEER_LOST)
        .saying(&[&endpoint, "does not answer as a learner does"]);
    let file = place.write("policy.safetensors", "precious");
    let endpoint = format!("unixsock-stream/{file}");
    let args = [&["learner", "--name", "r", "--listen", &endpoint], SMALL].concat();
    place.finish(&args).with_code(WRONG_INPUT).saying(&["there is a file at", &file]);
    assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
    let args = [&["learner", "--name", "r", "--listen", "http/example:1"], SMALL].concat();
    place.finish(&args).with_code(WRONG_INPUT).saying(&["http/example:1", "tcp/"]);
    place
        .finish(&["actor", "--connect", "tcp/127.0.0.1", "--connect-timeout", "1s"])
        .with_code(WRONG_INPUT)
        .saying(&["tcp/127.0.0.1", "port"]);
}

#[test]
fn nobody_at_the_address_is_a_lost_peer() {
    let place = Place::new();
    let endpoint = place.endpoint("nobody");
    place
        .finish(&["actor", "--connect", &endpoint, "--connect-timeout", "500ms"])
        .with_code(PEER_LOST)
        .saying(&["nobody.sock", "start a learner"]);
}

#[test]
fn a_wrong_run_name_lists_the_runs_that_are_there() {
    let place = Place::new();
    let learner = learner(&place, &[]);
    wait_until("the learner listens", PATIENCE, || learner.stderr().contains("listening"));
    actor(&place, &["--run", "other"])
        .finish(PATIENCE)
        .with_code(WRONG_INPUT)
        .saying(&["`other`", "there: `r`"]);
    learner.kill();
}

#[test]
fn a_second_learner_is_kept_out_of_a_run() {
    let place = Place::new();
    let first = learner(&place, &[]);
    wait_until("the learner listens", PATIENCE, || first.stderr().contains("listening"));
    let endpoint = place.endpoint("second");
    let args = [&["learner", "--name", "r", "--listen", &endpoint], SMALL].concat();
    place.finish(&args).with_code(WRONG_INPUT).saying(&["`r`", "another learner"]);
    first.kill();
}

#[test]
fn a_changed_configuration_is_refused_with_the_difference_and_can_be_forked() {
    let place = Place::new();
    let first = learner(&place, &["--stop-after", "8"]);
    let helper = actor(&place, &[]);
    let first = first.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE);
    let changed = ["--set", "learner.clip=0.3", "--seed", "9"];
    learner(&place, &changed).finish(PATIENCE).with_code(WRONG_INPUT).saying(&[
        "learner.clip: 0.2 -> 0.3",
        "seed: 1 -> 9",
        "--fork r",
    ]);
    // A fork that hardly learns ends with the weights that it began with.
    let endpoint = place.endpoint("learner");
    let fork = ["learner", "--name", "s", "--fork", "r", "--listen", &endpoint];
    let still = ["--set", "learner.learning_rate=1e-30", "--stop-after", "1"];
    let forked = place.start(&[&fork, SMALL, &changed, &still].concat());
    let helper = actor(&place, &[]);
    let forked = forked.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE);
    assert_eq!(weights(&forked), weights(&first));
    let lost = ["learner", "--name", "t", "--fork", "nothing", "--listen", &endpoint];
    place.finish(&[&lost, SMALL].concat()).with_code(WRONG_INPUT).saying(&["--fork", "`nothing`"]);
    assert!(!place.run("t").exists(), "a fork of nothing leaves nothing behind");
}

/// The digest of the weights that a learner printed at its end.
fn weights(finished: &Finished) -> &str {
    let line = finished.stdout.lines().find(|line| line.starts_with("weights"));
    line.unwrap_or_else(|| panic!("no weights in: {}", finished.stdout))
}

#[test]
fn a_second_fork_is_refused_and_a_fork_says_what_it_began_with() {
    let place = Place::new();
    let up = ["up", "-c", "cartpole", "--actors", "1", "--set", "learner.n_steps=32"];
    let start = |more: &[&str]| place.finish(&[&up, more].concat());
    let [first, _] = [("fa", "5"), ("fb", "6")].map(|(name, seed)| {
        start(&["--name", name, "--seed", seed, "--stop-after", "2"]).with_code(0)
    });
    let fork = |from: &str, updates: &str| {
        start(&["--name", "fc", "--fork", from, "--stop-after", updates])
    };
    fork("fa", "2").with_code(0);
    fork("fb", "4").with_code(WRONG_INPUT).saying(&["`fc` has already begun", "weights of `fa`"]);
    fork("fa", "4").with_code(0);
    let record = record(&place.run("fc"));
    let digest = record["origin"]["weights_sha256"].as_str().unwrap().to_owned();
    assert_eq!(record["origin"]["run"], "fa");
    assert!(weights(&first).ends_with(&digest), "{record}");
    let listed = place.finish(&["runs"]).with_code(0).stdout;
    assert!(listed.contains(&format!("fa {}", &digest[..12])), "{listed}");
    let report = fs::read_to_string(place.run("fc").join("report.html")).unwrap();
    assert!(report.contains(&digest), "the report names the starting weights");
}

#[test]
fn a_run_that_lost_its_checkpoints_keeps_its_policy() {
    let place = Place::new();
    let up = |steps: &str| {
        let steps = format!("learner.total_steps={steps}");
        let args = ["up", "--name", "gone", "--actors", "1"];
        place.finish(&[&args, SMALL, &["--set", &steps]].concat())
    };
    up("2560").with_code(0);
    let policy = place.run("gone").join("policy.safetensors");
    let before = fs::read(&policy).unwrap();
    for entry in fs::read_dir(place.run("gone").join("checkpoints")).unwrap() {
        fs::remove_file(entry.unwrap().path()).unwrap();
    }
    up("5120").with_code(WRONG_INPUT).saying(&["20 updates on record", "--fork gone"]);
    assert!(fs::read(&policy).unwrap() == before, "the finished policy stays");
}

#[test]
fn learners_that_start_at_once_have_runs_of_their_own() {
    let place = Place::new();
    let start = |seed: &str| {
        let endpoint = place.endpoint(seed);
        place.start(&[&["learner", "--seed", seed, "--listen", &endpoint], SMALL].concat())
    };
    let learners = ["1", "2", "3", "4"].map(start);
    for learner in &learners {
        wait_until("it listens", PATIENCE, || learner.stderr().contains("listening"));
    }
    assert_eq!(fs::read_dir(place.path().join("runs")).unwrap().count(), 4);
    learners.into_iter().for_each(Running::kill);
}

#[test]
fn damaged_checkpoints_give_way_to_older_ones_or_stop_the_run() {
    let place = Place::new();
    let first = learner(&place, &["--stop-after", "12"]);
    let helper = actor(&place, &[]);
    first.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE);
    let mut files: Vec<_> = fs::read_dir(place.run("r").join("checkpoints"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "checkpoint"))
        .collect();
    files.sort();
    assert!(files.len() >= 2, "{files:?}");
    // Torn: the last bytes never reached the disk.
    let newest = files.last().unwrap();
    let bytes = fs::read(newest).unwrap();
    fs::write(newest, &bytes[..bytes.len() / 2]).unwrap();
    let second = learner(&place, &["--stop-after", "16"]);
    let helper = actor(&place, &[]);
    let name = newest.file_name().unwrap().to_str().unwrap();
    second.finish(PATIENCE).with_code(0).saying(&[name, "torn", "resumed"]);
    helper.finish(PATIENCE);
    // Corrupt: every one of them.
    for entry in fs::read_dir(place.run("r").join("checkpoints")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "checkpoint") {
            let mut bytes = fs::read(&path).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            fs::write(&path, bytes).unwrap();
        }
    }
    learner(&place, &[]).finish(PATIENCE).with_code(WRONG_INPUT).saying(&["whole", "checkpoints"]);
}

#[test]
fn a_policy_or_trace_file_that_is_none_is_refused() {
    let place = Place::new();
    let file = place.write("policy.safetensors", "not a policy");
    place.finish(&["eval", &file]).with_code(WRONG_INPUT).saying(&["policy.safetensors", "text"]);
    let pointer = place.write("lfs.safetensors", "version https://git-lfs.github.com/spec/v1\n");
    place.finish(&["eval", &pointer]).with_code(WRONG_INPUT).saying(&["Git LFS pointer"]);
    let page = place.write("page.safetensors", "<!DOCTYPE html>");
    for command in
        [&["eval"][..], &["pilot", "eval", "--pilot"], &["up", "-c", "cartpole", "--fork"]]
    {
        let args = [command, &[page.as_str()]].concat();
        place.finish(&args).with_code(WRONG_INPUT).saying(&["HTML page"]);
    }
    place.finish(&["play", "nothing"]).with_code(WRONG_INPUT).saying(&["`nothing`"]);
    place.finish(&["conformance", "lander", &file]).with_code(WRONG_INPUT).saying(&["traces"]);
    place
        .finish(&["pilot", "eval", "--pilot", &file, "--seeds", "0..1"])
        .with_code(WRONG_INPUT)
        .saying(&["not a pilot"]);
    place.finish(&["pilot", "eval", "--seeds", "3..1"]).with_code(WRONG_INPUT).saying(&["A..B"]);
    place.finish(&["config", "moon"]).with_code(WRONG_INPUT).saying(&["lander"]);
}
