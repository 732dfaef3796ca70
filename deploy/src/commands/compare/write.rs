//! Where tables and figures go.

use std::fs;
use std::path::PathBuf;

use anyhow::Context as _;
use leadtime_eval::study::{Shown, StudyResult};

use super::index;
use crate::cli::CompareArgs;
use crate::output;
use crate::record::write_atomically;

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
    /// Chooses it: what is only a part of a study, or changed, overwrites no table unless the person says where.
    pub(super) fn new(args: &CompareArgs) -> Self {
        let whole = args.rows.is_empty()
            && args.parts.is_empty()
            && args.set.is_empty()
            && args.profile.is_empty()
            && args.steps.is_none();
        let results = args.out.clone().or_else(|| whole.then(|| PathBuf::from(RESULTS)));
        Self { results, quick: args.quick }
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
