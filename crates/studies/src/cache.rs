//! Evaluations on disk, so that writing a study again plays nothing again.
//!
//! ```text
//! runs/compare/<run>/evaluations/<key>     what the policy of a run did
//! runs/compare/evaluations/<key>           what a script did
//! ```
//!
//! A file's name is a digest over everything that was asked: who plays, in which task, which episodes, and which metrics
//! are computed. Which program gave the answer stands inside: the answer of another build, or of another class of
//! processor, is not taken but replaced, so that files do not pile up with every build.
//!
//! The digest over a file's content stands in front of it, and numbers keep their bits: an evaluation that is taken is the
//! one that was made, also where a value is no number; and a damaged file counts as none.

use std::fs;
use std::io;
use std::path::Path;

use leadtime_eval::measure::Evaluation;
use leadtime_proto::{codec, limits};
use leadtime_runs::digest::sha256;
use leadtime_runs::{ProgramBuild, regular, write_atomically};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// Digits of a key in a file's name.
const NAME_DIGITS: usize = 32;
/// Bytes of the digest in front of a file's content.
const DIGEST_BYTES: usize = 32;

/// Names the file of an evaluation after everything that decides it, the program excepted.
///
/// # Panics
///
/// If what is asked has no JSON form, which plain data has.
pub(crate) fn file_name<T: Serialize>(asked: &T) -> String {
    let asked = serde_json::to_vec(asked).expect("what is asked is plain data");
    sha256(&asked).chars().take(NAME_DIGITS).collect()
}

/// The evaluations that this build of the program made.
#[derive(Clone, Debug)]
pub struct EvalCache {
    /// The build of the program, and the class of processor that it ran on.
    program: String,
    n_taken: usize,
    n_made: usize,
}

/// What the file of an evaluation holds.
#[derive(Serialize, Deserialize)]
struct CachedEvaluation<E> {
    program: String,
    evaluation: E,
}

impl EvalCache {
    /// Keeps and takes the evaluations of a build.
    pub(crate) fn new(build: &ProgramBuild) -> Self {
        Self { program: format!("{} on {}", build.program, build.cpu), n_taken: 0, n_made: 0 }
    }

    /// Takes an evaluation that this program made before; `None` if there is none.
    pub(crate) fn take(&mut self, path: &Path) -> Option<Evaluation> {
        let bytes = regular::read(path).ok()?;
        let (expected, content) = bytes.split_at_checked(DIGEST_BYTES)?;
        if Sha256::digest(content).as_slice() != expected {
            return None;
        }
        let cached = codec::decode(content, limits::MAX_MESSAGE_BYTES).ok();
        let cached =
            cached.filter(|cached: &CachedEvaluation<_>| cached.program == self.program)?;
        self.n_taken += 1;
        Some(cached.evaluation)
    }

    /// Keeps an evaluation; where that is impossible, it will be made again.
    pub(crate) fn keep(&mut self, path: &Path, evaluation: &Evaluation) {
        self.n_made += 1;
        if let Err(error) = self.write(path, evaluation) {
            tracing::warn!(path = %path.display(), %error, "an evaluation cannot be kept");
        }
    }

    fn write(&self, path: &Path, evaluation: &Evaluation) -> io::Result<()> {
        let cached = CachedEvaluation { program: self.program.clone(), evaluation };
        let content = codec::encode(&cached).map_err(io::Error::other)?;
        if let Some(directory) = path.parent() {
            fs::create_dir_all(directory)?;
        }
        write_atomically(path, &[Sha256::digest(&content).as_slice(), &content].concat())
    }

    /// Says how many evaluations were made, and how many were there.
    pub fn sentence(&self) -> String {
        let Self { n_made, n_taken, .. } = self;
        format!("made {n_made} evaluations, took {n_taken} from the cache")
    }
}

#[cfg(test)]
mod tests {
    use leadtime_eval::measure::EpisodeResult;

    use super::*;

    fn build(program: &str) -> ProgramBuild {
        ProgramBuild { program: program.to_owned(), ..ProgramBuild::default() }
    }

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
    fn an_evaluation_is_taken_bit_for_bit_by_the_program_that_made_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("evaluations/a.json");
        let mut cache = EvalCache::new(&build("one"));
        assert_eq!(cache.take(&path), None);
        cache.keep(&path, &evaluation());
        let taken = cache.take(&path).unwrap();
        assert_eq!(codec::encode(&taken).unwrap(), codec::encode(&evaluation()).unwrap());
        assert_eq!(cache.sentence(), "made 1 evaluations, took 1 from the cache");
        let mut other = EvalCache::new(&build("other"));
        assert_eq!(other.take(&path), None);
        other.keep(&path, &evaluation());
        assert!(other.take(&path).is_some() && cache.take(&path).is_none());
        assert_eq!(fs::read_dir(dir.path().join("evaluations")).unwrap().count(), 1);
    }

    #[test]
    fn a_damaged_or_unwritable_file_counts_as_missing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.json");
        let mut cache = EvalCache::new(&build("one"));
        cache.keep(&path, &evaluation());
        let whole = fs::read(&path).unwrap();
        for place in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[place] ^= 1;
            fs::write(&path, damaged).unwrap();
            assert_eq!(cache.take(&path), None, "byte {place}");
        }
        fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        assert_eq!(cache.take(&path), None);
        fs::remove_file(&path).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        assert_eq!(cache.take(&path), None, "nobody waits for a pipe");
        fs::remove_file(&path).unwrap();
        fs::write(&path, "").unwrap();
        // Where there is a file, there cannot be a directory; that is no error.
        cache.keep(&path.join("b.json"), &evaluation());
        assert_eq!(cache.take(&path.join("b.json")), None);
    }
}
