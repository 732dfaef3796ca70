//! Sentences in one stretch of sound: `voice.json` says where each begins and when its words do.
//!
//! ```json
//! {"schema":1,"made_by":"flite 2.2, voice slt","rate":16000,"sentences":[
//!   {"text":"Climb now, zone ahead.","from":0,"samples":19200,"words":[[0,281],[281,562],[640,910],[910,1190]]}]}
//! ```
//!
//! Words are in milliseconds from the beginning of their sentence.

use serde::{Deserialize, Serialize};

use crate::sentence::{Sound, SpokenSentence, WordTime};

/// The version of the format.
const SCHEMA: u32 = 1;
/// Silence after each sentence, in milliseconds: what compression smears does not reach the next one.
const GAP: usize = 60;

/// Where the sentences of a stretch of sound are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SoundIndex {
    schema: u32,
    /// What spoke, with its settings.
    pub made_by: String,
    /// Samples per second, 4,000 to 96,000.
    pub rate: u32,
    sentences: Vec<IndexedSentence>,
}

/// Where a sentence is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct IndexedSentence {
    text: String,
    from: usize,
    samples: usize,
    words: Vec<[u32; 2]>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    estimated: bool,
}

impl SoundIndex {
    /// Puts sentences that have sound of one rate after one another; returns where each is, and the sound.
    pub fn join<'a>(
        made_by: String,
        rate: u32,
        sentences: impl IntoIterator<Item = &'a SpokenSentence>,
    ) -> (Self, Vec<i16>) {
        let (mut all, mut indexed) = (Vec::new(), Vec::new());
        for spoken in sentences {
            let Some(sound) = spoken.sound.as_ref().filter(|sound| sound.rate == rate) else {
                continue;
            };
            indexed.push(IndexedSentence {
                text: spoken.text.clone(),
                from: all.len(),
                samples: sound.samples.len(),
                words: spoken.words.iter().map(|word| [word.begin, word.end]).collect(),
                estimated: spoken.is_estimated,
            });
            all.extend_from_slice(&sound.samples);
            all.resize(all.len() + GAP * rate as usize / 1_000, 0);
        }
        (Self { schema: SCHEMA, made_by, rate, sentences: indexed }, all)
    }

    /// Writes it, a line a sentence.
    pub fn write(&self) -> String {
        // Plain data into memory: it cannot fail.
        let text = serde_json::to_string(self).unwrap_or_default();
        text.replace("{\"text\"", "\n{\"text\"") + "\n"
    }

    /// Reads it.
    ///
    /// # Errors
    ///
    /// If it is no JSON of an index, or of another schema or an impossible rate; in words.
    pub fn read(text: &str) -> Result<Self, String> {
        let read: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if read.schema != SCHEMA {
            return Err(format!("is of schema {}; known: {SCHEMA}", read.schema));
        }
        if !(4_000..=96_000).contains(&read.rate) {
            return Err(format!("has {} samples per second; allowed: 4000 to 96000", read.rate));
        }
        Ok(read)
    }

    /// Counts the sentences that have sound.
    pub fn n_sentences(&self) -> usize {
        self.sentences.len()
    }

    /// Returns each sentence, with its part of the sound where that is given.
    ///
    /// # Errors
    ///
    /// If the sound ends before a sentence, or the times of a sentence do not fit its words; in words.
    pub fn sentences(&self, sound: Option<&[i16]>) -> Result<Vec<SpokenSentence>, String> {
        self.sentences.iter().map(|indexed| self.sentence(indexed, sound)).collect()
    }

    fn sentence(
        &self,
        indexed: &IndexedSentence,
        sound: Option<&[i16]>,
    ) -> Result<SpokenSentence, String> {
        let text = &indexed.text;
        let sound = match sound {
            None => None,
            Some(all) => {
                let to = indexed.from.saturating_add(indexed.samples);
                let part = all.get(indexed.from..to);
                let part = part.ok_or_else(|| format!("the sound ends before `{text}`"))?;
                Some(Sound { rate: self.rate, samples: part.into() })
            }
        };
        let words = indexed.words.iter().map(|&[begin, end]| WordTime { begin, end }).collect();
        let is_estimated = indexed.estimated;
        let spoken = SpokenSentence { text: text.clone(), words, is_estimated, sound };
        let length = (indexed.samples as u64).saturating_mul(1_000) / u64::from(self.rate) + 1;
        if !spoken.has_words_in_order() || u64::from(spoken.end()) > length {
            return Err(format!("the times of `{text}` do not fit its words"));
        }
        Ok(spoken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spoken(text: &str, sample: i16) -> SpokenSentence {
        let sound = Sound { rate: 16_000, samples: vec![sample; 16_000].into() };
        SpokenSentence { sound: Some(sound), ..SpokenSentence::estimated(text, 900) }
    }

    #[test]
    fn sentences_are_found_again_in_one_stretch_of_sound() {
        let sentences = [spoken("Go up.", 7), spoken("Go down now.", 9)];
        let (index, all) = SoundIndex::join("me".to_owned(), 16_000, &sentences);
        let read = SoundIndex::read(&index.write()).unwrap();
        assert_eq!(read, index);
        assert_eq!(read.sentences(Some(&all)).unwrap(), sentences);
        let without = read.sentences(None).unwrap();
        assert_eq!(
            (without[1].words.clone(), &without[1].sound),
            (sentences[1].words.clone(), &None)
        );
        let told = read.sentences(Some(&all[..20_000])).unwrap_err();
        assert_eq!(told, "the sound ends before `Go down now.`");
    }

    #[test]
    fn a_sentence_of_any_length_is_read() {
        let (index, _) = SoundIndex::join("me".to_owned(), 16_000, &[spoken("Go up.", 7)]);
        // In milliseconds so many samples are more than a number holds.
        let samples = format!("\"samples\":{}", usize::MAX);
        let text = index.write().replacen("\"samples\":16000", &samples, 1);
        let index = SoundIndex::read(&text).unwrap();
        index.sentences(None).unwrap();
        assert_eq!(index.sentences(Some(&[0])).unwrap_err(), "the sound ends before `Go up.`");
    }

    #[test]
    fn an_index_with_other_words_than_times_is_refused() {
        let (index, _) = SoundIndex::join("me".to_owned(), 16_000, &[spoken("Go up.", 7)]);
        let text = index.write();
        for (from, to, told) in [
            ("Go up.", "Go up now.", "do not fit its words"),
            ("\"samples\":16000", "\"samples\":160", "do not fit its words"),
            ("\"schema\":1", "\"schema\":2", "is of schema 2"),
            ("\"rate\":16000", "\"rate\":1", "has 1 samples per second"),
            ("\"made_by\"", "\"made\"", "unknown field"),
        ] {
            let read = SoundIndex::read(&text.replacen(from, to, 1));
            let error = read.and_then(|index| index.sentences(None)).unwrap_err();
            assert!(error.contains(told), "{error}");
        }
    }
}
