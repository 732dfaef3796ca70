//! A rater without a language model: how near the words so far are to each of the domain's actions.
//!
//! Every topic is stood for by its phrases; a prefix is compared with all of them, the nearest of each topic counts,
//! and a softmax over the topics gives the share of the one that was meant. A stand-in: it measures likeness of words,
//! not understanding, and it was tuned on nothing.

use super::backend::{Call, Embedder, Input, Model, Reply};
use super::embedding::Embedding;
use super::error::BackendError;
use super::plan::Plan;
use crate::utterance::Fidelity;
use crate::words;

/// Temperature of the softmax over cosines.
const TEMPERATURE: f64 = 0.1;

/// Rates by likeness to the topics' phrases.
pub struct ClosedSet {
    id: String,
    embedder: Box<dyn Embedder>,
    /// Per topic its id and its phrases.
    topics: Vec<(String, Vec<Embedding>)>,
}

impl std::fmt::Debug for ClosedSet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.id)
    }
}

impl ClosedSet {
    /// Embeds the phrases of a plan.
    ///
    /// # Errors
    ///
    /// [`BackendError`] if the embedder cannot.
    pub fn new(plan: &Plan, mut embedder: Box<dyn Embedder>) -> Result<Self, BackendError> {
        let mut topics = Vec::new();
        for topic in &plan.topic {
            let phrases: Result<Vec<_>, _> =
                topic.what.iter().map(|phrase| embedder.embed(phrase)).collect();
            topics.push((topic.id.clone(), phrases?));
        }
        let id = format!("closed set of actions by {}, T = {TEMPERATURE}", embedder.id());
        Ok(Self { id, embedder, topics })
    }

    /// Computes the share of a topic among all, in percent.
    fn percent(&mut self, topic: &str, prefix: &str) -> Result<u8, BackendError> {
        let heard = self.embedder.embed(prefix)?;
        let nearest = |phrases: &Vec<Embedding>| {
            phrases.iter().map(|phrase| phrase.cosine(&heard)).fold(-1.0, f64::max)
        };
        let cosines: Vec<f64> = self.topics.iter().map(|(_, list)| nearest(list)).collect();
        let most = cosines.iter().copied().fold(-1.0, f64::max);
        let weights: Vec<f64> =
            cosines.iter().map(|cosine| ((cosine - most) / TEMPERATURE).exp()).collect();
        let place = self.topics.iter().position(|(id, _)| id == topic);
        let own = place.map_or(0.0, |place| weights[place]);
        Ok((100.0 * own / weights.iter().sum::<f64>()).round() as u8)
    }
}

impl Model for ClosedSet {
    fn id(&self) -> &str {
        &self.id
    }

    fn fidelity(&self) -> Fidelity {
        Fidelity::Local
    }

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        let Input::Sentence { topic, text, words } = &call.input else {
            return Err(BackendError::NotAnnotated { what: call.what() });
        };
        if let Some(n) = words {
            let percent = self.percent(topic, &words::prefix(text, *n))?;
            return Ok(Reply::complete(percent.to_string()));
        }
        let n_words = words::count(text) as usize;
        let percents: Result<Vec<String>, _> = (1..=n_words)
            .map(|n| Ok(self.percent(topic, &words::prefix(text, n))?.to_string()))
            .collect();
        Ok(Reply::complete(format!("Comprehension after each word: {}", percents?.join(", "))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::job;
    use crate::pipeline::lexical::Lexical;

    #[test]
    fn the_words_of_an_action_raise_its_share() {
        let plan = job::plan("lander").unwrap();
        let mut rater = ClosedSet::new(&plan, Box::new(Lexical)).unwrap();
        let first = rater.percent("shift_left", "Danger").unwrap();
        let whole = rater.percent("shift_left", "Danger, shift left").unwrap();
        assert!(first < 40 && whole > 55, "{first} {whole}");
        assert!(rater.percent("shift_right", "Danger, shift left").unwrap() < 40);
    }
}
