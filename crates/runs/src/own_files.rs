//! The files that a run keeps in its directory: nothing else may be written over them.

use std::path::{Path, PathBuf};

use crate::contents::{CHECKPOINTS, CONFIG, TENSORBOARD};
use crate::evaluation_record::LAST_EVALUATION;
use crate::held_out::HELD_OUT;
use crate::journal::JOURNAL;
use crate::layout::{LOCK, SUPERVISOR_LOCK};
use crate::policy_file::{BEST_POLICY, LAST_POLICY};
use crate::race::{FILE as RACE, QUARTER_POLICY};
use crate::record::{INITIAL_POLICY, RECORD};

/// The file of a run's page.
pub const REPORT_PAGE: &str = "report.html";

/// The files that a run writes and reads again.
const FILES: [&str; 13] = [
    CONFIG,
    RECORD,
    LOCK,
    SUPERVISOR_LOCK,
    JOURNAL,
    HELD_OUT,
    LAST_EVALUATION,
    REPORT_PAGE,
    INITIAL_POLICY,
    LAST_POLICY,
    BEST_POLICY,
    QUARTER_POLICY,
    RACE,
];
/// The folders in which everything is the run's.
const FOLDERS: [&str; 2] = [CHECKPOINTS, TENSORBOARD];

/// Returns the directory of the run that keeps the file at a path, or would write it; `None` for any other place.
///
/// Links are followed: the place that the path names counts, and the one that it leads to.
pub fn run_that_keeps(path: &Path) -> Option<PathBuf> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok();
    let named = folder.and_then(|folder| Some(folder.join(path.file_name()?)));
    [named, path.canonicalize().ok()].into_iter().flatten().find_map(|path| keeper(&path))
}

/// As [`run_that_keeps`], for a path without links.
fn keeper(path: &Path) -> Option<PathBuf> {
    let run = path.ancestors().skip(1).find(|folder| keeps_a_run(folder))?;
    let inside = path.strip_prefix(run).ok()?;
    let first = inside.iter().next()?.to_str()?;
    let is_direct = inside.iter().nth(1).is_none();
    let is_kept = FOLDERS.contains(&first) || (is_direct && FILES.contains(&first));
    is_kept.then(|| run.to_owned())
}

/// Tells whether a folder keeps a run; a folder of the record's name makes none.
fn keeps_a_run(folder: &Path) -> bool {
    let is_begun = || folder.join(CONFIG).is_file() && folder.join(CHECKPOINTS).is_dir();
    folder.join(RECORD).is_file() || is_begun()
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn a_run_keeps_its_own_files_and_no_others() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().canonicalize().unwrap().join("r");
        fs::create_dir_all(run.join("checkpoints")).unwrap();
        fs::create_dir(run.join("tensorboard")).unwrap();
        assert_eq!(run_that_keeps(&run.join("run.json")), None, "nothing was begun yet");
        fs::write(run.join("config.toml"), "").unwrap();
        for file in FILES.into_iter().chain(["checkpoints", "checkpoints/1", "tensorboard/x"]) {
            assert_eq!(run_that_keeps(&run.join(file)), Some(run.clone()), "{file}");
        }
        for file in ["steps.jsonl", "playthrough.png", "up.log"] {
            assert_eq!(run_that_keeps(&run.join(file)), None, "{file}");
        }
        assert_eq!(run_that_keeps(&place.path().join("run.json")), None);
        assert_eq!(run_that_keeps(Path::new("run.json")), None);
    }

    #[test]
    fn a_link_is_followed_to_the_run() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().canonicalize().unwrap().join("r");
        fs::create_dir(&run).unwrap();
        fs::write(run.join("run.json"), "{}").unwrap();
        let link = |to: &Path, name: &str| {
            let path = place.path().join(name);
            symlink(to, &path).unwrap();
            path
        };
        let folder = link(&run, "folder");
        assert_eq!(run_that_keeps(&folder.join("best.safetensors")), Some(run.clone()));
        assert_eq!(run_that_keeps(&folder.join("steps.jsonl")), None);
        let file = link(&run.join("run.json"), "steps.jsonl");
        assert_eq!(run_that_keeps(&file), Some(run));
    }
}
