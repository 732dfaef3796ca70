//! flite: a small synthesiser that reports when each phone ends, from which the times of words are made.
//!
//! ```text
//! flite -voice slt -t "Climb now, zone ahead." -psdur     pau:0.198 k:0.278 l:0.342 ay:0.452 m:0.557 n:0.640 ...
//! flite -voice slt -t "Climb" -ps                         pau k l ay m pau            so "Climb" has four phones
//! ```
//!
//! The phones of a sentence are dealt out to its words by how many each word has when it is spoken alone. Of the 520 shipped
//! sentences not one has another number than its words together; where one has, its times are estimated.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;

use leadtime_taxonomy::words;
use tempfile::TempDir;

use crate::child;
use crate::error::VoiceError;
use crate::sentence::{MEAN_WORD, Sound, SpokenSentence, WordTime};
use crate::speaker::Speaker;
use crate::trim::trimmed;
use crate::wav;

/// How much a voice is stretched while its pace is measured: nearly what it will be, because pauses do not stretch as words do.
const FIRST_STRETCH: f64 = 0.8;
/// The least and the most that a voice is stretched.
const STRETCH: (f64, f64) = (0.4, 2.5);

#[derive(Debug)]
pub(crate) struct Flite {
    voice: String,
    /// How long phones are, in terms of the voice's own.
    stretch: f64,
    /// How many phones a word has.
    n_phones: BTreeMap<String, usize>,
    directory: TempDir,
}

impl Flite {
    /// Finds flite and its voice.
    ///
    /// # Errors
    ///
    /// [`VoiceError::Missing`] if flite is not installed, [`VoiceError::FliteVoice`] if it lacks the voice,
    /// [`VoiceError::Temporary`] if no directory can be made for its sound.
    pub(crate) fn find(voice: &str) -> Result<Self, VoiceError> {
        let mut list = Command::new("flite");
        list.arg("-lv");
        let printed = child::output(list, missing)?.unwrap_or_default();
        let known = printed.split_once(':').map_or("", |(_, names)| names.trim());
        if !known.split_whitespace().any(|name| name == voice) {
            let known = known.split_whitespace().collect::<Vec<_>>().join(", ");
            return Err(VoiceError::FliteVoice { name: voice.to_owned(), known });
        }
        let directory = TempDir::new().map_err(VoiceError::Temporary)?;
        Ok(Self {
            voice: voice.to_owned(),
            stretch: FIRST_STRETCH,
            n_phones: BTreeMap::new(),
            directory,
        })
    }

    fn command(&self, text: &str) -> Command {
        let mut command = Command::new("flite");
        command.args([
            "-voice",
            &self.voice,
            "--setf",
            &format!("duration_stretch={}", self.stretch),
        ]);
        command.args(["-t", text]);
        command
    }

    /// Counts the phones of each word of a sentence; `None` where flite does not report them.
    fn count_phones(&mut self, text: &str) -> Result<Option<Vec<usize>>, VoiceError> {
        let mut counts = Vec::new();
        for piece in words::spoken(text) {
            let word = piece.trim_matches(|c: char| !c.is_alphanumeric());
            if let Some(n) = self.n_phones.get(word) {
                counts.push(*n);
                continue;
            }
            let mut command = self.command(word);
            command.args(["-ps", "-o", "none"]);
            let Ok(printed) = child::output(command, missing)? else { return Ok(None) };
            let n = printed.split_whitespace().filter(|phone| *phone != PAUSE).count();
            self.n_phones.insert(word.to_owned(), n);
            counts.push(n);
        }
        Ok(Some(counts))
    }
}

fn missing() -> VoiceError {
    VoiceError::Missing { program: "flite".to_owned(), package: "flite", instead: "--voice text" }
}

/// What flite calls silence.
const PAUSE: &str = "pau";

/// A phone that is heard, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Phone {
    begin: f64,
    end: f64,
}

/// Reads `pau:0.198 k:0.278 ...` without the pauses; `None` if it is something else.
fn phones(printed: &str) -> Option<Vec<Phone>> {
    let (mut begin, mut found) = (0.0, Vec::new());
    for phone in printed.split_whitespace() {
        let (name, end) = phone.rsplit_once(':')?;
        let end: f64 = end.parse().ok().filter(|end| *end >= begin)?;
        if name != PAUSE {
            found.push(Phone { begin, end });
        }
        begin = end;
    }
    (!found.is_empty()).then_some(found)
}

/// Deals phones out to words; `None` if there are more or fewer. Times are from the first phone on.
fn word_times(phones: &[Phone], counts: &[usize]) -> Option<Vec<WordTime>> {
    let is_dealt = counts.iter().sum::<usize>() == phones.len() && !counts.contains(&0);
    let first = phones.first().filter(|_| is_dealt)?.begin;
    let milliseconds = |at: f64| ((at - first) * 1e3).round() as u32;
    let mut rest = phones;
    let mut times = Vec::new();
    for n in counts {
        let (word, after) = rest.split_at(*n);
        let (begin, end) = (milliseconds(word[0].begin), milliseconds(word[n - 1].end));
        times.push(WordTime { begin, end });
        rest = after;
    }
    Some(times)
}

impl Speaker for Flite {
    fn made_by(&self) -> String {
        format!("flite, voice {}, stretch {:.3}", self.voice, self.stretch)
    }

    fn prepare(&mut self, sentences: &[&str]) -> Result<(), VoiceError> {
        self.stretch = FIRST_STRETCH;
        let (mut seconds, mut n_words) = (0.0, 0);
        for text in sentences {
            let mut command = self.command(text);
            command.args(["-psdur", "-o", "none"]);
            let printed = child::output(command, missing)?;
            // One that hangs here hangs later, too, and is reported then.
            let Some(phones) = printed.ok().and_then(|printed| phones(&printed)) else { break };
            seconds += phones[phones.len() - 1].end - phones[0].begin;
            n_words += words::count(text);
        }
        if n_words > 0 {
            let mean = seconds / f64::from(n_words);
            self.stretch = (self.stretch * MEAN_WORD / mean).clamp(STRETCH.0, STRETCH.1);
        }
        Ok(())
    }

    fn say(&mut self, text: &str) -> Result<Result<SpokenSentence, String>, VoiceError> {
        let path: PathBuf = self.directory.path().join("sentence.wav");
        // What an earlier sentence left is no sound of this one.
        drop(std::fs::remove_file(&path));
        let mut command = self.command(text);
        command.arg("-psdur").arg("-o").arg(&path);
        let printed = match child::output(command, missing)? {
            Ok(printed) => printed,
            Err(why) => return Ok(Err(why)),
        };
        let read = std::fs::read(&path).map_err(|error| error.to_string());
        let (rate, samples) = match read.and_then(|bytes| wav::read(&bytes)) {
            Ok(sound) => sound,
            Err(why) => return Ok(Err(format!("the sound of flite {why}"))),
        };
        let Some(phones) = phones(&printed) else {
            return Ok(Err("flite tells no phones".to_owned()));
        };
        let (first, last) = (phones[0].begin, phones[phones.len() - 1].end);
        let counts = self.count_phones(text)?;
        let times = counts.and_then(|counts| word_times(&phones, &counts));
        let samples = trimmed(&samples, rate, first, last);
        let length = ((last - first) * 1e3) as u32;
        let spoken = match times {
            Some(words) => {
                SpokenSentence { text: text.to_owned(), words, is_estimated: false, sound: None }
            }
            None => SpokenSentence::estimated(text, length),
        };
        Ok(Ok(SpokenSentence { sound: Some(Sound { rate, samples: samples.into() }), ..spoken }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phones_are_dealt_out_to_words_and_a_pause_belongs_to_no_word() {
        let phones = phones("pau:0.2 k:0.3 l:0.35 ay:0.45 pau:0.6 n:0.7 aw:0.9 pau:1.1").unwrap();
        assert_eq!(phones.len(), 5);
        let words = word_times(&phones, &[3, 2]).unwrap();
        assert_eq!(words, [WordTime { begin: 0, end: 250 }, WordTime { begin: 400, end: 700 }]);
        assert_eq!(word_times(&phones, &[3, 1]), None);
        assert_eq!(word_times(&phones, &[5, 0]), None);
    }

    #[test]
    fn text_that_is_not_a_list_of_phones_is_not_taken_for_one() {
        for printed in ["", "pau:0.2", "usage: flite TEXT", "k:0.3 l:0.2", "k"] {
            assert_eq!(phones(printed), None, "{printed}");
        }
    }
}
