//! Which keys decide what a run computes, the hash over them, and what differs between two configurations.
//!
//! Two configurations with the same identity give the same weights, bit for bit, from the same program.

use std::collections::BTreeMap;
use std::fmt;

use sha2::{Digest as _, Sha256};
use toml::{Table, Value};

/// Sections that say where and how a run is carried out, and not what it computes.
const FREE_SECTIONS: [&str; 3] = ["run.", "actor.", "evaluation."];
/// The key that may grow when a run is resumed.
pub const TOTAL_STEPS: &str = "learner.total_steps";
/// The seed's key.
const SEED: &str = "seed";
/// Settings that are younger than some runs, and the value at which each changes nothing.
const LATER: [(&str, f64); 1] = [("policy.length_bias", 0.0)];

/// Tells whether a key only says where and how a run is carried out.
pub fn is_free(key: &str) -> bool {
    FREE_SECTIONS.iter().any(|section| key.starts_with(section))
}

/// Returns the leaves that decide what a run computes.
///
/// Settings that are younger than some runs are left out where they change nothing, so an earlier run keeps its identity.
pub fn deciding(table: &Table) -> BTreeMap<String, String> {
    let mut leaves = flatten(table);
    leaves.retain(|key, value| !is_free(key) && !changes_nothing(key, value));
    leaves
}

/// Tells whether a value (empty: none) is that of a younger setting that changes nothing.
fn changes_nothing(key: &str, value: &str) -> bool {
    let is_neutral = |later, at| key == later && (value.is_empty() || value.parse() == Ok(at));
    LATER.iter().any(|(later, at)| is_neutral(*later, *at))
}

/// Computes the hash over everything that must not change when a run is resumed.
pub fn of_run(table: &Table) -> [u8; 32] {
    hash(table, TOTAL_STEPS)
}

/// Computes the hash over everything that decides what a training computes, except for its seed.
pub fn of_training(table: &Table) -> [u8; 32] {
    hash(table, SEED)
}

fn hash(table: &Table, except: &str) -> [u8; 32] {
    let mut hash = Sha256::new();
    for (key, value) in deciding(table).iter().filter(|(key, _)| *key != except) {
        hash.update(format!("{key}={value}\n"));
    }
    hash.finalize().into()
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

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let or_none = |text: &str| if text.is_empty() { "(none)" } else { text }.to_owned();
        write!(f, "{}: {} -> {}", self.key, or_none(&self.before), or_none(&self.after))
    }
}

/// Lists the keys whose values differ, in order.
///
/// A setting that came later than one of them is left out where it changes nothing.
pub fn difference(before: &Table, after: &Table) -> Vec<Change> {
    let (before, after) = (flatten(before), flatten(after));
    let mut keys: Vec<&String> = before.keys().chain(after.keys()).collect();
    keys.sort();
    keys.dedup();
    let changes = keys.into_iter().filter(|key| before.get(*key) != after.get(*key));
    let value = |of: &BTreeMap<String, String>, key: &String| of.get(key).cloned();
    let change = |key: &String| Change {
        key: key.clone(),
        before: value(&before, key).unwrap_or_default(),
        after: value(&after, key).unwrap_or_default(),
    };
    let matters = |change: &Change| {
        let Change { key, before, after } = change;
        !(changes_nothing(key, before) && changes_nothing(key, after))
    };
    changes.map(change).filter(matters).collect()
}

/// Returns every leaf of a table by its full key.
pub fn flatten(table: &Table) -> BTreeMap<String, String> {
    let mut leaves = BTreeMap::new();
    collect(table, "", &mut leaves);
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
    fn a_setting_that_came_later_and_changes_nothing_decides_nothing() {
        let before = table("[policy]\ninitiate_bias = -1.0");
        let same = table("[policy]\ninitiate_bias = -1.0\nlength_bias = 0.0");
        assert_eq!(deciding(&before), deciding(&same));
        assert!(difference(&before, &same).is_empty());
        let other = table("[policy]\ninitiate_bias = -1.0\nlength_bias = -0.5");
        let texts = |from, to| difference(from, to).iter().map(ToString::to_string).collect();
        let texts: [Vec<String>; 2] = [texts(&before, &other), texts(&other, &same)];
        let expected = ["(none) -> -0.5", "-0.5 -> 0.0"];
        assert_eq!(texts, expected.map(|text| vec![format!("policy.length_bias: {text}")]));
        assert!(flatten(&same).contains_key("policy.length_bias"));
    }

    #[test]
    fn a_difference_names_keys_and_both_values() {
        let changes = difference(&table("a = 1\n[b]\nc = 2"), &table("a = 1\n[b]\nc = 3\nd = 4"));
        let texts: Vec<String> = changes.iter().map(ToString::to_string).collect();
        assert_eq!(texts, ["b.c: 2 -> 3", "b.d: (none) -> 4"]);
    }

    #[test]
    fn how_a_run_is_carried_out_does_not_decide_its_weights() {
        const RUN: &str = "seed = 1\n[run]\nname = \"a\"\n[learner]\ntotal_steps = 5\nclip = 0.2";
        let run = table(RUN);
        for (from, to, expected) in [
            ("\"a\"", "\"b\"", [true, true]),
            ("steps = 5", "steps = 6", [true, false]),
            ("seed = 1", "seed = 2", [false, true]),
            ("0.2", "0.1", [false, false]),
        ] {
            let changed = table(&RUN.replace(from, to));
            let same =
                [of_run(&changed) == of_run(&run), of_training(&changed) == of_training(&run)];
            assert_eq!(same, expected, "{to}");
        }
    }
}
