//! An environment that a worker steps, as everybody else sees it.

use leadtime_proto::{EnvSpec, Mask};
use leadtime_sims::environment::{read_snapshot, write_snapshot};
use leadtime_sims::{End, Environment, EpisodeSeed, SnapshotError, StepOutcome};
use serde::{Deserialize, Serialize};

use crate::launch::{MAX_STATE_BYTES, WorkerLaunch};
use crate::link::not_the_same;
use crate::pool::{WorkerPlace, Workers};
use crate::settings::SnapshotKind;
use crate::slot::StepProgress;

/// Room in a snapshot for what is neither actions nor a pickle.
const FRAME_BYTES: usize = 256;

/// What of an environment is in its snapshot.
#[derive(Serialize, Deserialize)]
struct WorkerState {
    seed: EpisodeSeed,
    n_before: u32,
    #[serde(with = "serde_bytes")]
    base: Vec<u8>,
    #[serde(with = "serde_bytes")]
    actions: Vec<u8>,
    /// A hash of the observation: one that is put back must show the same.
    observed: u64,
}

/// An environment in a worker. The worker is found, or started, when the first episode begins.
#[derive(Debug)]
pub(crate) struct PythonEnvironment {
    workers: Workers,
    /// How the worker is started; why it must not be.
    launch: Result<WorkerLaunch, String>,
    snapshot: SnapshotKind,
    spec: EnvSpec,
    place: Option<WorkerPlace>,
    mask: u64,
    metrics: Vec<f32>,
    /// Why there is no place.
    failure: Option<String>,
}

impl PythonEnvironment {
    pub(crate) fn new(
        workers: Workers,
        launch: Result<WorkerLaunch, String>,
        snapshot: SnapshotKind,
        spec: EnvSpec,
    ) -> Self {
        let metrics = vec![0.0; spec.metrics.len()];
        let (place, failure) = (None, None);
        Self { workers, launch, snapshot, spec, place, mask: u64::MAX, metrics, failure }
    }

    /// Finds a worker, unless there is one.
    fn find_place(&mut self) -> Option<&WorkerPlace> {
        if self.place.is_none() && self.failure.is_none() {
            let found =
                self.launch.as_ref().map_err(Clone::clone).and_then(|launch| {
                    self.workers.reserve(launch).map_err(|error| error.to_string())
                });
            match found {
                Ok(place) => self.place = Some(place),
                Err(reason) => self.failure = Some(reason),
            }
        }
        self.place.as_ref()
    }

    /// Shows what the environment's row has, after it was begun.
    fn show(&mut self, observation: &mut [f32]) {
        let Some(place) = &self.place else { return observation.fill(0.0) };
        let (link, index) = (place.link(), place.index());
        let slot = link.slot(index);
        if slot.failure.is_some() || slot.row.observation.len() != observation.len() {
            return observation.fill(0.0);
        }
        observation.copy_from_slice(&slot.row.observation);
        self.mask = slot.row.mask;
    }
}

impl Environment for PythonEnvironment {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
        self.metrics.fill(0.0);
        if let Some(place) = self.find_place() {
            let (mut link, index) = (place.link(), place.index());
            let slot = link.slot_mut(index);
            if slot.is_ahead && slot.seed == seed {
                // The worker began it together with the step that ended the episode before.
                slot.is_ahead = false;
            } else if slot.failure.is_none() {
                link.begin(index, seed);
            }
        }
        self.show(observation);
    }

    fn mask(&self) -> Mask {
        Mask(self.mask)
    }

    fn announce(&mut self, action: &[u8]) {
        if let Some(place) = &self.place {
            place.link().announce(place.index(), action);
        }
    }

    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome {
        let over = StepOutcome { reward: 0.0, end: Some(End::Terminated) };
        let Some(place) = &self.place else {
            observation.fill(0.0);
            return over;
        };
        let index = place.index();
        let is_announced = {
            let mut link = place.link();
            link.announce(index, action);
            link.slot(index).progress == StepProgress::Announced
        };
        if is_announced {
            self.workers.send_steps();
        }
        let mut link = place.link();
        link.settle();
        let slot = link.slot_mut(index);
        slot.progress = StepProgress::Idle;
        if slot.failure.is_some() || slot.row.observation.len() != observation.len() {
            observation.fill(0.0);
            return over;
        }
        let row = &slot.row;
        let outcome = StepOutcome { reward: row.reward, end: row.end };
        self.mask = row.mask;
        if row.end.is_some() {
            observation.copy_from_slice(&row.last_observation);
            self.metrics.copy_from_slice(&row.metrics);
        } else {
            observation.copy_from_slice(&row.observation);
            link.bound_actions(index);
        }
        outcome
    }

    fn metrics(&self, out: &mut [f32]) {
        out.copy_from_slice(&self.metrics);
    }

    fn write_state(&self, out: &mut Vec<u8>) {
        let Some(place) = &self.place else { return };
        let (mut link, index) = (place.link(), place.index());
        if self.snapshot == SnapshotKind::Pickle {
            link.pickle(index);
        }
        let slot = link.slot(index);
        let mut state = WorkerState {
            seed: slot.seed,
            n_before: 0,
            base: Vec::new(),
            actions: Vec::new(),
            observed: hash(&slot.row.observation),
        };
        if self.snapshot != SnapshotKind::None {
            state.n_before = slot.n_before;
            state.base.clone_from(&slot.base);
            state.actions.clone_from(&slot.actions);
        }
        write_snapshot(&state, out);
    }

    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        let state: WorkerState = read_snapshot(state)?;
        let n_heads = self.spec.actions.heads.len();
        let heads = &self.spec.actions.heads;
        let possible = |action: &[u8]| {
            action.iter().zip(heads).all(|(choice, head)| usize::from(*choice) < head.n_choices)
        };
        let fits = state.actions.len().is_multiple_of(n_heads)
            && state.actions.chunks_exact(n_heads).all(possible)
            && (state.base.is_empty() || self.snapshot == SnapshotKind::Pickle);
        if !fits {
            return Err(SnapshotError::Mismatch { what: "its actions" });
        }
        if !state.seed.may_be() {
            return Err(SnapshotError::Mismatch { what: "number of the episode" });
        }
        self.metrics.fill(0.0);
        let kind = self.snapshot;
        let found = self.find_place().map(|place| {
            let (mut link, index) = (place.link(), place.index());
            let slot = link.slot_mut(index);
            slot.begin(state.seed);
            if kind != SnapshotKind::None {
                (slot.n_before, slot.base, slot.actions) =
                    (state.n_before, state.base, state.actions);
            }
            slot.failure = None;
            link.put_back(index);
            let slot = link.slot_mut(index);
            let is_other = hash(&slot.row.observation) != state.observed;
            if kind != SnapshotKind::None && slot.failure.is_none() && is_other {
                slot.failure = Some(not_the_same(slot.seed));
            }
        });
        debug_assert_eq!(found.is_none(), self.failure.is_some());
        if let Some(reason) = self.failure() {
            return Err(SnapshotError::Outside(reason));
        }
        self.show(observation);
        Ok(())
    }

    fn failure(&self) -> Option<String> {
        let in_place = |place: &WorkerPlace| place.link().slot(place.index()).failure.clone();
        self.failure.clone().or_else(|| self.place.as_ref().and_then(in_place))
    }

    fn is_restorable(&self) -> bool {
        self.snapshot != SnapshotKind::None
    }

    fn max_snapshot_bytes(&mut self) -> usize {
        match self.snapshot {
            SnapshotKind::None => FRAME_BYTES,
            // It has begun no episode, and would start a worker for it.
            SnapshotKind::Replay | SnapshotKind::Pickle => {
                MAX_STATE_BYTES + MAX_STATE_BYTES / 16 + FRAME_BYTES
            }
        }
    }
}

/// Hashes an observation's bits (FNV-1a).
fn hash(observation: &[f32]) -> u64 {
    observation.iter().fold(0xcbf2_9ce4_8422_2325, |hash: u64, x| {
        (hash ^ u64::from(x.to_bits())).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use leadtime_proto::{EnvId, Head};

    use super::*;
    use crate::settings::{PythonSettings, SpecSetting, WorldSpec};

    /// Makes an environment that keeps eight steps of an episode.
    fn environment(snapshot: SnapshotKind) -> PythonEnvironment {
        let fake = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/worker/fake.py");
        let heads = vec![Head { name: "action".to_owned(), n_choices: 2 }];
        let world = WorldSpec { obs_dim: 4, heads, versions: BTreeMap::new() };
        let spec = world.env_spec(&[]);
        let settings = PythonSettings {
            worker: format!("python3 '{fake}'"),
            spec: SpecSetting::Known(world),
            snapshot,
            ..PythonSettings::default()
        };
        let workers = Workers::default();
        workers.permit_configured();
        let launch = workers.launch(&settings).map_err(|error| error.to_string());
        let launch = launch.map(|launch| WorkerLaunch { max_action_bytes: 8, ..launch });
        PythonEnvironment::new(workers, launch, snapshot, spec)
    }

    /// Plays an episode of twelve steps; returns how many it has had, and the actions since.
    fn play(snapshot: SnapshotKind) -> Result<(usize, Vec<u8>), String> {
        let (mut env, mut observation) = (environment(snapshot), [0.0; 4]);
        env.reset(EpisodeSeed { run_seed: 1, env_id: EnvId(3), episode: 0 }, &mut observation);
        for step in 0..12 {
            let outcome = env.step(&[step % 2], &mut observation);
            if let Some(failure) = env.failure() {
                return Err(failure);
            }
            assert_eq!(outcome.end, None, "a pole that is pushed to and fro stays up");
        }
        let place = env.place.as_ref().unwrap();
        let link = place.link();
        let slot = link.slot(place.index());
        Ok((slot.n_steps(), slot.actions.clone()))
    }

    #[test]
    fn an_episode_that_no_run_reaches_is_not_gone_on_with() {
        let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(3), episode: u64::MAX };
        let (base, actions) = (Vec::new(), Vec::new());
        let state = WorkerState { seed, n_before: 0, base, actions, observed: 0 };
        let mut bytes = Vec::new();
        write_snapshot(&state, &mut bytes);
        let mut env = environment(SnapshotKind::Replay);
        let refused = env.read_state(&bytes, &mut [0.0; 4]).unwrap_err();
        assert!(refused.to_string().ends_with("number of the episode"), "{refused}");
        assert!(env.place.is_none(), "no worker is started for it");
    }

    #[test]
    fn a_long_episode_fails_only_where_it_would_be_played_again_as_a_whole() {
        let refused = play(SnapshotKind::Replay).unwrap_err();
        let told = "environment 3: episode 0 has 9 steps, more than can be played again";
        assert!(refused.starts_with(told), "{refused}");
        assert_eq!(play(SnapshotKind::Pickle), Ok((12, vec![1, 0, 1])));
        assert_eq!(play(SnapshotKind::None), Ok((12, Vec::new())));
    }
}
