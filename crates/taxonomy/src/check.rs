//! What a readable database may still lack: cells without sentences, or with too few to take turns.

use std::fmt;

use crate::database::Taxonomy;
use crate::utterance::Cell;

/// Something that a person should know before they use a database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// No sentence: retrieval falls back to another cell.
    EmptyCell {
        /// The topic.
        topic: String,
        /// The cell.
        cell: Cell,
    },
    /// Fewer sentences than wanted.
    ThinCell {
        /// The topic.
        topic: String,
        /// The cell.
        cell: Cell,
        /// Sentences there.
        found: usize,
        /// Sentences wanted.
        wanted: usize,
    },
    /// The rating and the structure disagree by more than a word.
    FarFromStructure {
        /// The topic.
        topic: String,
        /// The sentence.
        text: String,
        /// k as rated.
        rated: u32,
        /// Place of the directive's last word.
        structural: u32,
    },
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EmptyCell { topic, cell } => {
                write!(f, "topic `{topic}` has nothing at (k, l) = {cell}")
            }
            Self::ThinCell { topic, cell, found, wanted } => {
                write!(f, "topic `{topic}` has {found} of {wanted} utterances at (k, l) = {cell}")
            }
            Self::FarFromStructure { topic, text, rated, structural } => write!(
                f,
                "topic `{topic}`, \"{text}\": understood at word {rated}, its directive ends with word {structural}"
            ),
        }
    }
}

/// Lists what a database lacks; `wanted` is the number of sentences that every feasible cell should have.
pub fn check(taxonomy: &Taxonomy, wanted: usize) -> Vec<Finding> {
    let mut findings = Vec::new();
    for topic in taxonomy.topics() {
        let name = || topic.name().to_owned();
        for cell in taxonomy.feasible() {
            match topic.cell(cell).len() {
                0 => findings.push(Finding::EmptyCell { topic: name(), cell }),
                found if found < wanted => {
                    findings.push(Finding::ThinCell { topic: name(), cell, found, wanted });
                }
                _ => {}
            }
        }
        for utterance in topic.utterances() {
            let rated = utterance.cell.comprehension;
            let structural = utterance.structural_comprehension().unwrap_or(rated);
            if rated.abs_diff(structural) > 1 {
                let text = utterance.text.clone();
                findings.push(Finding::FarFromStructure { topic: name(), text, rated, structural });
            }
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"schema = 1
domain = "road"
fidelity = "grammar"
generator = "g"
rater = "r"
embedder = "e"
theta = 70
words = [2, 5]
topics = ["merge_left"]
config = ""
[[utterance]]
topic = "merge_left"
comprehension = 2
conveyance = 4
text = "Truck ahead, merge left."
spans = [["why", 0, 2], ["what", 2, 4]]
curve = [5, 80, 85, 95]
"#;

    #[test]
    fn gaps_and_odd_ratings_are_listed() {
        let taxonomy = Taxonomy::from_toml(TEXT).unwrap();
        let findings: Vec<String> = check(&taxonomy, 3).iter().map(ToString::to_string).collect();
        assert_eq!(findings.len(), 11);
        assert_eq!(findings[0], "topic `merge_left` has nothing at (k, l) = (2, 2)");
        assert_eq!(findings[2], "topic `merge_left` has 1 of 3 utterances at (k, l) = (2, 4)");
        assert_eq!(
            findings[10],
            "topic `merge_left`, \"Truck ahead, merge left.\": understood at word 2, its directive ends with word 4"
        );
        assert_eq!(check(&taxonomy, 1).len(), 10);
    }
}
