//! Which sentences of a cell are kept: near-duplicates go, medoids stay, and one that is always true.

use std::collections::BTreeMap;

use super::caller::Caller;
use super::candidate::{Candidate, Reason};
use super::embedding::Embedding;
use super::error::PipelineError;
use super::medoids::{Distances, medoids};
use super::plan::DatabasePlan;
use super::presuppose::Presuppositions;
use crate::utterance::Cell;

/// Chooses the representatives of every cell, and marks them; in the order of the file.
pub(super) fn choose(
    plan: &DatabasePlan,
    candidates: &mut [Candidate],
    caller: &mut Caller<'_>,
) -> Result<Vec<Candidate>, PipelineError> {
    let mut cells: BTreeMap<(usize, Cell), Vec<usize>> = BTreeMap::new();
    for (i, candidate) in candidates.iter().enumerate() {
        if let Some(cell) = candidate.landed.filter(|_| candidate.is_accepted()) {
            cells.entry((candidate.topic, cell)).or_default().push(i);
        }
    }
    let presupposed = Presuppositions::new(plan);
    let mut kept = Vec::new();
    for mut members in cells.into_values() {
        let is_pinned = |i: &usize| plan.pinned.contains(&candidates[*i].text);
        // Pinned ones first, so that others are compared with them.
        members.sort_by_key(|i| !is_pinned(i));
        let n_pinned = members.iter().filter(|i| is_pinned(i)).count();
        let mut distinct: Vec<(usize, Embedding)> = Vec::new();
        for i in members {
            let embedding = caller.embed(&candidates[i].text)?;
            let near = plan.settings.near_duplicate;
            if distinct.iter().any(|(_, other)| other.cosine(&embedding) >= near) {
                candidates[i].reason = Some(Reason::NearDuplicate);
            } else {
                distinct.push((i, embedding));
            }
        }
        let keep = plan.settings.keep;
        let mut chosen = representatives(&distinct, n_pinned, keep);
        let is_always_true =
            |i: usize| presupposed.facts(candidates[i].topic, &candidates[i].text).is_empty();
        if n_pinned < keep && !chosen.iter().any(|&i| is_always_true(i)) {
            // There must be something to say when nothing else holds: the first that was proposed is kept like a pinned one.
            if let Some(place) = distinct.iter().position(|(i, _)| is_always_true(*i)) {
                distinct[n_pinned..=place].rotate_right(1);
                chosen = representatives(&distinct, n_pinned + 1, keep);
            }
        }
        for (rank, i) in chosen.into_iter().enumerate() {
            candidates[i].medoid = Some(rank as u32);
            kept.push(candidates[i].clone());
        }
    }
    Ok(kept)
}

/// Chooses the medoids of a cell: the pinned first members, and of the rest who stands best for it.
///
/// The sentence that represents most comes first; of equals, the one that was proposed first.
fn representatives(members: &[(usize, Embedding)], n_pinned: usize, keep: usize) -> Vec<usize> {
    let n_pinned = n_pinned.min(members.len());
    let distance = |a: usize, b: usize| 1.0 - members[a].1.cosine(&members[b].1);
    let rest =
        Distances::new(members.len() - n_pinned, |a, b| distance(a + n_pinned, b + n_pinned));
    let of_rest = medoids(&rest, keep.saturating_sub(n_pinned));
    let chosen: Vec<usize> = (0..n_pinned).chain(of_rest.iter().map(|i| i + n_pinned)).collect();
    let distances = Distances::new(members.len(), distance);
    let mut sizes = vec![0_usize; chosen.len()];
    for i in 0..members.len() {
        sizes[distances.nearest(i, &chosen).0] += 1;
    }
    let mut ranked: Vec<(usize, usize)> = sizes.into_iter().zip(chosen).collect();
    ranked.sort_by_key(|(size, member)| (std::cmp::Reverse(*size), *member));
    ranked.into_iter().map(|(_, member)| members[member].0).collect()
}
