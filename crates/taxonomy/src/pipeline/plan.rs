//! What a database is to be made of: the domain, its topics, the phrases that say them, and the settings of a run.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::error::PipelineError;
use crate::database::MAX_WORDS;
use crate::facts::{self, MAX_FACTS};
use crate::raw;
use crate::words;

/// How a sentence is rated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RateForm {
    /// One call that sees the whole sentence and returns one number per word: the source's form.
    Joint,
    /// One call per word that sees the words so far: later words cannot leak into early ratings.
    Prefix,
}

/// The settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanSettings {
    /// Comprehension from which on a listener acts (1..=100 percent). Default 70; the source names none.
    pub theta: u8,
    /// Sentences that a cell should get before representatives are chosen (1..=200). Default 6.
    pub target: usize,
    /// Representatives kept per cell (1..=20). Default 4.
    pub keep: usize,
    /// Sentences asked for at a time (1..=50). Default 8.
    pub batch: usize,
    /// Times that a cell is asked for before it is given up (1..=1000). Default 40.
    pub attempts_per_cell: u32,
    /// Generations in all (1..=100000). Default 1000, as in the source.
    pub max_iterations: u32,
    /// Tries at a malformed rating (1..=10). Default 3.
    pub tries: u32,
    /// How a sentence is rated. Default `prefix`.
    pub rate: RateForm,
    /// Ratings whose median counts (1..=9, odd). Default 1.
    pub repeats: u32,
    /// Percent by which a rating may fall below what it was before (0..=100). Default 20.
    pub max_drop: u8,
    /// Percent by which the action must be ahead of every other one when it is understood (0..=100); each other action
    /// costs a rating. Default 0: no model is asked.
    pub min_margin: u8,
    /// Sentences per topic that are also rated with their words in another order, to see what the rater makes of it
    /// (0..=10). Default 2.
    pub controls: usize,
    /// Cosine from which on two sentences of a cell are the same (above 0, at most 1). Default 0.95.
    pub near_duplicate: f64,
    /// Sampling temperature of generation (0..=2). Default 0.9.
    pub temperature: f64,
    /// Nucleus of generation (above 0, at most 1). Default 0.95.
    pub top_p: f64,
    /// Longest reply, in tokens (16..=4096). Default 256.
    pub max_tokens: u32,
    /// Seed of every call. Default 1.
    pub seed: u64,
}

impl Default for PlanSettings {
    fn default() -> Self {
        Self {
            theta: 70,
            target: 6,
            keep: 4,
            batch: 8,
            attempts_per_cell: 40,
            max_iterations: 1000,
            tries: 3,
            rate: RateForm::Prefix,
            repeats: 1,
            max_drop: 20,
            min_margin: 0,
            controls: 2,
            near_duplicate: 0.95,
            temperature: 0.9,
            top_p: 0.95,
            max_tokens: 256,
            seed: 1,
        }
    }
}

/// A sentence with its rating, as a prompt shows it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RatedSentence {
    /// The sentence, one word per rating.
    pub text: String,
    /// Percent after each word.
    pub curve: Vec<u8>,
}

/// One topic of a plan: what it is about, and what its sentences may be like.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopicPlan {
    /// Its name, as the domain spells it.
    pub id: String,
    /// What the listener does when they follow it.
    pub action: String,
    /// Whether it states a fact rather than an action: any directive then belongs to another topic.
    #[serde(default)]
    pub statement: bool,
    /// Phrases that say it (What), for the grammar and to recognise it.
    pub what: Vec<String>,
    /// Further phrases that say it, to recognise it only: some would not go with every manner.
    #[serde(default)]
    pub also_what: Vec<String>,
    /// Manners that go with it, for the grammar; the domain's if none are given.
    #[serde(default)]
    pub how: Vec<String>,
    /// Reasons for it (Why), for the grammar.
    pub why: Vec<String>,
    /// What phrases presuppose on this topic, where that is something else than in general.
    #[serde(default)]
    pub presupposes: BTreeMap<String, Vec<String>>,
    /// Worked examples of a rating.
    pub rated: Vec<RatedSentence>,
}

/// Everything about a domain that sentences are made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatabasePlan {
    /// Name of the domain, as its configuration has it.
    pub domain: String,
    /// Who listens: `the pilot of a small lander`.
    pub role: String,
    /// State, actions and dynamics, for the first prompt.
    pub world: String,
    /// What the listener does not know.
    pub missing: String,
    /// Least and greatest number of words.
    pub words: [u32; 2],
    /// Phrases of manner or urgency (How), for the grammar and to recognise them.
    pub how: Vec<String>,
    /// Further ones, to recognise them only.
    #[serde(default)]
    pub also_how: Vec<String>,
    /// Words that carry nothing: `please`, `the`.
    pub fillers: Vec<String>,
    /// Five sentences that show what is wanted.
    pub examples: Vec<String>,
    /// Sentences that represent their cell if they land in one, whoever else would.
    #[serde(default)]
    pub pinned: Vec<String>,
    /// Sentences that a person has turned down.
    #[serde(default)]
    pub reject: Vec<String>,
    /// What a phrase presupposes: facts of the domain. None: it can never be false.
    #[serde(default)]
    pub presupposes: BTreeMap<String, Vec<String>>,
    /// The settings of a run.
    #[serde(default)]
    pub settings: PlanSettings,
    /// The topics, in the order of their ids.
    pub topic: Vec<TopicPlan>,
}

impl DatabasePlan {
    /// Reads a plan.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if the text is no TOML of a plan, or [`Self::check`] finds a key impossible. It names the line
    /// or the key, what was given and what is allowed.
    pub fn from_toml(text: &str) -> Result<Self, PipelineError> {
        let plan: Self = raw::read(text, "plan").map_err(PipelineError::Unusable)?;
        plan.check()?;
        Ok(plan)
    }

    /// Checks what a type cannot say.
    ///
    /// # Errors
    ///
    /// [`PipelineError::Unusable`] if a value is out of its range or does not fit another one; it names the first such
    /// key.
    pub fn check(&self) -> Result<(), PipelineError> {
        let [from, to] = self.words;
        let fits = 1 <= from && from <= to && to <= MAX_WORDS;
        require(fits, "words", format!("[{from}, {to}]"), "[least, greatest] within 1 to 20")?;
        require(!self.domain.is_empty(), "domain", "\"\"", "the name of a domain")?;
        require(!self.topic.is_empty(), "topic", "[]", "at least one topic")?;
        self.check_ids()?;
        check_facts("presupposes", &self.presupposes)?;
        for topic in &self.topic {
            let key = |name: &str| format!("topic.{}.{name}", topic.id);
            require(!topic.what.is_empty(), &key("what"), "[]", "at least one phrase")?;
            check_facts(&key("presupposes"), &topic.presupposes)?;
            for rated in &topic.rated {
                let (given, words) = (rated.curve.len(), words::count(&rated.text) as usize);
                let says = format!("{words} percentages, one per word of \"{}\"", rated.text);
                require(given == words, &key("rated"), given, &says)?;
            }
        }
        let names: BTreeSet<&str> = self.facts().collect();
        let (few, given) = (names.len() <= MAX_FACTS, format!("a table of {} facts", names.len()));
        require(few, "presupposes", given, &format!("at most {MAX_FACTS}, topics included"))?;
        self.settings.check()
    }

    /// Lists the names of the facts that its phrases presuppose, some of them several times.
    pub(super) fn facts(&self) -> impl Iterator<Item = &str> {
        let of_topics = self.topic.iter().map(|topic| &topic.presupposes);
        let tables = [&self.presupposes].into_iter().chain(of_topics);
        tables.flat_map(|table| table.values().flatten()).map(String::as_str)
    }

    /// Checks that each topic is found by its name.
    fn check_ids(&self) -> Result<(), PipelineError> {
        let mut seen = BTreeSet::new();
        let wrong = self.topic.iter().find(|topic| topic.id.is_empty() || !seen.insert(&topic.id));
        let given = wrong.map(|topic| format!("\"{}\"", topic.id)).unwrap_or_default();
        require(wrong.is_none(), "topic.id", given, "a name that no other topic has")
    }

    pub(super) fn topic_idx(&self, id: &str) -> Option<usize> {
        self.topic.iter().position(|topic| topic.id == id)
    }

    /// Computes a hash of everything in the plan, in hexadecimal.
    pub(super) fn hash(&self) -> String {
        // A plan holds only text, numbers and lists, which can always be written.
        hash(serde_json::to_string(self).unwrap_or_default().as_bytes())
    }
}

impl PlanSettings {
    fn check(&self) -> Result<(), PipelineError> {
        let refuse_unless = |holds, key: &str, given: f64, allowed: &str| {
            require(holds, &format!("settings.{key}"), given, allowed)
        };
        let within = |key: &str, given: f64, range: RangeInclusive<f64>, allowed: &str| {
            refuse_unless(range.contains(&given), key, given, allowed)
        };
        let share = |key: &str, given: f64| {
            refuse_unless(given > 0.0 && given <= 1.0, key, given, "above 0 and at most 1")
        };
        within("theta", self.theta.into(), 1.0..=100.0, "1 to 100 percent")?;
        within("target", self.target as f64, 1.0..=200.0, "1 to 200")?;
        within("keep", self.keep as f64, 1.0..=20.0, "1 to 20")?;
        within("batch", self.batch as f64, 1.0..=50.0, "1 to 50")?;
        within("attempts_per_cell", self.attempts_per_cell.into(), 1.0..=1000.0, "1 to 1000")?;
        within("max_iterations", self.max_iterations.into(), 1.0..=100_000.0, "1 to 100000")?;
        within("tries", self.tries.into(), 1.0..=10.0, "1 to 10")?;
        let odd = (1..=9).contains(&self.repeats) && self.repeats % 2 == 1;
        refuse_unless(odd, "repeats", self.repeats.into(), "an odd number from 1 to 9")?;
        within("max_drop", self.max_drop.into(), 0.0..=100.0, "0 to 100 percent")?;
        within("min_margin", self.min_margin.into(), 0.0..=100.0, "0 to 100 percent")?;
        within("controls", self.controls as f64, 0.0..=10.0, "0 to 10")?;
        share("near_duplicate", self.near_duplicate)?;
        within("temperature", self.temperature, 0.0..=2.0, "0 to 2")?;
        share("top_p", self.top_p)?;
        within("max_tokens", self.max_tokens.into(), 16.0..=4096.0, "16 to 4096 tokens")
    }
}

fn check_facts(key: &str, phrases: &BTreeMap<String, Vec<String>>) -> Result<(), PipelineError> {
    let mut all =
        phrases.iter().flat_map(|(phrase, facts)| facts.iter().map(move |fact| (phrase, fact)));
    let wrong = all.find(|(_, fact)| !facts::is_name(fact));
    let given =
        wrong.map(|(phrase, fact)| format!("`{fact}` for \"{phrase}\"")).unwrap_or_default();
    require(wrong.is_none(), key, given, "names of facts, of a to z, 0 to 9 and _")
}

fn require(
    holds: bool,
    key: &str,
    given: impl Display,
    allowed: &str,
) -> Result<(), PipelineError> {
    if holds { Ok(()) } else { Err(PipelineError::plan(key, given, allowed)) }
}

/// Computes a hash in hexadecimal, shortened to 128 bits: enough to distinguish whatever a run can hold.
pub(crate) fn hash(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes)[..16])
}

/// Writes bytes in hexadecimal, two digits each.
pub(crate) fn hexadecimal(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a string cannot fail.
        let _written = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
