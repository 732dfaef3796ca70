//! espeak-ng, or espeak: called as a program of its own. It reports no times of words, so they are in proportion to
//! letters.

use std::process::Command;

use tempfile::TempDir;

use crate::book::mean_word;
use crate::child;
use crate::error::VoiceError;
use crate::sentence::{MEAN_WORD, Sound, SpokenSentence};
use crate::speaker::Speaker;
use crate::trim::{trimmed, voiced};
use crate::wav;

/// Names of the program, the newer first.
const PROGRAMS: [&str; 2] = ["espeak-ng", "espeak"];
/// Words a minute that are asked for at first, and the range that espeak knows.
const RATE: f64 = 200.0;
const RATES: (f64, f64) = (80.0, 450.0);

/// An espeak program of this machine.
#[derive(Debug)]
pub(crate) struct Espeak {
    program: &'static str,
    words_per_minute: f64,
    directory: TempDir,
}

impl Espeak {
    /// Finds the program.
    ///
    /// # Errors
    ///
    /// [`VoiceError::Missing`] if neither program is installed, [`VoiceError::Temporary`] if no directory can be made
    /// for its sound.
    pub(crate) fn find() -> Result<Self, VoiceError> {
        let is_there = |program: &&str| {
            let mut version = Command::new(program);
            version.arg("--version");
            child::output(version, missing).is_ok()
        };
        let program = PROGRAMS.into_iter().find(is_there).ok_or_else(missing)?;
        let directory = TempDir::new().map_err(VoiceError::Temporary)?;
        Ok(Self { program, words_per_minute: RATE, directory })
    }
}

fn missing() -> VoiceError {
    let program = PROGRAMS[0].to_owned();
    VoiceError::Missing { program, package: PROGRAMS[0], instead: "--voice text" }
}

impl Speaker for Espeak {
    fn made_by(&self) -> String {
        format!("{}, {:.0} words a minute", self.program, self.words_per_minute)
    }

    fn prepare(&mut self, sentences: &[&str]) -> Result<(), VoiceError> {
        let mut spoken = Vec::new();
        for text in sentences {
            // One that hangs here hangs later, too, and is reported then.
            let Ok(said) = self.say(text)? else { break };
            spoken.push(said);
        }
        let mean = mean_word(spoken.iter());
        if mean > 0.0 {
            let asked = self.words_per_minute * mean / MEAN_WORD;
            self.words_per_minute = asked.clamp(RATES.0, RATES.1).round();
        }
        Ok(())
    }

    fn say(&mut self, text: &str) -> Result<Result<SpokenSentence, String>, VoiceError> {
        let path = self.directory.path().join("sentence.wav");
        // What an earlier sentence left is no sound of this one.
        drop(std::fs::remove_file(&path));
        let mut command = Command::new(self.program);
        command.args(["-v", "en-us", "-s", &self.words_per_minute.to_string()]);
        command.arg("-w").arg(&path).arg("--").arg(text);
        if let Err(why) = child::output(command, missing)? {
            return Ok(Err(why));
        }
        let read = std::fs::read(&path).map_err(|error| error.to_string());
        let (rate, samples) = match read.and_then(|bytes| wav::read(&bytes)) {
            Ok(sound) => sound,
            Err(why) => return Ok(Err(format!("the sound of {} {why}", self.program))),
        };
        let Some((from, to)) = voiced(&samples, rate) else {
            return Ok(Err(format!("{} is silent", self.program)));
        };
        let spoken = SpokenSentence::estimated(text, ((to - from) * 1e3) as u32);
        let samples = trimmed(&samples, rate, from, to).into();
        Ok(Ok(SpokenSentence { sound: Some(Sound { rate, samples }), ..spoken }))
    }
}
