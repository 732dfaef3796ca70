//! Steps that are taken to try a worker, and how two plays differ.

use leadtime_numerics::Pcg64;
use leadtime_proto::{EnvId, Head};
use leadtime_sims::EpisodeSeed;

use crate::link::WorkerLink;
use crate::protocol::StepRow;
use crate::slot::StepProgress;

/// Seed of the trials.
const SEED: u64 = 20_260_517;

/// An environment that is tried: its place in the worker, and what draws its actions.
#[derive(Clone)]
pub(crate) struct TriedSlot {
    place: usize,
    draws: Pcg64,
}

impl TriedSlot {
    /// Begins the first episode of one of the trials' environments at a place of the link.
    pub(crate) fn begin(link: &mut WorkerLink, place: usize, env_id: u32) -> Self {
        link.slot_mut(place).is_used = true;
        link.begin(place, EpisodeSeed { run_seed: SEED, env_id: EnvId(env_id), episode: 0 });
        Self { place, draws: Pcg64::seed_from_u64(SEED + u64::from(env_id)) }
    }

    /// Draws an action that is offered.
    fn action(&mut self, link: &WorkerLink) -> Vec<u8> {
        let (mask, mut first) = (link.slot(self.place).row.mask, 0);
        let draw = |head: &Head| {
            let of_head = mask.checked_shr(first).unwrap_or(0);
            first += head.n_choices as u32;
            let offered: Vec<u8> =
                (0..head.n_choices as u8).filter(|choice| of_head >> choice & 1 == 1).collect();
            if offered.is_empty() { 0 } else { offered[self.draws.below(offered.len())] }
        };
        link.hello().world.heads.iter().map(draw).collect()
    }
}

/// Plays so many steps at the first of some places, over episode ends, and returns what each has shown. Environments at the
/// other places are stepped together with it.
pub(crate) fn play(
    link: &mut WorkerLink,
    places: &[usize],
    n_steps: usize,
) -> Result<Vec<StepRow>, String> {
    let begin = |(env_id, place): (u32, &usize)| TriedSlot::begin(link, *place, env_id);
    let mut tried: Vec<TriedSlot> = (0..).zip(places).map(begin).collect();
    let first = link.slot(places[0]).row.clone();
    // Also of no step at all: an episode that could not begin.
    fault(link, &tried)?;
    let rest = steps(link, &mut tried, n_steps)?;
    Ok([vec![first], rest].concat())
}

/// Takes so many steps and returns what each has shown of the first environment.
pub(crate) fn steps(
    link: &mut WorkerLink,
    tried: &mut [TriedSlot],
    n_steps: usize,
) -> Result<Vec<StepRow>, String> {
    (0..n_steps).map(|_| step(link, tried)).collect()
}

/// Takes a step of each environment, in one frame.
fn step(link: &mut WorkerLink, tried: &mut [TriedSlot]) -> Result<StepRow, String> {
    for slot in &mut *tried {
        let action = slot.action(link);
        link.announce(slot.place, &action);
    }
    link.send_steps();
    link.settle();
    for slot in &*tried {
        let slot = link.slot_mut(slot.place);
        slot.progress = StepProgress::Idle;
        slot.is_ahead = false;
    }
    fault(link, tried)?;
    Ok(link.slot(tried[0].place).row.clone())
}

/// Says why one of the environments cannot be stepped, if so.
fn fault(link: &WorkerLink, tried: &[TriedSlot]) -> Result<(), String> {
    let mut failures = tried.iter().filter_map(|slot| link.slot(slot.place).failure.clone());
    failures.next().map_or(Ok(()), Err)
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
