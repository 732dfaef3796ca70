//! The database, checked: whatever [`Taxonomy::from_toml`] returns cannot be wrong any more.
//!
//! What is proven of every sentence: its words are l, its curve never falls and reaches the threshold at its k, its
//! spans lie within it and hold exactly one directive, no other sentence has the same words. What cannot be proven
//! (that it reads well) is for a person and the coverage report.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use crate::error::TaxonomyError;
use crate::facts::{self, FactSet, MAX_FACTS};
use crate::raw::{RawDatabase, RawUtterance, SCHEMA};
use crate::utterance::{Cell, Fidelity, SpanKind, Utterance};
use crate::words;

/// The most words that a sentence may have.
pub const MAX_WORDS: u32 = 20;

/// What a file says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatabaseHeader {
    /// The domain whose topics these are.
    pub domain: String,
    /// How the sentences were made, and so what may be claimed of them.
    pub fidelity: Fidelity,
    /// Who wrote the sentences.
    pub generator: String,
    /// Who rated how they are understood.
    pub rater: String,
    /// Comprehension from which on a listener acts, in percent.
    pub theta: u8,
    /// Least and greatest number of words.
    pub words: [u32; 2],
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

    /// Returns every sentence of the topic, cell by cell.
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
}

/// Sentences by topic and cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taxonomy {
    header: DatabaseHeader,
    topics: Vec<Topic>,
    /// Names of what sentences presuppose, in the order of the alphabet.
    facts: Vec<String>,
    /// Those that the plan of the domain names.
    planned: FactSet,
}

impl Taxonomy {
    /// Reads a database.
    ///
    /// # Errors
    ///
    /// [`TaxonomyError`] if the text is no TOML of this schema, if a sentence breaks a rule, if two sentences have the
    /// same words, or if a topic has none. It names the line, the key or the sentence, what it has and what is allowed.
    ///
    /// # Example
    ///
    /// ```
    /// let lander = leadtime_taxonomy::shipped("lander")?;
    /// assert_eq!(lander.topics()[0].name(), "ascend");
    /// # Ok::<(), leadtime_taxonomy::TaxonomyError>(())
    /// ```
    pub fn from_toml(text: &str) -> Result<Self, TaxonomyError> {
        Self::from_raw(RawDatabase::read(text)?)
    }

    /// Checks a database as it was written.
    pub(crate) fn from_raw(raw: RawDatabase) -> Result<Self, TaxonomyError> {
        check_header(&raw)?;
        let facts = fact_names(&raw)?;
        let mut seen = BTreeMap::new();
        let mut topics: Vec<Vec<Utterance>> = raw.topics.iter().map(|_| Vec::new()).collect();
        for (index, utterance) in raw.utterance.iter().enumerate() {
            let RawUtterance { topic, text, .. } = utterance;
            let fail = |defect: String| utterance.wrong(index, &defect);
            let topic_idx = raw.topics.iter().position(|name| name == topic);
            let topic_idx =
                topic_idx.ok_or_else(|| fail("its topic is not in `topics`".to_owned()))?;
            if let Some(other) = seen.insert(words::normalised(text), topic.clone()) {
                return Err(fail(format!("the same words stand under topic `{other}` already")));
            }
            topics[topic_idx].push(checked(utterance, &raw, &facts).map_err(fail)?);
        }
        let topics = raw.topics.into_iter().zip(topics);
        let topics: Vec<Topic> = topics.map(|(name, list)| Topic::new(name, list)).collect();
        if let Some(Topic { name, .. }) = topics.iter().find(|topic| topic.utterances.is_empty()) {
            return Err(TaxonomyError(format!(
                "topic `{name}` has no utterance; every topic of the header needs at least one"
            )));
        }
        let RawDatabase { domain, fidelity, generator, rater, theta, words, .. } = raw;
        let header = DatabaseHeader { domain, fidelity, generator, rater, theta, words };
        Ok(Self { header, topics, facts, planned: FactSet::NONE })
    }

    /// Returns what the file says of itself.
    pub fn header(&self) -> &DatabaseHeader {
        &self.header
    }

    /// Returns the topics, in the order of their ids.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Returns the names of all facts that some sentence presupposes, in the order of the alphabet.
    pub fn facts(&self) -> &[String] {
        &self.facts
    }

    /// Finds which of its facts are among some names: those of the facts that hold now, or are stated at all.
    ///
    /// A name that no sentence needs is passed over. Allocates nothing.
    pub fn facts_named<'n>(&self, names: impl IntoIterator<Item = &'n str>) -> FactSet {
        let place = |name: &str| self.facts.binary_search_by(|fact| fact.as_str().cmp(name)).ok();
        names.into_iter().filter_map(place).fold(FactSet::NONE, FactSet::with)
    }

    /// Lists the names of some of its facts.
    pub fn fact_names(&self, facts: FactSet) -> impl Iterator<Item = &str> {
        facts.places().filter_map(|place| self.facts.get(place)).map(String::as_str)
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
    /// [`TaxonomyError`] if the topics or their order differ, with both lists.
    pub fn expect_topics(&self, expected: &[&str]) -> Result<(), TaxonomyError> {
        if self.topics.iter().map(Topic::name).eq(expected.iter().copied()) {
            return Ok(());
        }
        let found: Vec<&str> = self.topics.iter().map(Topic::name).collect();
        let (found, expected) = (found.join(", "), expected.join(", "));
        Err(TaxonomyError(format!("the database speaks of [{found}], the domain of [{expected}]")))
    }

    /// Notes what the plan of the domain names: a sentence that presupposes it is no mistake where the domain does not tell it. It is
    /// never said, and the others are.
    #[cfg(feature = "pipeline")]
    pub(crate) fn planned<'n>(self, names: impl IntoIterator<Item = &'n str>) -> Self {
        let planned = self.facts_named(names);
        Self { planned, ..self }
    }

    /// Makes sure that a domain states every fact that a sentence presupposes, those excepted that its plan names.
    ///
    /// # Errors
    ///
    /// [`TaxonomyError`] if a sentence presupposes another fact that is not in `told`, with the sentence, the fact, and those
    /// that the domain states.
    pub fn expect_facts(&self, told: &[&str]) -> Result<(), TaxonomyError> {
        // One slip of a model, or of a person, must not make the other sentences useless.
        let told_here = self.facts_named(told.iter().copied());
        let known = self.planned.places().fold(told_here, FactSet::with);
        let is_known = |place: usize| known.includes(FactSet::NONE.with(place));
        let mut all = self.topics.iter().flat_map(|topic| &topic.utterances);
        let Some(Utterance { text, facts, .. }) = all.find(|it| !known.includes(it.facts)) else {
            return Ok(());
        };
        let fact = facts.places().find(|place| !is_known(*place));
        let fact = fact.map_or("", |place| self.facts[place].as_str());
        let told = if told.is_empty() { "nothing".to_owned() } else { told.join(", ") };
        Err(TaxonomyError(format!(
            "\"{text}\" presupposes `{fact}`, which the domain does not tell; it tells {told}"
        )))
    }
}

/// Lists what the sentences of a file presuppose.
fn fact_names(raw: &RawDatabase) -> Result<Vec<String>, TaxonomyError> {
    let mut names = BTreeSet::new();
    for (index, utterance) in raw.utterance.iter().enumerate() {
        for name in utterance.facts.iter().flatten() {
            if !facts::is_name(name) {
                let defect =
                    format!("`{name}` is no name of a fact; allowed: a to z, 0 to 9 and _");
                return Err(utterance.wrong(index, &defect));
            }
            names.insert(name.clone());
        }
    }
    if names.len() > MAX_FACTS {
        let n_facts = names.len();
        return Err(TaxonomyError(format!(
            "the sentences presuppose {n_facts} facts; allowed: at most {MAX_FACTS}"
        )));
    }
    Ok(names.into_iter().collect())
}

fn check_header(raw: &RawDatabase) -> Result<(), TaxonomyError> {
    let refuse = |key, given: String, allowed| {
        Err(TaxonomyError(format!("`{key}` is {given}; allowed: {allowed}")))
    };
    let [from, to] = raw.words;
    let names: BTreeSet<&String> = raw.topics.iter().collect();
    if raw.schema != SCHEMA {
        refuse("schema", raw.schema.to_string(), "1")
    } else if raw.domain.is_empty() {
        refuse("domain", "empty".to_owned(), "the name of a domain")
    } else if !(1..=100).contains(&raw.theta) {
        refuse("theta", raw.theta.to_string(), "1 to 100 percent")
    } else if !(1 <= from && from <= to && to <= MAX_WORDS) {
        refuse("words", format!("[{from}, {to}]"), "[least, greatest] within 1 to 20")
    } else if names.is_empty() || names.len() < raw.topics.len() {
        refuse("topics", format!("{:?}", raw.topics), "at least one name, each once")
    } else {
        Ok(())
    }
}

/// Checks one sentence on its own; an error says what is wrong with it.
fn checked(
    raw: &RawUtterance,
    database: &RawDatabase,
    facts: &[String],
) -> Result<Utterance, String> {
    let lacks = raw.lacks();
    if !lacks.is_empty() {
        return Err(format!("it lacks `{}`", lacks.join("`, `")));
    }
    let cell = Cell::new(raw.comprehension, raw.conveyance);
    let [from, to] = database.words;
    if cell.comprehension < from || cell.comprehension > cell.conveyance || cell.conveyance > to {
        return Err(format!("its (k, l) is {cell}; allowed: {from} <= k <= l <= {to}"));
    }
    let (counted, stated) = (words::count(&raw.text), cell.conveyance);
    if counted != stated {
        return Err(format!("it has {counted} words; `conveyance` says {stated}"));
    }
    check_curve(raw, database.theta, from)?;
    check_spans(raw)?;
    if !raw.word_end_ms.is_empty() {
        check_list("word_end_ms", &raw.word_end_ms, stated)?;
        check_rise("word_end_ms", &raw.word_end_ms, |a, b| b <= a)?;
    }
    let presupposed = raw.facts.iter().flatten().filter_map(|name| facts.binary_search(name).ok());
    let facts = presupposed.fold(FactSet::NONE, FactSet::with);
    let RawUtterance { text, spans, curve, clamped, word_end_ms, medoid, source, .. } = raw.clone();
    Ok(Utterance { text, cell, spans, facts, curve, clamped, word_end_ms, medoid, source })
}

fn check_list<T>(list: &str, values: &[T], allowed: u32) -> Result<(), String> {
    if values.len() == allowed as usize {
        return Ok(());
    }
    let given = values.len();
    Err(format!("its `{list}` has {given} values; allowed: {allowed}, one per word"))
}

fn check_rise<T>(list: &str, values: &[T], falls: impl Fn(&T, &T) -> bool) -> Result<(), String> {
    match values.windows(2).position(|pair| falls(&pair[0], &pair[1])) {
        Some(i) => {
            Err(format!("its `{list}` falls at word {}; allowed: values in rising order", i + 2))
        }
        None => Ok(()),
    }
}

fn check_curve(raw: &RawUtterance, theta: u8, from: u32) -> Result<(), String> {
    check_list("curve", &raw.curve, raw.conveyance)?;
    if let Some(given) = raw.curve.iter().find(|&&percent| percent > 100) {
        return Err(format!("its curve reaches {given}; allowed: 0 to 100 percent"));
    }
    check_rise("curve", &raw.curve, |a, b| b < a)?;
    let crossing = raw.curve.iter().position(|&percent| percent >= theta).map(|i| i as u32 + 1);
    let stated = raw.comprehension;
    let at = match crossing {
        Some(word) if raw.clamped && word < from && stated == from => return Ok(()),
        Some(word) if !raw.clamped && word == stated => return Ok(()),
        Some(word) => format!("word {word}"),
        None => "no word".to_owned(),
    };
    Err(format!("its curve reaches {theta} percent at {at}; `comprehension` says word {stated}"))
}

fn check_spans(raw: &RawUtterance) -> Result<(), String> {
    let (mut end, words) = (0, raw.conveyance);
    for span in &raw.spans {
        if span.from < end || span.to <= span.from || span.to > words {
            return Err(format!("its spans overlap, are empty or reach past word {words}"));
        }
        end = span.to;
    }
    match raw.spans.iter().filter(|span| span.part == SpanKind::What).count() {
        1 => Ok(()),
        given => Err(format!("it has {given} `what` spans; allowed: 1")),
    }
}

#[cfg(test)]
#[path = "database_tests.rs"]
mod tests;
