//! Formats that other releases read stay what they are: the messages of the present protocol and a run with a checkpoint
//! of the present format, as they were when their version number was given.
//!
//! A change that breaks one of these tests needs a new `PROTOCOL_VERSION` or `FORMAT_VERSION`;
//! `UPDATE_FROZEN=1 cargo test -p leadtime --test frozen` then writes what there is of the new version, and overwrites
//! nothing.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use leadtime_learner::checkpoint::FORMAT_VERSION;
use leadtime_proto::header::{PROTOCOL_VERSION, Schema};
use leadtime_proto::hex;
use leadtime_proto::message::{
    Announcement, Assignment, Control, ControlReply, Credit, EnvAssignment, Hello, HelloReply,
    Welcome,
};
use leadtime_proto::{
    ActionSpec, ActorId, EnvId, EnvSpec, Epoch, Header, Incarnation, Iteration, PolicySpec,
    PolicyVersion, Rollout, RowOverlap, RunName, RunSpec, Schedule, Sequence, TaskSpec, codec,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// More than any message here takes.
const MAX_BYTES: usize = 1 << 20;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data").join(name)
}

fn is_update() -> bool {
    std::env::var_os("UPDATE_FROZEN").is_some()
}

/// Writes a message as it crosses the wire, and asserts that it is read back as what it was.
fn sealed<T: Serialize + DeserializeOwned + PartialEq + std::fmt::Debug>(message: &T) -> String {
    let bytes = codec::encode(message).unwrap();
    let again: T = codec::decode(&bytes, MAX_BYTES).unwrap();
    assert_eq!(&again, message);
    hex::encode(&bytes)
}

fn run_spec() -> RunSpec {
    let actions = ActionSpec::discrete("push", 2);
    let env = EnvSpec { obs_dim: 4, actions, metrics: vec!["length".to_owned()] };
    RunSpec {
        seed: 7,
        task: TaskSpec { domain: "cartpole".to_owned(), settings: "{}".to_owned() },
        policy: PolicySpec::dense(&env, &[8]),
        env,
        n_steps: 2,
        schedule: Schedule::Lag(1),
    }
}

fn rollout() -> Rollout {
    Rollout {
        env_id: EnvId(2),
        iteration: Iteration(9),
        version: PolicyVersion(4),
        n_steps: 2,
        observations: (0..8).map(|i| i as f32 / 4.0).collect(),
        next_observation: vec![0.5; 4],
        masks: vec![3, 3],
        actions: vec![0, 1],
        log_probs: vec![-0.5, -0.75],
        values: vec![1.0, 2.0],
        next_value: 3.0,
        rewards: vec![1.0, 1.0],
        snapshot: vec![9, 8, 7],
        ..Rollout::default()
    }
}

/// Lists one message of every kind, as a line each.
fn messages() -> String {
    let actor = ActorId::new("a-1").unwrap();
    let hello = Hello {
        program: "leadtime 0.1.0".to_owned(),
        actor,
        incarnation: Incarnation(11),
        cpu: "x86_64 avx2".to_owned(),
        published: Sequence(5),
        first_unacknowledged: Sequence(4),
    };
    let announcement = Announcement {
        learner: Incarnation(12),
        versions: vec![(PolicyVersion(3), [1; 32]), (PolicyVersion(4), [2; 32])],
    };
    let welcome = HelloReply::Welcome(Box::new(Welcome {
        run: RunName::new("lander-1").unwrap(),
        spec: run_spec(),
        window: 64,
        weights: announcement.clone(),
        resend_from: Sequence(4),
    }));
    let env = EnvAssignment { env_id: EnvId(2), iteration: Iteration(9), snapshot: vec![1, 2, 3] };
    let assignment = Assignment { epoch: Epoch(6), envs: vec![env], keep: vec![EnvId(1)] };
    let stop = Control::Stop { reason: "the run is finished".to_owned(), cut_off: false };
    let credit = Credit {
        incarnation: Incarnation(11),
        learner: Incarnation(12),
        acknowledged: Sequence(5),
        limit: Sequence(69),
    };
    let rollout = rollout();
    let mut repeating =
        Rollout { observations: vec![1.0, 2.0, 3.0, 4.0, 2.0, 3.0, 4.0, 5.0], ..rollout.clone() };
    repeating.leave_out_repeats(RowOverlap::new(1, 3), 4);
    let cannot = ControlReply::CannotRestore { epoch: Epoch(6), envs: vec![EnvId(2)] };
    let refused = HelloReply::Refused { reason: "the run is ending".to_owned() };
    let header = Header {
        sequence: Sequence(5),
        epoch: Epoch(6),
        version: PolicyVersion(4),
        ..Header::plain(Schema::Rollout, Incarnation(11), b"payload")
    };
    assert_eq!(Header::from_bytes(&header.to_bytes()).unwrap(), header);
    let lines = [
        ("header", hex::encode(&header.to_bytes())),
        ("hello", sealed(&hello)),
        ("hello_reply.welcome", sealed(&welcome)),
        ("hello_reply.refused", sealed(&refused)),
        ("hello_reply.taken", sealed(&HelloReply::Taken)),
        ("control.assign", sealed(&Control::Assign(assignment))),
        ("control.stop", sealed(&stop)),
        ("control.wait", sealed(&Control::Wait)),
        ("control_reply.followed", sealed(&ControlReply::Followed { epoch: Epoch(6) })),
        ("control_reply.cannot_restore", sealed(&cannot)),
        ("credit", sealed(&credit)),
        ("announcement", sealed(&announcement)),
        ("rollout", sealed(&rollout)),
        ("rollout.repeats", sealed(&repeating)),
    ];
    lines.map(|(name, bytes)| format!("{name} {bytes}\n")).concat()
}

#[test]
fn the_messages_of_this_protocol_are_those_that_were_frozen() {
    let path = data(&format!("wire_{PROTOCOL_VERSION}.txt"));
    if is_update() && !path.exists() {
        fs::write(&path, messages()).unwrap();
    }
    let frozen = fs::read_to_string(&path).unwrap_or_default();
    for (now, then) in messages().lines().zip(frozen.lines()) {
        assert_eq!(
            now, then,
            "other bytes under protocol {PROTOCOL_VERSION}: it needs a new number"
        );
    }
    assert_eq!(messages().lines().count(), frozen.lines().count(), "{}", path.display());
}

fn program(place: &Path, args: &str) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_leadtime"));
    program
        .args(args.split_whitespace())
        .current_dir(place)
        .env_remove("RUST_LOG")
        .output()
        .unwrap()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let (path, place) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &place);
        } else {
            fs::copy(path, place).unwrap();
        }
    }
}

/// Makes a run that was stopped half-way, without what a resume does not read.
fn make_run(path: &Path) {
    let place = tempfile::tempdir().unwrap();
    let args = "up -c cartpole --name frozen --seed 7 --set learner.n_envs=2 --set learner.n_steps=16 \
                --set learner.n_minibatches=2 --set learner.total_steps=256 --set policy.hidden=[8] \
                --set run.checkpoint_every=4 --set evaluation.during_training=0 --stop-after 4 --actors 1";
    let done = program(place.path(), args);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let run = place.path().join("runs/frozen");
    let checkpoints = path.join("checkpoints");
    fs::create_dir_all(&checkpoints).unwrap();
    for name in ["config.toml", "run.json", "metrics.jsonl"] {
        fs::copy(run.join(name), path.join(name)).unwrap();
    }
    let newest = fs::read_dir(run.join("checkpoints")).unwrap().map(|entry| entry.unwrap().path());
    let newest = newest.filter(|path| path.extension().is_some_and(|it| it == "checkpoint")).max();
    let newest = newest.unwrap();
    fs::copy(&newest, checkpoints.join(newest.file_name().unwrap())).unwrap();
}

#[test]
fn a_run_with_a_checkpoint_of_this_format_is_resumed_and_finished() {
    let kept = data(&format!("run_{FORMAT_VERSION}"));
    if is_update() && !kept.exists() {
        make_run(&kept);
    }
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("runs/frozen");
    copy(&kept, &run);
    let args = "up -c runs/frozen/config.toml --name frozen --actors 1";
    let done = program(place.path(), args);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    assert!(said.contains("resumed from update 4"), "{said}");
    let record = fs::read_to_string(run.join("run.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["result"]["updates"], 8, "{record}");
    assert_eq!(record["result"]["books"]["balanced"], true, "{record}");
}
