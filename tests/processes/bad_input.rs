//! Wrong input through the program itself: one sentence with cause and remedy, a documented exit code, nothing lost.

use std::ffi::OsStr;
use std::fs;
use std::net::TcpListener;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use crate::support::{
    Finished, PATIENCE, PEER_LOST, Place, Running, WRONG_INPUT, checkpoints, record, repository,
    wait_for_words,
};
use leadtime_link::ForeignLearner;
use leadtime_proto::RunName;

/// A small CartPole run that takes a few seconds.
const SMALL: &str = "-c cartpole --set learner.n_steps=32 --set learner.total_steps=2560 --set run.checkpoint_every=4";

/// Asserts that a command is wrong input, and that it is told why.
#[track_caller]
fn refused(place: &Place, args: &[&str], texts: &[&str]) {
    place.finish(args).with_code(WRONG_INPUT).saying(texts);
}

/// The arguments of a learner of the run `r`.
fn learner_at(endpoint: &str) -> String {
    format!("learner --name r {SMALL} --listen {endpoint}")
}

fn learner(place: &Place, extra: &str) -> Running {
    place.start(&[&learner_at(&place.endpoint("learner")), extra])
}

fn actor(place: &Place) -> Running {
    place.start(&["actor --connect-timeout 10s --connect", &place.endpoint("learner")])
}

/// Lets a learner and an actor run to the learner's end.
#[track_caller]
fn train(place: &Place, learner: Running) -> Finished {
    let helper = actor(place);
    let learner = learner.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE);
    learner
}

#[test]
fn a_configuration_that_cannot_be_is_told_by_key_and_line() {
    let place = Place::new();
    for (text, told) in [
        ("domain = \"cartpole\"\n[learner]\nclipp = 0.2", ["my.toml", "line 3", "`clip`"]),
        ("domain = \"moon\"", ["my.toml", "`domain` is \"moon\"", "lander"]),
        ("[policy]\nhidden = []", ["`policy.hidden`", "0 layers", "allowed: 1 to 8"]),
        ("domain = ", ["my.toml", "line 1", "domain = "]),
        ("[world]\nwind_power = nan", ["line 2", "`world.wind_power` is nan", "a finite number"]),
    ] {
        let file = place.write("my.toml", text);
        refused(&place, &["check -c", &file], &told);
    }
}

#[test]
fn what_was_meant_is_guessed() {
    let place = Place::new();
    refused(&place, &["trian -c cartpole"], &["'train'"]);
    refused(
        &place,
        &["up -c cartpole --learning-rate 1e-4"],
        &["--set learner.learning_rate=1e-4"],
    );
    for command in ["up", "check", "learner"] {
        refused(&place, &[command, "lander"], &["tip: did you mean '-c lander'?"]);
    }
    refused(&place, &["smoke highway"], &["tip: did you mean '--domain highway'?"]);
    let unit = ["write a number with its unit: 60s or 2m"];
    refused(&place, &["check --connect 127.0.0.1:1 --connect-timeout 6"], &unit);
    refused(&place, &["check -c cartpole --steps 1.5"], &["a whole number of steps"]);
    refused(&place, &["check -c cartpole --steps 1e20"], &["1 to 1e15"]);
    let meant = ["`landr`; did you mean `lander`? Known: "];
    for args in ["config landr", "check -c landr", "taxonomy report landr"] {
        refused(&place, &[args], &meant);
    }
    let meant = [
        "`landr` is no file, no run in runs, and no built-in configuration; did you mean `lander`? Known: ",
    ];
    for args in ["describe landr", "script-search landr"] {
        refused(&place, &[args], &meant);
    }
    refused(&place, &["compare tabl1"], &["`tabl1`; did you mean `table1`? Known: "]);
    // A command that takes no settings gives no advice about them.
    let told = place.finish(&["runs --learning-rate 1e-4"]).with_code(WRONG_INPUT).stderr;
    assert!(!told.contains("--set"), "{told}");
}

#[test]
fn a_wrong_change_on_the_command_line_is_told_by_its_key() {
    let place = Place::new();
    let check = |set: &str, texts: &[&str]| {
        refused(&place, &["check -c cartpole --set", set], texts);
    };
    check("learner.clipp=1", &["learner.clipp", "unknown key"]);
    check("learner.clip=much", &["learner.clip", "expected"]);
    check("learner.clip", &["section.key=value"]);
    check("learner.clip=inf", &["`learner.clip` is inf", "allowed: a finite number"]);
    for key in ["seed", "learner.total_steps"] {
        let beyond = "9223372036854775808";
        check(&format!("{key}={beyond}"), &[key, beyond, "up to 9223372036854775807"]);
    }
    let weight = ["`world.near_weight` is inf", "allowed: a finite number"];
    refused(&place, &["check --set world.near_weight=inf"], &weight);
    let elsewhere = ["--worker is for worlds in Python (`domain = \"python\"`); `lander` is none"];
    refused(&place, &["check -c lander --worker true"], &elsewhere);
    refused(&place, &["check -c nowhere.toml"], &["nowhere.toml", "cartpole"]);
    refused(&place, &["lurner"], &["learner"]);
    refused(&place, &["actor"], &["--connect"]);
}

#[test]
fn a_change_that_says_nothing_to_a_trained_policy_is_told_by_its_key() {
    let place = Place::new();
    let policy = repository("deploy/policies/piloting.safetensors");
    let of_training = "`learner.clip` is a setting of training and changes nothing here";
    for command in ["eval", "probe", "play", "serve --describe"] {
        let args = [command, &policy, "--set learner.clip=0.1"];
        refused(&place, &args, &["--set: ", of_training, "[world], [human], [notifier]"]);
    }
    let each = ["eval", &policy, "--each learner.clip=[1,2]"];
    refused(&place, &each, &["--each: ", of_training]);
    let set = |command: &str, set: &str| place.finish(&[command, &policy, "--set", set]);
    let instead = "change `evaluation.world.zone_ends_episode`";
    for command in ["eval", "probe", "play"] {
        let told = set(command, "world.zone_ends_episode=true").with_code(WRONG_INPUT);
        told.saying(&["--set: `world.zone_ends_episode` has no effect", instead]);
    }
    set("eval --episodes 1", "evaluation.world.zone_ends_episode=true").with_code(0);
    let told =
        ["the policy observes ", "with `notifier.history = 1` the task has ", "leave it out"];
    set("eval", "notifier.history=1").with_code(WRONG_INPUT).saying(&told);
    for each in ["human.reaction_delay", "human.reaction_delay=3"] {
        refused(&place, &["eval", &policy, "--each", each], &["section.key=[value, ...]"]);
    }
}

#[test]
fn a_change_of_a_run_that_goes_on_is_told_by_its_own_option() {
    let place = Place::new();
    let told = |args: &str, texts: &[&str]| {
        for command in ["up --name r", "learner --name r"] {
            refused(&place, &[command, SMALL, args], texts);
        }
    };
    let unknown = ["--change learner.clp", "unknown key `clp`", "did you mean `clip`?"];
    told("--change learner.clp=0.1", &unknown);
    told("--change learner.clip=nan", &["--change learner.clip", "a finite number"]);
    told("--change learner.n_envs=16", &["`learner.n_envs` cannot change while a run goes on"]);
    let twice = ["`learner.clip` is given by --change twice", "leave one of them out"];
    told("--change learner.clip=0.1 --change learner.clip=0.2", &twice);
    let name = Command::new(env!("CARGO_BIN_EXE_leadtime"))
        .args(["up", "-c", "cartpole", "--name", ""])
        .current_dir(place.path())
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&name.stderr);
    assert_eq!(name.status.code(), Some(WRONG_INPUT), "{told}");
    assert!(told.contains("--name: `` is not a valid run name"), "{told}");
    assert!(!place.path().join("runs").exists(), "nothing was begun");
}

#[test]
fn sizes_that_no_message_and_no_file_may_have_are_refused_before_the_run() {
    let place = Place::new();
    let check = |set: &str, texts: &[&str]| refused(&place, &["check -c lander --set", set], texts);
    let long = ["`learner.n_steps` is 65536", "at most 16777216 bytes", "steps of this task"];
    check("learner.n_steps=65536 --set learner.n_envs=1", &long);
    let wide = ["`policy.hidden`", "weights", "at most 67108864 bytes"];
    check("policy.hidden=[4096,4096]", &wide);
    let wide = ["`policy.hidden`", "`learner.lag` is 16", "at most 67108864 bytes"];
    check("policy.hidden=[1024,1024] --set learner.lag=16", &wide);
    let many = ["`learner.n_envs` is 65536", "checkpoint", "at most 67108864 bytes"];
    check("learner.n_envs=65536 --set learner.n_steps=1", &many);
}

#[test]
fn a_lag_is_chosen_only_where_there_is_a_choice() {
    let place = Place::new();
    let up = format!("up --choose-lag --name r {SMALL}");
    let texts = ["--choose-lag is for `learner.mode = \"lag\"`", "or leave it out"];
    refused(&place, &[&up], &texts);
    fs::create_dir_all(place.path().join("runs/r")).unwrap();
    let texts = ["runs/r is begun and keeps its lag", "take another name"];
    refused(&place, &[&up, "--set learner.mode=lag"], &texts);
}

#[test]
fn too_few_actors_for_the_run_are_refused_at_once() {
    let place = Place::new();
    for command in ["up -c cartpole", "smoke --quick"] {
        let few = ["`run.actors_min` is 5", "--actors is 2", "at least 5", "--listen"];
        refused(&place, &[command, "--actors 2 --set run.actors_min=5"], &few);
    }
    assert!(!place.path().join("runs").exists(), "nothing was begun");
}

#[test]
fn a_lone_learner_says_whom_it_waits_for() {
    let place = Place::new();
    let learner = learner(&place, "--set run.actors_min=2");
    wait_for_words(&learner, "waiting for actors: 0 of 2");
    learner.kill();
}

#[test]
fn counts_of_episodes_have_a_range() {
    let place = Place::new();
    for args in ["eval r --episodes 0", "smoke --quick --episodes 0"] {
        refused(&place, &[args], &["--episodes", "1..=1000000"]);
    }
    let seeds = "pilot eval --seeds 0..99999999999999";
    refused(&place, &[seeds], &["99999999999999", "1 to 1000000"]);
}

#[test]
fn a_place_that_is_not_a_run_directory_is_named() {
    let place = Place::new();
    place.write("runs", "a file where the directory should be");
    let args = learner_at(&place.endpoint("learner"));
    refused(&place, &[&args], &["runs/r", "cannot be used"]);
    let place = Place::new();
    fs::create_dir_all(place.run("r")).unwrap();
    let novel = place.write("runs/r/novel.txt", "mine");
    refused(&place, &[&args], &["runs/r", "not a run directory"]);
    assert_eq!(fs::read_to_string(novel).unwrap(), "mine");
    // On a disk that is not mounted.
    let place = Place::new();
    symlink("/nowhere/runs", place.file("runs")).unwrap();
    let unwritable = "`run.directory` runs: nothing can be written there";
    refused(&place, &["check -c cartpole"], &[unwritable]);
    for command in ["runs", "runs prune --older 1d", &args] {
        refused(&place, &[command], &["runs is a link to /nowhere/runs, and nothing is there"]);
    }
}

#[test]
fn an_address_that_cannot_be_used_is_reported_as_what_it_is() {
    let place = Place::new();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    refused(&place, &[&learner_at(&endpoint)], &["in use", &endpoint]);
    // The directory that is left holds nothing, so another configuration may take it.
    let changed = [&learner_at(&endpoint), "--set learner.clip=0.3"];
    refused(&place, &changed, &["in use", &endpoint]);
    // Its actors meet at a socket, which is free.
    let up = place.finish(&["up --name u", SMALL, "--listen", &endpoint]).with_code(WRONG_INPUT);
    let told = format!("error: --listen: `{endpoint}` is in use: another process listens there");
    up.saying(&[&told]);
    let actor = place.finish(&["actor --connect-timeout 500ms --connect", &endpoint]);
    actor.with_code(PEER_LOST).saying(&[&endpoint, "does not answer as a learner does"]);
    let file = place.write("policy.safetensors", "precious");
    let endpoint = format!("unixsock-stream/{file}");
    refused(&place, &[&learner_at(&endpoint)], &["a file exists at", &file]);
    assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
    refused(&place, &[&learner_at("http/example:1")], &["http/example:1", "tcp/"]);
    let told = ["--connect: `foo` is not an address: it has no port; write HOST:PORT"];
    refused(&place, &["actor --connect foo"], &told);
    let actor = "actor --connect tcp/127.0.0.1 --connect-timeout 1s";
    refused(&place, &[actor], &["tcp/127.0.0.1", "port"]);
}

#[test]
fn a_finished_run_stays_as_it_is_if_the_learner_that_is_to_train_it_on_cannot_start() {
    let place = Place::new();
    place.finish(&["up --name r --actors 1", SMALL]).with_code(0);
    let read = |file: &str| fs::read(place.run("r").join(file)).unwrap();
    let files = || ["run.json", "config.toml"].map(read);
    let before = files();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    let longer = "--set learner.total_steps=5120";
    refused(&place, &[&learner_at(&endpoint), longer], &["in use", &endpoint]);
    assert!(files() == before, "{}", record(&place.run("r")));
    drop(taken);
    train(&place, learner(&place, longer));
    assert_eq!(record(&place.run("r"))["result"]["updates"], 40);
}

#[test]
fn nobody_at_the_address_is_a_lost_peer() {
    let place = Place::new();
    let actor = ["actor --connect-timeout 500ms --connect", &place.endpoint("nobody")];
    place.finish(&actor).with_code(PEER_LOST).saying(&["nobody.sock", "start a learner"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_of_another_release_ends_an_actor_that_says_what_to_do() {
    let remedy = "run the same release on both sides";
    let told_by_it =
        "the message has protocol 6, its receiver speaks 77: run the same release on both sides";
    for (no, told) in [(Some(told_by_it), told_by_it), (None, "the message has protocol 77")] {
        let place = Place::new();
        let (run, endpoint) = (RunName::new("r").unwrap(), place.endpoint("learner"));
        let learner = ForeignLearner::open(&run, endpoint.parse().unwrap(), no).await.unwrap();
        let actor = || place.finish(&["actor --connect", &endpoint]);
        let ended = tokio::task::block_in_place(actor).with_code(PEER_LOST);
        ended.saying(&[told, remedy]);
        drop(learner);
    }
}

#[test]
fn a_wrong_run_name_and_a_second_learner_are_kept_out() {
    let place = Place::new();
    let learner = learner(&place, "");
    wait_for_words(&learner, "listening");
    let other = ["actor --run other --connect-timeout 10s --connect", &place.endpoint("learner")];
    refused(&place, &other, &["`other`", "there: `r`"]);
    let second = learner_at(&place.endpoint("second"));
    refused(&place, &[&second], &["`r`", "another learner"]);
    learner.kill();
}

#[test]
fn a_changed_configuration_is_refused_with_the_difference_and_can_be_forked() {
    let place = Place::new();
    let first = train(&place, learner(&place, "--stop-after 8"));
    let changed = "--set learner.clip=0.3 --seed 9";
    let args = learner_at(&place.endpoint("learner"));
    let told = ["learner.clip: 0.2 -> 0.3", "seed: 1 -> 9", "--fork r"];
    refused(&place, &[&args, changed], &told);
    // A fork that hardly learns ends with the weights that it began with.
    let fork = args.replace("--name r", "--name s --fork r");
    let still = "--set learner.learning_rate=1e-30 --stop-after 1";
    let forked = train(&place, place.start(&[&fork, changed, still]));
    assert_eq!(weights(&forked), weights(&first));
    let lost = args.replace("--name r", "--name t --fork nothing");
    refused(&place, &[&lost], &["--fork", "`nothing`"]);
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
    let start = |more: &str| place.finish(&["up --actors 1", SMALL, more]);
    let [first, _] = ["--name fa --seed 5 --stop-after 2", "--name fb --seed 6 --stop-after 2"]
        .map(|args| start(args).with_code(0));
    let fork = |from: &str, updates: u64| {
        start(&format!("--name fc --fork {from} --stop-after {updates}"))
    };
    fork("fa", 2).with_code(0);
    fork("fb", 4).with_code(WRONG_INPUT).saying(&["`fc` has already begun", "weights of `fa`"]);
    fork("fa", 4).with_code(0);
    let record = record(&place.run("fc"));
    let digest = record["origin"]["weights_sha256"].as_str().unwrap().to_owned();
    assert_eq!(record["origin"]["run"], "fa");
    assert!(weights(&first).ends_with(&digest), "{record}");
    let listed = place.finish(&["runs --all"]).with_code(0).stdout;
    assert!(listed.contains(&format!("fa {}", &digest[..12])), "{listed}");
    let report = fs::read_to_string(place.run("fc").join("report.html")).unwrap();
    assert!(report.contains(&digest), "the report names the starting weights");
    // It has its own copy of them.
    fs::remove_dir_all(place.run("fa")).unwrap();
    fork("fa", 8).with_code(0);
    fork("fz", 12).with_code(WRONG_INPUT).saying(&["--fork", "`fz`"]);
}

#[test]
fn damaged_checkpoints_give_way_to_older_ones_or_stop_the_run() {
    let place = Place::new();
    train(&place, learner(&place, "--stop-after 12"));
    let files = checkpoints(&place.run("r"));
    assert!(files.len() >= 2, "{files:?}");
    // Torn: the last bytes never reached the disk.
    let newest = files.last().unwrap();
    let bytes = fs::read(newest).unwrap();
    fs::write(newest, &bytes[..bytes.len() / 2]).unwrap();
    let name = newest.file_name().unwrap().to_str().unwrap();
    let second = train(&place, learner(&place, "--stop-after 16"));
    second.saying(&[name, "torn", "resumed"]);
    // Corrupt: every one of them.
    for path in checkpoints(&place.run("r")) {
        let mut bytes = fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&path, bytes).unwrap();
    }
    let args = learner_at(&place.endpoint("learner"));
    refused(&place, &[&args], &["whole", "checkpoints"]);
}

#[test]
fn a_file_that_is_not_a_policy_or_not_a_trace_is_refused() {
    let place = Place::new();
    let file = place.write("policy.safetensors", "not a policy");
    let pointer = place.write("lfs.safetensors", "version https://git-lfs.github.com/spec/v1\n");
    let page = place.write("page.safetensors", "<!DOCTYPE html>");
    for (command, file, told) in [
        ("eval", &*file, &["policy.safetensors", "text"][..]),
        ("eval", &pointer, &["Git LFS pointer"]),
        ("eval", &page, &["HTML page"]),
        ("pilot eval --pilot", &page, &["HTML page"]),
        ("up -c cartpole --fork", &page, &["HTML page"]),
        ("play", "nothing", &["`nothing`"]),
        ("conformance lander", &file, &["traces"]),
        ("pilot eval --seeds 0..1 --pilot", &file, &["not a pilot"]),
        ("pilot eval --seeds", "3..1", &["A..B"]),
        ("config", "moon", &["lander"]),
    ] {
        refused(&place, &[command, file], told);
    }
}

#[test]
fn nothing_else_is_written_over_the_files_of_a_run() {
    let place = Place::new();
    for folder in ["checkpoints", "tensorboard"] {
        fs::create_dir_all(place.run("r").join(folder)).unwrap();
    }
    let record = place.write("runs/r/run.json", "{}");
    for args in [
        "eval r --episodes-to runs/r/run.json",
        "report r --out runs/r/run.json",
        "up -c cartpole --log-file runs/r/run.json",
        "up -c cartpole --name r --trace runs/r/checkpoints/4.checkpoint",
        "learner -c cartpole --trace runs/r/tensorboard/trace.json",
        "drive lander --connect tcp/127.0.0.1:1 --messages-to runs/r/metrics.jsonl",
        "play r --output runs/r/best.safetensors",
        "script-search lander --out runs/r/config.toml",
        "taxonomy export lander --output runs/r/policy.safetensors",
    ] {
        let target = args.rsplit(" --").next().unwrap();
        refused(&place, &[args], &[target, "the run `r` keeps its own", "choose another path"]);
    }
    assert_eq!(fs::read_to_string(record).unwrap(), "{}");
    // Another name is free.
    let steps = "eval nothing --episodes-to runs/r/steps.jsonl";
    refused(&place, &[steps], &["`nothing`"]);
}

#[test]
fn a_full_disk_costs_no_results() {
    let place = Place::new();
    place.finish(&["up --name r --actors 1 --stop-after 1", SMALL]).with_code(0);
    let evaluated = place.finish(&["eval r --episodes 2 --episodes-to /dev/full"]);
    let evaluated = evaluated.with_code(WRONG_INPUT);
    assert!(!evaluated.stdout.is_empty(), "the results are printed first");
    evaluated.saying(&["writing /dev/full"]);
    // A file for which there is no room stays as it was.
    let steps = place.write("steps.jsonl", "old\n");
    let mut limited = place.program_at(Path::new("sh"), &[]);
    limited.args(["-c", "trap '' XFSZ; ulimit -f 32; exec \"$@\"", "sh"]);
    limited.args([env!("CARGO_BIN_EXE_leadtime"), "eval", "r", "--episodes", "200"]);
    limited.args(["--episodes-to", &steps]);
    let evaluated = place.start_with(limited).finish(PATIENCE).with_code(WRONG_INPUT);
    assert!(!evaluated.stdout.is_empty(), "the results are printed first");
    evaluated.saying(&["writing ", "steps.jsonl"]);
    assert_eq!(fs::read_to_string(&steps).unwrap(), "old\n");
    let files = fs::read_dir(place.path()).unwrap().map(|entry| entry.unwrap().file_name());
    let partial = files.filter(|name| name.to_string_lossy().contains("partial"));
    assert_eq!(partial.count(), 0, "it is removed");
}

#[test]
fn a_pipe_that_is_given_for_a_file_is_refused_and_not_waited_for() {
    let place = Place::new();
    let pipe = place.file("pipe.toml");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let policy = repository("deploy/policies/piloting.safetensors");
    let eval = format!("eval {policy} --episodes 1 --baseline");
    for command in ["check -c", "up -c", "learner -c", "compare", &eval] {
        refused(&place, &[command, &pipe], &["reading ", "pipe.toml is not a file"]);
    }
    for command in ["conformance lander", "replay", "pilot eval --pilot"] {
        refused(&place, &[command, &pipe], &["pipe.toml is not a file"]);
    }
    place.finish(&["certs init pki"]).with_code(0);
    std::os::unix::fs::symlink("../pipe.toml", place.path().join("pki/acl.json5")).unwrap();
    refused(&place, &["certs issue pki actor:a"], &["reading pki/acl.json5", "is not a file"]);
}

#[test]
fn a_pipe_in_the_place_of_a_runs_page_keeps_nobody_waiting() {
    let place = Place::new();
    let up = ["up --name r --actors 1 --stop-after 1", SMALL];
    place.finish(&up).with_code(0);
    let page = place.run("r").join("report.html");
    fs::remove_file(&page).unwrap();
    assert!(Command::new("mkfifo").arg(&page).status().unwrap().success());
    refused(&place, &["report r --episodes 2"], &["report.html is not a file: move it away"]);
    place.finish(&up).with_code(0).saying(&["report.html cannot be written", "is not a file"]);
}

#[test]
fn control_characters_of_an_argument_do_not_reach_the_terminal() {
    let place = Place::new();
    let directory = |name: &str| place.path().join(format!("{name}\u{1b}[2J"));
    let said = |args: &[&str], path: &Path| {
        let mut command = place.program(args);
        command.arg(path);
        let done = place.start_with(command).finish(PATIENCE).with_code(0);
        let said = done.stdout + &done.stderr;
        let raw = said.contains(|c: char| c.is_control() && c != '\n');
        assert!(!raw && said.contains("\\u{1b}[2J"), "{args:?}: {said:?}");
        said
    };
    said(&["certs init"], &directory("certs"));
    let runs = directory("runs");
    let told = said(&["up --name r", SMALL, "--stop-after 4 --runs"], &runs);
    // What is said to be typed is read by a shell as the path that it is.
    let hint = told.lines().find(|line| line.trim_start().starts_with("leadtime up -c"));
    let hint = hint.unwrap_or_else(|| panic!("no hint in: {told}")).trim_start();
    let mut shell = Command::new("bash");
    let script = hint.replacen("leadtime", env!("CARGO_BIN_EXE_leadtime"), 1);
    shell.args(["-c", &script]).current_dir(place.path()).env_remove("RUST_LOG");
    place.start_with(shell).finish(PATIENCE).with_code(0);
    let mut list = place.program(&["runs --json --runs"]);
    list.arg(&runs);
    let list = place.start_with(list).finish(PATIENCE).with_code(0).json();
    assert_eq!(list[0]["state"], "finished", "{list}");
}

#[test]
fn a_run_in_a_directory_whose_name_is_not_text_can_be_resumed_as_told() {
    let place = Place::new();
    let mut up = place.program(&["up --name r --actors 1", SMALL, "--stop-after 4 --runs"]);
    up.arg(OsStr::from_bytes(b"runs\xff"));
    let told = place.start_with(up).finish(PATIENCE).with_code(0);
    told.saying(&["-c $'runs\\377/r/config.toml' --name r --runs $'runs\\377' --actors 1"]);
}
