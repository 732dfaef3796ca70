//! A helper of one's own: `pipe:COMMAND` reads sentences, a line of JSON each, and answers with sound.
//!
//! ```text
//! to the helper     {"say":"Climb now, zone ahead."}
//! from the helper   {"rate":16000,"words":[{"at":0,"from":0,"to":5},{"at":0.31,"from":6,"to":10}, ...],"samples":28886}
//!                   28886 samples, 16 bits, little-endian, one channel
//! ```
//!
//! `at` is when a word begins, in seconds; `from` and `to` are its characters in the sentence. Without `words` the times are in
//! proportion to letters. Every sentence has the same rate.

use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::process::{ChildStdin, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use leadtime_taxonomy::words;
use process_wrap::std::ChildWrapper;
use serde::Deserialize;
use serde_json::json;

use crate::child::{self, SENTENCE};
use crate::error::VoiceError;
use crate::sentence::{Sound, SpokenSentence, WordTime};
use crate::speaker::Speaker;
use crate::trim::voiced;
use crate::wav;

/// The longest line of a helper, in bytes.
const MAX_LINE: u64 = 65_536;
/// The longest sentence, in seconds.
const MAX_SECONDS: usize = 60;
/// The rates that a helper may have, in samples per second.
const RATES: std::ops::RangeInclusive<u32> = 4_000..=96_000;
/// How long a helper that was just started may take for its first sentence: it may have a model to load. Tests hang for less.
const START: Duration = Duration::from_secs(if cfg!(test) { 4 } else { 30 });
/// How long a helper that reads or writes no more may take to end.
const ENDS_WITHIN: Duration = Duration::from_millis(200);

/// A command that is started when the first sentence is to be spoken, and again after it hung.
#[derive(Debug)]
pub(crate) struct Helper {
    command: String,
    running: Option<RunningHelper>,
    /// It had all the time that a start may take, and answered nothing: it gets no such time again.
    started_in_vain: bool,
}

#[derive(Debug)]
struct RunningHelper {
    child: Box<dyn ChildWrapper>,
    input: ChildStdin,
    answers: Receiver<Result<HelperAnswer, String>>,
}

/// What a helper says of its sound.
#[derive(Debug, Deserialize)]
struct HelperHead {
    rate: u32,
    #[serde(default)]
    words: Vec<HelperWord>,
    samples: usize,
}

#[derive(Debug, Deserialize)]
struct HelperWord {
    at: f64,
    from: usize,
}

#[derive(Debug)]
struct HelperAnswer {
    head: HelperHead,
    samples: Vec<i16>,
}

impl Helper {
    pub(crate) fn new(command: &str) -> Self {
        Self { command: command.to_owned(), running: None, started_in_vain: false }
    }

    fn start(&self) -> Result<RunningHelper, VoiceError> {
        let failed = |source| VoiceError::Start { what: format!("`{}`", self.command), source };
        let mut command = child::shell(&self.command);
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = child::spawn(command).map_err(failed)?;
        let pipes = child.stdin().take().zip(child.stdout().take());
        let (input, output) = pipes.ok_or_else(|| failed(io::ErrorKind::BrokenPipe.into()))?;
        let (sender, answers) = sync_channel(1);
        let listen = move || listen(BufReader::new(output), &sender);
        thread::Builder::new().name("voice-helper".to_owned()).spawn(listen).map_err(failed)?;
        Ok(RunningHelper { child, input, answers })
    }

    /// Says why a helper that answered nothing has ended.
    fn end_of(&self, mut running: RunningHelper, why: String) -> Result<String, VoiceError> {
        match child::status_within(running.child.as_mut(), ENDS_WITHIN) {
            Some(status) if status.code() == Some(child::NOT_FOUND) => Err(VoiceError::Missing {
                program: self.command.clone(),
                package: "it",
                instead: "--voice text",
            }),
            _ => Ok(why),
        }
    }
}

/// Reads answers until one cannot be read.
fn listen(mut output: impl io::BufRead, answers: &SyncSender<Result<HelperAnswer, String>>) {
    loop {
        let answer = read_answer(&mut output);
        let is_last = answer.is_err();
        if answers.send(answer).is_err() || is_last {
            return;
        }
    }
}

fn read_answer(output: &mut impl io::BufRead) -> Result<HelperAnswer, String> {
    let mut line = Vec::new();
    let read = output.take(MAX_LINE).read_until(b'\n', &mut line);
    read.map_err(|error| format!("the helper cannot be read: {error}"))?;
    if line.is_empty() {
        return Err("the helper ended".to_owned());
    }
    let head: HelperHead = serde_json::from_slice(&line).map_err(|error| {
        format!("what the helper answers is no line of JSON as expected: {error}")
    })?;
    if !RATES.contains(&head.rate) || head.samples > head.rate as usize * MAX_SECONDS {
        return Err(format!(
            "the helper answers with {} samples at {} a second",
            head.samples, head.rate
        ));
    }
    let mut bytes = vec![0; 2 * head.samples];
    output
        .read_exact(&mut bytes)
        .map_err(|error| format!("the helper's sound ends early: {error}"))?;
    Ok(HelperAnswer { samples: wav::pcm(&bytes), head })
}

/// Finds the time of each piece of a sentence; `None` if the helper does not report it for each, in order.
fn word_times(text: &str, told: &[HelperWord], end: u32) -> Option<Vec<WordTime>> {
    let mut begins = Vec::new();
    for piece in words::spoken(text) {
        let first = piece.as_ptr() as usize - text.as_ptr() as usize;
        let from = text[..first].chars().count();
        let to = from + piece.chars().count();
        let word = told.iter().find(|word| (from..to).contains(&word.from))?;
        (word.at.is_finite() && word.at >= 0.0).then_some(())?;
        begins.push((word.at * 1e3).round() as u32);
    }
    let ends = begins.iter().copied().skip(1).chain([end]);
    let times = begins.iter().copied().zip(ends).map(|(begin, end)| WordTime { begin, end });
    let times: Vec<WordTime> = times.collect();
    times.iter().all(|word| word.begin <= word.end).then_some(times)
}

impl Speaker for Helper {
    fn made_by(&self) -> String {
        self.command.clone()
    }

    fn prepare(&mut self, _sentences: &[&str]) -> Result<(), VoiceError> {
        // How fast it speaks is the helper's own affair.
        Ok(())
    }

    fn say(&mut self, text: &str) -> Result<Result<SpokenSentence, String>, VoiceError> {
        let (mut running, is_new) = match self.running.take() {
            Some(running) => (running, false),
            None => (self.start()?, true),
        };
        let patience = if is_new && !self.started_in_vain { START } else { SENTENCE };
        let line = json!({"say": text}).to_string() + "\n";
        let written = running.input.write_all(line.as_bytes());
        let told = match running.answers.recv_timeout(patience) {
            Ok(answer) => answer,
            Err(RecvTimeoutError::Timeout) => {
                self.started_in_vain = is_new;
                Err(format!("the helper took more than {} s", patience.as_secs()))
            }
            Err(RecvTimeoutError::Disconnected) => Err("the helper ended".to_owned()),
        };
        let HelperAnswer { head, samples } = match (told, written) {
            (Ok(answer), _) => answer,
            (Err(why), _) => return self.end_of(running, why).map(Err),
        };
        self.running = Some(running);
        let voiced = voiced(&samples, head.rate);
        let sound = Sound { rate: head.rate, samples: samples.into() };
        let Some((_, to)) = voiced else {
            return Ok(Err("the helper's sound is silent".to_owned()));
        };
        let end = (to * 1e3) as u32;
        let spoken = match word_times(text, &head.words, end) {
            Some(words) => {
                SpokenSentence { text: text.to_owned(), words, is_estimated: false, sound: None }
            }
            None => SpokenSentence::estimated(text, end),
        };
        Ok(Ok(SpokenSentence { sound: Some(sound), ..spoken }))
    }
}

impl Drop for RunningHelper {
    fn drop(&mut self) {
        child::end(self.child.as_mut());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_found_by_their_characters() {
        let told = |at, from| HelperWord { at, from };
        let words = word_times("Zürich - now!", &[told(0.0, 0), told(0.4, 9)], 700).unwrap();
        assert_eq!(words, [WordTime { begin: 0, end: 400 }, WordTime { begin: 400, end: 700 }]);
        for wrong in [
            vec![],
            vec![told(0.0, 0)],
            vec![told(0.5, 0), told(0.4, 9)],
            vec![told(0.0, 0), told(f64::NAN, 9)],
        ] {
            assert_eq!(word_times("Zürich - now!", &wrong, 700), None, "{wrong:?}");
        }
    }

    #[test]
    fn garbage_is_not_taken_for_an_answer() {
        let read = |bytes: &[u8]| read_answer(&mut BufReader::new(bytes));
        let good = b"{\"rate\":16000,\"samples\":2}\n\x01\0\x02\0";
        assert_eq!(read(good).unwrap().samples, [1, 2]);
        for (garbage, told) in [
            (&b""[..], "the helper ended"),
            (b"noise\n", "no line of JSON"),
            (b"{\"rate\":16000,\"samples\":2}\n\x01", "ends early"),
            (b"{\"rate\":16000,\"samples\":99000000000}\n", "99000000000 samples"),
            (b"{\"rate\":1,\"samples\":2}\n", "at 1 a second"),
        ] {
            let error = read(garbage).unwrap_err();
            assert!(error.contains(told), "{error}");
        }
        let endless = vec![b'x'; 2 * MAX_LINE as usize];
        assert!(read(&endless).is_err());
    }
}
