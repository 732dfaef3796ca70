//! Learner and actors over a unix socket, in one process: whatever happens on the way, the weights are those of a
//! loop without any network, and the books balance.
//!
//! Most of it is CartPole with dense layers; the notifiers' worlds, with listeners and recurrent states that move, come after it.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use leadtime_actor::{ActorEnd, ActorReport, ActorSettings, Worker};
use leadtime_learner::checkpoint::{CheckpointError, CheckpointStore};
use leadtime_learner::{
    Build, HeldOutEpisode, HeldOutEvaluation, HeldOutMeans, LearnerConfig, PolicyEvaluator,
    ProgressSink, RatedPolicy, RunEnd, RunEvent, RunHealth, RunReport, RunStop, UpdateProgress,
};
use leadtime_link::{
    ActorEvent, ActorLink, ConnectSettings, Endpoint, ListenSettings, RUNTIME_VARIABLE, StartKey,
};
use leadtime_policy::{Parameters, Policy};
use leadtime_ppo::checkpoints::{CheckpointInterval, Retention};
use leadtime_ppo::{LearnerSettings, Mode, TrainError, Trainer};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Control, ControlReply, EnvAssignment};
use leadtime_proto::{
    ActorId, CheckedRollout, Encoder, EnvId, EnvSpec, Epoch, Header, Iteration, PolicySpec,
    PolicyVersion, Rollout, RunName, RunSpec, Sequence, TaskSpec, codec, fakes,
};
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::task::{JoinHandle, block_in_place};
use tokio_util::sync::CancellationToken;

const N_ENVS: usize = 3;
const N_UPDATES: u64 = 12;
const RUN_SEED: u64 = 11;
const RETENTION: Retention = Retention { newest: 3, every_updates: 0 };
/// Nothing in these tests takes this long.
const PATIENCE: Duration = Duration::from_mins(1);

fn task() -> TaskSpec {
    let settings = r#"{"world": {"max_steps": 30}}"#.to_owned();
    TaskSpec { domain: "cartpole".to_owned(), settings }
}

fn env_spec() -> EnvSpec {
    leadtime_worlds::builtin().build(&task()).unwrap().spec().clone()
}

fn policy_spec() -> PolicySpec {
    PolicySpec { normalize_observations: true, ..PolicySpec::dense(&env_spec(), &[16, 16]) }
}

fn settings(mode: Mode) -> LearnerSettings {
    let n_steps = 32;
    LearnerSettings {
        n_envs: N_ENVS,
        n_steps,
        total_steps: N_UPDATES * (N_ENVS * n_steps) as u64,
        learning_rate: 1e-3,
        normalize_rewards: true,
        mode,
        ..LearnerSettings::default()
    }
}

fn run_spec(mode: Mode) -> RunSpec {
    let settings = settings(mode);
    RunSpec {
        seed: RUN_SEED,
        task: task(),
        env: env_spec(),
        policy: policy_spec(),
        n_steps: settings.n_steps as u32,
        schedule: settings.schedule(),
    }
}

/// A run without processes, network or time.
struct PlainRun {
    settings: LearnerSettings,
    spec: RunSpec,
    worker: Worker,
    trainer: Trainer,
    policies: BTreeMap<PolicyVersion, Policy>,
}

impl PlainRun {
    fn new(spec: RunSpec, settings: LearnerSettings) -> Self {
        let mut worker = Worker::new(spec.clone());
        for env_id in (0..settings.n_envs as u32).map(EnvId) {
            let beginning = EnvAssignment { env_id, iteration: Iteration(0), snapshot: Vec::new() };
            let environment = leadtime_worlds::builtin().build(&spec.task).unwrap();
            worker.insert(environment, &beginning).unwrap();
        }
        let trainer = Trainer::new(&spec.policy, &settings, spec.seed).unwrap();
        let mut run = Self { settings, spec, worker, trainer, policies: BTreeMap::new() };
        run.publish();
        run
    }

    fn publish(&mut self) {
        let policy = Policy::new(&self.spec.policy, self.trainer.parameters()).unwrap();
        self.policies.insert(self.trainer.version(), policy);
    }

    /// Collects the rollouts of the next update.
    fn collect(&mut self) -> Vec<CheckedRollout> {
        let iteration = Iteration(self.trainer.version().0);
        let version = self.settings.schedule().behavior_version(iteration).unwrap();
        let acting = self.policies.get_mut(&version).unwrap();
        let rollouts = self.worker.collect(acting, version, &mut ()).to_vec();
        let (env, n_steps) = (&self.spec.env, self.settings.n_steps);
        let recurrent_dim = self.spec.policy.recurrent_dim();
        let check = |rollout: Rollout| rollout.check(env, n_steps, recurrent_dim).unwrap();
        rollouts.into_iter().map(check).collect()
    }

    fn update(&mut self, rollouts: &[CheckedRollout]) -> Result<(), TrainError> {
        self.trainer.update(rollouts)?;
        self.publish();
        Ok(())
    }

    /// Goes on until so many updates are made.
    fn reach(&mut self, n_updates: u64) -> Result<(), TrainError> {
        while self.trainer.version().0 < n_updates {
            let rollouts = self.collect();
            self.update(&rollouts)?;
        }
        Ok(())
    }

    fn digest(&self) -> [u8; 32] {
        self.trainer.parameters().digest().unwrap()
    }
}

/// The weights of a run without processes, network or time.
fn reference(mode: Mode) -> [u8; 32] {
    reference_after(mode, N_UPDATES)
}

/// The same after so many of its updates.
fn reference_after(mode: Mode, n_updates: u64) -> [u8; 32] {
    reference_of(&run_spec(mode), &settings(mode), n_updates)
}

/// The same of any run.
fn reference_of(spec: &RunSpec, settings: &LearnerSettings, n_updates: u64) -> [u8; 32] {
    let mut run = PlainRun::new(spec.clone(), settings.clone());
    run.reach(n_updates).unwrap();
    run.digest()
}

/// Makes updates until one diverges, and from there on with the usual steps. Returns how many were good, the weights after
/// them, and those at the end, if it does not diverge again.
fn diverging_reference(large: LearnerSettings) -> (u64, [u8; 32], Result<[u8; 32], TrainError>) {
    let mut run = PlainRun::new(run_spec(large.mode), large);
    let (state, rollouts) = loop {
        let (state, rollouts) = (run.trainer.state().unwrap(), run.collect());
        assert!(state.version().0 < N_UPDATES, "it is to diverge");
        if run.update(&rollouts).is_err() {
            break (state, rollouts);
        }
    };
    let n_good = state.version().0;
    run.trainer = Trainer::new(&run.spec.policy, &settings(run.settings.mode), RUN_SEED).unwrap();
    run.trainer.restore(state).unwrap();
    let good = run.digest();
    let rest = run.update(&rollouts).and_then(|()| run.reach(N_UPDATES));
    (n_good, good, rest.map(|()| run.digest()))
}

/// Tells a test how far a run is, holds it there, and remembers what happened.
struct Witness {
    n_updates: watch::Sender<u64>,
    n_queued: watch::Sender<usize>,
    held_at: watch::Receiver<u64>,
    events: Events,
    policy: PolicySpec,
}

impl ProgressSink for Witness {
    fn on_update(&mut self, progress: &UpdateProgress) {
        let n_updates = progress.n_updates;
        self.n_updates.send_replace(n_updates);
        let is_held = *self.held_at.borrow() <= n_updates;
        if is_held {
            let let_go = self.held_at.wait_for(|held_at| *held_at > n_updates);
            drop(block_in_place(|| Handle::current().block_on(let_go)));
        }
    }

    fn on_tick(&mut self, health: &RunHealth) {
        self.n_queued.send_replace(health.n_queued);
    }

    fn on_event(&mut self, event: &RunEvent) {
        self.events.lock().unwrap().push(event.clone());
    }

    fn on_policies(&mut self, last: &RatedPolicy, best: &RatedPolicy, all: &[HeldOutMeans]) {
        Parameters::from_safetensors(&last.weights, &self.policy).unwrap();
        let evaluations = [last, best].into_iter().filter_map(|policy| policy.held_out);
        evaluations.for_each(|it| assert!(all.contains(&it), "{it:?} is not among {all:?}"));
    }

    fn on_held_out(&mut self, _history: &[HeldOutMeans]) {}
}

/// Evaluates policies by their weights alone.
#[derive(Clone, Copy)]
enum Judge {
    Works,
    Fails,
    /// Goes on until it is stopped.
    Hangs,
    /// Works, and the run is to end with the first policy that has this score.
    Asks(f64),
}

impl Judge {
    fn evaluation(self) -> HeldOutEvaluation {
        HeldOutEvaluation {
            n_evaluations: 4,
            max_episodes: 20,
            stop_at: if let Self::Asks(mark) = self { Some(mark) } else { None },
            episodes: [1; 32],
            evaluator: Box::new(self),
        }
    }
}

impl PolicyEvaluator for Judge {
    fn evaluate(
        &mut self,
        weights: &[u8],
        n_episodes: u64,
        is_stopped: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Vec<HeldOutEpisode>>, Box<dyn Error + Send + Sync>> {
        let sum: u64 = weights.iter().map(|byte| u64::from(*byte)).sum();
        let episode = |i: u64| HeldOutEpisode {
            total_reward: 1.0,
            length: 1,
            success: Some(f64::from(u8::from(sum.is_multiple_of(i + 2)))),
        };
        match self {
            Self::Works | Self::Asks(_) => Ok(Some((0..n_episodes).map(episode).collect())),
            Self::Fails => Err("the world is broken".into()),
            Self::Hangs => {
                while !is_stopped() {
                    std::thread::yield_now();
                }
                Ok(None)
            }
        }
    }
}

/// What a run reported.
type Events = Arc<Mutex<Vec<RunEvent>>>;

#[track_caller]
fn assert_reported(events: &Events, is_it: impl Fn(&RunEvent) -> bool) {
    let events = events.lock().unwrap();
    assert!(events.iter().any(is_it), "{events:?}");
}

/// A learner that runs beside the test.
struct Learner {
    task: JoinHandle<Result<RunReport, leadtime_learner::Error>>,
    n_updates: watch::Receiver<u64>,
    n_queued: watch::Receiver<usize>,
    held_at: watch::Sender<u64>,
    events: Events,
    stop: CancellationToken,
}

impl Learner {
    fn start(directory: &Path, mode: Mode, actors_min: usize, incarnation: u64) -> Self {
        Self::start_with(Self::config(directory, mode, actors_min, incarnation))
    }

    fn config(directory: &Path, mode: Mode, actors_min: usize, incarnation: u64) -> LearnerConfig {
        LearnerConfig {
            run: RunName::new("test").unwrap(),
            start: StartKey::numbered(incarnation),
            spec: run_spec(mode),
            settings: settings(mode),
            window: 4,
            actors_min,
            listen: ListenSettings::new(vec![endpoint(directory)]),
            build: Build { program: "test".to_owned(), cpu: "cpu".to_owned() },
            checkpoints: directory.join("checkpoints"),
            checkpoint_interval: CheckpointInterval { updates: 2, time: Duration::from_mins(1) },
            retention: RETENTION,
            checkpoint_patience: Duration::from_mins(10),
            initial: None,
            identity: [mode as u8; 32],
            earlier: Vec::new(),
        }
    }

    fn start_with(config: LearnerConfig) -> Self {
        Self::start_judged(config, None)
    }

    fn start_judged(config: LearnerConfig, judge: Option<Judge>) -> Self {
        let (progress, n_updates) = watch::channel(0);
        let (queue, n_queued) = watch::channel(0);
        let (held_at, hold) = watch::channel(u64::MAX);
        let events = Arc::new(Mutex::new(Vec::new()));
        let (policy, heard) = (config.spec.policy.clone(), Arc::clone(&events));
        let sink =
            Witness { n_updates: progress, n_queued: queue, held_at: hold, events: heard, policy };
        let stop = CancellationToken::new();
        let held_out = judge.map(Judge::evaluation);
        let run_stop = RunStop { ask: stop.clone(), insist: stop.clone() };
        let run = leadtime_learner::run(config, Box::new(sink), held_out, run_stop);
        Self { task: tokio::spawn(run), n_updates, n_queued, held_at, events, stop }
    }

    /// Starts the next learner at an address that a killed one may hold for a moment longer.
    async fn start_again(directory: &Path, mode: Mode, incarnation: u64) -> Self {
        let attempts = async {
            loop {
                let mut learner = Self::start(directory, mode, 1, incarnation);
                // A learner listens before anything else: it fails at once, or it makes updates.
                let joined = tokio::select! {
                    biased;
                    Ok(_) = learner.n_updates.wait_for(|n| *n >= 1) => None,
                    joined = &mut learner.task => Some(joined.unwrap()),
                };
                match joined {
                    None => return learner,
                    Some(Err(leadtime_learner::Error::Link(
                        leadtime_link::Error::AddressInUse { .. },
                    ))) => tokio::task::yield_now().await,
                    Some(other) => panic!("{other:?}"),
                }
            }
        };
        tokio::time::timeout(PATIENCE, attempts).await.expect("the address comes free")
    }

    /// Has the run wait after so many updates: they take so little time that a test which waits for one may wake up after the
    /// last. To be called before there are actors.
    fn hold_at(&self, n_updates: u64) {
        self.held_at.send_replace(n_updates);
    }

    fn let_go(&self) {
        self.held_at.send_replace(u64::MAX);
    }

    async fn reach(&mut self, n_updates: u64) {
        let reached = self.n_updates.wait_for(|n| *n >= n_updates);
        tokio::time::timeout(PATIENCE, reached).await.expect("in time").expect("still running");
    }

    /// Waits until so many rollouts are with the learner, in a tick that comes after this call.
    async fn queues(&mut self, n_rollouts: usize) {
        self.n_queued.mark_unchanged();
        let queued = async {
            let mut found = None;
            while found != Some(n_rollouts) {
                self.n_queued.changed().await.expect("still running");
                found = Some(*self.n_queued.borrow_and_update());
            }
        };
        tokio::time::timeout(PATIENCE, queued).await.expect("in time");
    }

    async fn report(self) -> RunReport {
        let joined = tokio::time::timeout(PATIENCE, self.task).await.expect("in time");
        let report = joined.unwrap().unwrap();
        assert_eq!(report.balance, Ok(()), "{:?}", report.books);
        report
    }

    /// The report of a run that dismisses this actor when it ends.
    async fn report_with(self, actor: ActorTask) -> RunReport {
        let report = self.report().await;
        dismissed(actor).await;
        report
    }

    async fn stopped_with(self, actor: ActorTask) -> RunReport {
        self.stop.cancel();
        self.let_go();
        self.report_with(actor).await
    }
}

fn endpoint(directory: &Path) -> Endpoint {
    format!("unixsock-stream/{}", directory.join("z.sock").display()).parse().unwrap()
}

type ActorTask = JoinHandle<Result<ActorReport, leadtime_actor::Error>>;

fn actor(directory: &Path, name: &str, incarnation: u64) -> ActorTask {
    let settings = ActorSettings {
        actor: ActorId::new(name).unwrap(),
        start: StartKey::numbered(
            name.bytes().fold(1_000 + incarnation, |number, byte| 31 * number + u64::from(byte)),
        ),
        run: None,
        connect: ConnectSettings::new(vec![endpoint(directory)]),
        reconnect_timeout: PATIENCE,
        yields_to_learner: false,
        program: "test".to_owned(),
        cpu: "cpu".to_owned(),
    };
    let run = leadtime_actor::run(settings, leadtime_worlds::builtin(), CancellationToken::new());
    tokio::spawn(run)
}

/// So many actors, each with a name of its own.
fn crew(directory: &Path, n_actors: usize) -> Vec<ActorTask> {
    (0..n_actors).map(|i| actor(directory, &format!("a{i}"), 1)).collect()
}

async fn dismissed(actor: ActorTask) -> ActorReport {
    let joined = tokio::time::timeout(PATIENCE, actor).await.expect("in time");
    let report = joined.unwrap().unwrap();
    assert!(matches!(report.end, ActorEnd::Dismissed { .. }), "{:?}", report.end);
    report
}

async fn undisturbed(mode: Mode, n_actors: usize) -> RunReport {
    let directory = tempfile::tempdir().unwrap();
    let config = Learner::config(directory.path(), mode, n_actors, 1);
    undisturbed_run(directory.path(), config).await
}

/// A run by as many actors as it asks for.
async fn undisturbed_run(directory: &Path, config: LearnerConfig) -> RunReport {
    let (n_actors, n_updates) = (config.actors_min, config.settings.n_updates());
    let learner = Learner::start_with(config);
    let actors = crew(directory, n_actors);
    let report = learner.report().await;
    let mut journal = 0;
    for actor in actors {
        let own = dismissed(actor).await;
        assert_eq!(own.acknowledged, own.sent, "everything sent was acknowledged");
        journal += own.sent.0;
    }
    assert_eq!(report.books.published, journal, "the learner's books and the actors' journals");
    assert_eq!(report.end, RunEnd::Finished);
    assert_eq!(report.n_updates, n_updates);
    report
}

#[tokio::test(flavor = "multi_thread")]
async fn one_two_or_four_actors_learn_what_a_loop_without_a_network_learns() {
    for mode in [Mode::Sync, Mode::Lag] {
        let expected = reference(mode);
        for n_actors in [1, 2, 4] {
            let report = undisturbed(mode, n_actors).await;
            assert_eq!(report.digest, expected, "{mode:?} with {n_actors} actors");
            assert!(report.reproducible);
            assert_eq!(report.books.trained, N_UPDATES * N_ENVS as u64);
        }
    }
    assert_ne!(reference(Mode::Sync), reference(Mode::Lag), "the modes differ, so digests tell");
}

/// A run of a few updates in a notifier's world: listeners who differ, and observations that are normalised.
fn notifier_run(domain: &str) -> (RunSpec, LearnerSettings) {
    let delay = r#"{"uniform": {"low": 1, "high": 5, "drawn": "per_episode"}}"#;
    let text = format!(r#"{{"human": {{"reaction_delay": {delay}}}}}"#);
    let task = TaskSpec { domain: domain.to_owned(), settings: text };
    let environment = leadtime_worlds::builtin().build(&task).unwrap();
    let encoder = match (domain, environment.entity_history()) {
        ("lander", _) => Encoder::Lstm { projection: 8, state: 16 },
        (_, Some(history)) => Encoder::EgoAttention(history.attention(8, 2)),
        (_, None) => Encoder::Identity,
    };
    let env = environment.spec().clone();
    let policy =
        PolicySpec { encoder, normalize_observations: true, ..PolicySpec::dense(&env, &[16]) };
    let (n_envs, n_steps, mode): (usize, usize, _) = (4, 16, Mode::Lag);
    let total_steps = 4 * (n_envs * n_steps) as u64;
    let settings = LearnerSettings { n_envs, n_steps, total_steps, ..settings(mode) };
    let (n_steps, schedule) = (n_steps as u32, settings.schedule());
    (RunSpec { seed: RUN_SEED, task, env, policy, n_steps, schedule }, settings)
}

/// The actor that is killed was given states of the world, of the listener and of the network, and others go on from those that it
/// handed in.
#[tokio::test(flavor = "multi_thread")]
async fn in_every_world_actors_learn_what_a_loop_learns_also_when_one_is_killed() {
    let encoders = ["lander", "highway", "steakhouse"].map(|domain| {
        let (spec, _) = notifier_run(domain);
        (matches!(spec.policy.encoder, Encoder::EgoAttention(_)), spec.policy.recurrent_dim() > 0)
    });
    assert_eq!(encoders, [(false, true), (true, false), (false, false)], "one of each kind");
    for domain in ["lander", "highway", "steakhouse"] {
        let (spec, settings) = notifier_run(domain);
        let (n_updates, n_envs) = (settings.n_updates(), settings.n_envs as u64);
        let expected = reference_of(&spec, &settings, n_updates);
        let config = |directory: &Path, n_actors: usize| LearnerConfig {
            spec: spec.clone(),
            settings: settings.clone(),
            // What the lag lets an actor make that has all of them.
            window: 12,
            ..Learner::config(directory, settings.mode, n_actors, 1)
        };
        for n_actors in [1, 3] {
            let directory = tempfile::tempdir().unwrap();
            let config = config(directory.path(), n_actors);
            let report = undisturbed_run(directory.path(), config).await;
            assert_eq!(report.digest, expected, "{domain} with {n_actors} actors");
            assert_eq!((report.reproducible, report.books.trained), (true, n_updates * n_envs));
        }
        let directory = tempfile::tempdir().unwrap();
        // By then nobody can have made the rollouts of the last update: they need the policy of the second.
        let mut learner = Learner::start_with(config(directory.path(), 2));
        learner.hold_at(1);
        let events = Arc::clone(&learner.events);
        let (stays, victim) = (actor(directory.path(), "a", 1), actor(directory.path(), "b", 1));
        learner.reach(1).await;
        victim.abort();
        assert!(victim.await.unwrap_err().is_cancelled(), "it was at work");
        learner.let_go();
        let report = learner.report_with(stays).await;
        assert_eq!(report.digest, expected, "{domain}, and one is killed");
        assert_eq!((report.reproducible, report.books.trained), (true, n_updates * n_envs));
        assert_reported(
            &events,
            |event| matches!(event, RunEvent::ActorLeft { actor, n_envs, .. } if actor.as_str() == "b" && *n_envs > 0),
        );
    }
}

/// In a process of its own: so many connections in one process need more threads than the network library has, unless a variable
/// says so, which cannot be set while threads run.
#[tokio::test(flavor = "multi_thread")]
async fn sixty_four_actors_learn_what_a_loop_without_a_network_learns() {
    const N_ACTORS: usize = 64;
    let threads = leadtime_link::runtime();
    if std::env::var(RUNTIME_VARIABLE).ok().as_ref() != Some(&threads) {
        let mut own = Command::new(std::env::current_exe().unwrap());
        own.args(["--exact", "sixty_four_actors_learn_what_a_loop_without_a_network_learns"]);
        let done = own.env(RUNTIME_VARIABLE, threads).output().unwrap();
        let told = String::from_utf8_lossy(&done.stdout);
        let failure = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success() && told.contains("1 passed"), "{told}\n{failure}");
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let config = Learner::config(directory.path(), Mode::Sync, N_ACTORS, 1);
    let (n_steps, total_steps) = (8, (2 * N_ACTORS * 8) as u64);
    let settings = LearnerSettings { n_envs: N_ACTORS, n_steps, total_steps, ..config.settings };
    let spec = RunSpec { n_steps: n_steps as u32, ..config.spec };
    let expected = reference_of(&spec, &settings, 2);
    let learner = Learner::start_with(LearnerConfig { spec, settings, ..config });
    let actors = crew(directory.path(), N_ACTORS);
    let report = learner.report().await;
    // How fast so many are dismissed depends on the machine.
    for actor in &actors {
        actor.abort();
    }
    assert_eq!(report.digest, expected);
    assert_eq!((report.reproducible, report.books.trained), (true, 2 * N_ACTORS as u64));
}

/// Evaluations do not move a weight, and a run without them has its last policy as its best.
#[tokio::test(flavor = "multi_thread")]
async fn policies_that_wait_for_their_evaluation_survive_a_stop_and_the_best_is_the_same() {
    let judged = |directory: &Path, judge: Judge, incarnation: u64| {
        let config = Learner::config(directory, Mode::Lag, 1, incarnation);
        Learner::start_judged(config, Some(judge))
    };
    let directory = tempfile::tempdir().unwrap();
    let learner = judged(directory.path(), Judge::Works, 1);
    let helper = actor(directory.path(), "a", 1);
    let expected = learner.report_with(helper).await;
    assert_eq!(expected.digest, reference(Mode::Lag));
    let versions: Vec<u64> = expected.held_out.iter().map(|means| means.version.0).collect();
    assert_eq!(versions, [3, 6, 9, 12]);

    let directory = tempfile::tempdir().unwrap();
    let mut learner = judged(directory.path(), Judge::Hangs, 1);
    let helper = actor(directory.path(), "a", 1);
    learner.reach(6).await;
    // All that can be made with version 6. An update that is under way then would be waited for.
    learner.queues(2 * N_ENVS).await;
    let stopped = learner.stopped_with(helper).await;
    let waits = "training waits for the evaluation";
    assert_eq!((stopped.end, stopped.n_updates), (RunEnd::Stopped, 6), "{waits}");
    assert_eq!((stopped.held_out.len(), stopped.best.version), (0, stopped.last.version));
    let learner = judged(directory.path(), Judge::Works, 2);
    let helper = actor(directory.path(), "a", 2);
    let report = learner.report_with(helper).await;
    assert_eq!((report.digest, &report.held_out), (expected.digest, &expected.held_out));
    assert_eq!(report.best.version, expected.best.version);
    assert_eq!(report.best.weights, expected.best.weights);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_is_stopped_at_its_last_evaluation_evaluates_when_it_is_resumed() {
    let directory = tempfile::tempdir().unwrap();
    let start = |judge: Judge, incarnation: u64| {
        let config = Learner::config(directory.path(), Mode::Sync, 1, incarnation);
        let total_steps = 96; // One update, with one evaluation.
        let settings = LearnerSettings { total_steps, ..config.settings };
        Learner::start_judged(LearnerConfig { settings, ..config }, Some(judge))
    };
    let mut learner = start(Judge::Hangs, 1);
    let helper = actor(directory.path(), "a", 1);
    learner.reach(1).await;
    dismissed(helper).await;
    learner.stop.cancel();
    let stopped = learner.report().await;
    assert_eq!((stopped.end, stopped.n_updates, stopped.held_out.len()), (RunEnd::Stopped, 1, 0));
    let report = start(Judge::Works, 2).report().await;
    assert_eq!((report.end, report.held_out.len()), (RunEnd::AlreadyFinished, 1));
    assert_eq!(report.best.held_out, Some(report.held_out[0]));
}

/// Which policy is the last depends on weights alone: nothing is trained after one that may be it.
#[tokio::test(flavor = "multi_thread")]
async fn a_run_ends_with_the_first_policy_that_is_good_enough_and_goes_on_if_more_is_asked() {
    for mode in [Mode::Sync, Mode::Lag] {
        let run = |directory: &Path, judge: Judge, incarnation: u64| {
            let config = Learner::config(directory, mode, 1, incarnation);
            let learner = Learner::start_judged(config, Some(judge));
            let events = Arc::clone(&learner.events);
            let helper = actor(directory, "a", incarnation);
            async move {
                let report = learner.report().await;
                (report, events, helper)
            }
        };
        let directory = tempfile::tempdir().unwrap();
        let (whole, _, helper) = run(directory.path(), Judge::Works, 1).await;
        dismissed(helper).await;
        let early = &whole.held_out[..whole.held_out.len() - 1];
        let mark = early.iter().map(HeldOutMeans::score).fold(0.0, f64::max);
        let n_evaluated = 1 + early.iter().position(|means| means.score() >= mark).unwrap();
        let last = early[n_evaluated - 1].version;

        let directory = tempfile::tempdir().unwrap();
        let (report, events, helper) = run(directory.path(), Judge::Asks(mark), 1).await;
        dismissed(helper).await;
        assert_eq!((report.end, report.n_updates), (RunEnd::Finished, last.0), "{mode:?}");
        assert_eq!(report.digest, reference_after(mode, last.0), "{mode:?}");
        assert_eq!(report.held_out, early[..n_evaluated]);
        assert_reported(
            &events,
            |event| matches!(event, RunEvent::Reached { means } if means.version == last),
        );

        let (again, _, helper) = run(directory.path(), Judge::Asks(mark), 2).await;
        assert_eq!((again.end, again.digest), (RunEnd::AlreadyFinished, report.digest));
        helper.abort();
        let (more, _, helper) = run(directory.path(), Judge::Asks(2.0), 3).await;
        dismissed(helper).await;
        assert_eq!((more.n_updates, more.digest), (N_UPDATES, reference(mode)), "{mode:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_evaluation_that_fails_is_told_and_ends_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let config = Learner::config(directory.path(), Mode::Sync, 1, 1);
    let learner = Learner::start_judged(config, Some(Judge::Fails));
    let events = Arc::clone(&learner.events);
    let helper = actor(directory.path(), "a", 1);
    let report = learner.report_with(helper).await;
    assert_eq!((report.end, report.digest), (RunEnd::Finished, reference(Mode::Sync)));
    assert_eq!((report.held_out.len(), report.best.version), (0, report.last.version));
    let failed = |event: &RunEvent| matches!(event, RunEvent::EvaluationFailed { reason, .. } if reason == "the world is broken");
    assert_reported(&events, failed);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_comes_back_goes_on_to_the_same_weights() {
    for mode in [Mode::Sync, Mode::Lag] {
        let directory = tempfile::tempdir().unwrap();
        let mut learner = Learner::start(directory.path(), mode, 1, 1);
        learner.hold_at(5);
        let first = actor(directory.path(), "first", 1);
        learner.reach(5).await;
        let stopped = learner.stopped_with(first).await;
        assert_eq!((stopped.end, stopped.n_updates), (RunEnd::Stopped, 5));
        let resumed = Learner::start(directory.path(), mode, 1, 2);
        let second = actor(directory.path(), "second", 1);
        let report = resumed.report_with(second).await;
        assert_eq!(report.digest, reference(mode), "{mode:?}");
        assert_eq!(report.books.trained, N_UPDATES * N_ENVS as u64);
        let again = Learner::start(directory.path(), mode, 1, 3).report().await;
        assert_eq!((again.end, again.digest), (RunEnd::AlreadyFinished, report.digest));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_diverges_keeps_its_last_good_update_and_goes_on_with_smaller_steps() {
    let directory = tempfile::tempdir().unwrap();
    // No checkpoint is due before the end. With such steps not many updates are good, but the first one is.
    let config = |start| Learner::config(directory.path(), Mode::Sync, 1, start);
    let large = LearnerSettings { learning_rate: 5e5, ..settings(Mode::Sync) };
    let (n_good, good, rest) = diverging_reference(large.clone());
    assert!(n_good > 0);
    let interval = CheckpointInterval { updates: 1_000, ..config(1).checkpoint_interval };
    let learner = Learner::start_with(LearnerConfig {
        settings: large,
        checkpoint_interval: interval,
        ..config(1)
    });
    let (n_updates, events) = (learner.n_updates.clone(), Arc::clone(&learner.events));
    let helper = actor(directory.path(), "a", 1);
    let joined = tokio::time::timeout(PATIENCE, learner.task).await.expect("in time");
    let error = joined.unwrap().unwrap_err();
    assert!(error.is_divergence(), "{error:?}");
    dismissed(helper).await;
    assert_eq!(*n_updates.borrow(), n_good);
    let saved = format!("{n_good:012}.checkpoint");
    assert_reported(
        &events,
        |event| matches!(event, RunEvent::CheckpointWritten { path, .. } if path.ends_with(&saved)),
    );
    // A run that was to end there tells what was saved.
    let usual = settings(Mode::Sync);
    let total_steps = n_good * usual.total_steps / N_UPDATES;
    let short = LearnerConfig { settings: LearnerSettings { total_steps, ..usual }, ..config(2) };
    let report = Learner::start_with(short).report().await;
    assert_eq!((report.end, report.digest), (RunEnd::AlreadyFinished, good));
    let learner = Learner::start_with(config(3));
    let events = Arc::clone(&learner.events);
    let helper = actor(directory.path(), "a", 2);
    let joined = tokio::time::timeout(PATIENCE, learner.task).await.expect("in time");
    dismissed(helper).await;
    // Whether weights that are nearly ruined can learn again is up to the processor's arithmetic, with a network and without.
    match (rest, joined.unwrap()) {
        (Ok(digest), Ok(report)) => {
            assert_eq!((report.end, report.digest), (RunEnd::Finished, digest));
        }
        (Err(_), Err(error)) => assert!(error.is_divergence(), "{error:?}"),
        (plain, run) => panic!("{plain:?} without a network, {run:?} with one"),
    }
    assert_reported(
        &events,
        |event| matches!(event, RunEvent::Resumed { n_updates, .. } if *n_updates == n_good),
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_comes_back_from_an_older_checkpoint_rolls_its_books_back() {
    let directory = tempfile::tempdir().unwrap();
    let mut learner = Learner::start(directory.path(), Mode::Lag, 1, 1);
    learner.hold_at(7);
    let first = actor(directory.path(), "a", 1);
    learner.reach(7).await;
    let stopped = learner.stopped_with(first).await;
    let files = std::fs::read_dir(directory.path().join("checkpoints")).unwrap();
    let files = files.map(|entry| entry.unwrap().path());
    let newest = files.filter(|file| file.extension().is_some_and(|e| e == "checkpoint")).max();
    std::fs::write(newest.unwrap(), b"torn").unwrap();
    let resumed = Learner::start(directory.path(), Mode::Lag, 1, 2);
    let events = Arc::clone(&resumed.events);
    let second = actor(directory.path(), "a", 2);
    let report = resumed.report_with(second).await;
    assert_eq!(report.digest, reference(Mode::Lag));
    assert_eq!((stopped.end, stopped.n_updates), (RunEnd::Stopped, 7));
    assert_reported(&events, |event| matches!(event, RunEvent::CheckpointDamaged { .. }));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_outlives_its_learner_and_goes_on_with_the_next() {
    for mode in [Mode::Sync, Mode::Lag] {
        let directory = tempfile::tempdir().unwrap();
        let config = Learner::config(directory.path(), mode, 1, 1);
        let seldom = CheckpointInterval { updates: 4, ..config.checkpoint_interval };
        let config = LearnerConfig { checkpoint_interval: seldom, ..config };
        let mut killed = Learner::start_with(config);
        killed.hold_at(5);
        let survivor = actor(directory.path(), "survivor", 1);
        killed.reach(5).await;
        killed.task.abort();
        killed.let_go();
        assert!(killed.task.await.unwrap_err().is_cancelled());
        // It may have gone on until the abort took effect.
        let n_lost = *killed.n_updates.borrow() % 4;
        let resumed = Learner::start_again(directory.path(), mode, 2).await;
        let report = resumed.report().await;
        assert_eq!(report.digest, reference(mode), "{mode:?}");
        assert_eq!(report.books.trained, N_UPDATES * N_ENVS as u64);
        // Lost with the learner, or made before it and sent again because nobody had acknowledged it.
        let n_made_again = report.books.rolled_back + report.books.superseded;
        assert!(n_made_again >= n_lost * N_ENVS as u64, "{:?}", report.books);
        let own = dismissed(survivor).await;
        assert!(own.n_reconnects > 0);
        assert_eq!(report.books.published, own.sent.0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn async_takes_what_comes_and_accounts_for_all_of_it() {
    let report = undisturbed(Mode::Async, 2).await;
    assert!(!report.reproducible);
    assert_eq!(report.books.trained, N_UPDATES * N_ENVS as u64);
    assert_eq!(report.staleness.values().sum::<u64>(), report.books.trained);
}

fn pretended() -> StartKey {
    StartKey::numbered(2_000)
}

/// The assignment that an actor follows after this order.
fn epoch(control: &Control) -> Epoch {
    if let Control::Assign(assignment) = control { assignment.epoch } else { Epoch(0) }
}

/// An actor that takes part in everything but the work.
async fn pretender(directory: &Path, name: &str) -> (ActorLink, leadtime_link::Events<ActorEvent>) {
    let (actor, start) = (ActorId::new(name).unwrap(), pretended());
    let settings = ConnectSettings::new(vec![endpoint(directory)]);
    let (link, events) = ActorLink::open(&settings, &actor, &start).await.unwrap();
    let hello = fakes::hello(actor, start.incarnation());
    link.hello(None, &hello, PATIENCE).await.unwrap();
    (link, events)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_member_that_delivers_nothing_loses_its_environments_and_changes_no_bit() {
    let directory = tempfile::tempdir().unwrap();
    let learner = Learner::start(directory.path(), Mode::Lag, 2, 1);
    let events = Arc::clone(&learner.events);
    let (_link, inbox) = pretender(directory.path(), "mute").await;
    let follower = tokio::spawn(async move {
        while let Some(event) = inbox.recv().await {
            if let ActorEvent::Control { control, reply, .. } = event {
                reply.reply(&ControlReply::Followed { epoch: epoch(&control) }).unwrap();
            }
        }
    });
    let honest = actor(directory.path(), "honest", 1);
    let report = learner.report_with(honest).await;
    assert_eq!(report.digest, reference(Mode::Lag));
    assert!(report.reproducible);
    follower.abort();
    assert_reported(&events, |event| {
        matches!(event, RunEvent::WaitingForRollouts { actor, n_envs, .. }
            if actor.as_str() == "mute" && *n_envs > 0)
    });
}

/// Sends one rollout of every environment that it is given, sound but for the state at the end, and leaves.
async fn poison(link: ActorLink, inbox: leadtime_link::Events<ActorEvent>) {
    let spec = run_spec(Mode::Sync);
    let trainer = Trainer::new(&spec.policy, &settings(Mode::Sync), spec.seed).unwrap();
    let mut policy = Policy::new(&spec.policy, trainer.parameters()).unwrap();
    let mut n_sent = None;
    while let Some(event) = inbox.recv().await {
        match event {
            ActorEvent::Control { control, reply, .. } => {
                let epoch = epoch(&control);
                reply.reply(&ControlReply::Followed { epoch }).unwrap();
                let Control::Assign(assignment) = control else { continue };
                let mut worker = Worker::new(spec.clone());
                for given in &assignment.envs {
                    let env = leadtime_worlds::builtin().build(&spec.task).unwrap();
                    worker.insert(env, given).unwrap();
                }
                let rollouts = worker.collect(&mut policy, PolicyVersion(0), &mut ());
                for (rollout, number) in rollouts.iter().zip(1..) {
                    let rollout = Rollout { snapshot: vec![1], ..rollout.clone() };
                    let payload = codec::encode(&rollout).unwrap();
                    let plain = Header::plain(Schema::Rollout, pretended().incarnation(), &payload);
                    let header = Header { sequence: Sequence(number), epoch, ..plain };
                    link.publish_rollout(&header, payload.into()).unwrap();
                    n_sent = Some(Sequence(number));
                }
            }
            ActorEvent::Credit(credit) if Some(credit.acknowledged) == n_sent => break,
            _ => {}
        }
    }
    link.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_state_that_nobody_can_restore_ends_neither_an_actor_nor_the_run() {
    let directory = tempfile::tempdir().unwrap();
    let learner = Learner::start(directory.path(), Mode::Sync, 2, 1);
    let events = Arc::clone(&learner.events);
    let (link, inbox) = pretender(directory.path(), "rogue").await;
    let honest = actor(directory.path(), "honest", 1);
    tokio::time::timeout(PATIENCE, poison(link, inbox)).await.expect("in time");
    let report = learner.report_with(honest).await;
    assert_eq!((report.end, report.n_updates), (RunEnd::Finished, N_UPDATES));
    // On the word of one actor it is not cut off.
    assert_reported(
        &events,
        |event| matches!(event, RunEvent::Distrusted { actor, reason } if actor.as_str() == "rogue" && reason.contains("cannot restore")),
    );
    let events = events.lock().unwrap();
    assert!(!events.iter().any(|event| matches!(event, RunEvent::CutOff { .. })), "{events:?}");
}

/// Obeys the next order in words alone, and returns it.
async fn next_order(inbox: &leadtime_link::Events<ActorEvent>) -> Control {
    loop {
        if let ActorEvent::Control { control, reply, .. } = inbox.recv().await.unwrap() {
            reply.reply(&ControlReply::Followed { epoch: epoch(&control) }).unwrap();
            return control;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_whose_end_cannot_be_saved_waits_for_its_actors_once() {
    let directory = tempfile::tempdir().unwrap();
    let mut learner = Learner::start(directory.path(), Mode::Sync, 2, 1);
    let (_link, inbox) = pretender(directory.path(), "stays").await;
    assert!(matches!(next_order(&inbox).await, Control::Wait), "it is a member");
    // The run's directory was removed, and another learner has begun there.
    let checkpoints = directory.path().join("checkpoints");
    std::fs::remove_dir_all(&checkpoints).unwrap();
    let _other = CheckpointStore::open(&checkpoints, RETENTION).unwrap();
    learner.stop.cancel();
    let mut n_dismissed = 0;
    let ended = async {
        loop {
            tokio::select! {
                joined = &mut learner.task => break joined,
                order = next_order(&inbox) => {
                    n_dismissed += usize::from(matches!(order, Control::Stop { .. }));
                }
            }
        }
    };
    let joined = tokio::time::timeout(PATIENCE, ended).await.expect("in time");
    let error = joined.unwrap().unwrap_err();
    let is_it = matches!(error, leadtime_learner::Error::Checkpoint(CheckpointError::InUse(_)));
    assert!(is_it, "{error}");
    assert_eq!(n_dismissed, 1, "who stays after that is not waited for again");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_changed_configuration_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let mut learner = Learner::start(directory.path(), Mode::Sync, 1, 1);
    learner.hold_at(1);
    let only = actor(directory.path(), "a", 1);
    learner.reach(1).await;
    learner.stopped_with(only).await;
    let changed = Learner::start(directory.path(), Mode::Lag, 1, 2);
    let error = changed.task.await.unwrap().unwrap_err();
    assert!(matches!(error, leadtime_learner::Error::ConfigurationChanged { .. }), "{error}");
}
