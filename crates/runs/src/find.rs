//! A run by its name, and which one was meant by a misspelt name.

use std::fs;
use std::path::{Path, PathBuf};

use leadtime_proto::phrase::did_you_mean;
use leadtime_proto::text::quoted;

use crate::directory_error::RunDirError;
use crate::record::RECORD;

/// Finds a run by its path, or by its name in the directory of runs.
///
/// # Errors
///
/// [`RunDirError`] if there is none; a run of a similar name is named.
pub fn find_run(runs: &Path, name: &Path) -> Result<PathBuf, RunDirError> {
    let candidates = [name.to_owned(), runs.join(name)];
    let found = candidates.into_iter().find(|path| path.join(RECORD).exists());
    found.ok_or_else(|| {
        let meant = did_you_mean_run(runs, name);
        let (name, runs) = (quoted(&name.to_string_lossy()), runs.display());
        RunDirError::Refused(format!("there is no run `{name}` in {runs}{meant}"))
    })
}

/// Asks whether another run was meant: one with a similar name; nothing if there is none.
pub(crate) fn did_you_mean_run(runs: &Path, name: &Path) -> String {
    let entries = fs::read_dir(runs).into_iter().flatten().filter_map(Result::ok);
    let names = entries.filter(|entry| entry.path().is_dir());
    let names: Vec<String> =
        names.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    let name = name.to_str().unwrap_or_default();
    // A directory of that very name is no run, or it would have been found.
    did_you_mean(name, names.iter().map(String::as_str).filter(|other| *other != name))
}
