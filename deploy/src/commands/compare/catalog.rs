//! The studies that come with the program.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, ensure};

use super::study::Study;

/// Name and text, in the order in which `all` carries them out.
const BUILT_IN: [(&str, &str); 10] = [
    ("table1", include_str!("../../../studies/table1.toml")),
    ("robustness", include_str!("../../../studies/robustness.toml")),
    ("types", include_str!("../../../studies/types.toml")),
    ("cliff", include_str!("../../../studies/cliff.toml")),
    ("hard", include_str!("../../../studies/hard.toml")),
    ("steakhouse", include_str!("../../../studies/steakhouse.toml")),
    ("adaptive", include_str!("../../../studies/adaptive.toml")),
    ("layouts", include_str!("../../../studies/layouts.toml")),
    ("realtime", include_str!("../../../studies/realtime.toml")),
    ("reasons", include_str!("../../../studies/reasons.toml")),
];

/// The word for every study that comes with the program.
const ALL: &str = "all";

/// A study with the name that its files bear.
#[derive(Clone, Debug)]
pub(super) struct Named {
    /// The name.
    pub(super) name: String,
    /// The study.
    pub(super) study: Study,
}

/// Lists the names of the studies that come with the program.
pub(super) fn names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// Tells whether a study of that name comes with the program.
pub(super) fn is_built_in(name: &str) -> bool {
    names().any(|known| known == name)
}

/// Finds studies: one by name, all of them, or the one in a file.
///
/// # Errors
///
/// One sentence: what there is no study of, or what is wrong with it.
pub(super) fn find(name: &str) -> anyhow::Result<Vec<Named>> {
    if name == ALL {
        return names().map(built_in).collect();
    }
    if is_built_in(name) {
        return Ok(vec![built_in(name)?]);
    }
    let path = Path::new(name);
    let is_file = path.extension().is_some_and(|extension| extension == "toml");
    let known = names().collect::<Vec<_>>().join(", ");
    ensure!(is_file, "there is no study `{name}`; known: {known}, {ALL}, or a .toml file");
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    let study = Study::parse(&text).with_context(|| format!("study {}", path.display()))?;
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    check_name(stem).with_context(|| format!("study {}", path.display()))?;
    Ok(vec![Named { name: stem.to_owned(), study }])
}

/// Checks the name of a file, which the study's runs and pages will bear.
fn check_name(name: &str) -> anyhow::Result<()> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-';
    ensure!(
        !name.is_empty() && name.chars().all(plain),
        "`{name}` is no name for a study; name the file with a-z, 0-9, _ and -"
    );
    ensure!(
        !is_built_in(name) && name != ALL,
        "`{name}` is the name of a study that comes with the program; name the file otherwise"
    );
    Ok(())
}

fn built_in(name: &str) -> anyhow::Result<Named> {
    let text = BUILT_IN.iter().find(|(known, _)| *known == name).map_or("", |(_, text)| *text);
    let study = Study::parse(text).with_context(|| format!("study {name}"))?;
    Ok(Named { name: name.to_owned(), study })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_study_that_comes_with_the_program_is_sound() {
        assert_eq!(find(ALL).unwrap().len(), BUILT_IN.len());
    }

    #[test]
    fn the_search_is_a_sound_study_too() {
        Study::parse(include_str!("../../../studies/search.toml")).unwrap();
    }

    #[test]
    fn a_study_of_ones_own_needs_a_name_of_its_own() {
        for (name, told) in [
            ("table1", "comes with the program"),
            ("all", "comes with the program"),
            ("My Study", "no name for a study"),
            ("README", "no name for a study"),
        ] {
            let error = check_name(name).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains(name), "{error}");
        }
        check_name("my-study_2").unwrap();
    }

    #[test]
    fn an_unknown_study_is_told_with_those_there_are() {
        let error = find("table9").unwrap_err().to_string();
        assert!(error.contains("`table9`") && error.contains("table1, robustness"), "{error}");
    }
}
