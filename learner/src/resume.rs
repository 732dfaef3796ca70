//! What a checkpoint holds, and how a run begins: from its first update, or from a checkpoint.

use std::collections::BTreeMap;
use std::sync::Arc;

use leadtime_policy::Parameters;
use leadtime_ppo::{Trainer, TrainerState};
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{Epoch, PolicyVersion};
use serde::{Deserialize, Serialize};

use crate::books::Books;
use crate::builds::Builds;
use crate::checkpoint::{CheckpointStore, Loaded};
use crate::coordinator::{Coordinator, CoordinatorStart};
use crate::episodes::EpisodeWindow;
use crate::held_out_record::HeldOutRecord;
use crate::report::{RatedPolicy, RunEvent};
use crate::rollout_queue::RolloutQueue;
use crate::training::encode;
use crate::{Error, LearnerConfig};

/// How far a run has come, apart from its weights and books.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct TrainingRecord {
    pub(crate) held_out: HeldOutRecord,
    pub(crate) episodes: EpisodeWindow,
    /// How many rollouts each staleness had.
    pub(crate) staleness: BTreeMap<u64, u64>,
}

/// Everything a run needs to go on bit for bit.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Checkpoint {
    pub(crate) identity: [u8; 32],
    pub(crate) trainer: TrainerState,
    pub(crate) places: Vec<EnvAssignment>,
    pub(crate) epoch: Epoch,
    /// Versions that the schedule still acts with, besides the trainer's own.
    pub(crate) older: Vec<RatedPolicy>,
    pub(crate) record: TrainingRecord,
    pub(crate) books: Books,
    /// Rollouts accepted and not trained on.
    pub(crate) waiting: u64,
    pub(crate) builds: Builds,
}

impl Checkpoint {
    /// Takes a trainer's state after the last finished update, with how far the rest of the run is.
    pub(crate) fn of(
        coordinator: &Coordinator,
        mut trainer: TrainerState,
        identity: [u8; 32],
        older: Vec<RatedPolicy>,
        record: TrainingRecord,
    ) -> Self {
        // What was dropped since is told to the update under way, which is made again after a resume.
        for &env_id in coordinator.passed_over() {
            trainer.forget_episode(env_id);
        }
        Self {
            identity,
            trainer,
            places: coordinator.places(),
            epoch: coordinator.epoch(),
            older,
            record,
            books: coordinator.books().clone(),
            waiting: coordinator.n_pending(),
            builds: coordinator.builds().clone(),
        }
    }
}

/// Where a run begins: its first update, or the one after its newest checkpoint.
#[derive(Debug)]
pub(crate) struct ResumePoint {
    pub(crate) trainer: Trainer,
    pub(crate) start: CoordinatorStart,
    pub(crate) offered: BTreeMap<PolicyVersion, Arc<[u8]>>,
    pub(crate) record: TrainingRecord,
    /// What the sink is to hear first.
    pub(crate) events: Vec<RunEvent>,
}

/// Begins a run: from its newest whole checkpoint, or from the beginning if there never was one.
///
/// # Errors
///
/// [`Error::ConfigurationChanged`], or if the store, the trainer or the weights of a fork cannot be used.
pub(crate) fn begin(
    config: &LearnerConfig,
    store: &mut CheckpointStore,
) -> Result<ResumePoint, Error> {
    let (spec, settings) = (&config.spec, &config.settings);
    let trainer = match &config.initial {
        None => Trainer::new(&spec.policy, settings, spec.seed)?,
        Some(weights) => {
            let parameters = Parameters::from_safetensors(weights, &spec.policy)?;
            Trainer::from_parameters(&spec.policy, settings, spec.seed, parameters)?
        }
    };
    let mut point = ResumePoint {
        start: CoordinatorStart {
            places: RolloutQueue::beginning(settings.n_envs),
            version: trainer.version(),
            ..CoordinatorStart::default()
        },
        offered: BTreeMap::new(),
        trainer,
        record: TrainingRecord::default(),
        events: Vec::new(),
    };
    if let Some(loaded) = store.newest()? {
        point.resume(config, loaded)?;
    }
    point.offered.insert(point.start.version, encode(&point.trainer)?);
    if point.start.version.0 >= settings.n_updates() {
        return Ok(point); // Nothing is left for this build to compute.
    }
    if point.start.builds.note(&config.build) {
        point.events.push(RunEvent::OtherBuild { actor: None, build: config.build.clone() });
    }
    Ok(point)
}

impl ResumePoint {
    /// Continues from a checkpoint.
    fn resume(&mut self, config: &LearnerConfig, loaded: Loaded<Checkpoint>) -> Result<(), Error> {
        let Loaded { state, path, damaged } = loaded;
        let is_known =
            state.identity == config.identity || config.earlier.contains(&state.identity);
        if !is_known {
            return Err(Error::ConfigurationChanged(path));
        }
        self.trainer.restore(state.trainer)?;
        let version = self.trainer.version();
        let (epoch, places, mut books) = (state.epoch, state.places, state.books);
        if version.0 < config.settings.n_updates() {
            books.resume(state.waiting, config.settings.n_steps as u64);
        } else {
            // The checkpoint of the last update is older than the end if the run was killed in between.
            books.unused_at_end = state.waiting;
        }
        self.start = CoordinatorStart { places, epoch, version, books, builds: state.builds };
        let older = state.older.into_iter();
        self.offered = older.map(|policy| (policy.version, policy.weights)).collect();
        self.record = state.record;
        let resumed = RunEvent::Resumed {
            path,
            n_updates: version.0,
            n_steps: version.0 * config.steps_per_update(),
            n_episodes: self.record.episodes.means().n_finished,
            books: self.start.books.clone(),
        };
        let damaged = damaged.into_iter();
        self.events = damaged
            .map(|(path, damage)| RunEvent::CheckpointDamaged { path, damage })
            .chain([resumed])
            .collect();
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::path::PathBuf;
    use std::time::Duration;

    use leadtime_link::{ListenSettings, StartKey};
    use leadtime_ppo::checkpoints::{CheckpointInterval, Retention};
    use leadtime_ppo::{LearnerSettings, Mode};
    use leadtime_proto::{
        ActorId, CheckedRollout, EnvId, Incarnation, Iteration, Rollout, RunName, Sequence, fakes,
    };

    use super::*;
    use crate::Build;

    /// A run of one update with a lag.
    pub(crate) fn config() -> LearnerConfig {
        let settings = LearnerSettings {
            n_envs: 2,
            n_steps: 1,
            n_minibatches: 1,
            total_steps: 2,
            mode: Mode::Lag,
            ..LearnerSettings::default()
        };
        LearnerConfig {
            run: RunName::new("test").unwrap(),
            start: StartKey::draw().unwrap(),
            spec: fakes::run_spec("test", 1, settings.schedule()),
            settings,
            window: 4,
            actors_min: 1,
            listen: ListenSettings::new(Vec::new()),
            build: Build { program: "test".to_owned(), cpu: "cpu".to_owned() },
            checkpoints: PathBuf::new(),
            checkpoint_interval: CheckpointInterval { updates: 1, time: Duration::from_mins(1) },
            retention: Retention { newest: 3, every_updates: 0 },
            checkpoint_patience: Duration::from_mins(1),
            initial: None,
            identity: [0; 32],
            earlier: Vec::new(),
        }
    }

    /// Makes the rollouts of the update.
    pub(crate) fn batch(config: &LearnerConfig) -> Vec<CheckedRollout> {
        let rollout = |env_id| {
            let made = fakes::rollout(EnvId(env_id), Iteration(0), PolicyVersion(0));
            let made = Rollout { snapshot: vec![1], ..made };
            made.check(&config.spec.env, 1, 0).unwrap()
        };
        vec![rollout(0), rollout(1)]
    }

    /// Writes what is saved right after the update, with rollouts of the next one waiting, and begins again from it.
    #[test]
    fn a_run_that_was_killed_between_its_last_update_and_its_end_balances() {
        let config = config();
        let directory = tempfile::tempdir().unwrap();
        let mut store = CheckpointStore::open(directory.path(), config.retention).unwrap();
        let mut trainer = begin(&config, &mut store).unwrap().trainer;
        trainer.update(&batch(&config)).unwrap();
        let sender = (ActorId::new("a").unwrap(), Incarnation(1));
        let mut books = Books::default();
        books.trained = 2;
        for sequence in 1..=5 {
            books.enter(&sender, Sequence(sequence));
        }
        let checkpoint = Checkpoint {
            identity: config.identity,
            trainer: trainer.state().unwrap(),
            places: RolloutQueue::beginning(2),
            epoch: Epoch(1),
            older: Vec::new(),
            record: TrainingRecord::default(),
            books,
            waiting: 3,
            builds: Builds::default(),
        };
        store.write(1, &checkpoint).unwrap();
        let point = begin(&config, &mut store).unwrap();
        let books = point.start.books;
        assert_eq!(books.check(), Ok(()));
        assert_eq!((books.unused_at_end, books.rolled_back), (3, 0));
        // What was counted before this start is told to those who count from it.
        let [RunEvent::Resumed { n_updates, n_steps, books: told, .. }] = &point.events[..] else {
            panic!("{:?}", point.events);
        };
        assert_eq!((*n_updates, *n_steps, told), (1, 2, &books));
    }
}
