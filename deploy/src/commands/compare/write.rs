//! Where tables and figures go.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use leadtime_eval::study::{Shown, StudyResult};

use super::catalog::Named;
use super::{catalog, index};
use crate::cli::CompareArgs;
use crate::output;
use leadtime_runs::write_atomically;

/// Where results go unless the person says otherwise.
const RESULTS: &str = "docs/results";
/// The folder in it for results of quick runs.
pub(super) const QUICK: &str = "quick";

/// A picture that is not in a file yet.
#[derive(Clone, Debug)]
pub(super) struct Drawn {
    /// The file's name.
    pub(super) file: String,
    /// What there is to see.
    pub(super) caption: String,
    /// The PNG file.
    pub(super) png: Vec<u8>,
}

/// The directory for results; `None`: standard output alone.
#[derive(Clone, Debug)]
pub(super) struct Place {
    results: Option<PathBuf>,
    quick: bool,
}

impl Place {
    /// Chooses it: a study of one's own, and what is only a part of a study, or changed, overwrites no table unless the
    /// person says where.
    pub(super) fn new(args: &CompareArgs, studies: &[Named]) -> Self {
        let as_it_is = args.rows.is_empty()
            && args.parts.is_empty()
            && args.set.is_empty()
            && args.profile.is_empty()
            && args.steps.is_none()
            && args.seeds.is_none()
            && args.has_the_tables_episodes();
        let ours = studies.iter().all(|named| catalog::is_built_in(&named.name));
        let default = (as_it_is && ours).then(|| PathBuf::from(RESULTS));
        Self { results: args.out.clone().or(default), quick: args.quick }
    }

    /// Checks, before hours of training, that a study's page would replace nothing but an earlier one of its own.
    ///
    /// # Errors
    ///
    /// One sentence that names the page.
    pub(super) fn check(&self, study: &str) -> anyhow::Result<()> {
        let Some(directory) = self.directory() else { return Ok(()) };
        let [page, data] = ["md", "json"].map(|end| directory.join(format!("{study}.{end}")));
        ensure!(
            !page.exists() || data.exists(),
            "{} is no page of a study ({} is not beside it); use another --out, or another name for the study",
            page.display(),
            data.display()
        );
        Ok(())
    }

    fn directory(&self) -> Option<PathBuf> {
        let results = self.results.as_ref()?;
        Some(if self.quick { results.join(QUICK) } else { results.clone() })
    }

    /// Writes pictures, and says where they are.
    ///
    /// # Errors
    ///
    /// What the file system says, with the path.
    pub(super) fn write_pictures(&self, drawn: Vec<Drawn>) -> anyhow::Result<Vec<Shown>> {
        let mut shown = Vec::new();
        for Drawn { file, caption, png } in drawn {
            if self.directory().is_some() {
                self.put(&file, &png)?;
                shown.push(Shown { file, caption });
            }
        }
        Ok(shown)
    }

    /// Writes a study's page and data; prints its tables.
    ///
    /// # Errors
    ///
    /// What the file system says, with the path.
    pub(super) fn write(&self, result: &StudyResult) -> anyhow::Result<()> {
        let Some(directory) = self.directory() else {
            output::line(result.markdown().trim_end());
            return Ok(());
        };
        let name = &result.study;
        let mut json = serde_json::to_string_pretty(result)?;
        json.push('\n');
        self.put(&format!("{name}.md"), result.markdown().as_bytes())?;
        self.put(&format!("{name}.json"), json.as_bytes())?;
        output::line(&format!("{}", directory.join(format!("{name}.md")).display()));
        Ok(())
    }

    /// Writes the index over everything that lies there.
    ///
    /// # Errors
    ///
    /// What the file system says, with the path.
    pub(super) fn write_index(&self) -> anyhow::Result<()> {
        let Some(results) = &self.results else { return Ok(()) };
        let path = results.join(index::FILE);
        let page = index::page(results)?;
        write_atomically(&path, page.as_bytes())
            .with_context(|| format!("writing {}", path.display()))?;
        output::line(&format!("{}", path.display()));
        Ok(())
    }

    fn put(&self, file: &str, bytes: &[u8]) -> anyhow::Result<()> {
        let Some(directory) = self.directory() else { return Ok(()) };
        fs::create_dir_all(&directory)
            .with_context(|| format!("making {}", directory.display()))?;
        let path = directory.join(file);
        write_atomically(&path, bytes).with_context(|| format!("writing {}", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::test_support::args;
    use super::*;

    fn place(study: &str, more: &[&str]) -> Place {
        let studies = catalog::find(study).unwrap();
        Place::new(&args(Path::new("runs"), more), &studies)
    }

    #[test]
    fn only_a_whole_study_of_ours_replaces_a_table_unasked() {
        let results = |more: &[&str]| place("table1", more).directory();
        assert_eq!(results(&[]), Some(PathBuf::from("docs/results")));
        assert_eq!(results(&["--quick"]), Some(PathBuf::from("docs/results/quick")));
        for more in [
            ["--row", "a"],
            ["--part", "a"],
            ["--set", "learner.clip=0.1"],
            ["--profile", "lander"],
            ["--steps", "9000"],
            ["--seeds", "1..2"],
            ["--episodes", "5"],
            ["--eval-seed", "7"],
        ] {
            assert_eq!(results(&more), None, "{more:?}");
        }
        let out = ["--out", "elsewhere", "--seeds", "1..2"];
        assert_eq!(results(&out), Some(PathBuf::from("elsewhere")));
    }

    #[test]
    fn a_page_that_no_study_wrote_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let place = place("table1", &["--out", dir.path().to_str().unwrap()]);
        place.check("driving").unwrap();
        fs::write(dir.path().join("driving.md"), "# Written by hand").unwrap();
        let error = place.check("driving").unwrap_err().to_string();
        assert!(error.contains("driving.md is no page of a study"), "{error}");
        fs::write(dir.path().join("driving.json"), "{}").unwrap();
        place.check("driving").unwrap();
    }
}
