//! Checkpoint files: whole or not there.
//!
//! A file is replaced in one step ([`write_atomically`]), so a crash leaves the old files or the new one. What a disk does to a file later is noticed by the digest,
//! and the run falls back to the file before it, saying so.
//!
//! ```text
//! offset 0      4         8        16          48
//!        magic  format    length   SHA-256     payload (the project's codec)
//!        LTCK   u32 le    u64 le   of payload
//! ```
//!
//! The directory is locked as long as a [`CheckpointStore`] lives, so two learners cannot share a run.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use leadtime_ppo::{LearnerSettings, Mode};
use leadtime_proto::codec::{self, CodecError};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest as _, Sha256};
use thiserror::Error;

use crate::write_atomically;

/// The version of what a checkpoint holds.
pub const FORMAT_VERSION: u32 = 1;
/// How many checkpoints are kept.
pub const KEPT: usize = 3;
const MAGIC: [u8; 4] = *b"LTCK";
const FRONT_BYTES: usize = 48;
/// The largest state that a checkpoint holds, in bytes.
pub const MAX_PAYLOAD_BYTES: usize = leadtime_proto::limits::MAX_MESSAGE_BYTES;
const EXTENSION: &str = "checkpoint";

/// What the last training episodes and the books take, in bytes.
const RECORDS_BYTES: usize = 64 << 10;
/// Room beside an environment's snapshot: ids, counts, lengths.
const ENV_BYTES: usize = 256;

/// Returns an upper bound on the size of a state, in bytes, from the same for one version of the weights and for one
/// environment's snapshot with its recurrent state.
pub fn max_payload_bytes(settings: &LearnerSettings, weights: usize, snapshot: usize) -> usize {
    let n_older = if settings.mode == Mode::Lag { settings.lag as usize } else { 0 };
    // The parameters with Adam's two moments, the best policy, and the versions that acting still needs.
    (3 + 1 + n_older) * weights + settings.n_envs * (snapshot + ENV_BYTES) + RECORDS_BYTES
}

/// Why checkpoints cannot be written or read.
#[derive(Debug, Error)]
pub enum CheckpointError {
    /// The disk is full, the directory is not writable, or the like.
    #[error("cannot write {}: free some space or choose another run directory", path.display())]
    Write {
        /// The file or directory.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A file or directory cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file or directory.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Another learner has the directory.
    #[error("{} is in use by another learner: stop it, or choose another run name", path.display())]
    InUse {
        /// The directory.
        path: PathBuf,
    },
    /// No checkpoint is whole.
    #[error(
        "none of the {n_damaged} checkpoints in {} is whole: remove the directory to start again",
        path.display()
    )]
    AllDamaged {
        /// The directory.
        path: PathBuf,
        /// How many there are.
        n_damaged: usize,
    },
    /// The state cannot be written in the project's encoding.
    #[error("the state cannot be encoded")]
    Encode(#[source] CodecError),
}

/// What is wrong with one checkpoint file.
#[derive(Debug, Error)]
pub enum Damage {
    /// It cannot be read at all.
    #[error("it cannot be read")]
    Unreadable(#[source] io::Error),
    /// It does not start like one.
    #[error("it is not a checkpoint")]
    Magic,
    /// Another release wrote it.
    #[error("it has format {found}, this release reads {FORMAT_VERSION}")]
    Format {
        /// As written.
        found: u32,
    },
    /// It is shorter or longer than it says.
    #[error("it is torn: {found} of {expected} bytes are there")]
    Torn {
        /// Bytes there.
        found: u64,
        /// Bytes that should be.
        expected: u64,
    },
    /// Its content is not what was written.
    #[error("its content has changed since it was written")]
    Digest,
    /// It is whole, but holds something else.
    #[error("it cannot be decoded")]
    Decode(#[source] CodecError),
}

/// A checkpoint that was found.
#[derive(Debug)]
pub struct Loaded<T> {
    /// What it holds.
    pub state: T,
    /// Where it is.
    pub path: PathBuf,
    /// Newer files that could not be used.
    pub damaged: Vec<(PathBuf, Damage)>,
}

/// The checkpoint directory of a run.
#[derive(Debug)]
pub struct CheckpointStore {
    directory: PathBuf,
    _lock: File,
}

impl CheckpointStore {
    /// Opens (and makes, if need be) the directory, alone.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Write`] if it cannot be made or written, [`CheckpointError::InUse`] if another learner
    /// has it.
    pub fn open(directory: &Path) -> Result<Self, CheckpointError> {
        let failed = |source| CheckpointError::Write { path: directory.to_owned(), source };
        fs::create_dir_all(directory).map_err(failed)?;
        let lock = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(directory.join("lock"))
            .map_err(failed)?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { directory: directory.to_owned(), _lock: lock }),
            Err(TryLockError::WouldBlock) => {
                Err(CheckpointError::InUse { path: directory.to_owned() })
            }
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Writes the state after `n_updates` updates and removes the oldest files.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Write`], with the path; older checkpoints are then untouched.
    pub fn write<T: Serialize>(
        &self,
        n_updates: u64,
        state: &T,
    ) -> Result<PathBuf, CheckpointError> {
        let payload = codec::encode(state).map_err(CheckpointError::Encode)?;
        if payload.len() > MAX_PAYLOAD_BYTES {
            let error = CodecError::TooLarge { found: payload.len(), limit: MAX_PAYLOAD_BYTES };
            return Err(CheckpointError::Encode(error));
        }
        let mut bytes = Vec::with_capacity(FRONT_BYTES + payload.len());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&FORMAT_VERSION.to_le_bytes());
        bytes.extend_from_slice(&(payload.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&Sha256::digest(&payload));
        bytes.extend_from_slice(&payload);
        let path = self.write_file(&format!("{n_updates:012}.{EXTENSION}"), &bytes)?;
        let mut files = self.files()?;
        files.truncate(files.len().saturating_sub(KEPT));
        for old in files {
            fs::remove_file(&old).map_err(|source| CheckpointError::Write { path: old, source })?;
        }
        Ok(path)
    }

    /// Writes any other file of the directory in the same all-or-nothing way.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Write`], with the path.
    pub fn write_file(&self, name: &str, bytes: &[u8]) -> Result<PathBuf, CheckpointError> {
        let path = self.directory.join(name);
        match write_atomically(&path, bytes) {
            Ok(()) => Ok(path),
            Err(source) => Err(CheckpointError::Write { path, source }),
        }
    }

    /// Reads the newest whole checkpoint; `None` if there never was one.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::AllDamaged`] if there are some and none is whole.
    pub fn newest<T: DeserializeOwned>(&self) -> Result<Option<Loaded<T>>, CheckpointError> {
        let mut damaged = Vec::new();
        for path in self.files()?.into_iter().rev() {
            match read(&path) {
                Ok(state) => return Ok(Some(Loaded { state, path, damaged })),
                Err(damage) => damaged.push((path, damage)),
            }
        }
        match damaged.len() {
            0 => Ok(None),
            n_damaged => {
                Err(CheckpointError::AllDamaged { path: self.directory.clone(), n_damaged })
            }
        }
    }

    /// Lists the checkpoints, oldest first.
    fn files(&self) -> Result<Vec<PathBuf>, CheckpointError> {
        let failed = |source| CheckpointError::Read { path: self.directory.clone(), source };
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.directory).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.extension().is_some_and(|extension| extension == EXTENSION) {
                files.push(path);
            }
        }
        files.sort();
        Ok(files)
    }
}

/// Reads one checkpoint file.
///
/// # Errors
///
/// [`Damage`]: what is wrong with it.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, Damage> {
    let bytes = fs::read(path).map_err(Damage::Unreadable)?;
    let torn = |expected| Damage::Torn { found: bytes.len() as u64, expected };
    let (front, payload) = bytes.split_at_checked(FRONT_BYTES).ok_or(torn(FRONT_BYTES as u64))?;
    if front[0..4] != MAGIC {
        return Err(Damage::Magic);
    }
    let format = u32::from_le_bytes(std::array::from_fn(|i| front[4 + i]));
    if format != FORMAT_VERSION {
        return Err(Damage::Format { found: format });
    }
    let length = u64::from_le_bytes(std::array::from_fn(|i| front[8 + i]));
    if length != payload.len() as u64 {
        return Err(torn(length.saturating_add(FRONT_BYTES as u64)));
    }
    if front[16..48] != Sha256::digest(payload)[..] {
        return Err(Damage::Digest);
    }
    codec::decode(payload, MAX_PAYLOAD_BYTES).map_err(Damage::Decode)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> (tempfile::TempDir, CheckpointStore) {
        let directory = tempfile::tempdir().unwrap();
        let store = CheckpointStore::open(&directory.path().join("checkpoints")).unwrap();
        (directory, store)
    }

    fn newest(store: &CheckpointStore) -> Loaded<Vec<u64>> {
        store.newest().unwrap().unwrap()
    }

    #[test]
    fn the_newest_three_stay() {
        let (_directory, store) = store();
        assert!(store.newest::<Vec<u64>>().unwrap().is_none());
        for n_updates in 8..13 {
            store.write(n_updates, &vec![n_updates]).unwrap();
        }
        assert_eq!(store.files().unwrap().len(), KEPT);
        assert_eq!(newest(&store).state, [12]);
    }

    #[test]
    fn a_torn_or_changed_checkpoint_gives_way_to_the_one_before() {
        let (_directory, store) = store();
        store.write(1, &vec![1_u64]).unwrap();
        let path = store.write(2, &vec![2_u64, 3, 4]).unwrap();
        let whole = fs::read(&path).unwrap();
        let mut changed = whole.clone();
        *changed.last_mut().unwrap() ^= 1;
        let mut newer = whole.clone();
        newer[4] = 9;
        let mut foreign = whole.clone();
        foreign[0] = 0;
        for bytes in [&whole[..whole.len() - 1], &whole[..20], &[], &changed, &newer, &foreign] {
            fs::write(&path, bytes).unwrap();
            let loaded = newest(&store);
            assert_eq!(loaded.state, [1]);
            assert_eq!(loaded.damaged[0].0, path);
        }
        fs::write(&path, &changed).unwrap();
        assert!(matches!(newest(&store).damaged[0].1, Damage::Digest));
        fs::write(&path, &whole).unwrap();
        assert!(newest(&store).damaged.is_empty());
    }

    #[test]
    fn a_run_whose_checkpoints_are_all_damaged_does_not_begin_anew() {
        let (_directory, store) = store();
        let path = store.write(1, &vec![1_u64]).unwrap();
        fs::write(path, b"LTCK").unwrap();
        let error = store.newest::<Vec<u64>>().unwrap_err();
        assert!(matches!(error, CheckpointError::AllDamaged { n_damaged: 1, .. }));
    }

    #[test]
    fn a_crash_while_writing_leaves_a_file_that_nobody_reads() {
        let (_directory, store) = store();
        store.write(1, &vec![1_u64]).unwrap();
        fs::write(store.directory.join("000000000002.checkpoint.partial"), b"half").unwrap();
        assert_eq!(newest(&store).state, [1]);
    }

    #[test]
    fn a_second_learner_is_kept_out_until_the_first_is_gone() {
        let (_directory, store) = store();
        let path = store.directory.clone();
        assert!(matches!(CheckpointStore::open(&path), Err(CheckpointError::InUse { .. })));
        drop(store);
        CheckpointStore::open(&path).unwrap();
    }

    #[test]
    fn an_unwritable_place_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("file");
        fs::write(&file, b"").unwrap();
        let error = CheckpointStore::open(&file.join("run")).unwrap_err();
        assert!(error.to_string().contains("file/run"), "{error}");
    }
}
