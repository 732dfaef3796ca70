//! From a voice's name and the sentences of a notifier to the book that it speaks from.

use std::collections::BTreeMap;

use tracing::{info, warn};

use crate::book::VoiceBook;
use crate::child::MAX_FAILURES;
use crate::choice::{FLITE_VOICE, VoiceChoice};
use crate::error::VoiceError;
use crate::espeak::Espeak;
use crate::flite::Flite;
use crate::helper::Helper;
use crate::sentence::SpokenSentence;
use crate::speaker::Speaker;
use crate::{recorded, shipped};

/// Prepares a voice for the sentences of a domain; `None` for a voice without times of its own, `none` and `text`.
///
/// `with_sound` says whether the sound is needed, or the times of words alone. A sentence that the voice cannot speak has times
/// in proportion to its letters, and one warning says how many there are.
///
/// # Errors
///
/// [`VoiceError`] if the program behind the voice is missing, or the directory cannot be read.
pub fn prepare(
    choice: &VoiceChoice,
    domain: &str,
    texts: &[&str],
    with_sound: bool,
) -> Result<Option<VoiceBook>, VoiceError> {
    let sentences = match choice {
        VoiceChoice::None | VoiceChoice::Text => return Ok(None),
        VoiceChoice::Shipped => {
            let known = shipped::sentences(domain, with_sound).unwrap_or_default();
            completed(known, texts, "shipped with the program")?
        }
        VoiceChoice::Recorded(directory) => {
            let known = recorded::sentences(directory, with_sound)?;
            completed(known, texts, &format!("in {}", directory.display()))?
        }
        VoiceChoice::Flite(_) | VoiceChoice::Espeak | VoiceChoice::Pipe(_) => {
            speak(choice, texts)?.1
        }
    };
    Ok(Some(VoiceBook::new(choice.to_string(), sentences)))
}

/// Lets a program speak every text; returns what it is, and the sentences in the order of the texts.
///
/// # Errors
///
/// [`VoiceError::Missing`] or [`VoiceError::FliteVoice`] if it is not there; [`VoiceError::NoSpeaker`] for a voice that is no program.
pub fn speak(
    choice: &VoiceChoice,
    texts: &[&str],
) -> Result<(String, Vec<SpokenSentence>), VoiceError> {
    let mut speaker: Box<dyn Speaker> = match choice {
        VoiceChoice::Flite(voice) => Box::new(Flite::find(voice)?),
        VoiceChoice::Espeak => Box::new(Espeak::find()?),
        VoiceChoice::Pipe(command) => Box::new(Helper::new(command)),
        _ => return Err(VoiceError::NoSpeaker(choice.to_string())),
    };
    info!(voice = %choice, sentences = texts.len(), "sentences are being spoken");
    speaker.prepare(texts)?;
    let mut failures = Failures::default();
    let mut sentences = Vec::with_capacity(texts.len());
    for text in texts {
        let said = if failures.is_given_up() {
            None
        } else {
            failures.note(speaker.say(text)?.and_then(|spoken| failures.checked(spoken)))
        };
        sentences.push(said.unwrap_or_else(|| SpokenSentence::unheard(text)));
    }
    let n_unheard = sentences.iter().filter(|spoken| spoken.sound.is_none()).count();
    if n_unheard > 0 {
        let (n, why) = (texts.len(), failures.why);
        warn!(
            "{n_unheard} of {n} sentences have no sound, and times in proportion to their letters: {why}"
        );
    }
    Ok((speaker.made_by(), sentences))
}

/// What a speaker could not do.
#[derive(Debug, Default)]
struct Failures {
    n_in_a_row: u32,
    why: String,
    rate: Option<u32>,
}

impl Failures {
    fn is_given_up(&self) -> bool {
        self.n_in_a_row >= MAX_FAILURES
    }

    fn note(&mut self, said: Result<SpokenSentence, String>) -> Option<SpokenSentence> {
        match said {
            Ok(spoken) => {
                self.n_in_a_row = 0;
                self.rate = spoken.sound.as_ref().map(|sound| sound.rate);
                Some(spoken)
            }
            Err(why) => {
                self.n_in_a_row += 1;
                if self.why.is_empty() {
                    self.why = why;
                }
                None
            }
        }
    }

    /// Makes sure that all sentences go through one loudspeaker.
    fn checked(&self, spoken: SpokenSentence) -> Result<SpokenSentence, String> {
        let rate = spoken.sound.as_ref().map(|sound| sound.rate);
        match (self.rate, rate) {
            (Some(before), Some(now)) if before != now => {
                Err(format!("one sentence has {before} samples per second, another one {now}"))
            }
            _ => Ok(spoken),
        }
    }
}

/// Returns the texts' sentences; those that are not known are spoken by flite if it is installed.
fn completed(
    known: Vec<SpokenSentence>,
    texts: &[&str],
    place: &str,
) -> Result<Vec<SpokenSentence>, VoiceError> {
    let mut known: BTreeMap<String, SpokenSentence> =
        known.into_iter().map(|spoken| (spoken.text.clone(), spoken)).collect();
    let rate = known.values().find_map(|spoken| Some(spoken.sound.as_ref()?.rate));
    let missing: Vec<&str> =
        texts.iter().copied().filter(|text| !known.contains_key(*text)).collect();
    if !missing.is_empty() {
        let (n, n_texts) = (missing.len(), texts.len());
        let spoken = match speak(&VoiceChoice::Flite(FLITE_VOICE.to_owned()), &missing) {
            Ok((_, spoken)) => {
                warn!("{n} of {n_texts} sentences have no sound {place}; flite speaks them");
                spoken
            }
            Err(VoiceError::Missing { .. } | VoiceError::FliteVoice { .. }) => {
                warn!(
                    "{n} of {n_texts} sentences have no sound {place}; their words get times in proportion to their letters. \
                     Install flite, or make their sound with `leadtime taxonomy speak`"
                );
                missing.iter().map(|text| SpokenSentence::unheard(text)).collect()
            }
            Err(error) => return Err(error),
        };
        let one_rate = |mut it: SpokenSentence| {
            // A loudspeaker has one rate: better silent than too fast.
            let fits =
                rate.is_none() || it.sound.as_ref().is_none_or(|sound| Some(sound.rate) == rate);
            if !fits {
                it.sound = None;
            }
            it
        };
        known.extend(spoken.into_iter().map(one_rate).map(|it| (it.text.clone(), it)));
    }
    Ok(texts.iter().filter_map(|text| known.remove(*text)).collect())
}

#[cfg(test)]
#[path = "prepare_tests.rs"]
mod tests;
