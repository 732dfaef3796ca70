//! From a message to a sentence: the one place where words are found.

use std::sync::Arc;

use leadtime_numerics::Pcg64;
use leadtime_sims::Message;
use leadtime_taxonomy::{Cell, FactSet, Request, Rotation, Taxonomy};
use serde::{Deserialize, Serialize};

use crate::observation::FactList;

/// A sentence for a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Phrase<'a> {
    /// As it is spoken; empty for a notifier without words.
    pub text: &'a str,
    /// No sentence has exactly the message's k and l; this one stands in.
    pub stand_in: bool,
}

/// The sentences of a session, in turn.
#[derive(Clone, Debug)]
pub struct PhraseBook {
    taxonomy: Option<Arc<Taxonomy>>,
    /// Whose turn it is in each cell; nothing without words.
    rotation: Option<Rotation>,
}

/// Whose turn it is, as a snapshot keeps it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PhraseTurns(Option<Rotation>);

impl PhraseBook {
    /// Takes the sentences of a database, or none.
    pub fn new(taxonomy: Option<Arc<Taxonomy>>) -> Self {
        Self { taxonomy, rotation: None }
    }

    /// Starts an episode, whose generator draws which sentence of each cell comes first.
    pub fn begin(&mut self, generator: &mut Pcg64) {
        let taxonomy = self.taxonomy.as_ref();
        self.rotation = taxonomy.map(|taxonomy| Rotation::new(taxonomy, generator));
    }

    /// Finds a true sentence for a message; `None` if there is none.
    ///
    /// `facts` is what the client says to be the case. Without it nothing is known to hold, so only what presupposes nothing
    /// is said; the shipped databases have such a sentence for every message.
    pub fn find(&mut self, message: Message, facts: Option<&FactList>) -> Option<Phrase<'_>> {
        let (Some(taxonomy), Some(rotation)) = (&self.taxonomy, &mut self.rotation) else {
            return Some(Phrase { text: "", stand_in: false });
        };
        let cell = Cell::new(message.comprehension, message.conveyance);
        let request = Request { topic: message.topic, cell };
        let holding = facts.map_or(FactSet::NONE, |facts| taxonomy.facts_named(facts.iter()));
        let found = taxonomy.retrieve_true(request, holding).ok()??;
        let text = rotation.next(&found)?.text.as_str();
        Some(Phrase { text, stand_in: found.fallback })
    }

    /// Returns whose turn it is.
    pub fn turns(&self) -> PhraseTurns {
        PhraseTurns(self.rotation.clone())
    }

    /// Continues from saved turns; `false` if they belong to another database.
    pub fn restore(&mut self, turns: &PhraseTurns) -> bool {
        let fits = match (&self.taxonomy, &turns.0) {
            (None | Some(_), None) => true,
            (Some(taxonomy), Some(rotation)) => rotation.fits(taxonomy),
            (None, Some(_)) => false,
        };
        if fits {
            self.rotation.clone_from(&turns.0);
        }
        fits
    }
}

#[cfg(test)]
mod tests {
    use leadtime_taxonomy::shipped;

    use super::*;
    use crate::observation::LiveObservation;

    /// An observation that tells these facts.
    fn telling(facts: &[String]) -> LiveObservation {
        let mut observation = LiveObservation::new(1);
        let json = format!("{{\"seq\":1,\"t\":0,\"obs\":[0],\"facts\":{facts:?}}}");
        observation.read_json(json.as_bytes()).unwrap();
        observation
    }

    /// Says every message of a domain many times; returns how many facts the sentences presuppose, all of which are told.
    fn say_everything(taxonomy: &Arc<Taxonomy>, facts: Option<&FactList>) -> usize {
        let mut phrases = PhraseBook::new(Some(Arc::clone(taxonomy)));
        phrases.begin(&mut Pcg64::seed_from_u64(5));
        let mut n_presupposed = 0;
        let topics = 0..taxonomy.topics().len();
        let cells = topics.flat_map(|topic| taxonomy.feasible().map(move |cell| (topic, cell)));
        for (topic, cell) in cells.flat_map(|it| std::iter::repeat_n(it, 20)) {
            let Cell { comprehension, conveyance } = cell;
            let message = Message { topic, comprehension, conveyance };
            let Phrase { text, stand_in } = phrases.find(message, facts).unwrap();
            assert!(!stand_in, "{topic}, {cell}: {text}");
            let sentences = taxonomy.topics()[topic].cell(cell);
            let sentence = sentences.iter().find(|it| it.text == text).unwrap();
            let presupposed: Vec<&str> = taxonomy.fact_names(sentence.facts).collect();
            let is_told = |fact: &&str| facts.is_some_and(|facts| facts.contains(fact));
            assert!(presupposed.iter().all(is_told), "{text}: {presupposed:?}");
            n_presupposed += presupposed.len();
        }
        n_presupposed
    }

    #[test]
    fn what_is_said_is_true_and_without_facts_presupposes_nothing() {
        for domain in shipped::domains() {
            let taxonomy = Arc::new(leadtime_taxonomy::shipped(domain).unwrap());
            let observation = telling(&taxonomy.facts()[..1]);
            assert_eq!(say_everything(&taxonomy, None), 0, "{domain}");
            assert!(say_everything(&taxonomy, observation.facts()) > 0, "{domain}");
        }
    }

    #[test]
    fn sentences_take_turns_and_go_on_from_a_snapshot() {
        let taxonomy = Arc::new(leadtime_taxonomy::shipped("lander").unwrap());
        let mut phrases = PhraseBook::new(Some(taxonomy));
        phrases.begin(&mut Pcg64::seed_from_u64(3));
        let message = Message { topic: 1, comprehension: 2, conveyance: 4 };
        // Where everything holds, every sentence has its turn.
        let observation = telling(phrases.taxonomy.as_ref().unwrap().facts());
        let facts = observation.facts();
        let first = phrases.find(message, facts).unwrap().text.to_owned();
        let turns = phrases.turns();
        let second = phrases.find(message, facts).unwrap().text.to_owned();
        assert_ne!(first, second);
        let mut restored = PhraseBook::new(phrases.taxonomy.clone());
        assert!(restored.restore(&turns));
        assert_eq!(restored.find(message, facts).unwrap().text, second);
        let steakhouse = Arc::new(leadtime_taxonomy::shipped("steakhouse").unwrap());
        assert!(!PhraseBook::new(Some(steakhouse)).restore(&turns));
        let mut wordless = PhraseBook::new(None);
        assert_eq!(wordless.find(message, None), Some(Phrase { text: "", stand_in: false }));
    }
}
