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
use crate::coordinator::CoordinatorStart;
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
        }
        self.start = CoordinatorStart { places, epoch, version, books, builds: state.builds };
        let older = state.older.into_iter();
        self.offered = older.map(|policy| (policy.version, policy.weights)).collect();
        self.record = state.record;
        let damaged = damaged.into_iter();
        self.events = damaged
            .map(|(path, damage)| RunEvent::CheckpointDamaged { path, damage })
            .chain([RunEvent::Resumed { path, n_updates: version.0 }])
            .collect();
        Ok(())
    }
}
