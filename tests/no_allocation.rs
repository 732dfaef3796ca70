//! What production runs allocates nothing per step: not the driver, not the actor's recorder, not the evaluation's
//! measures, not the listener, the history or the batch, and not a notifier at work from the bytes of an observation to those of
//! what is said about it.
//!
//! It steps the lander in free flight (the contact world near the ground belongs to the physics engine, which keeps
//! its own memory), the highway past its first merge, and the steakhouse through words, directions and disclosures. An
//! untrained policy starts a message in every other step it may: speech, comprehension, reaction and cuts all happen.
//! This is a program of its own (no test harness), so that nobody else allocates beside it.

use std::alloc::System;

use leadtime_actor::{Phase, Stopwatch, Worker};
use leadtime_episodes::{Choice, EnvSlot, EpisodeObserver, Observer, PlaySettings, Player};
use leadtime_eval::measure::evaluate_with;
use leadtime_link::live::ArrivalEncoding;
use leadtime_numerics::Pcg64;
use leadtime_policy::{Parameters, Policy};
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{
    Encoder, EnvId, EnvSpec, HeadCredit, Iteration, PolicySpec, PolicyVersion, RunSpec, Schedule,
    TaskSpec,
};
use leadtime_serve::observation::{ObservationHead, write_json, write_raw};
use leadtime_serve::{LiveSession, ObservationBytes, SayTo, SessionPlan, WorkingPolicy};
use leadtime_sims::{End, StepOutcome};
use leadtime_taxonomy::{Request, Rotation, shipped};
use leadtime_voice::{VoiceChoice, prepare};
use stats_alloc::{INSTRUMENTED_SYSTEM, Stats, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const N_ENVS: u32 = 4;

fn main() {
    for (domain, n_steps) in [("lander", 8), ("highway", 16), ("steakhouse", 24)] {
        collecting_allocates_nothing(domain, n_steps / 2);
        evaluating_allocates_nothing(domain, u64::from(n_steps));
        saying_allocates_nothing(domain);
        for clock in ["observation", "timer"] {
            serving_allocates_nothing(domain, n_steps as usize, clock);
        }
    }
}

fn policy_spec(env: &EnvSpec) -> PolicySpec {
    PolicySpec {
        encoder: Encoder::Lstm { projection: 8, state: 16 },
        head_credit: HeadCredit::Active,
        normalize_observations: true,
        ..PolicySpec::dense(env, &[16])
    }
}

fn task(domain: &str) -> TaskSpec {
    TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() }
}

/// Compares what has been allocated at its marks.
#[derive(Default)]
struct Meter {
    n_marks: usize,
    first: Stats,
    last: Stats,
}

impl Meter {
    fn mark(&mut self) {
        self.last = ALLOCATOR.stats();
        if self.n_marks == 0 {
            self.first = self.last;
        }
        self.n_marks += 1;
    }

    fn check(&self, domain: &str, what: &str, n_marks: usize) {
        assert_eq!(self.n_marks, n_marks, "all episodes of {domain} go on while {what}");
        let change = self.last - self.first;
        let n_allocated = change.allocations + change.reallocations;
        assert_eq!(n_allocated, 0, "{domain}, {what}: {change:?}");
    }
}

/// A mark after every step of the environments.
struct Laps {
    meter: Meter,
    n_steps: usize,
}

impl Stopwatch for Laps {
    fn lap(&mut self, phase: Phase) {
        // The lap after the last step holds the snapshots, which are made once per rollout.
        if phase == Phase::Simulate && self.meter.n_marks < self.n_steps {
            self.meter.mark();
        }
    }
}

fn collecting_allocates_nothing(domain: &str, n_steps: u32) {
    let registry = leadtime_worlds::builtin();
    let build = || registry.build(&task(domain)).expect("the default task can be built");
    let env = build().spec().clone();
    let policy = policy_spec(&env);
    let parameters = Parameters::initialize(&policy, 1).expect("the architecture is sound");
    let mut acting = Policy::new(&policy, &parameters).expect("the parameters fit");
    let mut worker = Worker::new(RunSpec {
        seed: 1,
        task: task(domain),
        env,
        policy,
        n_steps,
        schedule: Schedule::Lag(0),
    });
    for env_id in (0..N_ENVS).map(EnvId) {
        let start = EnvAssignment { env_id, iteration: Iteration(0), snapshot: Vec::new() };
        worker.insert(build(), &start).expect("an empty snapshot is a fresh start");
    }
    worker.collect(&mut acting, PolicyVersion(0), &mut ());
    let mut laps = Laps { meter: Meter::default(), n_steps: n_steps as usize };
    let rollouts = worker.collect(&mut acting, PolicyVersion(0), &mut laps);
    assert!(rollouts.iter().all(|rollout| rollout.ends.is_empty()), "{domain}");
    laps.meter.check(domain, "collecting", n_steps as usize);
}

/// A mark after each of an episode's first steps but one.
struct FirstSteps {
    meter: Meter,
    n_steps: u64,
}

impl Observer for FirstSteps {
    fn on_step(&mut self, slot: &EnvSlot, _outcome: StepOutcome) {
        if (2..=self.n_steps).contains(&u64::from(slot.n_steps())) {
            self.meter.mark();
        }
    }
}

impl EpisodeObserver for FirstSteps {
    type Output = Meter;

    fn finish(self, _slot: &EnvSlot, _end: End) -> Meter {
        self.meter
    }
}

/// Asks for every message twice: with nothing told, and with everything.
fn saying_allocates_nothing(domain: &str) {
    let words = shipped(domain).expect("the words come with the program");
    let mut rotation = Rotation::new(&words, &mut Pcg64::seed_from_u64(1));
    let facts: Vec<String> = words.facts().to_vec();
    let names: Vec<&str> = facts.iter().map(String::as_str).collect();
    let mut meter = Meter::default();
    for told in [&[][..], &names] {
        for topic in 0..words.topics().len() {
            for cell in words.feasible() {
                let (request, holding) =
                    (Request { topic, cell }, words.facts_named(told.iter().copied()));
                let found = words.retrieve_true(request, holding);
                let found = found.expect("there is such a topic");
                assert!(found.and_then(|found| rotation.next(&found)).is_some());
                meter.mark();
            }
        }
    }
    meter.check(domain, "speaking", 2 * 10 * words.topics().len());
}

fn evaluating_allocates_nothing(domain: &str, n_steps: u64) {
    let registry = leadtime_worlds::builtin();
    let make = || registry.build(&task(domain));
    let spec = make().expect("the default task can be built").spec().clone();
    let trained = Player::untrained(&policy_spec(&spec), 1, Choice::Sample);
    for player in [trained.expect("the architecture is sound"), Player::baseline("heuristic")] {
        let settings = PlaySettings::new(u64::from(N_ENVS), 1);
        let observe = |_| FirstSteps { meter: Meter::default(), n_steps };
        let (_, meters) =
            evaluate_with(&make, &player, &settings, observe).expect("the task can be played");
        for meter in meters {
            meter.check(domain, player.name(), n_steps as usize - 1);
        }
    }
}

/// Counts what a session tells.
#[derive(Default)]
struct Ear {
    n_says: usize,
    n_statuses: usize,
}

impl SayTo for Ear {
    fn say(&mut self, bytes: &[u8]) {
        self.n_says += usize::from(!bytes.is_empty());
    }

    fn status(&mut self, bytes: &[u8]) {
        self.n_statuses += usize::from(!bytes.is_empty());
    }
}

fn serving_allocates_nothing(domain: &str, n_steps: usize, clock: &str) {
    /// How long a step takes, in nanoseconds.
    const STEP: u64 = 300_000_000;
    let environment = leadtime_worlds::builtin().build(&task(domain));
    let environment = environment.expect("the default task can be built");
    let spec = policy_spec(environment.spec());
    let parameters = Parameters::initialize(&spec, 1).expect("the architecture is sound");
    let words = leadtime_taxonomy::shipped(domain).expect("there are sentences");
    let policy = WorkingPolicy::new(
        domain,
        environment.as_ref(),
        &spec,
        &parameters,
        Choice::Sample,
        Some(words),
    );
    let policy = policy.expect("somebody is spoken to");
    let texts: Vec<&str> = policy.sentences().collect();
    let voice = prepare(&VoiceChoice::Shipped, domain, &texts, false);
    let policy = policy.with_voice(voice.expect("the shipped voice is there"));
    let question = format!(r#"{{"protocol":1,"domain":"{domain}","clock":"{clock}"}}"#);
    let plan = SessionPlan::read(question.as_bytes(), &policy, 1).expect("the question is sound");
    let mut decider = policy.decider();
    let mut session = LiveSession::new("s".to_owned(), plan, &policy, &decider, STEP);
    let values = vec![0.1; policy.obs_dim()];
    let head = |seq: u64| ObservationHead { seq, t: seq as f64, episode: 0, end: false };
    let json: Vec<_> = (0..n_steps as u64).map(|i| write_json(&head(2 * i + 1), &values)).collect();
    let raw: Vec<_> = (0..n_steps as u64).map(|i| write_raw(&head(2 * i + 2), &values)).collect();
    let (mut ear, mut meter) = (Ear::default(), Meter::default());
    for (i, (json, (numbers, beside))) in json.iter().zip(&raw).enumerate() {
        let now = (i as u64 + 2) * STEP;
        let written =
            ObservationBytes { encoding: &ArrivalEncoding::Json, payload: json, beside: None };
        session.arrive(now, now, written, &mut decider, &mut ear);
        let encoding = &ArrivalEncoding::Binary;
        let sent = ObservationBytes { encoding, payload: numbers, beside: Some(beside) };
        session.arrive(now + STEP / 2, now + STEP / 2, sent, &mut decider, &mut ear);
        session.tick(now + STEP / 2, &mut decider, &mut ear);
        meter.mark();
    }
    meter.check(domain, "serving", n_steps);
    // By the timer, not every observation has an answer.
    let n_answers = if clock == "timer" { 2 } else { 2 * n_steps };
    assert!(ear.n_says >= n_answers && ear.n_statuses > 1, "{domain}");
    assert!(session.counts().utterances > 0, "{domain}");
}
