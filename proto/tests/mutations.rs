//! Mutated messages on the receiving path: no panic, no more memory than the message deserves, a cause for every refusal.
//!
//! Three kinds of damage: bytes that arrive changed (the checksum sees them), bytes that an intruder sealed (it does
//! not), and headers. What gets through the receiver's checks is a message like any other, so it is also given to
//! the last step, the check of a rollout's shapes.

#![expect(clippy::unwrap_used, reason = "the tests' helpers fail as their tests do")]

use leadtime_proto::header::Schema;
use leadtime_proto::message::{
    Announcement, Assignment, Control, EnvAssignment, Hello, HelloReply, Welcome,
};
use leadtime_proto::receive::{self, CONTROL, Expected, HELLO, HELLO_REPLY, ROLLOUT};
use leadtime_proto::{
    ActionSpec, ActorId, EnvId, EnvSpec, EpisodeEnd, EpisodeSummary, Epoch, Header, Incarnation,
    Iteration, PolicySpec, PolicyVersion, RefusalCause, Rollout, RowOverlap, RunName, RunSpec,
    Schedule, Sequence, TaskSpec, codec,
};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// One way in which bytes are spoilt, and where: positions are taken modulo the length.
#[derive(Clone, Debug)]
enum Mutation {
    Flip(usize, u8),
    Set(usize, u8),
    Cut(usize),
    Insert(usize, Vec<u8>),
    /// Writes a length in the encoding's own words.
    Claim(usize, u64),
}

fn damage() -> impl Strategy<Value = Mutation> {
    let at = any::<usize>();
    prop_oneof![
        (at, 1..=u8::MAX).prop_map(|(at, mask)| Mutation::Flip(at, mask)),
        (at, prop_oneof![Just(0), Just(1), 250..=255_u8])
            .prop_map(|(at, value)| Mutation::Set(at, value)),
        at.prop_map(Mutation::Cut),
        (at, vec(any::<u8>(), 1..16)).prop_map(|(at, bytes)| Mutation::Insert(at, bytes)),
        (at, 0..63_u32).prop_map(|(at, bits)| Mutation::Claim(at, 1 << bits)),
    ]
}

fn spoil(mut bytes: Vec<u8>, damages: &[Mutation]) -> Vec<u8> {
    for damage in damages {
        let n = bytes.len();
        // What is replaced, and by what.
        let (at, n_replaced, new) = match damage {
            Mutation::Flip(at, mask) => {
                let at = at % n.max(1);
                (at, 1, bytes.get(at).map(|byte| byte ^ mask).into_iter().collect())
            }
            Mutation::Set(at, value) => (at % n.max(1), 1, vec![*value; n.min(1)]),
            Mutation::Cut(at) => (at % n.max(1), n, Vec::new()),
            Mutation::Insert(at, inserted) => (at % n.max(1), 0, inserted.clone()),
            Mutation::Claim(at, length) => {
                (at % n.max(1), 1, [&[253], length.to_le_bytes().as_slice()].concat())
            }
        };
        drop(bytes.splice(at..n.min(at + n_replaced), new));
    }
    bytes
}

fn spec() -> EnvSpec {
    let metrics = vec!["success".to_owned()];
    EnvSpec { obs_dim: 2, actions: ActionSpec::discrete("choice", 3), metrics }
}

fn summary() -> EpisodeSummary {
    EpisodeSummary { episode: 7, episode_return: 3.0, length: 11, metrics: vec![1.0] }
}

fn rollout() -> impl Strategy<Value = Rollout> {
    let sizes = (1..20_usize, vec(any::<u8>(), 1..64), any::<bool>());
    sizes.prop_map(|(n_steps, snapshot, has_history)| {
        let mut rollout = whole_rollout(n_steps, snapshot);
        if has_history {
            rollout.leave_out_repeats(RowOverlap::new(1, 1), 2);
        }
        rollout
    })
}

fn whole_rollout(n_steps: usize, snapshot: Vec<u8>) -> Rollout {
    Rollout {
        env_id: EnvId(3),
        iteration: Iteration(4),
        version: PolicyVersion(5),
        n_steps: n_steps as u32,
        observations: vec![0.5; 2 * n_steps],
        next_observation: vec![0.25; 2],
        masks: vec![u64::MAX; n_steps],
        actions: vec![2; n_steps],
        log_probs: vec![-1.0; n_steps],
        values: vec![0.0; n_steps],
        next_value: 0.5,
        rewards: vec![1.0; n_steps],
        ends: vec![EpisodeEnd {
            step: n_steps as u32 - 1,
            truncated: true,
            final_observation: vec![0.0; 2],
            final_value: 1.0,
            summary: summary(),
        }],
        recurrent: Vec::new(),
        snapshot,
        ..Rollout::default()
    }
}

fn control() -> Control {
    let iteration = Iteration(2);
    let env = |id| EnvAssignment { env_id: EnvId(id), iteration, snapshot: vec![id as u8; 40] };
    let envs = (0..5).map(env).collect();
    Control::Assign(Assignment { epoch: Epoch(3), envs, keep: vec![EnvId(9)] })
}

fn hello() -> Hello {
    Hello {
        program: "0.1.0".to_owned(),
        actor: ActorId::new("actor-1").unwrap(),
        incarnation: Incarnation(7),
        cpu: "x86_64".to_owned(),
        published: Sequence(10),
        first_unacknowledged: Sequence(9),
    }
}

fn reply() -> HelloReply {
    HelloReply::Welcome(Box::new(Welcome {
        run: RunName::new("run").unwrap(),
        spec: RunSpec {
            seed: 2,
            task: TaskSpec { domain: "lander".to_owned(), settings: "{}".to_owned() },
            env: spec(),
            policy: PolicySpec::dense(&spec(), &[64, 64]),
            n_steps: 20,
            schedule: Schedule::Async { staleness_max: 8 },
        },
        window: 4,
        weights: Announcement {
            learner: Incarnation(1),
            versions: vec![(PolicyVersion(2), [2; 32]), (PolicyVersion(3), [3; 32])],
        },
        resend_from: Sequence(1),
    }))
}

fn header(schema: Schema, payload: &[u8]) -> Header {
    Header {
        sequence: Sequence(7),
        epoch: Epoch(8),
        version: PolicyVersion(9),
        ..Header::plain(schema, Incarnation(6), payload)
    }
}

/// Sends spoilt bytes through the receiver twice: as damaged on the way, and as sealed by an intruder.
///
/// Returns what the intruder got through.
fn receive_spoilt<T: Serialize + DeserializeOwned>(
    message: &T,
    damages: &[Mutation],
    expected: Expected,
) -> Result<Option<T>, TestCaseError> {
    let sent = codec::encode(message).unwrap();
    let sealed = header(expected.schema, &sent).to_bytes();
    prop_assert!(receive::receive::<T>(Some(&sealed), &sent, expected).is_ok());

    let spoilt = spoil(sent.clone(), damages);
    let arrived = receive::receive::<T>(Some(&sealed), &spoilt, expected);
    if spoilt == sent {
        prop_assert!(arrived.is_ok());
    } else {
        let cause = arrived.map(drop).unwrap_err().cause;
        prop_assert_eq!(cause, RefusalCause::Checksum);
    }

    let resealed = header(expected.schema, &spoilt).to_bytes();
    match receive::receive::<T>(Some(&resealed), &spoilt, expected) {
        Ok((_, message)) => {
            // It is a message like any other: it can be written, and reads back the same.
            let again = codec::encode(&message).unwrap();
            let back: T = codec::decode(&again, expected.max_bytes).unwrap();
            prop_assert_eq!(codec::encode(&back).unwrap(), again);
            Ok(Some(message))
        }
        Err(refusal) => {
            prop_assert_eq!(refusal.cause, RefusalCause::Malformed);
            Ok(None)
        }
    }
}

#[test]
fn repeats_left_out_on_the_way_are_there_after_the_check() {
    let frames = (0..70_u8).flat_map(|t| [f32::from(t), f32::from(t) + 1.0]);
    let whole = Rollout { observations: frames.collect(), ..whole_rollout(70, vec![1]) };
    let mut sent = whole.clone();
    sent.leave_out_repeats(RowOverlap::new(1, 1), 2);
    sent.leave_out_repeats(RowOverlap::new(1, 1), 2);
    assert_eq!(sent.observations.len(), 71);
    let received = |sent: &Rollout| {
        let payload = codec::encode(sent).unwrap();
        let header = header(Schema::Rollout, &payload).to_bytes();
        receive::receive::<Rollout>(Some(&header), &payload, ROLLOUT).unwrap().1
    };
    assert_eq!(*received(&sent).check(&spec(), 70, 0).unwrap(), whole);
    sent.observations.pop();
    let refusal = received(&sent).check(&spec(), 70, 0).unwrap_err();
    assert_eq!(refusal.text, "`observations` has length 70, expected 71");
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2_000,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(20_260_101),
        ..ProptestConfig::default()
    })]

    #[test]
    fn a_spoilt_rollout_is_refused_or_checked(
        rollout in rollout(),
        damages in vec(damage(), 1..6),
    ) {
        if let Some(got) = receive_spoilt(&rollout, &damages, ROLLOUT)? {
            match got.check(&spec(), rollout.n_steps as usize, 0) {
                Ok(got) => prop_assert_eq!(got.observations.len(), 2 * rollout.n_steps as usize),
                Err(refusal) => prop_assert_eq!(refusal.sender, None),
            }
        }
    }

    #[test]
    fn a_spoilt_order_is_refused_or_an_order(damages in vec(damage(), 1..6)) {
        receive_spoilt(&control(), &damages, CONTROL)?;
    }

    #[test]
    fn a_spoilt_hello_or_welcome_is_refused_or_is_one(damages in vec(damage(), 1..6)) {
        if let Some(hello) = receive_spoilt(&hello(), &damages, HELLO)? {
            // Names become parts of keys and paths, so they are checked while they are decoded.
            prop_assert!(ActorId::new(hello.actor.as_str()).is_ok());
        }
        if let Some(HelloReply::Welcome(welcome)) = receive_spoilt(&reply(), &damages, HELLO_REPLY)? {
            prop_assert!(RunName::new(welcome.run.as_str()).is_ok());
        }
    }

    #[test]
    fn a_spoilt_header_is_refused_with_a_cause_or_is_a_header(
        rollout in rollout(),
        damages in vec(damage(), 1..4),
    ) {
        let payload = codec::encode(&rollout).unwrap();
        let sent = header(Schema::Rollout, &payload).to_bytes().to_vec();
        let spoilt = spoil(sent.clone(), &damages);
        match receive::receive::<Rollout>(Some(&spoilt), &payload, ROLLOUT) {
            // Who, which and under what are the sender's word; the rest of a header is checked.
            Ok((header, got)) => {
                prop_assert_eq!(header.checksum, Header::from_bytes(&sent).unwrap().checksum);
                prop_assert_eq!(got, rollout);
            }
            Err(refusal) => {
                use RefusalCause as C;
                let cause = refusal.cause;
                prop_assert!([C::Header, C::Protocol, C::Schema, C::Checksum].contains(&cause), "{cause}");
            }
        }
    }

    #[test]
    fn noise_is_refused(header in vec(any::<u8>(), 0..64), payload in vec(any::<u8>(), 0..256)) {
        let refusal = receive::receive::<Rollout>(Some(&header), &payload, ROLLOUT).unwrap_err();
        prop_assert_eq!(refusal.cause, RefusalCause::Header);
    }
}
