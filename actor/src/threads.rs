//! The two threads beside the actor's loop: one steps environments, one waits for the network.
//!
//! The loop gives each at most a known number of jobs, so handing one over never waits. A thread ends when its
//! end of the loop is dropped.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use leadtime_link::ActorLink;
use leadtime_policy::{Parameters, Policy};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Assignment, Welcome};
use leadtime_proto::{
    EnvSpec, Epoch, Header, Incarnation, Iteration, PolicyVersion, Rollout, TaskSpec, codec,
};
use leadtime_sims::{Environment, Registry};
use tokio::sync::mpsc;

use crate::Error;
use crate::outbox::Parcel;
use crate::worker::{Phase, Stopwatch, Worker, WorkerSettings};

/// The collecting thread's name.
const COLLECT: &str = "actor-collect";
/// The publishing thread's name.
const PUBLISH: &str = "actor-publish";
/// Rollouts that may be with the publishing thread.
pub(crate) const PUBLISHING: usize = 4;

/// Where the collecting thread's time went.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Times {
    pub(crate) infer: Duration,
    pub(crate) simulate: Duration,
    pub(crate) encode: Duration,
    pub(crate) wait: Duration,
}

/// What the collecting thread is asked to do.
#[derive(Debug)]
pub(crate) enum Job {
    /// Step these environments from now on.
    Assign(Assignment),
    /// Collect the lowest iteration.
    Collect { version: PolicyVersion, parameters: Arc<Parameters> },
}

/// What came of it.
#[derive(Debug)]
pub(crate) struct Collected {
    pub(crate) parcels: Vec<Parcel>,
    /// The iteration to be collected next.
    pub(crate) next: Option<Iteration>,
    pub(crate) times: Times,
}

/// The loop's end of the collecting thread.
#[derive(Debug)]
pub(crate) struct Collector {
    jobs: SyncSender<Job>,
    results: mpsc::Receiver<Result<Collected, Error>>,
}

impl Collector {
    /// Builds one environment to see that it is the one the learner means, and starts the thread.
    pub(crate) fn start(
        registry: Registry,
        welcome: &Welcome,
        incarnation: Incarnation,
    ) -> Result<Self, Error> {
        let task = welcome.task.clone();
        build(&registry, &task, &welcome.env)?;
        let settings = WorkerSettings {
            run_seed: welcome.run_seed,
            n_steps: welcome.n_steps,
            env: welcome.env.clone(),
            policy: welcome.policy.clone(),
        };
        let studio = Studio {
            worker: Worker::new(settings.clone()),
            settings,
            registry,
            task,
            incarnation,
            epoch: Epoch(0),
            policy: None,
            watch: Laps { last: Instant::now(), times: Times::default() },
        };
        let (jobs, inbox) = sync_channel(1);
        let (outbox, results) = mpsc::channel(1);
        spawn(COLLECT, move || collect(studio, &inbox, &outbox))?;
        Ok(Self { jobs, results })
    }

    /// Hands a job over; there must be no other under way.
    pub(crate) fn begin(&self, job: Job) -> Result<(), Error> {
        self.jobs.try_send(job).map_err(|_gone| Error::ThreadGone { name: COLLECT })
    }

    /// Waits for the result of the job under way.
    pub(crate) async fn result(&mut self) -> Result<Collected, Error> {
        self.results.recv().await.unwrap_or(Err(Error::ThreadGone { name: COLLECT }))
    }
}

fn build(
    registry: &Registry,
    task: &TaskSpec,
    expected: &EnvSpec,
) -> Result<Box<dyn Environment>, Error> {
    let env = registry.build(task)?;
    if env.spec() == expected {
        Ok(env)
    } else {
        Err(Error::SpecMismatch { domain: task.domain.clone() })
    }
}

/// What the collecting thread works with.
struct Studio {
    worker: Worker,
    settings: WorkerSettings,
    registry: Registry,
    task: TaskSpec,
    incarnation: Incarnation,
    epoch: Epoch,
    policy: Option<(Arc<Parameters>, Policy)>,
    watch: Laps,
}

struct Laps {
    last: Instant,
    times: Times,
}

impl Laps {
    fn lap(&mut self) -> Duration {
        std::mem::replace(&mut self.last, Instant::now()).elapsed()
    }
}

impl Stopwatch for Laps {
    fn lap(&mut self, phase: Phase) {
        let took = self.lap();
        match phase {
            Phase::Infer => self.times.infer += took,
            Phase::Simulate => self.times.simulate += took,
        }
    }
}

fn collect(
    mut studio: Studio,
    inbox: &Receiver<Job>,
    outbox: &mpsc::Sender<Result<Collected, Error>>,
) {
    while let Ok(job) = inbox.recv() {
        studio.watch.times = Times { wait: studio.watch.lap(), ..Times::default() };
        if outbox.blocking_send(studio.work(job)).is_err() {
            return; // The actor is leaving and nobody waits for the result.
        }
    }
}

impl Studio {
    fn work(&mut self, job: Job) -> Result<Collected, Error> {
        let parcels = match job {
            Job::Assign(assignment) => {
                self.assign(&assignment)?;
                Vec::new()
            }
            Job::Collect { version, parameters } => self.collect(version, &parameters)?,
        };
        let next = self.worker.next_iteration();
        Ok(Collected { parcels, next, times: self.watch.times })
    }

    fn assign(&mut self, assignment: &Assignment) -> Result<(), Error> {
        self.epoch = assignment.epoch;
        self.worker.retain(&assignment.keep);
        for given in &assignment.envs {
            let env = build(&self.registry, &self.task, &self.settings.env)?;
            let env_id = given.env_id;
            let inserted = self.worker.insert(env, given);
            inserted.map_err(|source| Error::Snapshot { env_id, source })?;
        }
        Ok(())
    }

    fn collect(
        &mut self,
        version: PolicyVersion,
        parameters: &Arc<Parameters>,
    ) -> Result<Vec<Parcel>, Error> {
        let packed = self.policy.take().filter(|(packed, _)| Arc::ptr_eq(packed, parameters));
        let packed = match packed {
            Some(packed) => packed,
            None => (Arc::clone(parameters), Policy::new(&self.settings.policy, parameters)?),
        };
        let (_, policy) = self.policy.insert(packed);
        let (epoch, incarnation) = (self.epoch, self.incarnation);
        let rollouts = self.worker.collect(policy, version, &mut self.watch);
        let parcels: Result<Vec<Parcel>, Error> =
            rollouts.iter().map(|rollout| pack(rollout, epoch, incarnation)).collect();
        self.watch.times.encode = self.watch.lap();
        parcels
    }
}

fn pack(rollout: &Rollout, epoch: Epoch, incarnation: Incarnation) -> Result<Parcel, Error> {
    let payload = codec::encode(rollout)?;
    let header = Header {
        epoch,
        version: rollout.version,
        ..Header::plain(Schema::Rollout, incarnation, &payload)
    };
    Ok(Parcel { header, payload })
}

/// The loop's end of the publishing thread.
#[derive(Debug)]
pub(crate) struct Publisher {
    parcels: SyncSender<Parcel>,
    results: mpsc::Receiver<Result<Duration, Error>>,
}

impl Publisher {
    /// Starts the thread.
    pub(crate) fn start(link: Arc<ActorLink>) -> Result<Self, Error> {
        let (parcels, inbox) = sync_channel::<Parcel>(PUBLISHING);
        let (outbox, results) = mpsc::channel(PUBLISHING);
        spawn(PUBLISH, move || {
            while let Ok(parcel) = inbox.recv() {
                let started = Instant::now();
                let result = link.publish_rollout(&parcel.header, parcel.payload);
                let result = result.map(|()| started.elapsed()).map_err(Error::from);
                if outbox.blocking_send(result).is_err() {
                    return; // The actor is leaving.
                }
            }
        })?;
        Ok(Self { parcels, results })
    }

    /// Hands a rollout over; there must be fewer than [`PUBLISHING`] under way.
    pub(crate) fn begin(&self, parcel: Parcel) -> Result<(), Error> {
        self.parcels.try_send(parcel).map_err(|_gone| Error::ThreadGone { name: PUBLISH })
    }

    /// Waits until a rollout is with the network and tells how long that took.
    pub(crate) async fn result(&mut self) -> Result<Duration, Error> {
        self.results.recv().await.unwrap_or(Err(Error::ThreadGone { name: PUBLISH }))
    }
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), Error> {
    thread::Builder::new().name(name.to_owned()).spawn(work).map(drop).map_err(Error::Thread)
}
