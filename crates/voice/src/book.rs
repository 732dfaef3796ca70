//! The sentences of a notifier as they are spoken.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::sentence::SpokenSentence;

/// Sentences by their text.
#[derive(Clone, Debug, Default)]
pub struct VoiceBook {
    /// Who speaks: `shipped`, `flite:slt`.
    pub name: String,
    /// Samples per second; every sentence with sound has this rate. 0 where none has sound.
    pub rate: u32,
    sentences: BTreeMap<String, Arc<SpokenSentence>>,
}

impl VoiceBook {
    /// Makes a book of sentences; of equal texts the last one stays.
    pub fn new(name: String, sentences: impl IntoIterator<Item = SpokenSentence>) -> Self {
        let sentences = sentences.into_iter().map(|it| (it.text.clone(), Arc::new(it)));
        let sentences: BTreeMap<_, _> = sentences.collect();
        let rate = sentences.values().find_map(|it| Some(it.sound.as_ref()?.rate)).unwrap_or(0);
        Self { name, rate, sentences }
    }

    /// Returns how a text is spoken.
    pub fn get(&self, text: &str) -> Option<&Arc<SpokenSentence>> {
        self.sentences.get(text)
    }

    /// Lists the sentences in the order of the alphabet.
    pub fn sentences(&self) -> impl Iterator<Item = &Arc<SpokenSentence>> {
        self.sentences.values()
    }

    /// Counts the sentences whose times were not measured.
    pub fn n_estimated(&self) -> usize {
        self.sentences().filter(|it| it.is_estimated).count()
    }

    /// Computes how long a word takes on average, in seconds, pauses within sentences included; 0 without sentences.
    pub fn mean_word(&self) -> f64 {
        mean_word(self.sentences().map(AsRef::as_ref))
    }
}

/// Computes how long a word takes on average, in seconds; 0 without sentences.
pub(crate) fn mean_word<'a>(sentences: impl Iterator<Item = &'a SpokenSentence>) -> f64 {
    let (mut seconds, mut n_words) = (0.0, 0);
    for sentence in sentences {
        seconds += f64::from(sentence.end()) / 1e3;
        n_words += sentence.words.len();
    }
    if n_words == 0 { 0.0 } else { seconds / n_words as f64 }
}
