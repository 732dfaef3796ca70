//! What is said about a database that cannot be used: which sentence, what it has, what it should have.

use thiserror::Error;

use crate::utterance::Cell;

/// Why a text is not a database, or not a usable one.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TaxonomyError {
    /// Not TOML, an unknown key, a wrong type.
    #[error("line {line} of the utterance database: {message}")]
    Form {
        /// Line of the text, from 1.
        line: usize,
        /// What the reader says.
        message: String,
    },
    /// A key of the header is impossible.
    #[error("`{key}` is {given}; allowed: {allowed}")]
    Header {
        /// The key.
        key: &'static str,
        /// What was given.
        given: String,
        /// What would do.
        allowed: &'static str,
    },
    /// A sentence that cannot be what the file says of it.
    #[error("utterance {} of topic `{topic}`, \"{text}\": {defect}", index + 1)]
    Utterance {
        /// Its place in the file, from 0.
        index: usize,
        /// Its topic.
        topic: String,
        /// Its text.
        text: String,
        /// What is wrong.
        defect: Defect,
    },
    /// Nothing could be said about a topic.
    #[error("topic `{topic}` has no utterance; every topic of the header needs at least one")]
    EmptyTopic {
        /// The topic.
        topic: String,
    },
    /// A topic that the database does not have was asked for.
    #[error("there is no topic {topic}; the database has {n_topics}, numbered from 0")]
    UnknownTopic {
        /// As asked for.
        topic: usize,
        /// How many there are.
        n_topics: usize,
    },
    /// The topics of a database and of a domain differ.
    #[error("the database speaks of [{}], the domain of [{}]", found.join(", "), expected.join(", "))]
    OtherTopics {
        /// In the database, in order.
        found: Vec<String>,
        /// In the domain, in order.
        expected: Vec<String>,
    },
    /// No database of that name comes with the crate.
    #[error("there are no shipped utterances for `{domain}`; shipped: {known}")]
    NotShipped {
        /// As asked for.
        domain: String,
        /// What there is.
        known: String,
    },
}

/// What is wrong with one sentence.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Defect {
    /// Its topic is not in the header.
    #[error("its topic is not in `topics`")]
    UnknownTopic,
    /// Its words are not l.
    #[error("it has {counted} words; `conveyance` says {stated}")]
    WordCount {
        /// As counted.
        counted: u32,
        /// l.
        stated: u32,
    },
    /// k and l that no notifier can choose.
    #[error("its (k, l) is {cell}; allowed: {from} <= k <= l <= {to}")]
    Infeasible {
        /// k and l.
        cell: Cell,
        /// Least number of words.
        from: u32,
        /// Greatest number of words.
        to: u32,
    },
    /// Not one value per word.
    #[error("its `{list}` has {given} values; allowed: {allowed}, one per word")]
    Length {
        /// Which list.
        list: &'static str,
        /// Values given.
        given: usize,
        /// Words.
        allowed: u32,
    },
    /// A value above 100 %.
    #[error("its curve reaches {given}; allowed: 0 to 100 percent")]
    Percent {
        /// What was given.
        given: u8,
    },
    /// A curve that falls, or word ends that do not rise.
    #[error("its `{list}` falls at word {word}; allowed: values in rising order")]
    Falls {
        /// Which list.
        list: &'static str,
        /// The word, from 1.
        word: usize,
    },
    /// The curve says another k.
    #[error("its curve reaches {theta} percent at {}; `comprehension` says word {stated}", match crossing {
        Some(word) => format!("word {word}"),
        None => "no word".to_owned(),
    })]
    Crossing {
        /// The threshold.
        theta: u8,
        /// Where the curve crosses it, from 1.
        crossing: Option<u32>,
        /// k.
        stated: u32,
    },
    /// Spans that overlap, are empty or reach past the last word.
    #[error("its spans overlap, are empty or reach past word {words}")]
    Spans {
        /// l.
        words: u32,
    },
    /// None or several directives.
    #[error("it has {given} `what` spans; allowed: 1")]
    Directives {
        /// How many.
        given: usize,
    },
    /// The same words are there already.
    #[error("the same words stand under topic `{other}` already")]
    Duplicate {
        /// The topic of the first one.
        other: String,
    },
}
