//! What a sentence presupposes, by the phrases of a plan: "zone below" that there is a zone below.
//!
//! The longest phrase counts, so "car closing behind" says more than "car behind", and a whole sentence may be a phrase.
//! What a topic says of a phrase goes before what the plan says of it: "path clear" is another path to the right than down.

use std::collections::{BTreeMap, BTreeSet};

use super::plan::DatabasePlan;
use crate::words;

/// By phrase, cut into words: the facts that it presupposes.
type PhraseFacts = BTreeMap<Vec<String>, Vec<String>>;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct NamedPhrase<'a> {
    /// Index of its first word.
    pub(super) from: usize,
    /// Index after its last word.
    pub(super) to: usize,
    /// What it presupposes; nothing, if it can never be false.
    pub(super) facts: &'a [String],
}

/// Knows what the phrases of a plan presuppose.
#[derive(Clone, Debug)]
pub(super) struct Presuppositions {
    topics: Vec<PhraseFacts>,
}

impl Presuppositions {
    /// Collects a plan's phrases.
    pub(super) fn new(plan: &DatabasePlan) -> Self {
        let phrases = |own: &BTreeMap<String, Vec<String>>| {
            let all = plan.presupposes.iter().chain(own);
            all.map(|(phrase, facts)| (words::words(phrase), facts.clone())).collect()
        };
        Self { topics: plan.topic.iter().map(|topic| phrases(&topic.presupposes)).collect() }
    }

    /// Finds the phrases of a sentence of a topic, from the left; none runs over a comma.
    pub(super) fn named(&self, topic: usize, text: &str) -> Vec<NamedPhrase<'_>> {
        let phrases = &self.topics[topic];
        let mut found = Vec::new();
        let mut from = 0;
        for clause in text.split(|c: char| ",;:.!".contains(c)) {
            let spoken = words::words(clause);
            let mut at = 0;
            while at < spoken.len() {
                let mut ends = (at + 1..=spoken.len()).rev();
                let longest = ends.find_map(|to| Some((to, phrases.get(&spoken[at..to])?)));
                let to = longest.map_or(at + 1, |(to, _)| to);
                found.extend(longest.map(|(_, facts)| NamedPhrase {
                    from: from + at,
                    to: from + to,
                    facts,
                }));
                at = to;
            }
            from += spoken.len();
        }
        found
    }

    /// Lists the facts that a sentence of a topic presupposes, in the order of the alphabet.
    pub(super) fn facts(&self, topic: usize, text: &str) -> Vec<String> {
        let facts: BTreeSet<String> =
            self.named(topic, text).iter().flat_map(|named| named.facts).cloned().collect();
        facts.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::job;

    fn facts(domain: &str, topic: &str, text: &str) -> Vec<String> {
        let plan = job::plan(domain).unwrap();
        let topic = plan.topic_idx(topic).unwrap();
        Presuppositions::new(&plan).facts(topic, text)
    }

    #[test]
    fn the_longest_phrase_counts() {
        assert_eq!(facts("highway", "speed_up", "Car behind, go faster."), ["car_behind"]);
        let closing = facts("highway", "speed_up", "Car closing behind, go faster.");
        assert_eq!(closing, ["car_closing_behind"]);
        let both = facts("steakhouse", "inform", "Board free, sink occupied.");
        assert_eq!(both, ["board_free", "sink_occupied"]);
        // "Left lane" is not what is said here.
        let closing = facts("highway", "merge_left", "Shift left, lane closing.");
        assert_eq!(closing, ["lane_ends"]);
    }

    #[test]
    fn a_phrase_says_of_each_topic_what_is_meant_there() {
        assert_eq!(facts("lander", "shift_left", "Off course, fly left."), ["off_course_right"]);
        assert_eq!(facts("lander", "shift_right", "Off course, fly right."), ["off_course_left"]);
    }

    #[test]
    fn a_purpose_presupposes_nothing_and_is_known() {
        let plan = job::plan("lander").unwrap();
        let presuppositions = Presuppositions::new(&plan);
        let named = presuppositions.named(0, "For safety, climb now.");
        assert_eq!(named, [NamedPhrase { from: 0, to: 2, facts: &[] }]);
        assert!(presuppositions.named(0, "Climb now.").is_empty());
    }
}
