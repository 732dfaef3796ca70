//! Checkpoint files: whole or not there.
//!
//! A file is replaced in one step ([`write_atomically`]), so a crash leaves the old files or the new one. What a disk
//! does to a file later is noticed by the digest, and the run falls back to the file before it, saying so.
//!
//! ```text
//! offset 0      4         8        16          48
//!        magic  format    length   SHA-256     payload (the project's codec)
//!        LTCK   u32 le    u64 le   of payload
//! ```
//!
//! # Invariants
//!
//! * The newest whole files stay, as many as [`Retention`] says. Damaged ones do not count, and go when the run has passed them.
//! * A file that somebody has given another name, a copy for example, is older than all others: it is read if no other one is
//!   whole, and never removed.
//! * A file of a format that this release does not read is not damaged: it is refused, and nothing is removed.
//! * The directory is locked as long as a [`CheckpointStore`] lives, so two learners cannot share a run. One that was removed or
//!   moved away is made and locked again before anything is written, unless another learner was faster.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use leadtime_ppo::checkpoints::{MAX_PAYLOAD_BYTES, Retention};
use leadtime_proto::codec::{self, CodecError};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest as _, Sha256};
use thiserror::Error;
use tracing::warn;

use crate::files::{lock_file, replaced_name, write_atomically};

/// The version of what a checkpoint holds; no other one is read.
pub const FORMAT_VERSION: u32 = 3;
const MAGIC: [u8; 4] = *b"LTCK";
const FRONT_BYTES: usize = 48;
const EXTENSION: &str = "checkpoint";
const LOCK: &str = "lock";

/// Why checkpoints cannot be written or read.
#[derive(Debug, Error)]
pub enum CheckpointError {
    /// The disk is full, the directory is not writable, or the like.
    #[error("cannot write {}: free some space or choose another run directory", path.display())]
    Write {
        /// The file or directory that was to be written.
        path: PathBuf,
        /// What the operating system reports.
        source: io::Error,
    },
    /// A file or directory cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file or directory that was to be read.
        path: PathBuf,
        /// What the operating system reports.
        source: io::Error,
    },
    /// Another learner holds the directory's lock.
    #[error("{} is in use by another learner: stop it, or choose another run name", .0.display())]
    InUse(PathBuf),
    /// A release with another checkpoint format wrote the newest checkpoint.
    #[error(
        "{} has checkpoint format {found}, this release reads format {FORMAT_VERSION}: resume the run with the release \
         that wrote it, or start another run (--name; --fork takes this one's weights)",
        path.display()
    )]
    OtherFormat {
        /// The checkpoint of the other format.
        path: PathBuf,
        /// The format that the file states.
        found: u32,
    },
    /// There are checkpoints, and each of them is damaged.
    #[error(
        "none of the {n_damaged} checkpoints in {} is whole: restore one from a backup, or start another run (--name; \
         --fork takes this one's weights)",
        path.display()
    )]
    AllDamaged {
        /// The checkpoint directory of the run.
        path: PathBuf,
        /// How many damaged checkpoints it holds.
        n_damaged: usize,
    },
    /// The state cannot be written in the project's encoding.
    #[error("the state cannot be encoded")]
    Encode(#[source] CodecError),
}

/// A checkpoint that was found.
#[derive(Debug)]
pub struct Loaded<T> {
    /// The state, decoded and whole.
    pub state: T,
    /// The file that it was read from.
    pub path: PathBuf,
    /// Newer files that could not be used, and what is wrong with each.
    pub damaged: Vec<(PathBuf, String)>,
}

/// The checkpoint directory of a run.
#[derive(Debug)]
pub struct CheckpointStore {
    directory: PathBuf,
    retention: Retention,
    /// Files that [`Self::newest`] found damaged.
    damaged: BTreeSet<PathBuf>,
    lock: File,
}

impl CheckpointStore {
    /// Opens the directory, creates it if necessary, and locks it against other learners.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Write`] if it cannot be made or written, [`CheckpointError::InUse`] if another learner
    /// has it.
    pub fn open(directory: &Path, retention: Retention) -> Result<Self, CheckpointError> {
        let (lock, directory) = (lock(directory)?, directory.to_owned());
        Ok(Self { directory, retention, damaged: BTreeSet::new(), lock })
    }

    /// Writes the state after `n_updates` updates and removes what is no longer needed.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Write`] if the directory or the file cannot be written; older checkpoints are then untouched.
    /// [`CheckpointError::Encode`] if the state cannot be encoded, or is larger than a checkpoint may be.
    /// [`CheckpointError::InUse`] if the directory was removed meanwhile, and another learner has begun there.
    pub fn write<T: Serialize>(
        &mut self,
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
        let path = self.directory.join(format!("{n_updates:012}.{EXTENSION}"));
        // The directory may have been removed meanwhile; the run in memory is worth more than the reason.
        if !is_same_file(&self.lock, &self.directory.join(LOCK)) {
            self.lock = lock(&self.directory)?;
        }
        write_atomically(&path, &bytes)
            .map_err(|source| CheckpointError::Write { path: path.clone(), source })?;
        self.damaged.remove(&path);
        self.clean_up(&path);
        Ok(path)
    }

    /// Removes whole files that need not be kept, and damaged ones that the run has passed.
    ///
    /// A file that cannot be removed, or is gone already, is no reason to end a run whose state has just been saved.
    fn clean_up(&self, newest: &Path) {
        let Ok(files) = self.files() else { return };
        let files = files.into_iter().filter(|path| n_updates(path).is_some());
        let (damaged, whole): (Vec<_>, Vec<_>) =
            files.partition(|path| self.damaged.contains(path));
        let n_old = whole.len().saturating_sub(self.retention.newest);
        let old = whole.into_iter().take(n_old);
        let is_for_good = |n_updates| self.retention.is_for_good(n_updates);
        let old = old.filter(|path| !n_updates(path).is_some_and(is_for_good));
        let passed = damaged.into_iter().filter(|path| path.as_path() < newest);
        // What a crash while writing left.
        let torn = self.entries(|name| replaced_name(name).is_some()).unwrap_or_default();
        for path in old.chain(passed).chain(torn) {
            if let Err(error) = fs::remove_file(&path)
                && error.kind() != io::ErrorKind::NotFound
            {
                warn!(checkpoint = %path.display(), %error, "an old checkpoint cannot be removed");
            }
        }
    }

    /// Reads the newest whole checkpoint; `None` if there is no checkpoint at all.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::OtherFormat`] if another release wrote a checkpoint that is newer than all whole ones;
    /// [`CheckpointError::AllDamaged`] if there are some and none is whole.
    pub fn newest<T: DeserializeOwned>(&mut self) -> Result<Option<Loaded<T>>, CheckpointError> {
        let mut damaged = Vec::new();
        let mut found = None;
        for path in self.files()?.into_iter().rev() {
            // Older files are looked at, too: only whole ones count when old files are removed.
            match read(&path) {
                Ok(_) if found.is_some() => {}
                Ok((format, _)) if format != FORMAT_VERSION => {
                    return Err(CheckpointError::OtherFormat { path, found: format });
                }
                Ok((_, bytes)) => match codec::decode(&bytes[FRONT_BYTES..], MAX_PAYLOAD_BYTES) {
                    Ok(state) => found = Some((state, path)),
                    Err(_) => damaged.push((path, "it cannot be decoded".to_owned())),
                },
                Err(damage) if found.is_none() => damaged.push((path, damage)),
                Err(_) => {
                    self.damaged.insert(path);
                }
            }
        }
        self.damaged.extend(damaged.iter().map(|(path, _)| path.clone()));
        match (found, damaged.len()) {
            (Some((state, path)), _) => Ok(Some(Loaded { state, path, damaged })),
            (None, 0) => Ok(None),
            (None, n_damaged) => {
                Err(CheckpointError::AllDamaged { path: self.directory.clone(), n_damaged })
            }
        }
    }

    /// Lists the checkpoints, oldest first; those with another name than ours count as the oldest.
    fn files(&self) -> Result<Vec<PathBuf>, CheckpointError> {
        let is_checkpoint =
            |name: &str| Path::new(name).extension().is_some_and(|end| end == EXTENSION);
        let mut files = self.entries(is_checkpoint)?;
        files.sort_by_key(|path| n_updates(path));
        Ok(files)
    }

    fn entries(&self, is_wanted: fn(&str) -> bool) -> Result<Vec<PathBuf>, CheckpointError> {
        let failed = |source| CheckpointError::Read { path: self.directory.clone(), source };
        let entries = fs::read_dir(&self.directory).map_err(failed)?;
        let paths: io::Result<Vec<PathBuf>> = entries.map(|entry| Ok(entry?.path())).collect();
        let mut files = paths.map_err(failed)?;
        files.retain(|path| path.file_name().and_then(|name| name.to_str()).is_some_and(is_wanted));
        files.sort();
        Ok(files)
    }
}

/// Makes a directory for checkpoints, if it is not there, and takes its lock.
fn lock(directory: &Path) -> Result<File, CheckpointError> {
    let failed = |path: &Path, source| CheckpointError::Write { path: path.to_owned(), source };
    fs::create_dir_all(directory).map_err(|source| failed(directory, source))?;
    let path = directory.join(LOCK);
    lock_file(&path).map_err(|error| match error {
        TryLockError::WouldBlock => CheckpointError::InUse(directory.to_owned()),
        TryLockError::Error(source) => failed(&path, source),
    })
}

/// Tells whether a path still leads to an open file.
fn is_same_file(open: &File, path: &Path) -> bool {
    let id = |found: fs::Metadata| (found.dev(), found.ino());
    let (open, there) = (open.metadata().map(id), fs::metadata(path).map(id));
    matches!((open, there), (Ok(open), Ok(there)) if open == there)
}

/// Returns after how many updates a checkpoint was written, as its name says; `None` if it has another name.
fn n_updates(path: &Path) -> Option<u64> {
    path.file_stem()?.to_str()?.parse().ok()
}

/// Reads a file and checks that it is undamaged, whatever its format; otherwise says what is wrong with it.
fn read(path: &Path) -> Result<(u32, Vec<u8>), String> {
    let unreadable = |_unshown: io::Error| "it cannot be read".to_owned();
    let found = fs::metadata(path).map_err(unreadable)?;
    // Opening something else, such as a pipe, could wait for ever.
    if !found.is_file() {
        return Err("it is not a file".to_owned());
    }
    let most = (FRONT_BYTES + MAX_PAYLOAD_BYTES) as u64;
    if found.len() > most {
        return Err(format!("it has {} bytes; a checkpoint has at most {most}", found.len()));
    }
    let bytes = fs::read(path).map_err(unreadable)?;
    let n_found = bytes.len();
    let torn = |n_stated| format!("it is torn: {n_found} of {n_stated} bytes are there");
    let (front, payload) =
        bytes.split_at_checked(FRONT_BYTES).ok_or_else(|| torn(FRONT_BYTES as u64))?;
    if front[0..4] != MAGIC {
        return Err("it is not a checkpoint".to_owned());
    }
    let format = u32::from_le_bytes(std::array::from_fn(|i| front[4 + i]));
    let length = u64::from_le_bytes(std::array::from_fn(|i| front[8 + i]));
    if length != payload.len() as u64 {
        return Err(torn(length.saturating_add(FRONT_BYTES as u64)));
    }
    if front[16..48] != Sha256::digest(payload)[..] {
        return Err("its content has changed since it was written".to_owned());
    }
    Ok((format, bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> (tempfile::TempDir, CheckpointStore) {
        let directory = tempfile::tempdir().unwrap();
        let store = open(&directory.path().join("checkpoints")).unwrap();
        (directory, store)
    }

    fn open(path: &Path) -> Result<CheckpointStore, CheckpointError> {
        CheckpointStore::open(path, Retention { newest: 3, every_updates: 0 })
    }

    fn newest(store: &mut CheckpointStore) -> Loaded<Vec<u64>> {
        store.newest().unwrap().unwrap()
    }

    fn write(store: &mut CheckpointStore, numbers: impl IntoIterator<Item = u64>) {
        for n_updates in numbers {
            store.write(n_updates, &vec![n_updates]).unwrap();
        }
    }

    fn path(store: &CheckpointStore, n_updates: u64) -> PathBuf {
        store.directory.join(format!("{n_updates:012}.checkpoint"))
    }

    #[test]
    fn the_newest_three_stay() {
        let (_directory, mut store) = store();
        assert!(store.newest::<Vec<u64>>().unwrap().is_none());
        write(&mut store, 8..13);
        assert_eq!(store.files().unwrap().len(), 3);
        // What a crash while writing leaves.
        let torn = store.directory.join("000000000013.checkpoint.12.partial");
        fs::write(&torn, b"half").unwrap();
        assert_eq!(newest(&mut store).state, [12]);
        write(&mut store, [13]);
        assert!(!torn.exists());
    }

    #[test]
    fn those_of_every_so_many_updates_stay_for_good() {
        let directory = tempfile::tempdir().unwrap();
        let retention = Retention { newest: 2, every_updates: 5 };
        let mut store = CheckpointStore::open(directory.path(), retention).unwrap();
        write(&mut store, 1..=13);
        assert_eq!(store.files().unwrap(), [5, 10, 12, 13].map(|n| path(&store, n)));
    }

    #[test]
    fn a_torn_or_changed_checkpoint_gives_way_to_the_one_before() {
        let (_directory, mut store) = store();
        write(&mut store, [1]);
        let path = store.write(2, &vec![2_u64, 3, 4]).unwrap();
        let whole = fs::read(&path).unwrap();
        let mut changed = whole.clone();
        *changed.last_mut().unwrap() ^= 1;
        let mut foreign = whole.clone();
        foreign[0] = 0;
        for bytes in [&whole[..whole.len() - 1], &whole[..20], &[], &changed, &foreign] {
            fs::write(&path, bytes).unwrap();
            let loaded = newest(&mut store);
            assert_eq!(loaded.state, [1]);
            assert_eq!(loaded.damaged[0].0, path);
        }
        fs::write(&path, &changed).unwrap();
        assert!(newest(&mut store).damaged[0].1.contains("content has changed"));
        fs::write(&path, &whole).unwrap();
        assert!(newest(&mut store).damaged.is_empty());
        for n_updates in [1, 2] {
            fs::write(self::path(&store, n_updates), b"LTCK").unwrap();
        }
        let error = store.newest::<Vec<u64>>().unwrap_err();
        assert!(matches!(error, CheckpointError::AllDamaged { n_damaged: 2, .. }));
    }

    #[test]
    fn damaged_checkpoints_take_no_place_of_whole_ones() {
        let (_directory, mut store) = store();
        write(&mut store, [1, 9, 10]);
        for n_updates in [9, 10] {
            fs::write(path(&store, n_updates), b"torn").unwrap();
        }
        assert_eq!(newest(&mut store).state, [1]);
        write(&mut store, [2, 3]);
        let kept = |store: &CheckpointStore| store.files().unwrap();
        assert_eq!(kept(&store), [1, 2, 3, 9, 10].map(|n| path(&store, n)));
        write(&mut store, [9]);
        assert_eq!(kept(&store), [2, 3, 9, 10].map(|n| path(&store, n)), "9 is whole again");
        write(&mut store, [11]);
        assert_eq!(kept(&store), [3, 9, 11].map(|n| path(&store, n)));
        fs::write(path(&store, 9), b"torn").unwrap();
        assert!(newest(&mut store).damaged.is_empty(), "an older one is no news");
        write(&mut store, [12]);
        assert_eq!(kept(&store), [3, 11, 12].map(|n| path(&store, n)));
    }

    #[test]
    fn a_vanished_checkpoint_or_directory_does_not_keep_a_new_one_from_being_written() {
        let (_directory, mut store) = store();
        write(&mut store, 1..4);
        // Neither can be removed as a file: the one is gone, the other has become a directory.
        fs::remove_file(path(&store, 1)).unwrap();
        fs::create_dir(path(&store, 0)).unwrap();
        write(&mut store, 4..6);
        fs::remove_dir_all(&store.directory).unwrap();
        write(&mut store, [6]);
        assert_eq!(newest(&mut store).state, [6]);
    }

    #[test]
    fn a_copy_under_another_name_is_older_than_all_others_and_stays() {
        let (_directory, mut store) = store();
        write(&mut store, [1]);
        let copy = store.directory.join("so-far-good.checkpoint");
        fs::copy(path(&store, 1), &copy).unwrap();
        write(&mut store, 2..7);
        assert_eq!(newest(&mut store).state, [6], "what was learned since is not lost");
        let mut kept = vec![copy.clone()];
        kept.extend([4, 5, 6].map(|n| path(&store, n)));
        assert_eq!(store.files().unwrap(), kept);
        for n_updates in [4, 5, 6] {
            fs::write(path(&store, n_updates), "torn").unwrap();
        }
        let loaded = newest(&mut store);
        assert_eq!((loaded.state, loaded.path), (vec![1], copy));
    }

    #[test]
    fn a_pipe_is_not_waited_for_and_a_damaged_checkpoint_gives_way_to_the_one_before() {
        let pipe = |path: &Path| {
            assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
        };
        let (_directory, mut store) = store();
        write(&mut store, [1]);
        pipe(&path(&store, 2));
        fs::create_dir(path(&store, 3)).unwrap();
        let large = File::create(path(&store, 4)).unwrap();
        large.set_len((FRONT_BYTES + MAX_PAYLOAD_BYTES) as u64 + 1).unwrap();
        let loaded = newest(&mut store);
        assert_eq!((loaded.state, loaded.damaged.len()), (vec![1], 3));
        assert!(loaded.damaged[0].1.contains("a checkpoint has at most"), "{:?}", loaded.damaged);
        assert_eq!(loaded.damaged[1].1, "it is not a file");
        let other = tempfile::tempdir().unwrap();
        pipe(&other.path().join(LOCK));
        assert!(matches!(open(other.path()), Err(CheckpointError::Write { .. })));
    }

    #[test]
    fn a_directory_that_was_removed_is_locked_again_and_another_learners_is_left_alone() {
        let (_directory, mut store) = store();
        write(&mut store, [1]);
        fs::remove_dir_all(&store.directory).unwrap();
        write(&mut store, [2]);
        assert!(matches!(open(&store.directory), Err(CheckpointError::InUse(_))));
        fs::rename(&store.directory, store.directory.with_extension("away")).unwrap();
        let mut other = open(&store.directory).unwrap();
        write(&mut other, [7]);
        let refused = store.write(3, &vec![3_u64]);
        assert!(matches!(refused, Err(CheckpointError::InUse(_))));
        assert_eq!(other.files().unwrap(), [path(&other, 7)]);
    }

    #[test]
    fn a_checkpoint_of_another_release_is_refused_and_not_passed_over() {
        let (_directory, mut store) = store();
        write(&mut store, [1, 2]);
        let mut other = fs::read(path(&store, 2)).unwrap();
        other[4] = 9;
        fs::write(path(&store, 2), &other).unwrap();
        let error = store.newest::<Vec<u64>>().unwrap_err().to_string();
        assert!(error.contains("format 9, this release reads format 3"), "{error}");
        write(&mut store, [3]);
        assert_eq!(newest(&mut store).state, [3], "one that is older is of no concern");
    }

    #[test]
    fn a_second_learner_is_kept_out_until_the_first_is_gone_and_an_unwritable_place_is_named() {
        let (_directory, store) = store();
        let path = store.directory.clone();
        assert!(matches!(open(&path), Err(CheckpointError::InUse(_))));
        drop(store);
        open(&path).unwrap();
        let error = open(&path.join("lock/run")).unwrap_err();
        assert!(error.to_string().contains("lock/run"), "{error}");
    }
}
