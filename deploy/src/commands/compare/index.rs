//! The index of results: every study's main tables, from the data that lies beside it.

use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use anyhow::Context as _;
use leadtime_eval::study::StudyResult;

use super::catalog;
use super::write::QUICK;

/// The index's file.
pub(super) const FILE: &str = "README.md";

/// Makes the index of a directory: full results where there are some, else those of a quick run, and in the end how to
/// get the rest.
///
/// # Errors
///
/// What the file system says, or data that is none of ours.
pub(super) fn page(results: &Path) -> anyhow::Result<String> {
    let mut page = String::from(
        "# Results\n\nThe paper's figures and ours beside them. This page is written by `leadtime compare`; each study's \
         own page has every measure, and says where its numbers are from.\n\n",
    );
    page.push_str(&others(results)?);
    let mut missing = Vec::new();
    for name in catalog::names() {
        let full = read(&results.join(format!("{name}.json")))?;
        let quick = read(&results.join(QUICK).join(format!("{name}.json")))?;
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

fn read(path: &Path) -> anyhow::Result<Option<StudyResult>> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error).with_context(|| format!("reading {}", path.display())),
    };
    let result = serde_json::from_str(&text);
    Ok(Some(result.with_context(|| format!("{} is no study's result", path.display()))?))
}

/// Lists the other pages of the directory by their headings.
fn others(results: &Path) -> anyhow::Result<String> {
    let Ok(entries) = fs::read_dir(results) else { return Ok(String::new()) };
    let names = entries.filter_map(Result::ok).filter_map(|e| e.file_name().into_string().ok());
    let is_page = |name: &str| Path::new(name).extension().is_some_and(|end| end == "md");
    let is_study = |name: &str| catalog::names().any(|study| name == format!("{study}.md"));
    let mut names: Vec<String> =
        names.filter(|name| is_page(name) && name != FILE && !is_study(name)).collect();
    names.sort();
    let mut lines = String::new();
    for name in names {
        let text = fs::read_to_string(results.join(&name)).with_context(|| name.clone())?;
        let heading = text.lines().find_map(|line| line.strip_prefix("# ")).unwrap_or(&name);
        let line = format!("* [{heading}]({name})\n");
        lines.push_str(&line);
    }
    Ok(if lines.is_empty() { lines } else { format!("Elsewhere:\n\n{lines}\n") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_directory_gets_a_page_that_says_how_to_fill_it() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("parity.md"), "# Parity with others\n").unwrap();
        let page = page(dir.path()).unwrap();
        assert!(page.contains("* [Parity with others](parity.md)"), "{page}");
        let rest = "Other tables are not in this directory: `leadtime compare table1`, ";
        assert!(page.contains(rest), "{page}");
        assert!(!page.contains("\n## "), "what is not there has no section: {page}");
    }

    #[test]
    fn data_that_is_none_of_ours_is_told_with_its_path() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("hard.json"), "{}").unwrap();
        let error = page(dir.path()).unwrap_err().to_string();
        assert!(error.contains("hard.json is no study's result"), "{error}");
    }
}
