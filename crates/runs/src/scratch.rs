//! The short-lived directory of a launch: the configuration for its processes, and the socket they meet at.
//!
//! It is removed when its supervisor ends. One that was killed cannot do so; then the learner that it leaves behind
//! does, or the next launch on this machine. What is removed is ours without doubt: its name begins with [`PREFIX`] and
//! it holds [`OWNER`], a file that the supervisor keeps locked for as long as it lives.

use std::fs::{self, File, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// How the name of every such directory begins.
const PREFIX: &str = "leadtime-";
/// The file that marks one, locked by its owner.
const OWNER: &str = "owner";
/// The longest temporary directory that leaves room for a socket's name (the kernel allows 107 bytes in all).
const MAX_BASE_BYTES: usize = 60;

/// A directory that only this user can look into; removed when dropped.
#[derive(Debug)]
pub(crate) struct ScratchDir {
    directory: TempDir,
    _owner: File,
}

impl ScratchDir {
    /// Makes one, after removing those whose owners have died; an error says where it was tried.
    pub(crate) fn make() -> Result<Self, (PathBuf, io::Error)> {
        let preferred = std::env::temp_dir();
        // Addresses are text, so the path has to be, too.
        let fits = preferred.to_str().is_some_and(|path| path.len() <= MAX_BASE_BYTES);
        Self::make_in(if fits { &preferred } else { Path::new("/tmp") })
    }

    fn make_in(base: &Path) -> Result<Self, (PathBuf, io::Error)> {
        let left = fs::read_dir(base).into_iter().flatten().filter_map(Result::ok);
        left.for_each(|entry| remove_if_abandoned(&entry.path()));
        let make = || -> io::Result<Self> {
            let private = Permissions::from_mode(0o700);
            let directory =
                tempfile::Builder::new().prefix(PREFIX).permissions(private).tempdir_in(base)?;
            // Locked before it has its name, so that nobody takes it for a dead owner's.
            let unnamed = directory.path().join("owner.new");
            let owner = File::create(&unnamed)?;
            owner.lock()?;
            fs::rename(&unnamed, directory.path().join(OWNER))?;
            Ok(Self { directory, _owner: owner })
        };
        make().map_err(|error| (base.to_owned(), error))
    }

    pub(crate) fn path(&self) -> &Path {
        self.directory.path()
    }
}

/// Removes such a directory if its owner is gone; anything else stays as it is.
pub fn remove_if_abandoned(directory: &Path) {
    let name = directory.file_name().and_then(|name| name.to_str());
    let is_named = name.is_some_and(|name| name.starts_with(PREFIX));
    let is_directory = directory.symlink_metadata().is_ok_and(|found| found.is_dir());
    let owner = directory.join(OWNER);
    // Opening something else than a file, such as a pipe of another user's, could wait for ever.
    let is_owned = owner.symlink_metadata().is_ok_and(|found| found.is_file());
    if !(is_named && is_directory && is_owned) {
        return;
    }
    let Ok(owner) = File::open(owner) else { return };
    if owner.try_lock().is_ok() {
        // What cannot be removed now is tried again by the next launch.
        drop(fs::remove_dir_all(directory));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_leftovers_of_a_killed_owner_are_removed() {
        let base = tempfile::tempdir().unwrap();
        let make = |name: &str, files: &[&str]| {
            let directory = base.path().join(name);
            fs::create_dir(&directory).unwrap();
            for file in files {
                fs::write(directory.join(file), "").unwrap();
            }
            directory
        };
        let abandoned = make("leadtime-abandoned", &[OWNER, "config.toml"]);
        let kept = [make("leadtime-notes", &["mine"]), make("other", &[OWNER, "mine"])];
        let living = ScratchDir::make_in(base.path()).unwrap();
        let next = ScratchDir::make_in(base.path()).unwrap();
        assert!(!abandoned.exists());
        for directory in kept.iter().map(PathBuf::as_path).chain([living.path(), next.path()]) {
            remove_if_abandoned(directory);
            assert!(directory.exists(), "{}", directory.display());
        }
        assert_eq!(living.path().metadata().unwrap().permissions().mode() & 0o777, 0o700);
        let path = living.path().to_owned();
        drop(living);
        assert!(!path.exists());
    }
}
