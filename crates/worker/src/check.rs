//! Whether a worker keeps the promise of equal bits: two processes, and a pickle put back.

use leadtime_numerics::Pcg64;
use leadtime_proto::EnvId;
use leadtime_sims::EpisodeSeed;

use crate::error::Error;
use crate::link::Link;
use crate::pool::Workers;
use crate::protocol::StepRow;
use crate::settings::{PythonSettings, SnapshotKind};

/// Steps that two processes take.
const N_STEPS: usize = 200;
/// Steps before a pickle, and after it.
const PICKLE_STEPS: usize = 10;
/// Seed of the check.
const SEED: u64 = 20_260_517;

/// What the check of a worker found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerReport {
    /// Steps that two processes took.
    pub n_steps: usize,
    /// Versions of Python and of the packages that step the environments.
    pub versions: Vec<String>,
    /// What breaks the promise of equal bits.
    pub defects: Vec<String>,
}

/// Has two workers take the same steps, and compares every byte that they show.
///
/// # Errors
///
/// [`Error`] if no worker can be started.
pub fn check_worker(workers: &Workers, settings: &PythonSettings) -> Result<WorkerReport, Error> {
    let launch = workers.launch(settings)?;
    let mut shown = Vec::new();
    let mut versions = Vec::new();
    for place in [0, launch.batch - 1] {
        // Neither the process nor the place in it may make a difference.
        let mut link = Link::start(launch.clone())?;
        let said = &link.hello().world.versions;
        versions = said.iter().map(|(package, version)| format!("{package} {version}")).collect();
        shown.push(play(&mut link, place, N_STEPS));
    }
    let defects = match (&shown[0], &shown[1]) {
        (Err(reason), _) | (_, Err(reason)) => vec![reason.clone()],
        (Ok(first), Ok(second)) => difference(first, second)
            .map(|(step, what)| {
                format!(
                    "two processes differ in {what} after step {step}: the environment does not depend on its seed and its \
                     actions alone"
                )
            })
            .into_iter()
            .collect(),
    };
    Ok(WorkerReport { n_steps: N_STEPS, versions, defects })
}

/// Says why a pickle cannot put an environment back, if so.
///
/// An environment may pickle without complaint and come back fresh: as the arguments that it was made with.
pub(crate) fn check_pickle(link: &mut Link) -> Option<String> {
    debug_assert_eq!(link.launch().snapshot, SnapshotKind::Pickle);
    let place = link.reserve()?;
    let found = pickled(link, place);
    link.release(place);
    found
}

fn pickled(link: &mut Link, place: usize) -> Option<String> {
    let mut draws = Pcg64::seed_from_u64(SEED);
    begin(link, place);
    let mut go_on = |link: &mut Link| -> Result<Vec<StepRow>, String> {
        (0..PICKLE_STEPS).map(|_| step(link, place, &mut draws)).collect()
    };
    if let Err(reason) = go_on(link) {
        return Some(reason);
    }
    link.pickle(place);
    if let Some(reason) = &link.slot(place).failure {
        return Some(reason.clone());
    }
    let (base, seed) = (link.slot(place).base.clone(), link.slot(place).seed);
    let before = draws.clone();
    let mut go_on = |link: &mut Link| -> Result<Vec<StepRow>, String> {
        (0..PICKLE_STEPS).map(|_| step(link, place, &mut draws)).collect()
    };
    let first = match go_on(link) {
        Ok(first) => first,
        Err(reason) => return Some(reason),
    };
    let slot = link.slot_mut(place);
    slot.begin(seed);
    slot.base = base;
    link.put_back(place);
    draws = before;
    let second: Result<Vec<StepRow>, String> =
        (0..PICKLE_STEPS).map(|_| step(link, place, &mut draws)).collect();
    let why = match second {
        Ok(second) => difference(&first, &second)
            .map(|(step, what)| format!("{what} differs {step} steps after it was put back"))?,
        Err(reason) => reason,
    };
    Some(format!(
        "a pickle of the environment is not all of it ({why}); world.snapshot = \"replay\" puts it back by its actions"
    ))
}

fn begin(link: &mut Link, place: usize) {
    let slot = link.slot_mut(place);
    slot.is_used = true;
    link.begin(place, EpisodeSeed { run_seed: SEED, env_id: EnvId(0), episode: 0 });
}

/// Plays so many steps, over episode ends, and returns what each has shown.
fn play(link: &mut Link, place: usize, n_steps: usize) -> Result<Vec<StepRow>, String> {
    let mut draws = Pcg64::seed_from_u64(SEED);
    begin(link, place);
    let first = link.slot(place).row.clone();
    let rest = (0..n_steps).map(|_| step(link, place, &mut draws));
    let shown: Result<Vec<StepRow>, String> = [Ok(first)].into_iter().chain(rest).collect();
    match &link.slot(place).failure {
        Some(reason) => Err(reason.clone()),
        None => shown,
    }
}

/// Takes a step with an action that is offered.
fn step(link: &mut Link, place: usize, draws: &mut Pcg64) -> Result<StepRow, String> {
    let (mask, mut first) = (link.slot(place).row.mask, 0);
    let heads = &link.hello().world.heads;
    let action: Vec<u8> = heads
        .iter()
        .map(|head| {
            let of_head = mask.checked_shr(first).unwrap_or(0);
            first += head.n_choices as u32;
            let offered: Vec<u8> =
                (0..head.n_choices as u8).filter(|choice| of_head >> choice & 1 == 1).collect();
            if offered.is_empty() { 0 } else { offered[draws.below(offered.len())] }
        })
        .collect();
    link.announce(place, &action);
    link.send_steps();
    link.settle();
    let slot = link.slot_mut(place);
    slot.progress = crate::slot::StepProgress::Idle;
    slot.is_ahead = false;
    match &slot.failure {
        Some(reason) => Err(reason.clone()),
        None => Ok(slot.row.clone()),
    }
}

/// Finds the first step in which two plays differ, and in what.
fn difference(first: &[StepRow], second: &[StepRow]) -> Option<(usize, String)> {
    let bits = |values: &[f32]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let mut rows = first.iter().zip(second).enumerate();
    rows.find_map(|(step, (a, b))| {
        let observed =
            bits(&a.observation).iter().zip(&bits(&b.observation)).position(|(a, b)| a != b);
        let what = if let Some(i) = observed {
            format!("observation[{i}], {} and {},", a.observation[i], b.observation[i])
        } else if a.reward.to_bits() != b.reward.to_bits() {
            format!("the reward, {} and {},", a.reward, b.reward)
        } else if a.end != b.end {
            "the end of the episode".to_owned()
        } else if a.mask != b.mask {
            "the offered choices".to_owned()
        } else if a.end.is_some() && bits(&a.last_observation) != bits(&b.last_observation) {
            "the last observation".to_owned()
        } else if a.end.is_some() && bits(&a.metrics) != bits(&b.metrics) {
            "the metrics".to_owned()
        } else {
            return None;
        };
        Some((step, what))
    })
}
