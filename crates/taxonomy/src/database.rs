//! The database, checked: whatever [`Taxonomy::from_toml`] returns cannot be wrong any more.
//!
//! What is proven of every sentence: its words are l, its curve never falls and reaches the threshold at its k, its
//! spans lie within it and hold exactly one directive, no other sentence has the same words. What cannot be proven
//! (that it reads well) is for a person and the coverage report.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;

use crate::error::{Defect, TaxonomyError};
use crate::raw::{self, RawDatabase, RawUtterance, SCHEMA};
use crate::utterance::{Cell, Fidelity, SpanKind, Utterance};
use crate::words;

/// The most words that a sentence may have.
pub const MAX_WORDS: u32 = 20;

/// What a file says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatabaseHeader {
    /// The domain whose topics these are.
    pub domain: String,
    /// What made it.
    pub fidelity: Fidelity,
    /// Who wrote the sentences.
    pub generator: String,
    /// Who rated how they are understood.
    pub rater: String,
    /// What chose the representatives.
    pub embedder: String,
    /// Comprehension from which on a listener acts, in percent.
    pub theta: u8,
    /// Least and greatest number of words.
    pub words: [u32; 2],
    /// Hash of the configuration it was made with.
    pub config: String,
}

/// The sentences of one topic, ordered by k, l, rank and text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    name: String,
    utterances: Vec<Utterance>,
    /// Where the sentences of each filled cell lie, ordered by cell.
    cells: Vec<(Cell, Range<usize>)>,
}

impl Topic {
    fn new(name: String, mut utterances: Vec<Utterance>) -> Self {
        utterances.sort_by(|a, b| (a.cell, a.medoid, &a.text).cmp(&(b.cell, b.medoid, &b.text)));
        let mut cells: Vec<(Cell, Range<usize>)> = Vec::new();
        for (i, utterance) in utterances.iter().enumerate() {
            match cells.last_mut() {
                Some((cell, range)) if *cell == utterance.cell => range.end = i + 1,
                _ => cells.push((utterance.cell, i..i + 1)),
            }
        }
        Self { name, utterances, cells }
    }

    /// Returns the name, as the domain spells it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns every sentence.
    pub fn utterances(&self) -> &[Utterance] {
        &self.utterances
    }

    /// Returns the sentences of a cell; none if it is empty.
    pub fn cell(&self, cell: Cell) -> &[Utterance] {
        match self.cells.binary_search_by_key(&cell, |(cell, _)| *cell) {
            Ok(i) => &self.utterances[self.cells[i].1.clone()],
            Err(_) => &[],
        }
    }

    /// Lists the filled cells in order, each with its sentences.
    pub fn cells(&self) -> impl Iterator<Item = (Cell, &[Utterance])> {
        self.cells.iter().map(|(cell, range)| (*cell, &self.utterances[range.clone()]))
    }

    /// Returns the place of a filled cell among the filled cells.
    pub(crate) fn cell_idx(&self, cell: Cell) -> Option<usize> {
        self.cells.binary_search_by_key(&cell, |(cell, _)| *cell).ok()
    }
}

/// Sentences by topic and cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taxonomy {
    header: DatabaseHeader,
    topics: Vec<Topic>,
}

impl Taxonomy {
    /// Reads a database.
    ///
    /// # Errors
    ///
    /// [`TaxonomyError`] naming the line, the key or the sentence, what it has and what is allowed.
    ///
    /// # Example
    ///
    /// ```
    /// let lander = leadtime_taxonomy::shipped("lander")?;
    /// assert_eq!(lander.topics()[0].name(), "ascend");
    /// # Ok::<(), leadtime_taxonomy::TaxonomyError>(())
    /// ```
    pub fn from_toml(text: &str) -> Result<Self, TaxonomyError> {
        let raw = raw::read(text)?;
        check_header(&raw)?;
        let mut seen = BTreeMap::new();
        let mut topics: Vec<Vec<Utterance>> = raw.topics.iter().map(|_| Vec::new()).collect();
        for (index, utterance) in raw.utterance.iter().enumerate() {
            let fail = |defect| TaxonomyError::Utterance {
                index,
                topic: utterance.topic.clone(),
                text: utterance.text.clone(),
                defect,
            };
            let topic = raw.topics.iter().position(|topic| *topic == utterance.topic);
            let topic = topic.ok_or_else(|| fail(Defect::UnknownTopic))?;
            let key = words::normalised(&utterance.text);
            if let Some(other) = seen.insert(key, utterance.topic.clone()) {
                return Err(fail(Defect::Duplicate { other }));
            }
            topics[topic].push(checked(utterance, &raw).map_err(fail)?);
        }
        let topics: Vec<Topic> = raw
            .topics
            .iter()
            .cloned()
            .zip(topics)
            .map(|(name, list)| Topic::new(name, list))
            .collect();
        if let Some(empty) = topics.iter().find(|topic| topic.utterances.is_empty()) {
            return Err(TaxonomyError::EmptyTopic { topic: empty.name.clone() });
        }
        let header = DatabaseHeader {
            domain: raw.domain,
            fidelity: raw.fidelity,
            generator: raw.generator,
            rater: raw.rater,
            embedder: raw.embedder,
            theta: raw.theta,
            words: raw.words,
            config: raw.config,
        };
        Ok(Self { header, topics })
    }

    /// Returns what the file says of itself.
    pub fn header(&self) -> &DatabaseHeader {
        &self.header
    }

    /// Returns the topics, in the order of their ids.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Lists the cells that a notifier could choose, filled or not.
    pub fn feasible(&self) -> impl Iterator<Item = Cell> {
        let [from, to] = self.header.words;
        Cell::feasible(from, to)
    }

    /// Makes sure that the topics are a domain's, in its order.
    ///
    /// # Errors
    ///
    /// [`TaxonomyError::OtherTopics`] with both lists.
    pub fn expect_topics(&self, expected: &[&str]) -> Result<(), TaxonomyError> {
        if self.topics.iter().map(Topic::name).eq(expected.iter().copied()) {
            return Ok(());
        }
        let found = self.topics.iter().map(|topic| topic.name.clone()).collect();
        let expected = expected.iter().map(|&topic| topic.to_owned()).collect();
        Err(TaxonomyError::OtherTopics { found, expected })
    }
}

fn require(
    holds: bool,
    key: &'static str,
    given: impl fmt::Display,
    allowed: &'static str,
) -> Result<(), TaxonomyError> {
    if holds {
        Ok(())
    } else {
        Err(TaxonomyError::Header { key, given: given.to_string(), allowed })
    }
}

fn check_header(raw: &RawDatabase) -> Result<(), TaxonomyError> {
    require(raw.schema == SCHEMA, "schema", raw.schema, "1")?;
    require(!raw.domain.is_empty(), "domain", "empty", "the name of a domain")?;
    require((1..=100).contains(&raw.theta), "theta", raw.theta, "1 to 100 percent")?;
    let [from, to] = raw.words;
    let fits = 1 <= from && from <= to && to <= MAX_WORDS;
    require(fits, "words", format!("[{from}, {to}]"), "[least, greatest] within 1 to 20")?;
    let mut names: Vec<&str> = raw.topics.iter().map(String::as_str).collect();
    names.sort_unstable();
    names.dedup();
    let distinct = !names.is_empty() && names.len() == raw.topics.len();
    require(distinct, "topics", format!("{:?}", raw.topics), "at least one name, each once")
}

/// Checks one sentence on its own.
fn checked(raw: &RawUtterance, database: &RawDatabase) -> Result<Utterance, Defect> {
    let cell = Cell::new(raw.comprehension, raw.conveyance);
    let [from, to] = database.words;
    if cell.comprehension < from || cell.comprehension > cell.conveyance || cell.conveyance > to {
        return Err(Defect::Infeasible { cell, from, to });
    }
    let counted = words::count(&raw.text);
    if counted != cell.conveyance {
        return Err(Defect::WordCount { counted, stated: cell.conveyance });
    }
    check_curve(raw, database.theta, from)?;
    check_spans(raw)?;
    check_word_ends(raw)?;
    Ok(Utterance {
        text: raw.text.clone(),
        cell,
        spans: raw.spans.clone(),
        curve: raw.curve.clone(),
        clamped: raw.clamped,
        word_end_ms: raw.word_end_ms.clone(),
        medoid: raw.medoid,
        source: raw.source.clone(),
    })
}

fn check_curve(raw: &RawUtterance, theta: u8, from: u32) -> Result<(), Defect> {
    if raw.curve.len() != raw.conveyance as usize {
        let (given, allowed) = (raw.curve.len(), raw.conveyance);
        return Err(Defect::Length { list: "curve", given, allowed });
    }
    if let Some(&given) = raw.curve.iter().find(|&&percent| percent > 100) {
        return Err(Defect::Percent { given });
    }
    if let Some(i) = raw.curve.windows(2).position(|pair| pair[1] < pair[0]) {
        return Err(Defect::Falls { list: "curve", word: i + 2 });
    }
    let crossing = raw.curve.iter().position(|&percent| percent >= theta).map(|i| i as u32 + 1);
    let stated = raw.comprehension;
    let holds = match crossing {
        Some(word) if raw.clamped => word < from && stated == from,
        Some(word) => word == stated,
        None => false,
    };
    if holds { Ok(()) } else { Err(Defect::Crossing { theta, crossing, stated }) }
}

fn check_spans(raw: &RawUtterance) -> Result<(), Defect> {
    let mut end = 0;
    for span in &raw.spans {
        if span.from < end || span.to <= span.from || span.to > raw.conveyance {
            return Err(Defect::Spans { words: raw.conveyance });
        }
        end = span.to;
    }
    let given = raw.spans.iter().filter(|span| span.part == SpanKind::What).count();
    if given == 1 { Ok(()) } else { Err(Defect::Directives { given }) }
}

fn check_word_ends(raw: &RawUtterance) -> Result<(), Defect> {
    let ends = &raw.word_end_ms;
    if !ends.is_empty() && ends.len() != raw.conveyance as usize {
        let (given, allowed) = (ends.len(), raw.conveyance);
        return Err(Defect::Length { list: "word_end_ms", given, allowed });
    }
    match ends.windows(2).position(|pair| pair[1] <= pair[0]) {
        Some(i) => Err(Defect::Falls { list: "word_end_ms", word: i + 2 }),
        None => Ok(()),
    }
}

#[cfg(test)]
#[path = "database_tests.rs"]
mod tests;
