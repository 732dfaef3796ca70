//! Steps that are taken to try a worker, and how two plays differ.

use leadtime_numerics::Pcg64;
use leadtime_proto::EnvId;
use leadtime_sims::EpisodeSeed;

use crate::link::WorkerLink;
use crate::protocol::StepRow;
use crate::slot::StepProgress;

/// Seed of the trials.
pub(crate) const SEED: u64 = 20_260_517;

/// Begins the first episode of the trials at a place of the link.
pub(crate) fn begin(link: &mut WorkerLink, place: usize) {
    let slot = link.slot_mut(place);
    slot.is_used = true;
    link.begin(place, EpisodeSeed { run_seed: SEED, env_id: EnvId(0), episode: 0 });
}

/// Plays so many steps, over episode ends, and returns what each has shown.
pub(crate) fn play(
    link: &mut WorkerLink,
    place: usize,
    n_steps: usize,
) -> Result<Vec<StepRow>, String> {
    let mut draws = Pcg64::seed_from_u64(SEED);
    begin(link, place);
    let first = link.slot(place).row.clone();
    let rest = steps(link, place, n_steps, &mut draws);
    // Also of no step at all: an episode that could not begin.
    match &link.slot(place).failure {
        Some(reason) => Err(reason.clone()),
        None => Ok([vec![first], rest?].concat()),
    }
}

/// Takes so many steps and returns what each has shown.
pub(crate) fn steps(
    link: &mut WorkerLink,
    place: usize,
    n_steps: usize,
    draws: &mut Pcg64,
) -> Result<Vec<StepRow>, String> {
    (0..n_steps).map(|_| step(link, place, draws)).collect()
}

/// Takes a step with an action that is offered.
fn step(link: &mut WorkerLink, place: usize, draws: &mut Pcg64) -> Result<StepRow, String> {
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
    slot.progress = StepProgress::Idle;
    slot.is_ahead = false;
    match &slot.failure {
        Some(reason) => Err(reason.clone()),
        None => Ok(slot.row.clone()),
    }
}

/// Finds the first step in which two plays differ, and in what.
pub(crate) fn difference(first: &[StepRow], second: &[StepRow]) -> Option<(usize, String)> {
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
