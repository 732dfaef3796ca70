//! What was proposed, accepted and given up so far, and so what is asked for next.

use std::collections::{BTreeMap, BTreeSet};

use super::candidate::{Candidate, Reason};
use super::plan::DatabasePlan;
use crate::utterance::Cell;
use crate::words;

/// What was proposed, accepted and given up so far.
#[derive(Debug)]
pub(super) struct BuildProgress {
    pub(super) candidates: Vec<Candidate>,
    /// Normalised text to its first candidate.
    seen: BTreeMap<String, usize>,
    /// Accepted sentences per topic and cell.
    pub(super) accepted: BTreeMap<(usize, Cell), usize>,
    /// Generations asked per topic and cell.
    pub(super) rounds: BTreeMap<(usize, Cell), u32>,
    pub(super) given_up: BTreeSet<(usize, Cell)>,
    iterations: u32,
}

impl BuildProgress {
    pub(super) fn new(plan: &DatabasePlan) -> Self {
        let [from, to] = plan.words;
        let cells = |topic| Cell::feasible(from, to).map(move |cell| (topic, cell));
        let all = || (0..plan.topic.len()).flat_map(cells);
        Self {
            candidates: Vec::new(),
            seen: BTreeMap::new(),
            accepted: all().map(|key| (key, 0)).collect(),
            rounds: all().map(|key| (key, 0)).collect(),
            given_up: BTreeSet::new(),
            iterations: 0,
        }
    }

    /// Picks the emptiest cell that may still be asked for; of equals, the one asked for least.
    pub(super) fn next(&mut self, plan: &DatabasePlan) -> Option<(usize, Cell, u32)> {
        let settings = &plan.settings;
        if self.iterations >= settings.max_iterations {
            return None;
        }
        let open = self.accepted.iter().filter(|(key, n)| {
            **n < settings.target
                && self.rounds[key] < settings.attempts_per_cell
                && !self.given_up.contains(key)
        });
        let (&(topic, cell), _) = open.min_by_key(|&(key, n)| (*n, self.rounds[key], *key))?;
        Some((topic, cell, self.ask(topic, cell)))
    }

    /// Counts that a cell is asked for; returns how often it was before.
    pub(super) fn ask(&mut self, topic: usize, cell: Cell) -> u32 {
        let rounds = self.rounds.entry((topic, cell)).or_default();
        *rounds += 1;
        self.iterations += 1;
        *rounds - 1
    }

    /// Lists the cells that no call asked for.
    pub(super) fn never_asked(&self) -> Vec<(usize, Cell)> {
        let never = self.rounds.iter().filter(|(_, rounds)| **rounds == 0);
        never.map(|(key, _)| *key).collect()
    }

    /// Lists the accepted sentences of a topic.
    pub(super) fn texts(&self, topic: usize) -> Vec<String> {
        let of_topic = |candidate: &&Candidate| candidate.topic == topic && candidate.is_accepted();
        self.candidates.iter().filter(of_topic).map(|candidate| candidate.text.clone()).collect()
    }

    /// Returns whether the same words were proposed before; for another topic, both are turned down.
    pub(super) fn repeated(&mut self, candidate: &Candidate) -> Option<Reason> {
        let first = *self.seen.get(&words::normalised(&candidate.text))?;
        let first = &mut self.candidates[first];
        if first.topic == candidate.topic {
            return Some(Reason::Duplicate);
        }
        if let Some(accepted) = accepted(&mut self.accepted, first) {
            *accepted = accepted.saturating_sub(1);
        }
        first.reason = Some(Reason::AmbiguousTopic);
        Some(Reason::AmbiguousTopic)
    }

    pub(super) fn add(&mut self, candidate: Candidate) {
        if let Some(accepted) = accepted(&mut self.accepted, &candidate) {
            *accepted += 1;
        }
        let place = self.candidates.len();
        if !candidate.spans.is_empty() {
            self.seen.entry(words::normalised(&candidate.text)).or_insert(place);
        }
        self.candidates.push(candidate);
    }
}

/// Returns where an accepted sentence is counted.
fn accepted<'a>(
    counts: &'a mut BTreeMap<(usize, Cell), usize>,
    candidate: &Candidate,
) -> Option<&'a mut usize> {
    let cell = candidate.landed.filter(|_| candidate.is_accepted())?;
    counts.get_mut(&(candidate.topic, cell))
}
