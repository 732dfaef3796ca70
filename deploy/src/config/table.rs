//! Plain operations on TOML tables: overlay, `--set`, and the difference of two configurations.

use std::collections::BTreeMap;

use toml::{Table, Value};

/// The one table inside a section that is a section itself: `[evaluation.world]`.
const SUBSECTION: &str = "world";
/// Settings that came after runs had been made without them, and the value at which they change nothing.
const LATER: [(&str, f64); 1] = [("policy.length_bias", 0.0)];

/// Lays `over` onto `base`: sections are merged key by key, everything else is replaced.
///
/// Inside a section a table with one key stands for a choice (`{ fixed = 2 }`), so another choice replaces it whole.
pub fn overlay(base: &mut Table, over: &Table) {
    for (key, value) in over {
        match (base.get_mut(key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => overlay_section(below, above),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

fn overlay_section(base: &mut Table, over: &Table) {
    for (key, value) in over {
        match (base.get_mut(key), value) {
            (Some(Value::Table(below)), Value::Table(above))
                if key == SUBSECTION || !is_other_choice(below, above) =>
            {
                overlay_section(below, above);
            }
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

fn is_other_choice(below: &Table, above: &Table) -> bool {
    below.len() == 1 && above.len() == 1 && below.keys().next() != above.keys().next()
}

/// One `--set section.key=value`.
#[derive(Clone, Debug)]
pub struct Assignment {
    path: Vec<String>,
    value: Value,
}

impl Assignment {
    /// Reads `section.key=value`; the value is TOML, or a text if it is no TOML.
    ///
    /// # Errors
    ///
    /// A sentence, if there is no `=` or no key in front of it, or a whole number beyond what TOML can hold.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (key, value) = text
            .split_once('=')
            .ok_or_else(|| format!("`{text}` is not of the form section.key=value"))?;
        let path: Vec<String> = key.trim().split('.').map(str::to_owned).collect();
        if path.iter().any(String::is_empty) {
            return Err(format!("`{key}` is not a key: write section.key=value"));
        }
        let value = value.trim();
        if is_whole_number(value) && value.replace('_', "").parse::<i64>().is_err() {
            return Err(format!("`{key}` is {value}; allowed: whole numbers up to {}", i64::MAX));
        }
        let value = format!("value = {value}")
            .parse::<Table>()
            .ok()
            .and_then(|mut table| table.remove("value"))
            .unwrap_or_else(|| Value::String(value.to_owned()));
        Ok(Self { path, value })
    }

    /// Returns the key as written: `learner.clip`.
    pub fn key(&self) -> String {
        self.path.join(".")
    }

    /// Makes the assignment in `table`; a whole number given for a fraction becomes one.
    pub fn apply(&self, table: &mut Table) {
        let Some((last, sections)) = self.path.split_last() else { return };
        let mut at = table;
        for section in sections {
            at = inner_table(at, section);
        }
        let value = match (at.get(last), &self.value) {
            (Some(Value::Float(_)), Value::Integer(whole)) => Value::Float(*whole as f64),
            _ => self.value.clone(),
        };
        at.insert(last.clone(), value);
    }
}

impl std::fmt::Display for Assignment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} = {}", self.key(), self.value)
    }
}

/// One `--each section.key=[values]`: an assignment per value.
#[derive(Clone, Debug)]
pub struct Alternatives(Vec<Assignment>);

impl Alternatives {
    /// Reads `section.key=[value, ...]`.
    ///
    /// # Errors
    ///
    /// As [`Assignment::parse`], and if what stands behind the `=` is no list of values.
    pub fn parse(text: &str) -> Result<Self, String> {
        let Assignment { path, value } = Assignment::parse(text)?;
        match value {
            Value::Array(values) if !values.is_empty() => {
                let assignment = |value| Assignment { path: path.clone(), value };
                Ok(Self(values.into_iter().map(assignment).collect()))
            }
            _ => Err(format!("`{text}` is not of the form section.key=[value, ...]")),
        }
    }

    /// Returns the assignments, in order.
    pub fn assignments(&self) -> &[Assignment] {
        &self.0
    }
}

fn is_whole_number(text: &str) -> bool {
    let digits = text.strip_prefix(['+', '-']).unwrap_or(text);
    digits.starts_with(|first: char| first.is_ascii_digit())
        && digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'_')
}

/// Returns the table under `key`, made (in place of anything else) if there is none.
fn inner_table<'a>(table: &'a mut Table, key: &str) -> &'a mut Table {
    if !table.get(key).is_some_and(Value::is_table) {
        table.insert(key.to_owned(), Value::Table(Table::new()));
    }
    match table.get_mut(key) {
        Some(Value::Table(inner)) => inner,
        _ => unreachable!("it was made just now"),
    }
}

/// A key whose value differs between two configurations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The full key: `learner.clip`.
    pub key: String,
    /// Its value in the first, as TOML; empty if it has none.
    pub before: String,
    /// Its value in the second, as TOML; empty if it has none.
    pub after: String,
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let or_none = |text: &str| if text.is_empty() { "(none)" } else { text }.to_owned();
        write!(f, "{}: {} -> {}", self.key, or_none(&self.before), or_none(&self.after))
    }
}

/// Lists the keys whose values differ, in order; those that came later and change nothing do not.
pub fn difference(before: &Table, after: &Table) -> Vec<Change> {
    let (old, new) = (deciding(before), deciding(after));
    let (before, after) = (flatten(before), flatten(after));
    let mut keys: Vec<&String> = before.keys().chain(after.keys()).collect();
    keys.sort();
    keys.dedup();
    let value = |of: &BTreeMap<String, String>, key: &String| of.get(key).cloned();
    keys.into_iter()
        .filter(|key| old.get(*key) != new.get(*key))
        .map(|key| Change {
            key: key.clone(),
            before: value(&before, key).unwrap_or_default(),
            after: value(&after, key).unwrap_or_default(),
        })
        .collect()
}

/// Returns every leaf of a table by its full key.
pub fn flatten(table: &Table) -> BTreeMap<String, String> {
    let mut leaves = BTreeMap::new();
    collect(table, "", &mut leaves);
    leaves
}

/// Returns the leaves that decide what a run computes, for comparing runs: without settings that came after runs had been
/// made, where these are at the value that leaves everything as it was. So an earlier run stays the same run.
pub fn deciding(table: &Table) -> BTreeMap<String, String> {
    let mut leaves = flatten(table);
    let is_as_before = |key: &str, value: &str| {
        LATER.iter().any(|(later, at)| key == *later && value.parse() == Ok(*at))
    };
    leaves.retain(|key, value| !is_as_before(key, value));
    leaves
}

fn collect(table: &Table, prefix: &str, leaves: &mut BTreeMap<String, String>) {
    for (key, value) in table {
        let full = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            Value::Table(inner) => collect(inner, &full, leaves),
            leaf => {
                leaves.insert(full, leaf.to_string());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Table {
        text.parse().unwrap()
    }

    #[test]
    fn an_overlay_keeps_what_it_does_not_name() {
        let mut base = table("seed = 1\n[learner]\nclip = 0.2\nn_envs = 4");
        overlay(&mut base, &table("[learner]\nclip = 0.1"));
        assert_eq!(base, table("seed = 1\n[learner]\nclip = 0.1\nn_envs = 4"));
        let mut base = table("[world]\nwidth = 1\n[evaluation.world]\nwind = true");
        overlay(&mut base, &table("[world]\nheight = 2\n[evaluation.world]\ncalm = 1"));
        let expected = "[world]\nwidth = 1\nheight = 2\n[evaluation.world]\nwind = true\ncalm = 1";
        assert_eq!(base, table(expected));
    }

    #[test]
    fn another_choice_replaces_the_old_one() {
        let mut base = table("[human]\ndelay = { fixed = 2 }\nrepeat = \"restart\"");
        overlay(&mut base, &table("[human]\ndelay = { uniform = { low = 1 } }"));
        let expected = "[human]\ndelay = { uniform = { low = 1 } }\nrepeat = \"restart\"";
        assert_eq!(base, table(expected));
    }

    #[test]
    fn an_assignment_reads_toml_and_plain_words() {
        let mut base = table("domain = \"lander\"\n[learner]\nclip = 0.2");
        for text in ["learner.clip=1", "learner.mode=sync", "seed=7", "world.wind=true"] {
            Assignment::parse(text).unwrap().apply(&mut base);
        }
        let expected = "domain = \"lander\"\nseed = 7\n[learner]\nclip = 1.0\nmode = \"sync\"\n\
                        [world]\nwind = true";
        assert_eq!(base, table(expected));
        assert!(Assignment::parse("clip").is_err());
        assert!(Assignment::parse(".clip=1").is_err());
    }

    #[test]
    fn alternatives_are_an_assignment_each() {
        let each = Alternatives::parse("human.delay=[{fixed=0}, {fixed=2}]").unwrap();
        let texts: Vec<String> = each.assignments().iter().map(ToString::to_string).collect();
        assert_eq!(texts, ["human.delay = { fixed = 0 }", "human.delay = { fixed = 2 }"]);
        for text in ["human.delay=3", "human.delay=[]", "human.delay"] {
            assert!(Alternatives::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_setting_that_came_later_and_changes_nothing_decides_nothing() {
        let before = table("[policy]\ninitiate_bias = -1.0");
        let same = table("[policy]\ninitiate_bias = -1.0\nlength_bias = 0.0");
        assert_eq!(deciding(&before), deciding(&same));
        assert!(difference(&before, &same).is_empty());
        let other = table("[policy]\ninitiate_bias = -1.0\nlength_bias = -0.5");
        let changes = difference(&before, &other);
        assert_eq!(changes[0].to_string(), "policy.length_bias: (none) -> -0.5");
        let back = difference(&other, &same);
        assert_eq!(back[0].to_string(), "policy.length_bias: -0.5 -> 0.0");
        assert!(flatten(&same).contains_key("policy.length_bias"));
    }

    #[test]
    fn a_difference_names_keys_and_both_values() {
        let changes = difference(&table("a = 1\n[b]\nc = 2"), &table("a = 1\n[b]\nc = 3\nd = 4"));
        let texts: Vec<String> = changes.iter().map(ToString::to_string).collect();
        assert_eq!(texts, ["b.c: 2 -> 3", "b.d: (none) -> 4"]);
    }
}
