//! Which keys decide what a run computes, the hash over them, and what differs between two configurations.
//!
//! Two configurations with the same identity give the same weights, bit for bit, from the same program.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use sha2::{Digest as _, Sha256};
use toml::{Table, Value};

/// Sections that say where and how a run is carried out, and not what it computes.
const FREE_SECTIONS: [&str; 3] = ["run.", "actor.", EVALUATION];
/// The learner's threads change no bit.
const THREADS: &str = "learner.threads";
/// Settings of the domain `python` that only say how its workers are kept; what these are named in another world decides there.
const FREE_IN_PYTHON: [&str; 2] = ["world.batch", "world.step_timeout"];
/// Settings of the learner that may change while a run goes on: they decide how it learns from there on. The others decide
/// what its state is, such as the number of its environments.
pub const CHANGEABLE: [&str; 14] = [
    "learner.anneal",
    "learner.clip",
    "learner.entropy_coef",
    "learner.gae_lambda",
    "learner.gamma",
    "learner.learning_rate",
    "learner.max_grad_norm",
    "learner.n_epochs",
    "learner.n_minibatches",
    "learner.normalize_advantages",
    "learner.reward_scale",
    "learner.target_kl",
    "learner.value_clip",
    "learner.value_coef",
];
/// The key that may grow when a run is resumed.
pub const TOTAL_STEPS: &str = "learner.total_steps";
/// The other key that decides when a run ends, and nothing else; it may rise, or go, when a run is resumed.
pub const STOP_AT: &str = "evaluation.stop_at";
/// The section that says how policies are evaluated, while a run trains and after it.
const EVALUATION: &str = "evaluation.";
/// Its setting that is about evaluations after training alone.
const EPISODES: &str = "evaluation.episodes";
/// The seed's key.
const SEED: &str = "seed";
/// Settings that are younger than some runs, with the value, as TOML, at which each changes nothing.
const LATER: [(&str, &str); 9] = [
    ("policy.length_bias", "0.0"),
    ("world.arrive_within", "0.0"),
    ("world.ego.braking", "6.0"),
    ("world.hardest_braking", "0.0"),
    ("world.near_charged", "\"per_step\""),
    ("world.observation.own_x_unit", "200.0"),
    ("world.observe_time", "false"),
    ("world.reward.hard_braking", "0.0"),
    ("world.reward.late", "0.0"),
];

/// A setting that earlier runs have: which messages stated a reason. Where a reason is worth nothing it decided nothing, and a
/// run without it has the identity of one with the value that every profile had.
const RETIRED: (&str, &str) = ("human.reason_from_words", "4");
/// The setting without which it decided nothing, and that value.
const REASON_WEIGHT: (&str, &str) = ("human.reason_weight", "0.0");

/// Removes what an earlier release wrote and this one no longer reads, where it decided nothing.
pub(crate) fn without_retired(mut table: Table) -> Table {
    let leaves = flatten(&table);
    if leaves.get(REASON_WEIGHT.0).is_some_and(|weight| weight == REASON_WEIGHT.1)
        && let Some((section, key)) = RETIRED.0.split_once('.')
        && let Some(Value::Table(section)) = table.get_mut(section)
    {
        section.remove(key);
    }
    table
}

/// Returns whether a key only says where and how a run is carried out.
pub fn is_free(key: &str) -> bool {
    let is_free = key == THREADS || FREE_SECTIONS.iter().any(|section| key.starts_with(section));
    is_free && key != STOP_AT
}

/// Returns whether a key decides what a policy reaches in an evaluation while its run trains, and so which is the best one.
pub fn decides_best(key: &str) -> bool {
    key.starts_with(EVALUATION) && key != EPISODES
}

/// Returns whether a key decides the weights that a run with these settings ends with.
pub fn decides_weights(key: &str, settings: &Table) -> bool {
    !is_free(key) || decides_end(key, settings)
}

/// Returns whether a key decides when a run with these settings ends, by what its policies reach while it trains.
///
/// That is so only where `evaluation.stop_at` is set; elsewhere such a key is free.
fn decides_end(key: &str, settings: &Table) -> bool {
    let stop_at = STOP_AT.strip_prefix(EVALUATION).unwrap_or_default();
    let section = settings.get("evaluation").and_then(Value::as_table);
    decides_best(key) && section.is_some_and(|section| section.contains_key(stop_at))
}

/// Returns the leaves that decide what a run computes; without a younger setting that changes nothing, so that an earlier
/// run keeps its identity.
fn deciding(table: &Table) -> BTreeMap<String, String> {
    deciding_and(table, |_| false)
}

/// As [`deciding`], with free keys that decide something all the same.
fn deciding_and(table: &Table, decides: impl Fn(&str) -> bool) -> BTreeMap<String, String> {
    let mut leaves = flatten(table);
    leaves.retain(|key, value| (!is_free(key) || decides(key)) && !changes_nothing(key, value));
    if table.get("domain").and_then(Value::as_str) == Some(leadtime_worker::DOMAIN) {
        leaves.retain(|key, _| !FREE_IN_PYTHON.contains(&key.as_str()));
    }
    if leaves.get(REASON_WEIGHT.0).is_some_and(|weight| weight == REASON_WEIGHT.1) {
        let (key, value) = RETIRED;
        leaves.insert(key.to_owned(), value.to_owned());
    }
    leaves
}

/// Returns whether a value (empty: none) is that of a younger setting that changes nothing.
fn changes_nothing(key: &str, value: &str) -> bool {
    let number = |text: &str| text.parse::<f64>().ok();
    LATER.iter().filter(|(later, _)| *later == key).any(|&(_, idle)| {
        let is_same = number(value).zip(number(idle)).is_some_and(|(value, idle)| value == idle);
        value.is_empty() || value == idle || is_same
    })
}

/// Computes the hash over everything that must not change when a run is resumed.
pub fn of_run(table: &Table) -> [u8; 32] {
    hash(&deciding(table), &[TOTAL_STEPS, STOP_AT])
}

/// Computes the hash over everything that decides the weights at the end of a training, except for its seed.
///
/// Where `evaluation.stop_at` is set, that is also how policies are evaluated on the way.
pub fn of_training(table: &Table) -> [u8; 32] {
    hash(&deciding_and(table, |key| decides_end(key, table)), &[SEED])
}

/// Computes the hash over everything that decides the best weights of a training, except for its seed: also over how policies
/// are evaluated on the way.
pub fn of_best(table: &Table) -> [u8; 32] {
    hash(&deciding_and(table, decides_best), &[SEED])
}

fn hash(leaves: &BTreeMap<String, String>, except: &[&str]) -> [u8; 32] {
    let mut hash = Sha256::new();
    for (key, value) in leaves.iter().filter(|(key, _)| !except.contains(&key.as_str())) {
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
    let [before, after] = [before, after].map(|table| flatten(&without_retired(table.clone())));
    let keys: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
    let change = |key: &String| {
        let [before, after] = [&before, &after].map(|of| of.get(key).cloned().unwrap_or_default());
        Change { key: key.clone(), before, after }
    };
    let matters = |change: &Change| {
        let Change { key, before, after } = change;
        before != after && !(changes_nothing(key, before) && changes_nothing(key, after))
    };
    keys.into_iter().map(change).filter(matters).collect()
}

/// Returns every leaf of a table by its full key.
pub(crate) fn flatten(table: &Table) -> BTreeMap<String, String> {
    let mut leaves = BTreeMap::new();
    for (key, value) in table {
        match value {
            Value::Table(inner) => {
                let inner = flatten(inner).into_iter();
                leaves.extend(inner.map(|(rest, value)| (format!("{key}.{rest}"), value)));
            }
            leaf => drop(leaves.insert(key.clone(), leaf.to_string())),
        }
    }
    leaves
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
        assert_eq!(changes(&before, &other), ["policy.length_bias: (none) -> -0.5"]);
        assert_eq!(changes(&other, &same), ["policy.length_bias: -0.5 -> 0.0"]);
        assert!(flatten(&same).contains_key("policy.length_bias"));
        let whole = table("[policy]\ninitiate_bias = -1.0\nlength_bias = 0");
        assert!(difference(&same, &whole).is_empty());
        for (key, idle) in LATER {
            let (section, name) = key.split_once('.').unwrap();
            let later = table(&format!("[{section}]\n{name} = {idle}"));
            assert!(difference(&table(""), &later).is_empty() && deciding(&later).is_empty());
        }
    }

    #[test]
    fn how_workers_are_kept_decides_nothing() {
        let run = |domain: &str, batch: u32| {
            table(&format!("domain = \"{domain}\"\n[world]\nbatch = {batch}\nworker = \"w\""))
        };
        assert_eq!(of_run(&run("python", 8)), of_run(&run("python", 16)));
        assert_ne!(of_run(&run("mine", 8)), of_run(&run("mine", 16)));
    }

    fn changes(before: &Table, after: &Table) -> Vec<String> {
        difference(before, after).iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_difference_names_keys_and_both_values() {
        let changes = changes(&table("a = 1\n[b]\nc = 2"), &table("a = 1\n[b]\nc = 3\nd = 4"));
        assert_eq!(changes, ["b.c: 2 -> 3", "b.d: (none) -> 4"]);
    }

    #[test]
    fn how_a_run_is_carried_out_does_not_decide_its_weights() {
        const RUN: &str = "seed = 1\n[run]\nname = \"a\"\n[evaluation]\nduring_training = 8\n[learner]\n\
                           total_steps = 5\nclip = 0.2";
        let run = table(RUN);
        for (from, to, expected) in [
            ("\"a\"", "\"b\"", [true, true]),
            ("training = 8", "training = 0", [true, true]),
            ("clip", "threads = 2\nclip", [true, true]),
            ("steps = 5", "steps = 6", [true, false]),
            ("training = 8", "training = 8\nstop_at = 0.9", [true, false]),
            ("seed = 1", "seed = 2", [false, true]),
            ("0.2", "0.1", [false, false]),
        ] {
            let changed = table(&RUN.replace(from, to));
            let same =
                [of_run(&changed) == of_run(&run), of_training(&changed) == of_training(&run)];
            assert_eq!(same, expected, "{to}");
        }
        // Runs are found by this hash: it must stay what it is.
        let text = "learner.clip=0.2\nlearner.total_steps=5\n";
        assert_eq!(of_training(&run).as_slice(), Sha256::digest(text).as_slice());
    }

    #[test]
    fn what_is_evaluated_on_the_way_decides_the_best_policy_and_the_end_where_a_score_does() {
        const RUN: &str = "[evaluation]\nepisodes = 9\nduring_training = 8\nheld_out_episodes = 20\n\
                           action = \"sample\"\n[evaluation.world]\nwind = true";
        let run = table(RUN);
        let marked = table(&RUN.replace("sample\"", "sample\"\nstop_at = 0.9"));
        for (from, to, decides) in [
            ("episodes = 9", "episodes = 10", false),
            ("training = 8", "training = 20", true),
            ("out_episodes = 20", "out_episodes = 40", true),
            ("sample", "greedy", true),
            ("wind = true", "wind = false", true),
        ] {
            let changed = |of: &Table| table(&of.to_string().replace(from, to));
            assert_ne!(changed(&run), run, "{to}");
            assert_eq!(of_training(&changed(&run)), of_training(&run), "{to}");
            assert_eq!(of_training(&changed(&marked)) != of_training(&marked), decides, "{to}");
            assert_eq!(of_best(&changed(&run)) != of_best(&run), decides, "{to}");
            assert_eq!(of_run(&changed(&marked)), of_run(&marked), "{to}");
        }
        let action = "evaluation.action";
        assert!(decides_end(action, &marked) && !decides_end(action, &run));
        assert!(!decides_end(EPISODES, &marked) && !decides_end("run.name", &marked));
    }
}
