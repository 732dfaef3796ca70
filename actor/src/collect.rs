//! What the collecting and the restoring thread do: build environments, step them, encode the rollouts.
//!
//! Environments are restored beside the collecting thread, not by it: an order is answered with what could not be
//! restored, and a rollout may take longer than an order may wait for its answer.

use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_episodes::EnvSlot;
use leadtime_policy::{Parameters, Policy};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Assignment, EnvAssignment};
use leadtime_proto::{
    EnvId, Epoch, Header, Incarnation, Iteration, PolicyVersion, Rollout, RowOverlap, RunSpec,
    codec,
};
use leadtime_sims::{Environment, Registry, SnapshotError};
use tracing::debug;

use crate::Error;
use crate::outbox::EncodedRollout;
use crate::worker::{Phase, Stopwatch, Worker, ready_slot};

/// Builds a run's environments.
#[derive(Clone, Debug)]
pub(crate) struct EnvBuilder {
    registry: Registry,
    spec: Arc<RunSpec>,
    /// Which numbers of an observation repeat the previous observation.
    overlap: RowOverlap,
}

/// Environments that can be stepped.
#[derive(Debug, Default)]
pub(crate) struct RestoredEnvs {
    restored: Vec<(Iteration, EnvSlot)>,
    /// Those that start from the beginning. Building them cannot fail, and the collecting thread does it.
    fresh: Vec<EnvAssignment>,
}

impl EnvBuilder {
    /// Builds one environment and checks that its specification is the learner's.
    pub(crate) fn new(registry: Registry, spec: &RunSpec) -> Result<Self, Error> {
        let overlap = RowOverlap::default();
        let mut builder = Self { registry, spec: Arc::new(spec.clone()), overlap };
        let layout = builder.build()?.describe().observation;
        let frame = layout.frame.len();
        builder.overlap = RowOverlap::new(frame, frame * layout.n_frames.saturating_sub(1));
        Ok(builder)
    }

    fn build(&self) -> Result<Box<dyn Environment>, Error> {
        let env = self.registry.build(&self.spec.task)?;
        if *env.spec() == self.spec.env {
            Ok(env)
        } else {
            Err(Error::SpecMismatch(self.spec.task.domain.clone()))
        }
    }

    /// Makes an assignment's environments ready, and names those that cannot be.
    pub(crate) fn restore(
        &self,
        assignment: Assignment,
    ) -> Result<(RestoredEnvs, Vec<EnvId>), Error> {
        let (mut envs, mut failed) = (RestoredEnvs::default(), Vec::new());
        for given in assignment.envs {
            if given.snapshot.is_empty() {
                envs.fresh.push(given);
                continue;
            }
            match ready_slot(&self.spec, self.build()?, &given) {
                Ok(slot) => envs.restored.push((given.iteration, slot)),
                Err(SnapshotError::Outside(reason)) => return Err(Error::Outside { reason }),
                Err(error) => {
                    debug!(env_id = %given.env_id, %error, "snapshot not restored");
                    failed.push(given.env_id);
                }
            }
        }
        failed.sort_unstable();
        Ok((envs, failed))
    }
}

/// What the collecting thread is asked to do.
#[derive(Debug)]
pub(crate) enum CollectJob {
    /// Step these environments from now on.
    Adopt { epoch: Epoch, keep: Vec<EnvId>, envs: RestoredEnvs },
    /// Collect the lowest iteration.
    Collect { version: PolicyVersion, weights: Arc<Parameters> },
}

/// Where the collecting thread's time went.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CollectTimes {
    pub(crate) infer: Duration,
    pub(crate) simulate: Duration,
    pub(crate) encode: Duration,
    pub(crate) adopt: Duration,
    pub(crate) wait: Duration,
}

/// What came of a job.
#[derive(Debug)]
pub(crate) struct Collected {
    pub(crate) rollouts: Vec<EncodedRollout>,
    /// The iteration to be collected next.
    pub(crate) next: Option<Iteration>,
    /// The iteration and the behaviour version of what was made; `None` if environments were adopted.
    pub(crate) made: Option<(Iteration, PolicyVersion)>,
    /// When the job began.
    pub(crate) started: Instant,
    pub(crate) times: CollectTimes,
}

#[derive(Debug)]
struct PhaseTimer {
    last: Instant,
    times: CollectTimes,
}

impl PhaseTimer {
    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        now - std::mem::replace(&mut self.last, now)
    }
}

impl Stopwatch for PhaseTimer {
    fn lap(&mut self, phase: Phase) {
        let took = self.lap();
        match phase {
            Phase::Infer => self.times.infer += took,
            Phase::Simulate => self.times.simulate += took,
        }
    }
}

/// What the collecting thread works with.
#[derive(Debug)]
pub(crate) struct CollectWorker {
    worker: Worker,
    builder: EnvBuilder,
    incarnation: Incarnation,
    epoch: Epoch,
    policy: Option<(Arc<Parameters>, Policy)>,
    timer: PhaseTimer,
}

impl CollectWorker {
    pub(crate) fn new(builder: EnvBuilder, incarnation: Incarnation) -> Self {
        Self {
            worker: Worker::new(RunSpec::clone(&builder.spec)),
            builder,
            incarnation,
            epoch: Epoch(0),
            policy: None,
            timer: PhaseTimer { last: Instant::now(), times: CollectTimes::default() },
        }
    }

    pub(crate) fn work(&mut self, job: CollectJob) -> Result<Collected, Error> {
        self.timer.times = CollectTimes { wait: self.timer.lap(), ..CollectTimes::default() };
        let (started, iteration) = (self.timer.last, self.worker.next_iteration());
        let (made, rollouts) = match job {
            CollectJob::Adopt { epoch, keep, envs } => {
                self.adopt(epoch, &keep, envs)?;
                self.timer.times.adopt = self.timer.lap();
                (None, Vec::new())
            }
            CollectJob::Collect { version, weights } => {
                let rollouts = self.collect(version, &weights)?;
                (iteration.map(|iteration| (iteration, version)), rollouts)
            }
        };
        if let Some((_, reason)) = self.worker.failure() {
            return Err(Error::Outside { reason });
        }
        let next = self.worker.next_iteration();
        Ok(Collected { rollouts, next, made, started, times: self.timer.times })
    }

    fn adopt(&mut self, epoch: Epoch, keep: &[EnvId], envs: RestoredEnvs) -> Result<(), Error> {
        self.epoch = epoch;
        self.worker.retain(keep);
        for (iteration, slot) in envs.restored {
            self.worker.adopt(iteration, slot);
        }
        for given in envs.fresh {
            let inserted = self.worker.insert(self.builder.build()?, &given);
            inserted.map_err(|source| Error::Snapshot { env_id: given.env_id, source })?;
        }
        Ok(())
    }

    fn collect(
        &mut self,
        version: PolicyVersion,
        weights: &Arc<Parameters>,
    ) -> Result<Vec<EncodedRollout>, Error> {
        let packed = self.policy.take().filter(|(packed, _)| Arc::ptr_eq(packed, weights));
        let packed = match packed {
            Some(packed) => packed,
            None => (Arc::clone(weights), Policy::new(&self.builder.spec.policy, weights)?),
        };
        let (_, policy) = self.policy.insert(packed);
        let rollouts = self.worker.collect(policy, version, &mut self.timer);
        let (overlap, obs_dim) = (self.builder.overlap, self.builder.spec.env.obs_dim);
        // Here, and not where it is published: what may have to be sent again is kept as it was encoded.
        let encode = |rollout: &mut Rollout| -> Result<EncodedRollout, Error> {
            rollout.leave_out_repeats(overlap, obs_dim);
            let payload = codec::encode(rollout)?;
            let plain = Header::plain(Schema::Rollout, self.incarnation, &payload);
            let header = Header { epoch: self.epoch, version, ..plain };
            Ok(EncodedRollout { header, payload: payload.into() })
        };
        let encoded = rollouts.iter_mut().map(encode).collect();
        self.timer.times.encode = self.timer.lap();
        encoded
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{PolicySpec, Schedule, TaskSpec};

    use super::*;

    #[test]
    fn a_snapshot_that_cannot_be_restored_costs_only_its_own_environment() {
        let tasks = leadtime_sims::classic::entries().into_iter();
        let registry = tasks.fold(Registry::default(), Registry::with_domain);
        let settings = r#"{"world": {"max_steps": 30}}"#.to_owned();
        let task = TaskSpec { domain: "cartpole".to_owned(), settings };
        let env = registry.build(&task).unwrap().spec().clone();
        let policy = PolicySpec::dense(&env, &[8]);
        let schedule = Schedule::Lag(0);
        let spec = RunSpec { seed: 1, task, policy, env, n_steps: 8, schedule };
        let weights = Arc::new(Parameters::initialize(&spec.policy, 1).unwrap());
        let builder = EnvBuilder::new(registry, &spec).unwrap();
        let mut worker = CollectWorker::new(builder.clone(), Incarnation(1));
        let given = |id: u32, iteration, snapshot: &[u8]| EnvAssignment {
            env_id: EnvId(id),
            iteration: Iteration(iteration),
            snapshot: snapshot.to_vec(),
        };
        let mut follow = |epoch, envs| {
            let assignment = Assignment { epoch: Epoch(epoch), envs, keep: Vec::new() };
            let (envs, failed) = builder.restore(assignment).unwrap();
            let adopt = CollectJob::Adopt { epoch: Epoch(epoch), keep: Vec::new(), envs };
            worker.work(adopt).unwrap();
            let (version, weights) = (PolicyVersion(0), Arc::clone(&weights));
            let made = worker.work(CollectJob::Collect { version, weights }).unwrap().rollouts;
            let made = made.iter().map(|one| codec::decode(&one.payload, usize::MAX).unwrap());
            (made.collect::<Vec<Rollout>>(), failed)
        };
        let (made, failed) = follow(1, vec![given(0, 0, &[])]);
        assert_eq!((made.len(), failed), (1, Vec::new()));
        let whole = &made[0].snapshot;
        let mut longer = whole.clone();
        longer.push(0);
        let envs = [&[1][..], whole, &whole[1..], &longer, &[]];
        let envs = (0..).zip(envs).map(|(id, snapshot)| given(id, 1, snapshot)).collect();
        let (made, failed) = follow(2, envs);
        let stepped: Vec<u32> = made.iter().map(|rollout| rollout.env_id.0).collect();
        assert_eq!((stepped, failed), (vec![1, 4], [0, 2, 3].map(EnvId).to_vec()));
    }
}
