//! The index of results: every study's main tables, from the data next to it.

use std::fs;
use std::path::{Path, PathBuf};

use leadtime_runs::regular;
use serde_json::Value;

use crate::catalog;
use crate::error::{Error, ensure};
use crate::result::StudyResult;

/// The file of the index, in the folder of the results.
pub(crate) const FILE: &str = "README.md";
/// How the index begins, and began in earlier releases.
const BEGINNING: &str = "# Results\n\nThe paper's figures and ours beside them. ";
/// What the results say of the paper's claims, written by hand: a table without a heading.
const VERDICT: &str = "verdict.md";
/// The folder next to it for results of quick runs.
pub(crate) const QUICK: &str = "quick";

/// Makes the index of a directory: full results where there are some, else those of a quick run, and in the end how to
/// get the rest.
pub(crate) fn page(results: &Path) -> Result<String, Error> {
    let mut page = BEGINNING.to_owned()
        + "`leadtime compare` writes this page. Each study's own page has every measure, and says where its numbers come \
           from.\n\n";
    if let Some(verdict) = text_of(&results.join(VERDICT))? {
        page.extend(["## Does it reproduce the paper?\n\n", &verdict, "\n"]);
    }
    page.push_str(&others(results));
    let mut missing = Vec::new();
    for name in catalog::names() {
        let full = read(&data(results, name))?;
        let quick = read(&data(&results.join(QUICK), name))?;
        let section = match (full, quick) {
            (Some(result), _) => result.section(""),
            (None, Some(result)) => result.section(&format!("{QUICK}/")),
            (None, None) => {
                missing.push(format!("`leadtime compare {name}`"));
                continue;
            }
        };
        // The index has the only heading of the first level.
        page.push_str(&section.replace("\n## ", "\n### ").replacen("# ", "## ", 1));
    }
    if !missing.is_empty() {
        let rest = missing.join(", ");
        page = format!("{page}Other tables are not in this directory: {rest}.\n");
    }
    Ok(page)
}

/// Returns the file of a study's data in a directory.
pub(crate) fn data(directory: &Path, study: &str) -> PathBuf {
    directory.join(format!("{study}.json"))
}

/// Makes sure that the index of a directory can be made of what is there, but for the data that will be `written` anew, and
/// that it replaces nothing but an earlier one.
pub(crate) fn check(results: &Path, written: &[PathBuf]) -> Result<(), Error> {
    text_of(&results.join(VERDICT))?;
    let quick = results.join(QUICK);
    let there = catalog::names().flat_map(|name| [data(results, name), data(&quick, name)]);
    there.filter(|file| !written.contains(file)).try_for_each(|file| read(&file).map(drop))?;
    let path = results.join(FILE);
    let Some(text) = text_of(&path)? else { return Ok(()) };
    ensure(text.starts_with(BEGINNING), || {
        format!(
            "{} was not written by `leadtime compare`, whose index would replace it; use another --out",
            path.display()
        )
    })
}

/// Tells whether a file is there and holds the data of a study, of whichever release.
pub(crate) fn is_data(path: &Path) -> Result<bool, Error> {
    let Some(text) = text_of(path)? else { return Ok(false) };
    Ok(serde_json::from_str::<Value>(&text).is_ok_and(|data| data["study"].is_string()))
}

/// Reads a file of text; `None` if it is not there.
fn text_of(path: &Path) -> Result<Option<String>, Error> {
    regular::if_there(regular::read_to_string(path)).map_err(Error::file("reading", path))
}

fn read(path: &Path) -> Result<Option<StudyResult>, Error> {
    let Some(text) = text_of(path)? else { return Ok(None) };
    let foreign = |error: serde_json::Error| {
        Error::Refused(format!("{} is not a study's result: {error}", path.display()))
    };
    serde_json::from_str(&text).map(Some).map_err(foreign)
}

/// Lists the other pages of the directory by their headings.
fn others(results: &Path) -> String {
    let Ok(entries) = fs::read_dir(results) else { return String::new() };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let is_page = |name: &str| Path::new(name).extension().is_some_and(|end| end == "md");
    let is_study = |name: &str| catalog::names().any(|study| name == format!("{study}.md"));
    let is_ours = |name: &str| name == FILE || name == VERDICT || is_study(name);
    let mut names: Vec<String> = names.filter(|name| is_page(name) && !is_ours(name)).collect();
    names.retain(|name| results.join(name).is_file());
    names.sort();
    let mut lines = String::new();
    for name in names {
        let path = results.join(&name);
        // Somebody else's page, in whichever encoding or not to be read at all, must not end a comparison that is done.
        let bytes = fs::read(&path).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes);
        let heading = text.lines().find_map(|line| line.strip_prefix("# ")).unwrap_or(&name);
        lines.extend(["* [", heading, "](", &name, ")\n"]);
    }
    if lines.is_empty() { lines } else { format!("Elsewhere:\n\n{lines}\n") }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::os::unix::fs::symlink;

    use super::*;
    use crate::test_support::sentence;

    #[test]
    fn an_empty_directory_gets_a_page_that_says_how_to_fill_it() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("parity.md"), "# Parity with others\n").unwrap();
        fs::write(dir.path().join(VERDICT), "| claim | verdict |\n").unwrap();
        fs::write(dir.path().join("old.md"), b"# Old \xff\n").unwrap();
        fs::create_dir(dir.path().join("notes.md")).unwrap();
        // A file that nobody can read from its beginning, whoever runs this.
        symlink("/proc/self/mem", dir.path().join("locked.md")).unwrap();
        let page = page(dir.path()).unwrap();
        assert!(page.contains("## Does it reproduce the paper?\n\n| claim |"), "{page}");
        let page = page.replacen("\n## Does", "", 1);
        assert!(page.contains("* [Parity with others](parity.md)"), "{page}");
        assert!(page.contains("* [Old \u{fffd}](old.md)") && !page.contains("notes.md"), "{page}");
        assert!(page.contains("* [locked.md](locked.md)"), "{page}");
        let rest = "Other tables are not in this directory: `leadtime compare table1`, ";
        assert!(page.contains(rest), "{page}");
        assert!(!page.contains("\n## "), "what is not there has no section: {page}");
    }

    #[test]
    fn foreign_json_is_reported_with_its_path() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("hard.json"), "{}").unwrap();
        let error = sentence(page(dir.path()));
        assert!(error.contains("hard.json is not a study's result"), "{error}");
    }

    /// Where the results of the studies that come with the program are shown.
    fn shipped() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results")
    }

    #[test]
    fn every_page_of_results_is_what_its_data_say_but_for_those_written_by_hand() {
        let by_hand = ["beyond", "cooking", "driving", "parity", "pilot", "piloting", "search"];
        let by_hand = by_hand.into_iter().chain(["targets", "verdict"]);
        let mut pages: Vec<String> = by_hand.map(str::to_owned).collect();
        for name in catalog::names() {
            let Some(result) = read(&data(&shipped(), name)).unwrap() else { continue };
            let page = fs::read_to_string(shipped().join(format!("{name}.md"))).unwrap();
            let differs = |(ours, theirs): &(&str, &str)| ours != theirs;
            let made = result.markdown();
            assert_eq!(page.lines().zip(made.lines()).find(differs), None, "{name}: page, data");
            assert_eq!(page, made, "{name}");
            let study = &catalog::find(name).unwrap()[0].study;
            assert_eq!((&result.title, &result.lead), (&study.title, &study.lead), "{name}");
            pages.push(name.to_owned());
        }
        let index = fs::read_to_string(shipped().join(FILE)).unwrap();
        assert_eq!(page(&shipped()).unwrap(), index);
        pages.push("README".to_owned());
        pages.sort();
        let files = fs::read_dir(shipped()).unwrap().map(|entry| entry.unwrap().path());
        let files = files.filter(|file| file.extension().is_some_and(|end| end == "md"));
        let mut found: Vec<String> =
            files.map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
        found.sort();
        assert_eq!(found, pages, "a page is a study's, or one of those written by hand");
    }

    #[test]
    fn the_first_seeds_of_the_studies_are_those_that_the_documentation_names() {
        let text = fs::read_to_string(shipped().join("../studies.md")).unwrap();
        let (_, told) = text.split_once("* Rows train with ").unwrap();
        let (told, _) = told.split_once(". The main rows").unwrap();
        let told: BTreeSet<u64> =
            told.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok()).collect();
        let studies = catalog::find("all").unwrap();
        let parts = studies.iter().flat_map(|named| &named.study.parts);
        assert_eq!(parts.map(|part| part.first_seed).collect::<BTreeSet<u64>>(), told);
    }
}
