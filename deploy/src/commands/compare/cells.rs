//! Judged cells on disk, so that writing a study again plays nothing again.
//!
//! ```text
//! runs/compare/<run>/evaluations/<question>.json     what the policy of a run did
//! runs/compare/evaluations/<question>.json           what a script did
//! ```
//!
//! A file's name is a digest over everything that was asked: who plays, in which task, which episodes, and what is told
//! of them. Which program gave the answer stands inside: the answer of another build, or of another class of processor,
//! is not taken but replaced, so that files do not pile up with every build.
//!
//! The first line is a digest over the second, and every number is written as its bits. So an answer that is taken is
//! the one that was given, bit for bit, also where a value is no number; and a file that was damaged counts as none.

use std::fs;
use std::io;
use std::path::Path;

use leadtime_eval::measure::{EpisodeResult, Evaluation};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use leadtime_runs::write_atomically;
use leadtime_runs::{build, cpu, digest::hex};

/// Digits of a question's digest in a file's name.
const NAME_DIGITS: usize = 32;

/// What was asked, as a digest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Question(String);

impl Question {
    /// Digests everything that decides an answer, the program excepted.
    ///
    /// # Errors
    ///
    /// If it has no JSON form.
    pub(super) fn new<T: Serialize>(asked: &T) -> serde_json::Result<Self> {
        let digest = digest(&serde_json::to_vec(asked)?);
        Ok(Self(digest.chars().take(NAME_DIGITS).collect()))
    }

    /// Returns the name of the file for its answer.
    pub(super) fn file(&self) -> String {
        format!("{}.json", self.0)
    }
}

/// The cells that were judged by this build of the program.
#[derive(Clone, Debug)]
pub(super) struct Cells {
    /// Who answers.
    program: String,
    n_taken: usize,
    n_judged: usize,
}

/// A file's second line.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Answer {
    program: String,
    player: String,
    seed: u64,
    metrics: Vec<String>,
    /// Bits of the reward, steps, whether a time limit ended it, bits of the metrics.
    episodes: Vec<(u64, u64, bool, Vec<u32>)>,
}

impl Cells {
    /// Reads which program this is.
    ///
    /// # Errors
    ///
    /// As [`build::executable_digest`].
    pub(super) fn new() -> io::Result<Self> {
        let program = format!("{} on {}", build::executable_digest()?, cpu::fingerprint());
        Ok(Self::of(program))
    }

    fn of(program: String) -> Self {
        Self { program, n_taken: 0, n_judged: 0 }
    }

    /// Takes an answer that this program gave before; `None` if there is none.
    pub(super) fn take(&mut self, path: &Path) -> Option<Evaluation> {
        let text = fs::read_to_string(path).ok()?;
        let (expected, json) = text.split_once('\n')?;
        let intact = digest(json.as_bytes()) == expected;
        let answer: Answer = serde_json::from_str(json).ok().filter(|_| intact)?;
        let evaluation = answer.by(&self.program)?;
        self.n_taken += 1;
        Some(evaluation)
    }

    /// Keeps an answer; where that is impossible, it will be played again.
    pub(super) fn keep(&mut self, path: &Path, evaluation: &Evaluation) {
        self.n_judged += 1;
        if let Err(error) = self.write(path, evaluation) {
            tracing::warn!(path = %path.display(), %error, "an evaluation cannot be kept");
        }
    }

    fn write(&self, path: &Path, evaluation: &Evaluation) -> io::Result<()> {
        let json = serde_json::to_string(&Answer::new(&self.program, evaluation))?;
        if let Some(directory) = path.parent() {
            fs::create_dir_all(directory)?;
        }
        write_atomically(path, format!("{}\n{json}", digest(json.as_bytes())).as_bytes())
    }

    /// Says how much was played, and how much was there.
    pub(super) fn sentence(&self) -> String {
        let Self { n_judged, n_taken, .. } = self;
        format!("judged {n_judged} cells, and took {n_taken} that were judged before")
    }
}

impl Answer {
    fn new(program: &str, evaluation: &Evaluation) -> Self {
        let Evaluation { player, seed, metrics, episodes } = evaluation.clone();
        let bits = |episode: EpisodeResult| {
            let metrics = episode.metrics.into_iter().map(f32::to_bits).collect();
            (episode.total_reward.to_bits(), episode.n_steps, episode.truncated, metrics)
        };
        let episodes = episodes.into_iter().map(bits).collect();
        Self { program: program.to_owned(), player, seed, metrics, episodes }
    }

    /// Returns the answer, if it is this program's.
    fn by(self, program: &str) -> Option<Evaluation> {
        let Self { player, seed, metrics, episodes, .. } = self;
        let episode =
            |(reward, n_steps, truncated, metrics): (u64, u64, bool, Vec<u32>)| EpisodeResult {
                total_reward: f64::from_bits(reward),
                n_steps,
                truncated,
                metrics: metrics.into_iter().map(f32::from_bits).collect(),
            };
        let episodes = episodes.into_iter().map(episode).collect();
        (self.program == program).then_some(Evaluation { player, seed, metrics, episodes })
    }
}

fn digest(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation() -> Evaluation {
        let episode = |total_reward: f64, value: f32| EpisodeResult {
            total_reward,
            n_steps: 80,
            truncated: false,
            metrics: vec![value, 0.1],
        };
        Evaluation {
            player: "p".to_owned(),
            seed: 2_000_101,
            metrics: vec!["lead_time".to_owned(), "success".to_owned()],
            episodes: vec![episode(0.1 + 0.2, 7.0), episode(f64::MIN_POSITIVE, f32::NAN)],
        }
    }

    #[test]
    fn an_answer_is_taken_bit_for_bit_by_the_program_that_gave_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("evaluations/a.json");
        let mut cells = Cells::of("one".to_owned());
        assert_eq!(cells.take(&path), None);
        cells.keep(&path, &evaluation());
        let taken = cells.take(&path).unwrap();
        assert_eq!(Answer::new("", &taken), Answer::new("", &evaluation()));
        assert_eq!(cells.sentence(), "judged 1 cells, and took 1 that were judged before");
        let mut other = Cells::of("other".to_owned());
        assert_eq!(other.take(&path), None);
        other.keep(&path, &evaluation());
        assert!(other.take(&path).is_some() && cells.take(&path).is_none());
        assert_eq!(fs::read_dir(dir.path().join("evaluations")).unwrap().count(), 1);
    }

    #[test]
    fn a_damaged_file_counts_as_none_whichever_byte_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.json");
        let mut cells = Cells::of("one".to_owned());
        cells.keep(&path, &evaluation());
        let whole = fs::read(&path).unwrap();
        for place in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[place] ^= 1;
            fs::write(&path, damaged).unwrap();
            assert_eq!(cells.take(&path), None, "byte {place}");
        }
        fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        assert_eq!(cells.take(&path), None);
    }

    #[test]
    fn what_cannot_be_written_is_no_error() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("evaluations"), "a file").unwrap();
        let mut cells = Cells::of("one".to_owned());
        cells.keep(&dir.path().join("evaluations/a.json"), &evaluation());
        assert_eq!(cells.take(&dir.path().join("evaluations/a.json")), None);
    }
}
