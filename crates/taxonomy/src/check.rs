//! What a readable database may still lack: cells without sentences, with too few to take turns, or with none that is always
//! true.

use thiserror::Error;

use crate::database::Taxonomy;
use crate::facts::FactSet;

/// Something that a person should know before they use a database: an empty cell, a thin one, one that may have nothing
/// true to say, or a sentence whose rating and structure disagree by more than a word.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("topic `{topic}`{says}")]
pub struct Finding {
    topic: String,
    says: String,
}

impl Finding {
    /// Says something of a topic, or of one of its sentences.
    #[cfg(feature = "pipeline")]
    pub(crate) fn new(topic: &str, says: String) -> Self {
        Self { topic: topic.to_owned(), says }
    }
}

/// Lists what a database lacks; `wanted` is the number of sentences that every feasible cell should have.
pub fn check(taxonomy: &Taxonomy, wanted: usize) -> Vec<Finding> {
    let mut findings = Vec::new();
    for topic in taxonomy.topics() {
        let mut find = |says| findings.push(Finding { topic: topic.name().to_owned(), says });
        for cell in taxonomy.feasible() {
            match topic.cell(cell).len() {
                0 => find(format!(" has nothing at (k, l) = {cell}")),
                n if n < wanted => {
                    find(format!(" has {n} of {wanted} utterances at (k, l) = {cell}"));
                }
                _ => {}
            }
            let said = topic.cell(cell);
            if !said.is_empty() && said.iter().all(|it| it.facts != FactSet::NONE) {
                find(format!(" has no utterance at (k, l) = {cell} that is always true"));
            }
        }
        for utterance in topic.utterances() {
            let rated = utterance.cell.comprehension;
            let structural = utterance.structural_comprehension().unwrap_or(rated);
            if rated.abs_diff(structural) > 1 {
                let text = &utterance.text;
                find(format!(
                    ", \"{text}\": understood at word {rated}, its directive ends with word {structural}"
                ));
            }
        }
    }
    findings
}

/// Lists the sentences that are never said, because the domain does not tell a fact that they presuppose; `told` are the
/// names of those that it does.
pub fn check_facts(taxonomy: &Taxonomy, told: &[&str]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for topic in taxonomy.topics() {
        for utterance in topic.utterances() {
            let mut names = taxonomy.fact_names(utterance.facts);
            if let Some(fact) = names.find(|name| !told.contains(name)) {
                let text = &utterance.text;
                let says = format!(
                    ", \"{text}\": it is never said, because it presupposes `{fact}`, which the domain does not tell"
                );
                findings.push(Finding { topic: topic.name().to_owned(), says });
            }
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::header;

    const SENTENCE: &str = r#"[[utterance]]
topic = "merge_left"
comprehension = 2
conveyance = 4
text = "Truck ahead, merge left."
spans = [["why", 0, 2], ["what", 2, 4]]
curve = [5, 80, 85, 95]
"#;

    #[test]
    fn gaps_and_odd_ratings_are_listed() {
        let text = header(&["merge_left"]) + SENTENCE;
        let taxonomy = Taxonomy::from_toml(&text).unwrap();
        let findings: Vec<String> = check(&taxonomy, 3).iter().map(ToString::to_string).collect();
        assert_eq!(findings.len(), 11);
        assert_eq!(findings[0], "topic `merge_left` has nothing at (k, l) = (2, 2)");
        assert_eq!(findings[2], "topic `merge_left` has 1 of 3 utterances at (k, l) = (2, 4)");
        assert_eq!(
            findings[10],
            "topic `merge_left`, \"Truck ahead, merge left.\": understood at word 2, its directive ends with word 4"
        );
        assert_eq!(check(&taxonomy, 1).len(), 10);
        let text = text.replace("curve =", "facts = [\"truck_ahead\"]\ncurve =");
        let findings = check(&Taxonomy::from_toml(&text).unwrap(), 1);
        assert_eq!(findings.len(), 11);
        assert_eq!(
            findings[2].to_string(),
            "topic `merge_left` has no utterance at (k, l) = (2, 4) that is always true"
        );
    }
}
