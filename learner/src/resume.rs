//! What a checkpoint holds, and how a run begins: anew, or where it was.

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
use crate::report::{RatedPolicy, RunEvent};
use crate::rollout_queue::RolloutQueue;
use crate::training::encode;
use crate::{Error, LearnerConfig};

/// A policy as a checkpoint keeps it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SavedPolicy {
    version: PolicyVersion,
    score: Option<f64>,
    #[serde(with = "serde_bytes")]
    weights: Vec<u8>,
}

impl From<&RatedPolicy> for SavedPolicy {
    fn from(policy: &RatedPolicy) -> Self {
        let RatedPolicy { version, score, weights } = policy;
        Self { version: *version, score: *score, weights: weights.to_vec() }
    }
}

impl From<SavedPolicy> for RatedPolicy {
    fn from(saved: SavedPolicy) -> Self {
        let SavedPolicy { version, score, weights } = saved;
        Self { version, score, weights: weights.into() }
    }
}

/// Everything a run needs to go on bit for bit.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Checkpoint {
    pub(crate) identity: [u8; 32],
    pub(crate) trainer: TrainerState,
    pub(crate) places: Vec<EnvAssignment>,
    pub(crate) epoch: Epoch,
    /// Versions that the schedule still acts with, beside the trainer's own.
    pub(crate) older: Vec<SavedPolicy>,
    pub(crate) best: Option<SavedPolicy>,
    pub(crate) episodes: EpisodeWindow,
    pub(crate) staleness: BTreeMap<u64, u64>,
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
    pub(crate) best: Option<RatedPolicy>,
    pub(crate) episodes: EpisodeWindow,
    pub(crate) staleness: BTreeMap<u64, u64>,
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
    let mut point = match store.newest()? {
        None => anew(config, trainer)?,
        Some(loaded) => resumed(config, trainer, loaded)?,
    };
    if point.start.version.0 >= settings.n_updates() {
        return Ok(point); // Nothing is left for this build to compute.
    }
    if point.start.builds.note(&config.build) {
        point.events.push(RunEvent::OtherBuild { actor: None, build: config.build.clone() });
    }
    Ok(point)
}

fn anew(config: &LearnerConfig, trainer: Trainer) -> Result<ResumePoint, Error> {
    Ok(ResumePoint {
        start: CoordinatorStart {
            places: RolloutQueue::beginning(config.settings.n_envs),
            epoch: Epoch(0),
            version: trainer.version(),
            books: Books::default(),
            builds: Builds::default(),
        },
        offered: BTreeMap::from([(trainer.version(), encode(&trainer)?)]),
        trainer,
        best: None,
        episodes: EpisodeWindow::default(),
        staleness: BTreeMap::new(),
        events: Vec::new(),
    })
}

fn resumed(
    config: &LearnerConfig,
    mut trainer: Trainer,
    loaded: Loaded<Checkpoint>,
) -> Result<ResumePoint, Error> {
    let Loaded { state, path, damaged } = loaded;
    if state.identity != config.identity {
        return Err(Error::ConfigurationChanged { path });
    }
    trainer.restore(state.trainer)?;
    let older = state.older.into_iter().map(RatedPolicy::from);
    let mut offered: BTreeMap<PolicyVersion, Arc<[u8]>> =
        older.map(|policy| (policy.version, policy.weights)).collect();
    offered.insert(trainer.version(), encode(&trainer)?);
    let n_updates = trainer.version().0;
    let mut books = state.books;
    if n_updates < config.settings.n_updates() {
        books.resume(state.waiting, config.settings.n_steps as u64);
    }
    let damaged = damaged
        .into_iter()
        .map(|(path, damage)| RunEvent::CheckpointDamaged { path, damage: Arc::new(damage) });
    let events = damaged.chain([RunEvent::Resumed { path, n_updates }]).collect();
    Ok(ResumePoint {
        start: CoordinatorStart {
            places: state.places,
            epoch: state.epoch,
            version: trainer.version(),
            books,
            builds: state.builds,
        },
        offered,
        best: state.best.map(RatedPolicy::from),
        episodes: state.episodes,
        staleness: state.staleness,
        events,
        trainer,
    })
}
