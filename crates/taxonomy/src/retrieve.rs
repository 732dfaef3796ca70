//! From (c, k, l) and the facts that hold to a sentence: one that is true, of the exact cell or of the one that loses
//! least time.
//!
//! A notifier may choose a cell that no sentence fills. It never hears another topic for that: it gets the cell of
//! the same topic whose sentences cost least, and learns which, because what the listener hears is that cell's k
//! and l. The same goes for a cell of which every sentence is false now. The shipped databases have no such cell: each
//! has a sentence that presupposes nothing.

use crate::database::Taxonomy;
use crate::error::TaxonomyError;
use crate::facts::FactSet;
use crate::utterance::{Cell, Utterance};

/// What a notifier wants to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Index of the topic, in the domain's order.
    pub topic: usize,
    /// When it should be understood, and over.
    pub cell: Cell,
}

/// Returns what hearing `heard` in place of `asked` costs: words weighted 3 where k' is later, 1 where it is earlier and 1/2
/// where l' differs, all times two.
///
/// A late comprehension delays the reaction, an early one takes the words that should have said why, a wrong length
/// keeps the channel busy or the follow-through short. The ratios are ours; a study of listeners could replace them.
fn lost(asked: Cell, heard: Cell) -> u64 {
    let late = heard.comprehension.saturating_sub(asked.comprehension);
    let early = asked.comprehension.saturating_sub(heard.comprehension);
    let length = heard.conveyance.abs_diff(asked.conveyance);
    6 * u64::from(late) + 2 * u64::from(early) + u64::from(length)
}

/// The sentences that may be said for a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retrieved<'a> {
    /// The topic asked for.
    pub topic: usize,
    /// The k and l that the listener will hear; what a simulation must apply.
    pub cell: Cell,
    /// The cell's place among the filled cells of its topic.
    pub(crate) cell_idx: usize,
    /// All sentences of the cell, by rank; at least one of them is true.
    pub utterances: &'a [Utterance],
    /// The facts that hold now.
    pub holding: FactSet,
    /// Another cell than the one asked for.
    pub fallback: bool,
}

impl Retrieved<'_> {
    /// Returns whether everything holds that a sentence presupposes.
    pub fn is_true(&self, utterance: &Utterance) -> bool {
        self.holding.includes(utterance.facts)
    }
}

impl Taxonomy {
    /// Finds the sentences for a request of which at least one is true; `None` if nothing true can be said on the topic.
    ///
    /// The cell asked for is taken if one of its sentences is true, else the one with a true sentence that loses least; of
    /// equals, the smaller k', then the smaller l'.
    /// [`Rotation::next`](crate::Rotation::next) takes one of the true ones. Depends on its arguments alone, and allocates
    /// nothing; neither do [`Taxonomy::facts_named`] and `next`.
    ///
    /// # Errors
    ///
    /// [`TaxonomyError`] if the database has no topic of that index.
    ///
    /// # Example
    ///
    /// What a live assistant says, message by message: the facts come from whoever sees the world, and what they do not
    /// state does not hold.
    ///
    /// ```
    /// use leadtime_numerics::Pcg64;
    /// use leadtime_taxonomy::{Cell, Request, Rotation, shipped};
    ///
    /// let words = shipped("lander")?;
    /// let mut rotation = Rotation::new(&words, &mut Pcg64::seed_from_u64(1));
    /// let ascend = Request { topic: 0, cell: Cell::new(2, 4) };
    /// let mut say = |told: &[&str]| {
    ///     let holding = words.facts_named(told.iter().copied());
    ///     let found = words.retrieve_true(ascend, holding)?;
    ///     let sentence = found.and_then(|found| rotation.next(&found));
    ///     Ok::<_, leadtime_taxonomy::TaxonomyError>(sentence.map(|it| it.text.as_str()))
    /// };
    /// assert_eq!(say(&[])?, Some("Pull up for safety."));
    /// assert!(say(&["zone_below"])?.is_some());
    /// # Ok::<(), leadtime_taxonomy::TaxonomyError>(())
    /// ```
    pub fn retrieve_true(
        &self,
        request: Request,
        holding: FactSet,
    ) -> Result<Option<Retrieved<'_>>, TaxonomyError> {
        let topic = self.topics().get(request.topic).ok_or_else(|| {
            let (topic, n_topics) = (request.topic, self.topics().len());
            TaxonomyError(format!(
                "there is no topic {topic}; the database has {n_topics}, numbered from 0"
            ))
        })?;
        let is_other = |cell: Cell| cell != request.cell;
        let can_be_said = |said: &[Utterance]| said.iter().any(|it| holding.includes(it.facts));
        // Cells come ordered by k, then l, so the first of the least is the one that is wanted.
        let cells = topic.cells().enumerate().filter(|(_, (_, said))| can_be_said(said));
        let nearest =
            cells.min_by_key(|(_, (cell, _))| (is_other(*cell), lost(request.cell, *cell)));
        Ok(nearest.map(|(cell_idx, (cell, utterances))| Retrieved {
            topic: request.topic,
            cell,
            cell_idx,
            utterances,
            holding,
            fallback: is_other(cell),
        }))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use std::collections::BTreeSet;

    use leadtime_numerics::Pcg64;

    use super::*;
    use crate::test_support::header;
    use crate::{Rotation, words};

    /// Writes a database of some topics: sentences, each on a topic, in a cell, with some of the facts `f0` to `f3` by
    /// bits.
    fn database(topics: &[&str], sentences: &[(usize, Cell, u8)]) -> Taxonomy {
        use std::fmt::Write as _;
        let mut text = header(topics);
        for (i, &(topic, Cell { comprehension: k, conveyance: l }, bits)) in
            sentences.iter().enumerate()
        {
            let topic = topics[topic];
            let spoken: Vec<String> = (0..l).map(|word| format!("{topic}{i}x{word}")).collect();
            let curve: Vec<u32> = (1..=l).map(|word| if word < k { 10 } else { 90 }).collect();
            let facts: Vec<&str> = names(bits).collect();
            writeln!(
                text,
                "[[utterance]]\ntopic = \"{topic}\"\ncomprehension = {k}\nconveyance = {l}\ntext = \"{}\"\n\
                 spans = [[\"what\", 0, {k}]]\nfacts = {facts:?}\ncurve = {curve:?}",
                spoken.join(" ")
            )
            .unwrap();
        }
        Taxonomy::from_toml(&text).unwrap()
    }

    /// Writes a database of two topics with one sentence in each of the listed cells.
    fn with_cells(cells: &[(usize, Cell)]) -> Taxonomy {
        let sentences: Vec<_> = cells.iter().map(|&(topic, cell)| (topic, cell, 0)).collect();
        database(&["a", "b"], &sentences)
    }

    /// Writes a database of one topic: sentences, each in a cell, with some of the facts.
    fn with_facts(sentences: &[(Cell, u8)]) -> Taxonomy {
        let sentences: Vec<_> = sentences.iter().map(|&(cell, bits)| (0, cell, bits)).collect();
        database(&["a"], &sentences)
    }

    fn names(bits: u8) -> impl Iterator<Item = &'static str> {
        let all = ["f0", "f1", "f2", "f3"].into_iter().enumerate();
        all.filter(move |(i, _)| bits >> i & 1 == 1).map(|(_, name)| name)
    }

    /// Finds the sentences for a request, whether they are true or not.
    fn retrieve(taxonomy: &Taxonomy, request: Request) -> Retrieved<'_> {
        taxonomy.retrieve_true(request, FactSet::ALL).unwrap().unwrap()
    }

    fn request(topic: usize, k: u32, l: u32) -> Request {
        Request { topic, cell: Cell::new(k, l) }
    }

    #[test]
    fn an_exact_cell_is_taken_and_an_empty_one_gives_the_one_that_loses_least() {
        let cells = [Cell::new(2, 2), Cell::new(4, 4), Cell::new(3, 5)];
        let taxonomy = with_cells(&[(0, cells[0]), (0, cells[1]), (0, cells[2]), (1, cells[0])]);
        let find = |k, l| {
            let found = retrieve(&taxonomy, request(0, k, l));
            assert!(found.fallback);
            found.cell
        };
        let found = retrieve(&taxonomy, request(0, 3, 5));
        assert_eq!((found.cell, found.fallback), (cells[2], false));
        // Two words long: 2 · 0.5. Early and short would cost 1 + 0.5, late and long 3 + 0.5.
        assert_eq!(find(3, 3), Cell::new(3, 5));
        assert_eq!(find(2, 5), Cell::new(2, 2));
        assert_eq!(find(4, 5), Cell::new(4, 4));
        assert_eq!(find(5, 5), Cell::new(4, 4));
        // Never the other topic, not even for its exact cell.
        assert_eq!(retrieve(&taxonomy, request(1, 4, 4)).cell, cells[0]);
        let request = request(2, 2, 2);
        let error = taxonomy.retrieve_true(request, FactSet::ALL).unwrap_err();
        assert_eq!(error.to_string(), "there is no topic 2; the database has 2, numbered from 0");
    }

    #[test]
    fn the_smaller_k_wins_among_equal_losses() {
        // One word early, or two words long: both lose 2.
        let (early, long, asked) = (Cell::new(3, 3), Cell::new(4, 5), Cell::new(4, 3));
        assert_eq!([early, long].map(|cell| lost(asked, cell)), [2, 2]);
        let taxonomy = with_cells(&[(0, long), (0, early), (1, Cell::new(2, 2))]);
        assert_eq!(retrieve(&taxonomy, request(0, 4, 3)).cell, early);
    }

    #[test]
    fn a_cell_whose_sentences_are_false_gives_its_place_to_the_nearest_with_a_true_one() {
        let [asked, near, far] = [Cell::new(3, 3), Cell::new(3, 4), Cell::new(5, 5)];
        let taxonomy = with_facts(&[(asked, 1), (asked, 3), (near, 2), (far, 0)]);
        let find = |holding: u8| {
            let holding = taxonomy.facts_named(names(holding));
            let request = Request { topic: 0, cell: asked };
            taxonomy.retrieve_true(request, holding).unwrap().unwrap()
        };
        let cells = [0, 1, 2, 3].map(|holding| find(holding).cell);
        assert_eq!(cells, [far, asked, near, asked]);
        assert_eq!([0, 1, 2, 3].map(|holding| find(holding).fallback), [true, false, true, false]);
        // Without a fact that everybody tells, the cell alone decides.
        let request = Request { topic: 0, cell: asked };
        assert_eq!(retrieve(&taxonomy, request).cell, asked);
        let taxonomy = with_facts(&[(asked, 1)]);
        let none = taxonomy.retrieve_true(request, FactSet::NONE).unwrap();
        assert_eq!(none, None);
    }

    proptest! {
        #[test]
        fn what_is_said_is_true_and_everything_true_has_its_turn(
            sentences in proptest::collection::vec((0_usize..10, 0_u8..16), 1..24),
            asked in 0_usize..10, holding in 0_u8..16, seed in 0_u64..100,
        ) {
            let cells: Vec<Cell> = Cell::feasible(2, 5).collect();
            let list: Vec<(Cell, u8)> =
                sentences.iter().map(|&(cell, bits)| (cells[cell], bits)).collect();
            let taxonomy = with_facts(&list);
            let request = Request { topic: 0, cell: cells[asked] };
            let told = taxonomy.facts_named(names(holding));
            let found = taxonomy.retrieve_true(request, told).unwrap();
            let is_true = |bits: u8| bits & !holding == 0;
            let sayable = list.iter().filter(|(_, bits)| is_true(*bits));
            let least = sayable.clone().map(|(cell, _)| lost(request.cell, *cell)).min();
            prop_assert_eq!(found.map(|found| lost(request.cell, found.cell)), least);
            let Some(found) = found else { return Ok(()) };
            let n_true = sayable.filter(|(cell, _)| *cell == found.cell).count();
            let mut rotation = Rotation::new(&taxonomy, &mut Pcg64::seed_from_u64(seed));
            let mut said = BTreeSet::new();
            for _ in 0..n_true {
                let sentence = rotation.next(&found).unwrap();
                let presupposed: Vec<&str> = taxonomy.fact_names(sentence.facts).collect();
                prop_assert!(presupposed.iter().all(|fact| names(holding).any(|it| it == *fact)));
                prop_assert_eq!(sentence.cell, found.cell);
                said.insert(sentence.text.clone());
            }
            prop_assert_eq!(said.len(), n_true);
        }

        #[test]
        fn retrieval_keeps_the_topic_and_the_order_of_k_and_l(
            filled in proptest::collection::btree_set((0_usize..2, 0_usize..10), 1..20),
            topic in 0_usize..2, k in 0_u32..8, l in 0_u32..8,
        ) {
            let cells: Vec<Cell> = Cell::feasible(2, 5).collect();
            let mut entries: Vec<(usize, Cell)> =
                filled.iter().map(|&(topic, cell)| (topic, cells[cell])).collect();
            for topic in 0..2 {
                if !entries.iter().any(|entry| entry.0 == topic) {
                    entries.push((topic, Cell::new(2, 3)));
                }
            }
            let taxonomy = with_cells(&entries);
            let found = retrieve(&taxonomy, request(topic, k, l));
            prop_assert_eq!(found.topic, topic);
            prop_assert!(found.cell.comprehension <= found.cell.conveyance);
            prop_assert!(!found.utterances.is_empty());
            for utterance in found.utterances {
                prop_assert_eq!(utterance.cell, found.cell);
                prop_assert!(words::words(&utterance.text)[0].starts_with(["a", "b"][topic]));
            }
            // Nothing in the topic would have lost less, and asking again gives the same.
            for &(other, cell) in &entries {
                if other == topic {
                    let asked = Cell::new(k, l);
                    prop_assert!(lost(asked, found.cell) <= lost(asked, cell));
                }
            }
            let again = retrieve(&taxonomy, request(topic, k, l));
            prop_assert_eq!(again, found);
        }
    }
}
