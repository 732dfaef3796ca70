//! Who takes turns: so that a listener does not hear the same sentence again and again.

use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};

use crate::database::Taxonomy;
use crate::retrieve::Retrieved;
use crate::utterance::Utterance;

/// Goes through the sentences of each cell in turn, from a start that a seeded generator draws.
///
/// Every sentence of a cell is said once before any is said again. One that is false now loses its turn.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rotation {
    /// Per topic and filled cell, how many sentences were passed.
    passed: Vec<Vec<u32>>,
}

impl Rotation {
    /// Draws where each cell starts.
    pub fn new(taxonomy: &Taxonomy, generator: &mut Pcg64) -> Self {
        let mut start = |n: usize| generator.below(n) as u32;
        let cells =
            |topic: &crate::Topic| topic.cells().map(|(_, list)| start(list.len())).collect();
        Self { passed: taxonomy.topics().iter().map(cells).collect() }
    }

    /// Returns whether it could be a rotation of this database.
    pub fn fits(&self, taxonomy: &Taxonomy) -> bool {
        let topics = taxonomy.topics();
        let n_cells = topics.iter().map(|topic| topic.cells().count());
        self.passed.iter().map(Vec::len).eq(n_cells)
    }

    /// Takes the next sentence of what was retrieved that is true; none if there is no such sentence, or if that is another
    /// database's. Allocates nothing.
    pub fn next<'a>(&mut self, retrieved: &Retrieved<'a>) -> Option<&'a Utterance> {
        let passed = self.passed.get_mut(retrieved.topic)?.get_mut(retrieved.cell_idx)?;
        let n = retrieved.utterances.len();
        let mut turns = (0..n).map(|i| (*passed as usize + i) % n);
        let turn = turns.find(|&i| retrieved.is_true(&retrieved.utterances[i]))?;
        *passed = ((turn + 1) % n) as u32;
        Some(&retrieved.utterances[turn])
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::{Cell, FactSet, Request, shipped};

    #[test]
    fn every_sentence_has_its_turn_before_one_comes_again() {
        let taxonomy = shipped("lander").unwrap();
        let request = Request { topic: 1, cell: Cell::new(2, 4) };
        let found = taxonomy.retrieve_true(request, FactSet::ALL);
        let found = found.unwrap().unwrap();
        let n = found.utterances.len();
        assert!(n >= 3);
        let mut starts = BTreeSet::new();
        for seed in 0..20 {
            let mut rotation = Rotation::new(&taxonomy, &mut Pcg64::seed_from_u64(seed));
            let said: Vec<&str> =
                (0..2 * n).map(|_| rotation.next(&found).unwrap().text.as_str()).collect();
            assert_eq!(said[..n].iter().collect::<BTreeSet<_>>().len(), n);
            assert_eq!(said[..n], said[n..]);
            starts.insert(said[0].to_owned());
            let mut again = Rotation::new(&taxonomy, &mut Pcg64::seed_from_u64(seed));
            assert_eq!(again.next(&found).unwrap().text, said[0]);
        }
        assert!(starts.len() > 1, "every seed starts with {starts:?}");
    }
}
