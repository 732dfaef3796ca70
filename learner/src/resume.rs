//! What a checkpoint holds, and how a run begins: anew, or where it was.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use leadtime_policy::Parameters;
use leadtime_ppo::{Trainer, TrainerState};
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{Epoch, PolicyVersion};
use serde::{Deserialize, Serialize};

use crate::books::Books;
use crate::checkpoint::{CheckpointStore, Loaded};
use crate::collect::Collector;
use crate::coordinator::Start;
use crate::episodes::Episodes;
use crate::report::{RatedPolicy, RunEvent};
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
    pub(crate) episodes: Episodes,
    pub(crate) staleness: BTreeMap<u64, u64>,
    pub(crate) books: Books,
    /// Rollouts accepted and not trained on.
    pub(crate) waiting: u64,
    /// Whether everyone so far ran one build of the program on one class of CPU.
    pub(crate) uniform: bool,
}

/// How far a run had got when it began.
#[derive(Debug)]
pub(crate) struct Standing {
    pub(crate) trainer: Trainer,
    pub(crate) start: Start,
    pub(crate) offered: BTreeMap<PolicyVersion, Arc<[u8]>>,
    pub(crate) best: Option<RatedPolicy>,
    pub(crate) episodes: Episodes,
    pub(crate) staleness: BTreeMap<u64, u64>,
    /// Whether everyone so far ran one build of the program on one class of CPU.
    pub(crate) uniform: bool,
    pub(crate) events: Vec<RunEvent>,
}

/// Begins a run: from its newest whole checkpoint, or from the beginning if there never was one.
pub(crate) fn begin(config: &LearnerConfig, store: &CheckpointStore) -> Result<Standing, Error> {
    let (policy, settings) = (&config.spec.policy, &config.settings);
    let trainer = match &config.initial {
        None => Trainer::new(policy, settings, config.spec.seed)?,
        Some(weights) => {
            let parameters = Parameters::from_safetensors(weights, policy)?;
            Trainer::from_parameters(policy, settings, config.spec.seed, parameters)?
        }
    };
    match store.newest::<Checkpoint>()? {
        None => anew(config, trainer),
        Some(loaded) => resumed(config, trainer, loaded),
    }
}

fn anew(config: &LearnerConfig, trainer: Trainer) -> Result<Standing, Error> {
    Ok(Standing {
        start: Start {
            places: Collector::beginning(config.settings.n_envs),
            epoch: Epoch(0),
            version: trainer.version(),
            books: Books::default(),
        },
        offered: BTreeMap::from([(trainer.version(), encode(&trainer)?)]),
        trainer,
        best: None,
        episodes: Episodes::default(),
        staleness: BTreeMap::new(),
        uniform: true,
        events: Vec::new(),
    })
}

fn resumed(
    config: &LearnerConfig,
    mut trainer: Trainer,
    loaded: Loaded<Checkpoint>,
) -> Result<Standing, Error> {
    let Loaded { state, path, damaged } = loaded;
    if state.identity != config.identity {
        return Err(Error::ConfigurationChanged { path });
    }
    trainer.restore(state.trainer)?;
    let older = state.older.into_iter().map(RatedPolicy::from);
    let mut offered: BTreeMap<PolicyVersion, Arc<[u8]>> =
        older.map(|policy| (policy.version, policy.weights)).collect();
    offered.insert(trainer.version(), encode(&trainer)?);
    let mut books = state.books;
    if trainer.version().0 < config.settings.n_updates() {
        books.resume(state.waiting, config.settings.n_steps as u64);
    }
    Ok(Standing {
        start: Start {
            places: state.places,
            epoch: state.epoch,
            version: trainer.version(),
            books,
        },
        offered,
        best: state.best.map(RatedPolicy::from),
        episodes: state.episodes,
        staleness: state.staleness,
        uniform: state.uniform,
        events: events(damaged, path, trainer.version().0),
        trainer,
    })
}

fn events(
    damaged: Vec<(PathBuf, crate::checkpoint::Damage)>,
    path: PathBuf,
    n_updates: u64,
) -> Vec<RunEvent> {
    let damaged = damaged
        .into_iter()
        .map(|(path, damage)| RunEvent::CheckpointDamaged { path, damage: Arc::new(damage) });
    damaged.chain([RunEvent::Resumed { path, n_updates }]).collect()
}
