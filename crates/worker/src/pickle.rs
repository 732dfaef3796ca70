//! Whether a pickle of an environment is all of it.

use crate::link::WorkerLink;
use crate::settings::SnapshotKind;
use crate::trial::{TriedSlot, difference, steps};

/// Steps before a pickle, and after it.
const PICKLE_STEPS: usize = 10;

/// Says why a pickle cannot put an environment back, if so.
///
/// An environment may pickle without complaint and come back fresh: as the arguments that it was made with.
pub(crate) fn check_pickle(link: &mut WorkerLink) -> Option<String> {
    debug_assert_eq!(link.launch().snapshot, SnapshotKind::Pickle);
    let place = link.reserve()?;
    let found = compare(link, place);
    link.release(place);
    found.err()
}

/// Takes the same steps before and after an environment was put back; an error says why they are not the same.
fn compare(link: &mut WorkerLink, place: usize) -> Result<(), String> {
    let mut tried = [TriedSlot::begin(link, place, 0)];
    steps(link, &mut tried, PICKLE_STEPS)?;
    link.pickle(place);
    let slot = link.slot(place);
    if let Some(reason) = &slot.failure {
        return Err(reason.clone());
    }
    let (base, seed) = (slot.base.clone(), slot.seed);
    let mut again = tried.clone();
    let first = steps(link, &mut tried, PICKLE_STEPS)?;
    let slot = link.slot_mut(place);
    slot.begin(seed);
    slot.base = base;
    link.put_back(place);
    let why = match steps(link, &mut again, PICKLE_STEPS) {
        Ok(second) => match difference(&first, &second) {
            None => return Ok(()),
            Some((step, what)) => format!("{what} differs {step} steps after it was put back"),
        },
        Err(reason) => reason,
    };
    Err(format!(
        "a pickle of the environment is not all of it ({why}); world.snapshot = \"replay\" puts it back by its actions"
    ))
}
