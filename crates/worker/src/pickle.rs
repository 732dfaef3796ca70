//! Whether a pickle of an environment is all of it.

use leadtime_numerics::Pcg64;

use crate::link::WorkerLink;
use crate::protocol::StepRow;
use crate::settings::SnapshotKind;
use crate::trial::{SEED, begin, difference, step};

/// Steps before a pickle, and after it.
const PICKLE_STEPS: usize = 10;

/// Says why a pickle cannot put an environment back, if so.
///
/// An environment may pickle without complaint and come back fresh: as the arguments that it was made with.
pub(crate) fn check_pickle(link: &mut WorkerLink) -> Option<String> {
    debug_assert_eq!(link.launch().snapshot, SnapshotKind::Pickle);
    let place = link.reserve()?;
    let found = pickled(link, place);
    link.release(place);
    found
}

fn pickled(link: &mut WorkerLink, place: usize) -> Option<String> {
    let mut draws = Pcg64::seed_from_u64(SEED);
    begin(link, place);
    let mut go_on = |link: &mut WorkerLink| -> Result<Vec<StepRow>, String> {
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
    let mut go_on = |link: &mut WorkerLink| -> Result<Vec<StepRow>, String> {
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
