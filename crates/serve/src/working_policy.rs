//! A policy with everything that it needs to speak: its half of the task, its choices, its words.

use std::sync::Arc;

use leadtime_episodes::Choice;
use leadtime_numerics::Pcg64;
use leadtime_policy::{ActionDistribution, Parameters, Policy};
use leadtime_proto::{Mask, PolicySpec};
use leadtime_sims::notifier::Session;
use leadtime_sims::{Environment, Fact, Quantity};
use leadtime_taxonomy::{Taxonomy, TaxonomyError, Topic};
use leadtime_voice::VoiceBook;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

/// Why a policy cannot go to work.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum UnfitPolicy {
    #[error(
        "nobody is spoken to in `{0}`: a notifier of the piloting, driving or cooking task, or of your own, is needed"
    )]
    NoNotifier(String),
    #[error("there are no sentences for the topics of `{0}`; --voice none works without words")]
    NoWords(String),
    #[error(transparent)]
    Words(#[from] TaxonomyError),
    #[error(transparent)]
    Policy(#[from] leadtime_policy::Error),
}

/// Where a policy is from and how it was put to work: what a recording has to know to do the same again.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyOrigin {
    /// Its file, as the notifier was started with it.
    pub path: String,
    /// SHA-256 over the file, in hexadecimal.
    pub sha256: String,
    /// Keys of the task that were changed, each as `key=value`.
    pub changes: Vec<String>,
    /// How an action is chosen.
    pub action: Choice,
    /// The words: a database, `shipped` or `none`.
    pub words: String,
    /// The voice, whose words take the times that they take, as `--voice` names it; of `pipe:COMMAND` and `recorded:DIR` the kind
    /// alone.
    #[serde(default = "silent")]
    pub voice: String,
}

/// Returns what others may know of a voice that `--voice` names: commands and paths of this machine stay private.
pub fn told_voice(name: &str) -> &str {
    match name.split_once(':') {
        Some((kind @ ("pipe" | "recorded"), _)) => kind,
        _ => name,
    }
}

/// The voice of recordings that name none: words without sound.
fn silent() -> String {
    "text".to_owned()
}

/// A policy that is ready to speak.
#[derive(Clone, Debug)]
pub struct WorkingPolicy {
    /// Name of the task's domain, such as `lander`.
    pub domain: String,
    /// The notifier before its first episode.
    pub session: Session,
    /// SHA-256 over its file, in hexadecimal.
    pub sha256: String,
    /// Updates that made it.
    pub n_updates: u64,
    /// How it was put to work.
    pub origin: PolicyOrigin,
    /// The settings of the task that it was made for, where they are known.
    pub task: Option<Value>,
    /// What each number of an observation is.
    observation: Vec<Quantity>,
    /// What a client may say to be the case, as far as some sentence presupposes it.
    facts: Vec<Fact>,
    /// Everything that a client of this task may say to be the case.
    known_facts: Vec<Fact>,
    taxonomy: Option<Arc<Taxonomy>>,
    voice: Option<Arc<VoiceBook>>,
    decider: LiveDecider,
}

impl WorkingPolicy {
    /// Joins a policy with its task and its words; `taxonomy` is `None` for a notifier without words.
    ///
    /// # Errors
    ///
    /// [`UnfitPolicy`] if the task has no listener, if the words are about other topics or presuppose what the task does not
    /// tell, or if the parameters are of another network.
    pub fn new(
        domain: &str,
        environment: &dyn Environment,
        spec: &PolicySpec,
        parameters: &Parameters,
        choice: Choice,
        taxonomy: Option<Taxonomy>,
    ) -> Result<Self, UnfitPolicy> {
        let session = environment.session();
        let session = session.ok_or_else(|| UnfitPolicy::NoNotifier(domain.to_owned()))?;
        let known_facts = environment.facts();
        if let Some(taxonomy) = &taxonomy {
            let about = taxonomy.expect_topics(session.topics());
            about.map_err(|_other| UnfitPolicy::NoWords(domain.to_owned()))?;
            // A sentence that presupposes anything else would never be said, and is most often a slip of the pen.
            let told: Vec<&str> = known_facts.iter().map(|fact| fact.name).collect();
            taxonomy.expect_facts(&told)?;
        }
        let is_presupposed = |fact: &Fact| {
            taxonomy.as_ref().is_some_and(|it| it.facts().iter().any(|name| name == fact.name))
        };
        let facts = known_facts.iter().copied().filter(is_presupposed).collect();
        let mut observation = environment.describe().observation.frame;
        observation.truncate(session.obs_dim());
        Ok(Self {
            domain: domain.to_owned(),
            decider: LiveDecider::new(spec, parameters, choice)?,
            session,
            sha256: String::new(),
            n_updates: 0,
            origin: PolicyOrigin::default(),
            task: None,
            observation,
            facts,
            known_facts,
            taxonomy: taxonomy.map(Arc::new),
            voice: None,
        })
    }

    /// Says which file it is of, and how many updates made it.
    pub fn of_file(self, sha256: String, n_updates: u64) -> Self {
        Self { sha256, n_updates, ..self }
    }

    /// Says how it was put to work, for recordings.
    pub fn put_to_work(self, origin: PolicyOrigin) -> Self {
        let voice = told_voice(&origin.voice).to_owned();
        Self { origin: PolicyOrigin { voice, ..origin }, ..self }
    }

    /// Returns a checksum over every sentence in order, with its topic, its cell and what it presupposes: two databases with the
    /// same one say the same.
    pub fn words_checksum(&self) -> u32 {
        let Some(taxonomy) = &self.taxonomy else { return 0 };
        let mut sum = 0;
        let mut add = |text: &str| {
            // What separates two texts is in neither.
            sum = crc32c::crc32c_append(crc32c::crc32c_append(sum, text.as_bytes()), &[0]);
        };
        for topic in taxonomy.topics() {
            add(topic.name());
            let cells =
                topic.cells().flat_map(|(cell, list)| list.iter().map(move |it| (cell, it)));
            for (cell, sentence) in cells {
                add(&cell.to_string());
                add(&sentence.text);
                taxonomy.fact_names(sentence.facts).for_each(&mut add);
            }
        }
        sum
    }

    /// Returns whether the words are those of a checksum that was kept: by an older release over the texts alone.
    pub fn has_words(&self, checksum: u32) -> bool {
        checksum == self.words_checksum() || checksum == self.texts_checksum()
    }

    fn texts_checksum(&self) -> u32 {
        let topics = self.taxonomy.iter().flat_map(|taxonomy| taxonomy.topics());
        let sentences = topics.flat_map(|topic| topic.cells().flat_map(|(_, list)| list));
        sentences.fold(0, |sum, sentence| crc32c::crc32c_append(sum, sentence.text.as_bytes()))
    }

    /// Says which settings its task has, JSON.
    pub fn of_task(self, settings: &str) -> Self {
        Self { task: serde_json::from_str(settings).ok(), ..self }
    }

    /// Speaks with a voice: words take the time that they take in its sound.
    pub fn with_voice(self, voice: Option<VoiceBook>) -> Self {
        Self { voice: voice.map(Arc::new), ..self }
    }

    /// Returns the voice, if it has one.
    pub fn voice(&self) -> Option<Arc<VoiceBook>> {
        self.voice.clone()
    }

    /// Returns how many numbers an observation has.
    pub fn obs_dim(&self) -> usize {
        self.session.obs_dim()
    }

    /// Says what each number of an observation is.
    pub fn observation(&self) -> &[Quantity] {
        &self.observation
    }

    /// Lists the facts that a client may state: those that some sentence presupposes.
    pub fn facts(&self) -> &[Fact] {
        &self.facts
    }

    /// Lists all facts of the task, those that no sentence presupposes included.
    pub fn known_facts(&self) -> &[Fact] {
        &self.known_facts
    }

    /// Returns the words, if there are any.
    pub fn taxonomy(&self) -> Option<Arc<Taxonomy>> {
        self.taxonomy.clone()
    }

    /// Counts the sentences of all topics; 0 without words.
    pub fn n_sentences(&self) -> usize {
        self.sentences().count()
    }

    /// Lists the sentences, topic by topic.
    pub fn sentences(&self) -> impl Iterator<Item = &str> {
        let topics = self.taxonomy.iter().flat_map(|taxonomy| taxonomy.topics());
        topics.flat_map(Topic::utterances).map(|utterance| utterance.text.as_str())
    }

    /// Returns what decides: one per thread, because it thinks in memory of its own.
    pub fn decider(&self) -> LiveDecider {
        self.decider.clone()
    }
}

/// What decides: a network with its own memory for a pass.
#[derive(Clone, Debug)]
pub struct LiveDecider {
    policy: Policy,
    distribution: ActionDistribution,
    choice: Choice,
    logits: Vec<f32>,
}

impl LiveDecider {
    fn new(
        spec: &PolicySpec,
        parameters: &Parameters,
        choice: Choice,
    ) -> Result<Self, leadtime_policy::Error> {
        let policy = Policy::new(spec, parameters)?;
        let distribution = ActionDistribution::new(&spec.actions, spec.head_credit);
        let logits = vec![0.0; policy.n_choices()];
        Ok(Self { policy, distribution, choice, logits })
    }

    /// Returns the width of the state that a session carries from step to step.
    pub fn recurrent_dim(&self) -> usize {
        self.policy.recurrent_dim()
    }

    /// Returns how many choices a decision has.
    pub fn n_heads(&self) -> usize {
        self.distribution.n_heads()
    }

    /// Decides, as in training and evaluation, bit for bit. Shapes: `row` `[row_dim]`, `choices` `[n_heads]`.
    pub fn decide(
        &mut self,
        row: &[f32],
        mask: Mask,
        recurrent: &mut [f32],
        draws: &mut Pcg64,
        choices: &mut [u8],
    ) {
        self.policy.evaluate(row, recurrent, &mut self.logits, &mut [0.0]);
        match self.choice {
            Choice::Sample => self.distribution.sample(&self.logits, mask, draws, choices),
            Choice::Greedy => self.distribution.greedy(&self.logits, mask, choices),
        };
    }
}

#[cfg(test)]
mod tests {
    use leadtime_taxonomy::shipped;

    use super::*;

    fn policy(words: &str) -> WorkingPolicy {
        crate::test_support::policy("lander", Some(Taxonomy::from_toml(words).unwrap()))
    }

    #[test]
    fn words_that_presuppose_something_else_are_other_words() {
        let text = shipped::text("lander").unwrap();
        let own = policy(text);
        let other = policy(&text.replacen("facts = [\"zone_near\"]", "facts = []", 1));
        assert_eq!(other.texts_checksum(), own.texts_checksum());
        assert_ne!(other.words_checksum(), own.words_checksum());
        assert!(!other.has_words(own.words_checksum()));
        assert!(own.has_words(own.words_checksum()));
        assert!(own.has_words(own.texts_checksum()), "a recording of an older release");
    }
}
