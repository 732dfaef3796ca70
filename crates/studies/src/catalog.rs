//! The studies that come with the program.

use std::path::Path;

use leadtime_proto::phrase::no_such;
use leadtime_runs::regular;

use crate::error::{Error, Placed as _, ensure};
use crate::study::Study;

/// Name and text, in the order in which `all` carries them out.
const BUILT_IN: [(&str, &str); 13] = [
    ("table1", include_str!("../studies/table1.toml")),
    ("robustness", include_str!("../studies/robustness.toml")),
    ("types", include_str!("../studies/types.toml")),
    ("cliff", include_str!("../studies/cliff.toml")),
    ("hard", include_str!("../studies/hard.toml")),
    ("steakhouse", include_str!("../studies/steakhouse.toml")),
    ("adaptive", include_str!("../studies/adaptive.toml")),
    ("layouts", include_str!("../studies/layouts.toml")),
    ("realtime", include_str!("../studies/realtime.toml")),
    ("reasons", include_str!("../studies/reasons.toml")),
    ("slack", include_str!("../studies/slack.toml")),
    ("letter", include_str!("../studies/letter.toml")),
    ("factors", include_str!("../studies/factors.toml")),
];

/// The word for every study that comes with the program.
const ALL: &str = "all";

/// A study with the name that its files bear.
#[derive(Clone, Debug)]
pub struct NamedStudy {
    /// The name: its file without the ending.
    pub name: String,
    /// The study as it was read.
    pub study: Study,
}

/// Lists the names of the studies that come with the program.
pub fn names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// Returns whether a study of that name comes with the program.
pub(crate) fn is_built_in(name: &str) -> bool {
    names().any(|known| known == name)
}

/// Finds studies: one by name, all of them, or the one in a file.
///
/// # Errors
///
/// If there is no such study, or its file cannot be read or is not a sound study.
pub fn find(name: impl AsRef<Path>) -> Result<Vec<NamedStudy>, Error> {
    let path = name.as_ref();
    let name = &*path.to_string_lossy();
    if name == ALL {
        return names().map(built_in).collect();
    }
    if is_built_in(name) {
        return built_in(name).map(|study| vec![study]);
    }
    let is_file = path.extension().is_some_and(|extension| extension == "toml");
    ensure(is_file, || {
        let known: Vec<&str> = names().chain([ALL]).collect();
        no_such("study or .toml file", name, known)
    })?;
    let text = regular::read_to_string(path).map_err(Error::file("reading", path))?;
    let place = format!("study {}", path.display());
    let study = Study::parse(&place, &text)?;
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    check_name(stem).at(&place)?;
    Ok(vec![NamedStudy { name: stem.to_owned(), study }])
}

/// Checks the name of a file, which the study's runs and pages will bear.
fn check_name(name: &str) -> Result<(), Error> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-';
    ensure(!name.is_empty() && name.chars().all(plain), || {
        format!("`{name}` cannot name a study; name the file with a-z, 0-9, _ and -")
    })?;
    ensure(!is_built_in(name) && name != ALL, || {
        format!("`{name}` is the name of a built-in study; rename the file")
    })
}

fn built_in(name: &str) -> Result<NamedStudy, Error> {
    let text = BUILT_IN.iter().find(|(known, _)| *known == name).map_or("", |(_, text)| *text);
    let study = Study::parse(&format!("study {name}"), text)?;
    Ok(NamedStudy { name: name.to_owned(), study })
}

#[cfg(test)]
mod tests {
    use leadtime_config::{Layer, identity};
    use leadtime_runs::Tasks;

    use super::*;
    use crate::profile;
    use crate::study::StudyPart;
    use crate::test_support::sentence;

    #[test]
    fn every_study_that_comes_with_the_program_is_sound_and_the_search_too() {
        assert_eq!(find(ALL).unwrap().len(), BUILT_IN.len());
        Study::parse("search", include_str!("../studies/search.toml")).unwrap();
    }

    #[test]
    fn a_name_is_plain_and_not_that_of_another_study_and_a_known_one_is_found() {
        let (taken, odd) = ("built-in study", "cannot name a study");
        for (name, reason) in
            [("table1", taken), ("all", taken), ("My Study", odd), ("README", odd)]
        {
            let error = sentence(check_name(name));
            assert!(error.contains(reason) && error.contains(name), "{error}");
        }
        check_name("my-study_2").unwrap();
        let error = sentence(find("table9"));
        assert!(error.contains("`table9`") && error.contains("table1, robustness"), "{error}");
    }

    #[test]
    fn the_factors_together_lead_from_the_letter_to_our_profile_and_back() {
        let tasks = Tasks::new();
        let study = built_in("factors").unwrap().study;
        let [way, letter, ours] = &study.parts[..] else { panic!("three parts") };
        let profile = |part: &StudyPart| profile::read(&tasks, Path::new(&part.profile)).unwrap();
        let last = way.rows.last().unwrap();
        for (from, rows, to) in [
            (letter, &letter.rows[..], ours),
            (ours, &ours.rows[..], letter),
            (way, std::slice::from_ref(last), ours),
        ] {
            let sets = rows.iter().map(|row| Layer::table("`set`", &row.set));
            let arrived = profile(from).with(sets, &tasks.registry).unwrap();
            let mut left = identity::difference(&arrived.table, &profile(to).table);
            left.retain(|it| it.key != identity::TOTAL_STEPS && !identity::is_free(&it.key));
            let left: Vec<String> = left.iter().map(ToString::to_string).collect();
            assert!(left.is_empty(), "no factor of {} changes {left:?}", from.name);
            let names = |part: &StudyPart| {
                part.rows[1..].iter().map(|row| row.name.clone()).collect::<Vec<_>>()
            };
            assert_eq!(names(from), names(to));
        }
    }
}
