//! A run by its name, and which one was meant by a misspelt name.

use std::fs;
use std::path::{Path, PathBuf};

use leadtime_proto::phrase::did_you_mean;
use leadtime_proto::text::quoted;

use crate::RunRecord;
use crate::contents::is_run;
use crate::directory_error::RunDirError;
use crate::record::RECORD;

/// Finds a run by its path, or by its name in the directory of runs.
///
/// # Errors
///
/// [`RunDirError`] if there is none; a run of a similar name is named.
pub fn find_run(runs: &Path, name: &Path) -> Result<PathBuf, RunDirError> {
    let candidates = [name.to_owned(), runs.join(name)];
    let whole = candidates.iter().find(|path| path.join(RECORD).exists());
    // A run that has lost its record is still a run: reading it says what is missing.
    let found = whole.or_else(|| candidates.iter().find(|path| is_run(path)));
    found.cloned().ok_or_else(|| {
        if name.is_file() {
            let name = quoted(&name.to_string_lossy());
            return RunDirError::Refused(format!(
                "`{name}` is a file, and a run is wanted here; `leadtime eval` evaluates a policy file"
            ));
        }
        let meant = did_you_mean_run(runs, name);
        let (name, runs) = (quoted(&name.to_string_lossy()), runs.display());
        RunDirError::Refused(format!("there is no run `{name}` in {runs}{meant}"))
    })
}

/// Returns the name by which a run is found where it lies: that of its directory, which somebody may have renamed or
/// copied since the record was written; the one on record where the directory's is no text.
pub fn name_in_place(directory: &Path, record: &RunRecord) -> String {
    let named = |path: &Path| path.file_name()?.to_str().map(str::to_owned);
    // Such as `.`.
    let name = named(directory).or_else(|| named(&directory.canonicalize().ok()?));
    name.unwrap_or_else(|| record.name.clone())
}

/// Asks whether another run was meant: `; did you mean `lander-1`?` for one with a similar name; nothing if there is none.
pub fn did_you_mean_run(runs: &Path, name: &Path) -> String {
    let entries = fs::read_dir(runs).into_iter().flatten().filter_map(Result::ok);
    let names = entries.filter(|entry| entry.path().is_dir());
    let names: Vec<String> =
        names.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    let name = name.to_str().unwrap_or_default();
    // A directory of that very name is no run, or it would have been found.
    did_you_mean(name, names.iter().map(String::as_str).filter(|other| *other != name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ProgramBuild;

    #[test]
    fn a_directory_that_was_renamed_is_a_run_of_its_new_name() {
        let runs = tempfile::tempdir().unwrap();
        let record = RunRecord::begin("old", "cartpole", 1, &ProgramBuild::default());
        assert_eq!(name_in_place(&runs.path().join("new"), &record), "new");
        assert_eq!(name_in_place(Path::new("/"), &record), "old");
        fs::create_dir_all(runs.path().join("new/checkpoints")).unwrap();
        let nameless = runs.path().join("new/checkpoints/..");
        assert_eq!(name_in_place(&nameless, &record), "new");
    }

    #[test]
    fn a_run_that_has_lost_its_record_is_found_after_one_that_has_it() {
        let place = tempfile::tempdir().unwrap();
        let (runs, here) = (place.path().join("runs"), place.path().join("r"));
        let there = runs.join("r");
        for directory in [&here, &there] {
            fs::create_dir_all(directory).unwrap();
            fs::write(directory.join("config.toml"), "").unwrap();
        }
        assert_eq!(find_run(&runs, Path::new("r")).unwrap(), there);
        assert_eq!(find_run(&runs, &here).unwrap(), here);
        fs::write(here.join(RECORD), "{}").unwrap();
        assert_eq!(find_run(&runs, &here).unwrap(), here);
        let missing = find_run(&runs, Path::new("s")).unwrap_err().to_string();
        assert!(missing.starts_with("there is no run `s`"), "{missing}");
        let policy = here.join("policy.safetensors");
        fs::write(&policy, "").unwrap();
        let told = find_run(&runs, &policy).unwrap_err().to_string();
        assert!(told.contains("`leadtime eval` evaluates a policy file"), "{told}");
    }
}
