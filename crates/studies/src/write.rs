//! Where tables and figures go.

use std::fs;
use std::path::{Path, PathBuf};

use leadtime_runs::write_atomically;

use crate::catalog::NamedStudy;
use crate::error::{Error, ensure};
use crate::request::StudyRequest;
use crate::result::{FigureLink, StudyFigure, StudyResult};
use crate::{catalog, index};

/// Where results go unless a request names another directory.
const RESULTS: &str = "docs/results";

/// The directory for results, if they are written.
#[derive(Clone, Debug)]
pub(crate) struct Destination {
    results: Option<PathBuf>,
    quick: bool,
}

impl Destination {
    /// Chooses it: only a complete, unchanged, built-in study replaces a page unless the request names a directory.
    pub(crate) fn new(request: &StudyRequest, studies: &[NamedStudy]) -> Self {
        let built_in = studies.iter().all(|named| catalog::is_built_in(&named.name));
        let default = (request.is_unchanged() && built_in).then(|| PathBuf::from(RESULTS));
        Self { results: request.out.clone().or(default), quick: request.quick }
    }

    /// Checks, before hours of training, that a study's page would replace nothing but an earlier one of its own.
    pub(crate) fn check(&self, study: &str) -> Result<(), Error> {
        let Some(directory) = self.directory() else { return Ok(()) };
        let page = directory.join(format!("{study}.md"));
        let data = index::data(&directory, study);
        ensure(!page.exists() || data.exists(), || {
            format!(
                "{} was not written by a study ({} is missing); use another --out, or another name for the study",
                page.display(),
                data.display()
            )
        })?;
        ensure(!data.exists() || index::is_data(&data)?, || {
            format!(
                "{} is not a study's result; use another --out, or another name for the study",
                data.display()
            )
        })
    }

    /// Checks, before hours of training, that the index can be made, and would replace nothing but an earlier one.
    pub(crate) fn check_index(&self, studies: &[NamedStudy]) -> Result<(), Error> {
        let Some((results, directory)) = self.results.as_deref().zip(self.directory()) else {
            return Ok(());
        };
        let written: Vec<PathBuf> =
            studies.iter().map(|named| index::data(&directory, &named.name)).collect();
        index::check(results, &written)
    }

    fn directory(&self) -> Option<PathBuf> {
        let results = self.results.as_ref()?;
        Some(if self.quick { results.join(index::QUICK) } else { results.clone() })
    }

    /// Writes figures, and returns where they are.
    pub(crate) fn write_figures(
        &self,
        figures: Vec<StudyFigure>,
    ) -> Result<Vec<FigureLink>, Error> {
        let Some(directory) = self.directory() else { return Ok(Vec::new()) };
        let write = |StudyFigure { file, caption, png }| {
            put(&directory, &file, &png)?;
            Ok(FigureLink { file, caption })
        };
        figures.into_iter().map(write).collect()
    }

    /// Writes a study's page and data, and returns the page's path; `None` if results are not written.
    pub(crate) fn write(&self, result: &StudyResult) -> Result<Option<PathBuf>, Error> {
        let Some(directory) = self.directory() else { return Ok(None) };
        let name = &result.study;
        let json = serde_json::to_string_pretty(result).unwrap_or_default() + "\n";
        // The data first: by it a page is known as a study's, also after a kill between the two.
        put(&directory, &format!("{name}.json"), json.as_bytes())?;
        put(&directory, &format!("{name}.md"), result.markdown().as_bytes()).map(Some)
    }

    /// Writes the index over all results in the directory, and returns its path; `None` if results are not written.
    pub(crate) fn write_index(&self) -> Result<Option<PathBuf>, Error> {
        let Some(results) = &self.results else { return Ok(None) };
        let page = index::page(results)?;
        put(results, index::FILE, page.as_bytes()).map(Some)
    }
}

fn put(directory: &Path, file: &str, bytes: &[u8]) -> Result<PathBuf, Error> {
    fs::create_dir_all(directory).map_err(Error::file("making", directory))?;
    let path = directory.join(file);
    write_atomically(&path, bytes).map_err(Error::file("writing", &path))?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::bootstrap;
    use crate::test_support::{STUDY, request, sentence, study};
    use leadtime_config::Override;

    fn destination(request: &StudyRequest) -> Destination {
        Destination::new(request, &catalog::find("table1").unwrap())
    }

    #[test]
    fn only_a_whole_unchanged_study_replaces_a_page_unasked() {
        let whole = request(Path::new("runs"));
        let directory = |request: &StudyRequest| destination(request).directory();
        assert_eq!(directory(&whole), Some(PathBuf::from("docs/results")));
        let quick = StudyRequest { quick: true, ..whole.clone() };
        assert_eq!(directory(&quick), Some(PathBuf::from("docs/results/quick")));
        let set = vec![Override::parse("learner.clip=0.1").unwrap()];
        for changed in [
            StudyRequest { rows: vec!["a".to_owned()], ..whole.clone() },
            StudyRequest { parts: vec!["a".to_owned()], ..whole.clone() },
            StudyRequest { set, ..whole.clone() },
            StudyRequest { profiles: vec![PathBuf::from("lander")], ..whole.clone() },
            StudyRequest { steps: Some(9_000), ..whole.clone() },
            StudyRequest { seeds: Some(1..2), ..whole.clone() },
            StudyRequest { episodes: 5, ..whole.clone() },
            StudyRequest { eval_seed: 7, ..whole.clone() },
        ] {
            assert_eq!(directory(&changed), None, "{changed:?}");
            let out = Some(PathBuf::from("elsewhere"));
            assert_eq!(directory(&StudyRequest { out: out.clone(), ..changed }), out);
        }
        assert_eq!(Destination::new(&whole, &[study("own", STUDY)]).directory(), None);
    }

    #[test]
    fn a_page_that_no_study_wrote_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let out = Some(dir.path().to_owned());
        let destination = destination(&StudyRequest { out, ..request(Path::new("runs")) });
        destination.check("driving").unwrap();
        fs::write(dir.path().join("driving.md"), "# Written by hand").unwrap();
        let error = sentence(destination.check("driving"));
        assert!(error.contains("driving.md was not written by a study"), "{error}");
        fs::write(dir.path().join("driving.json"), r#"{"frames": []}"#).unwrap();
        let error = sentence(destination.check("driving"));
        assert!(error.contains("driving.json is not a study's result"), "{error}");
        fs::write(dir.path().join("driving.json"), r#"{"study": "driving"}"#).unwrap();
        destination.check("driving").unwrap();
    }

    #[test]
    fn a_study_whose_page_could_not_be_written_is_written_again() {
        let dir = tempfile::tempdir().unwrap();
        let out = Some(dir.path().to_owned());
        let destination = destination(&StudyRequest { out, ..request(Path::new("runs")) });
        let result = StudyResult {
            study: "driving".to_owned(),
            title: "t".to_owned(),
            lead: "l".to_owned(),
            warnings: Vec::new(),
            bootstrap: bootstrap(),
            provenance: Vec::new(),
            parts: Vec::new(),
        };
        let [page, data] = ["md", "json"].map(|end| dir.path().join(format!("driving.{end}")));
        // Something is in the way of one of the two, and goes away.
        for (blocked, other) in [(&data, &page), (&page, &data)] {
            fs::create_dir(blocked).unwrap();
            destination.write(&result).unwrap_err();
            fs::remove_dir(blocked).unwrap();
            assert_eq!(other.exists(), *other == data);
            destination.check("driving").unwrap();
        }
        assert_eq!(destination.write(&result).unwrap(), Some(page));
    }

    #[test]
    fn an_index_that_could_not_be_made_is_told_before_anything_is_trained() {
        let dir = tempfile::tempdir().unwrap();
        let out = Some(dir.path().to_owned());
        let studies = catalog::find("table1").unwrap();
        let whole = StudyRequest { out, ..request(Path::new("runs")) };
        let check = |quick| {
            let request = StudyRequest { quick, ..whole.clone() };
            Destination::new(&request, &studies).check_index(&studies)
        };
        // One of an earlier release, which this study will replace.
        fs::write(dir.path().join("table1.json"), "{\"study\": \"table1\"}").unwrap();
        check(false).unwrap();
        let error = sentence(check(true));
        assert!(error.contains("table1.json is not a study's result"), "{error}");
        fs::write(dir.path().join("hard.json"), "{").unwrap();
        let error = sentence(check(false));
        assert!(error.contains("hard.json is not a study's result"), "{error}");
    }

    #[test]
    fn an_index_that_no_comparison_wrote_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let out = Some(dir.path().to_owned());
        let destination = destination(&StudyRequest { out, ..request(Path::new("runs")) });
        destination.check_index(&[]).unwrap();
        let index = destination.write_index().unwrap().unwrap();
        destination.check_index(&[]).unwrap();
        fs::write(&index, "# My project\n").unwrap();
        let error = sentence(destination.check_index(&[]));
        assert!(error.contains("README.md was not written by `leadtime compare`"), "{error}");
        assert_eq!(fs::read_to_string(&index).unwrap(), "# My project\n");
    }
}
