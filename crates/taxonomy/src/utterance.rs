//! One sentence of the database, and what is known about how it is heard.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::facts::FactSet;

/// When a sentence is understood and when it is over: the place of an utterance within its topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Comprehension time k, in words.
    pub comprehension: u32,
    /// Conveyance time l, in words.
    pub conveyance: u32,
}

impl Cell {
    /// Makes the cell of a comprehension time k and a conveyance time l, in words.
    pub const fn new(comprehension: u32, conveyance: u32) -> Self {
        Self { comprehension, conveyance }
    }

    /// Lists the cells that can be: `from` <= k <= l <= `to`, ordered by k, then l.
    ///
    /// Of the 16 pairs with two to five words, 10 can be: nothing is understood after it is over.
    pub fn feasible(from: u32, to: u32) -> impl Iterator<Item = Self> {
        (from..=to).flat_map(move |k| (k..=to).map(move |l| Self::new(k, l)))
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {})", self.comprehension, self.conveyance)
    }
}

/// What a part of a sentence does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpanKind {
    /// Says what to do: the directive. Every utterance has exactly one.
    What,
    /// Says in which manner, or how soon.
    How,
    /// Says for which reason.
    Why,
}

/// Some words of a sentence that belong together: `["why", 0, 2]` in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "(SpanKind, u32, u32)", into = "(SpanKind, u32, u32)")]
pub struct WordSpan {
    /// What the words do.
    pub part: SpanKind,
    /// Index of the first word, from 0.
    pub from: u32,
    /// Index after the last word.
    pub to: u32,
}

impl From<(SpanKind, u32, u32)> for WordSpan {
    fn from((part, from, to): (SpanKind, u32, u32)) -> Self {
        Self { part, from, to }
    }
}

impl From<WordSpan> for (SpanKind, u32, u32) {
    fn from(span: WordSpan) -> Self {
        (span.part, span.from, span.to)
    }
}

/// What made a database; only the first reproduces the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fidelity {
    /// Written and rated by an instruction-tuned language model of the source's class (Llama-3-8B or more).
    Paper,
    /// Written and rated by an annotator who followed the two prompts; no experiment, no language model run.
    Authored,
    /// Put together from phrase lists; k is the place of the directive's last word.
    Grammar,
    /// Written or rated by a smaller stand-in: good for trying the pipeline.
    Local,
}

impl Fidelity {
    /// Returns the name as files spell it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Authored => "authored",
            Self::Grammar => "grammar",
            Self::Local => "local",
        }
    }
}

/// A sentence and how it is heard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Utterance {
    /// As it is spoken: `Zone ahead, go up.`
    pub text: String,
    /// The cell (k, l) that it belongs to.
    pub cell: Cell,
    /// What, How and Why, in order; words in none of them are fillers.
    pub spans: Vec<WordSpan>,
    /// What must hold for it to be true; [`Taxonomy::fact_names`](crate::Taxonomy::fact_names) names it.
    pub facts: FactSet,
    /// Comprehension after each word, in percent; never falls. Shape `[l]`.
    pub curve: Vec<u8>,
    /// The threshold was crossed before the least k that a notifier can choose.
    pub clamped: bool,
    /// End of each word from the start of speech, in milliseconds, where a recording is known. Shape `[l]` or `[0]`.
    pub word_end_ms: Vec<u32>,
    /// Place among the representatives of its cell, from 0.
    pub medoid: u32,
    /// Where it comes from: the key of a call, or who wrote it.
    pub source: String,
}

impl Utterance {
    /// Returns the directive's words.
    pub fn what(&self) -> Option<WordSpan> {
        self.spans.iter().copied().find(|span| span.part == SpanKind::What)
    }

    /// Computes where understanding should come by structure alone: the place of the directive's last word, from 1.
    pub fn structural_comprehension(&self) -> Option<u32> {
        self.what().map(|what| what.to)
    }

    /// Returns whether it states a reason, before or after the directive: `I_why` of the informativeness α·l +
    /// β·`I_why`.
    ///
    /// # Source
    ///
    /// arXiv:2509.07438, informativeness. It labels "Press the pedal slowly to speed up." as ending in a Why, and calls
    /// its `I_why` 0 all the same. Here a reason counts wherever it stands: a listener hears it.
    pub fn states_reason(&self) -> bool {
        self.spans.iter().any(|span| span.part == SpanKind::Why)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn utterance(text: &str, spans: &[(SpanKind, u32, u32)]) -> Utterance {
        let (l, text, source) = (crate::words::count(text), text.to_owned(), "test".to_owned());
        let spans = spans.iter().map(|span| WordSpan::from(*span)).collect();
        let (curve, word_end_ms, cell) = (vec![100; l as usize], Vec::new(), Cell::new(l, l));
        let facts = FactSet::NONE;
        Utterance {
            text,
            cell,
            spans,
            facts,
            curve,
            clamped: false,
            word_end_ms,
            medoid: 0,
            source,
        }
    }

    #[test]
    fn ten_of_sixteen_cells_can_be() {
        let cells: Vec<Cell> = Cell::feasible(2, 5).collect();
        assert_eq!(cells.len(), 10);
        assert!(cells.is_sorted());
        assert!(cells.iter().all(|cell| cell.comprehension <= cell.conveyance));
    }

    #[test]
    fn a_reason_counts_before_and_after_the_directive() {
        let trails = utterance(
            "Press the pedal slowly to speed up.",
            &[(SpanKind::What, 0, 4), (SpanKind::Why, 4, 7)],
        );
        let leads = utterance(
            "To speed up, press the pedal slowly.",
            &[(SpanKind::Why, 0, 3), (SpanKind::What, 3, 7)],
        );
        let without = utterance("Press the pedal slowly.", &[(SpanKind::What, 0, 4)]);
        let stated = [&trails, &leads, &without].map(Utterance::states_reason);
        assert_eq!(stated, [true, true, false]);
        assert_eq!(leads.structural_comprehension(), Some(7));
    }
}
