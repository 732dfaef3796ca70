//! Who can be asked: what a call is, what a reply is, what a model and an embedder must do.

use std::fmt::Debug;

use serde::{Deserialize, Serialize};

use super::embedding::Embedding;
use super::error::BackendError;
use super::plan::hash;
use crate::utterance::{Cell, Fidelity};

/// The stage of the pipeline that asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CallStage {
    /// What in the domain matters for a decision.
    Summarise,
    /// Sentences for a topic and a cell.
    Generate,
    /// Comprehension after each word.
    Rate,
    /// The same of nothing, or of words in another order: what the rater makes of it is only reported.
    Control,
    /// A sentence as a vector.
    Embed,
}

/// How a reply is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sampling {
    /// Temperature; 0 takes the likeliest token.
    pub temperature: f64,
    /// Nucleus sampling: the share of probability that is kept, 0 to 1.
    pub top_p: f64,
    /// Longest reply, in tokens.
    pub max_tokens: u32,
}

/// What a call is about, for backends that do not read prompts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Input {
    /// The domain as a whole, to be summarised.
    Domain,
    /// Sentences that are wanted for one cell.
    Sentences {
        /// Id of the topic in the plan.
        topic: String,
        /// Where they should land.
        cell: Cell,
        /// How many are wanted.
        n: usize,
        /// How often this cell was asked for before.
        round: u32,
    },
    /// A sentence to rate.
    Sentence {
        /// Id of the topic in the plan.
        topic: String,
        /// The sentence, whole, whatever is shown of it.
        text: String,
        /// Words shown; all if not given.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        words: Option<usize>,
    },
    /// A sentence to embed.
    Text {
        /// The sentence to be embedded.
        text: String,
    },
}

/// One question to a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Call {
    /// The stage of the build that asks.
    pub stage: CallStage,
    /// What the model is.
    pub system: String,
    /// What it is asked.
    pub prompt: String,
    /// How the reply is drawn.
    pub sampling: Sampling,
    /// Seed of the draw, below 2^53.
    pub seed: u64,
    /// What it is about.
    pub input: Input,
}

impl Call {
    /// Computes the call's key: a hash of everything that the reply can depend on.
    pub(super) fn key(&self, model: &str) -> String {
        // Field order is fixed by the type, so equal calls are equal text.
        hash(serde_json::to_string(&(model, self)).unwrap_or_default().as_bytes())
    }

    /// Says in words which call this is.
    pub(super) fn what(&self) -> String {
        match &self.input {
            Input::Domain => "the summary of the domain".to_owned(),
            Input::Sentences { topic, cell, round, .. } => {
                format!("generation {} of topic `{topic}` at (k, l) = {cell}", round + 1)
            }
            Input::Sentence { topic, text, words: None } => {
                format!("the rating of \"{text}\" for topic `{topic}`")
            }
            Input::Sentence { topic, text, words: Some(n) } => {
                format!("the rating of the first {n} words of \"{text}\" for topic `{topic}`")
            }
            Input::Text { text } => format!("the embedding of \"{text}\""),
        }
    }
}

/// Why a reply ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Finish {
    /// The model ended it by itself.
    Stop,
    /// It ran into the limit: its last line cannot be trusted.
    Length,
    /// There is nothing more to be had: asking again would not help.
    Exhausted,
}

/// The answer to a call.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// What the model wrote.
    pub text: String,
    /// Why it ended there.
    pub finish: Finish,
    /// Tokens of the prompt and of the reply, where the backend counts them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tokens: Option<(u64, u64)>,
}

impl Reply {
    /// Makes a complete reply.
    pub fn complete(text: impl Into<String>) -> Self {
        Self { text: text.into(), finish: Finish::Stop, tokens: None }
    }

    /// Says that there is nothing more to be had.
    pub(super) fn exhausted() -> Self {
        Self { finish: Finish::Exhausted, ..Self::complete("") }
    }

    /// Takes the lines of a round, `n` each, from a list that may end.
    pub(super) fn page<'a>(lines: impl Iterator<Item = &'a str>, n: usize, round: u32) -> Self {
        let page: Vec<&str> = lines.skip(n * round as usize).take(n).collect();
        if page.is_empty() { Self::exhausted() } else { Self::complete(page.join("\n")) }
    }
}

/// Writes or rates sentences.
pub trait Model: Debug {
    /// Names it, so that two with the same name answer alike: model, weights, server.
    fn id(&self) -> &str;

    /// Says what may be claimed of what it makes.
    fn fidelity(&self) -> Fidelity;

    /// Returns whether it has sentences for a cell that would be lost if no call asked for them.
    fn holds(&self, _topic: &str, _cell: Cell) -> bool {
        false
    }

    /// Returns whether its answers are written down, so that a call log must hold the very same ones.
    fn is_written(&self) -> bool {
        false
    }

    /// Answers a call.
    ///
    /// # Errors
    ///
    /// [`BackendError`] if there is no answer; waiting and trying again is the backend's own business.
    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError>;
}

/// Turns sentences into vectors.
pub trait Embedder: Debug {
    /// Names it: model, weights, pooling.
    fn id(&self) -> &str;

    /// Embeds one sentence.
    ///
    /// # Errors
    ///
    /// [`BackendError`] if the server does not answer, refuses, or answers with something that is no vector.
    fn embed(&mut self, text: &str) -> Result<Embedding, BackendError>;
}

/// Replaces the model that made a call log: it has that model's name, and asks nobody.
#[derive(Debug)]
pub(super) struct LoggedBackend {
    pub(super) id: String,
    pub(super) fidelity: Fidelity,
}

impl Model for LoggedBackend {
    fn id(&self) -> &str {
        &self.id
    }

    fn fidelity(&self) -> Fidelity {
        self.fidelity
    }

    fn complete(&mut self, _call: &Call) -> Result<Reply, BackendError> {
        Err(BackendError::Local("a replay asks nobody".to_owned()))
    }
}

impl Embedder for LoggedBackend {
    fn id(&self) -> &str {
        &self.id
    }

    fn embed(&mut self, _text: &str) -> Result<Embedding, BackendError> {
        Err(BackendError::Local("a replay asks nobody".to_owned()))
    }
}
