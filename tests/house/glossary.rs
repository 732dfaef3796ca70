//! What GLOSSARY.md names is there.

use std::collections::BTreeSet;
use std::fs;

use crate::code::{all_sources, root};
use crate::type_name;

/// Macros that define a type each time they are called.
const MAKERS: [&str; 2] = ["counter! {", "slug! {"];

#[test]
fn every_identifier_of_the_glossary_is_in_the_sources() {
    let product = || all_sources().iter().filter(|source| source.is_product());
    let types: BTreeSet<&str> = product().flat_map(|source| types_of(&source.code)).collect();
    let words: BTreeSet<&str> = product().flat_map(|source| words(&source.text)).collect();
    let others: Vec<String> =
        ["crates/config/configs", "crates/studies/studies", "python/leadtime"]
            .iter()
            .flat_map(|folder| fs::read_dir(root().join(folder)).expect("the folder is there"))
            .map(|entry| entry.expect("it can be listed").path())
            .map(|path| path.display().to_string() + &fs::read_to_string(&path).unwrap_or_default())
            .collect();
    let glossary = fs::read_to_string(root().join("GLOSSARY.md")).expect("it is there");
    let is_there = |word: &str| {
        // `behavior_` and `paper_letter_*` stand for names that begin so.
        let begins =
            |known: &str| known == word || (word.ends_with('_') && known.starts_with(word));
        words.iter().any(|known| begins(known)) || others.iter().any(|text| text.contains(word))
    };
    let missing = |(_, name): &(usize, &str)| {
        let mut parts = self::words(name);
        let first = parts.next().unwrap_or_default();
        let is_type = first.starts_with(char::is_uppercase);
        let is_known = if is_type { types.contains(first) } else { is_there(first) };
        !is_known || !parts.all(is_there)
    };
    let missing: Vec<(usize, &str)> = identifiers(&glossary).into_iter().filter(missing).collect();
    assert_eq!(missing, [], "lines of GLOSSARY.md, and what they name that is nowhere");
}

/// Lists the names in the second column of the tables, each with its line.
fn identifiers(glossary: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    for (i, line) in glossary.lines().enumerate() {
        let column = line.strip_prefix('|').and_then(|row| row.split('|').nth(1));
        let quoted = column.unwrap_or_default().split('`').skip(1).step_by(2);
        found.extend(quoted.map(|name| (i + 1, name)));
    }
    found
}

fn types_of(code: &str) -> impl Iterator<Item = &str> {
    let made = MAKERS.iter().flat_map(|maker| code.split(maker).skip(1));
    let made = made.filter_map(|inside| words(inside).next());
    code.lines().filter_map(type_name).chain(made)
}

pub(crate) fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty())
}

#[test]
fn names_are_read_off_the_second_column() {
    let glossary = "| term | identifier | meaning |\n|---|---|---|\n| role `x` | `Role`, `A::B` | See `Other`. |";
    assert_eq!(identifiers(glossary), [(3, "Role"), (3, "A::B")]);
    let types: Vec<&str> = types_of("slug! {\n\n    RunName, 4\n}\nstruct A;").collect();
    assert_eq!(types, ["A", "RunName"]);
}
