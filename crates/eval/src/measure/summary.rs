//! A player's episodes summed up: means with intervals.
//!
//! A rate can be undefined in an episode: without a notification there is no share of notifications followed. Such an
//! episode does not count for the rate, and `n` is the number of those that do.

use leadtime_numerics::proportion::with_width;
use leadtime_numerics::stats::{Bootstrap, Interval, interquartile_mean, mean, standard_deviation};
use serde::{Deserialize, Serialize};

use super::evaluation::Evaluation;
use super::{lead, outcome, said};

/// Rates that are made from two counts: name, numerator, denominator.
const RATES: [(&str, &str, &str); 5] = [
    ("followed_of_initiated", "followed", "notifications"),
    ("followed_of_comprehended", "followed", "comprehended"),
    ("long_rate", "long_notifications", "notifications"),
    ("preempted_rate", "preempted", "notifications"),
    ("overwritten_rate", "overwritten", "comprehended"),
];

/// Means that need at least one notification to be defined.
const MEANS: [&str; 3] = ["mean_k", "mean_l", "first_notification"];

/// Measures that are 0 or 1 in an episode; these and [`RATES`] have exact intervals where the bootstrap has none.
const SHARES: [&str; 13] = [
    "success",
    outcome::AVERTED,
    outcome::HARMED,
    "enter_danger",
    "landed",
    "landed_on_pad",
    "crashed",
    "out",
    "timed_out",
    "arrived",
    "in_time",
    "comfortable",
    "dish_delivered",
];

/// What comes first in a table; everything else follows in the task's order.
const ORDER: [&str; 13] = [
    "success",
    outcome::AVERTED,
    outcome::HARMED,
    "notifications_per_step",
    "notifications",
    "followed_of_initiated",
    "followed_of_comprehended",
    "preempted_rate",
    "overwritten_rate",
    "long_rate",
    "enter_danger",
    "return",
    "length",
];

/// What is looked at first: the first [`N_MAIN`] of these that a task has, with shorter words than [`title`]'s.
const MAIN: [(&str, &str); 12] = [
    ("success", "success"),
    (outcome::AVERTED, "hazards averted"),
    (outcome::HARMED, "harm done"),
    ("enter_danger", "enters danger"),
    ("crashed", "crashes"),
    ("steps_to_deliver", "steps to deliver"),
    ("notifications", "notifications"),
    ("followed_of_initiated", "follow-through"),
    ("return", "return"),
    ("length", "length (steps)"),
    ("in_time", "in time"),
    ("comfortable", "comfortable"),
];
const N_MAIN: usize = 8;

/// Counts whose rates say more, and what is only an ingredient.
const HIDDEN: [&str; 5] =
    ["followed", "long_notifications", "preempted", "overwritten", "danger_from"];

/// One number about a player, with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measure {
    /// Name of the metric or rate, such as `success`.
    pub name: String,
    /// Episodes in which it was defined.
    pub n: usize,
    /// Mean with bootstrap interval, exact for a share that is 0 or 1 in all episodes; `None` if it was defined nowhere.
    pub interval: Option<Interval>,
    /// Standard deviation over episodes; `None` for fewer than two.
    pub standard_deviation: Option<f64>,
    /// The mean of each evaluation (training seed) in which it was defined.
    #[serde(default)]
    pub by_seed: Vec<f64>,
}

impl Measure {
    /// Returns the standard deviation of the training seeds' means; `None` for fewer than two.
    pub fn deviation_over_seeds(&self) -> Option<f64> {
        (self.by_seed.len() >= 2).then(|| standard_deviation(&self.by_seed))
    }

    /// Returns the interquartile mean of the training seeds' means; `None` for fewer than four, of which nothing is cut.
    pub fn interquartile_mean_over_seeds(&self) -> Option<f64> {
        (self.by_seed.len() >= 4).then(|| interquartile_mean(&self.by_seed))
    }
}

/// All measures of one player.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name that tables give the player.
    pub player: String,
    /// Number of episodes, over all training seeds.
    pub n_episodes: usize,
    /// Number of evaluations (training seeds) that were put together.
    pub n_seeds: usize,
    /// The measures, most telling first.
    pub measures: Vec<Measure>,
}

impl Summary {
    /// Sums up one evaluation.
    pub fn new(evaluation: &Evaluation, bootstrap: &Bootstrap) -> Self {
        Self::over_seeds(&evaluation.player, std::slice::from_ref(evaluation), bootstrap)
    }

    /// Sums up evaluations of policies from several training seeds; intervals resample seeds, then episodes.
    pub fn over_seeds(player: &str, evaluations: &[Evaluation], bootstrap: &Bootstrap) -> Self {
        let names = evaluations.first().map(|e| measure_names(&e.metrics)).unwrap_or_default();
        let measures = names.into_iter().enumerate().map(|(i, name)| {
            let values: Vec<Vec<f64>> = evaluations.iter().map(|e| values(e, &name)).collect();
            measure(name, &values, bootstrap, i as u64)
        });
        Self {
            player: player.to_owned(),
            n_episodes: evaluations.iter().map(|e| e.episodes.len()).sum(),
            n_seeds: evaluations.len(),
            measures: measures.collect(),
        }
    }

    /// Returns a measure by name.
    pub fn get(&self, name: &str) -> Option<&Measure> {
        self.measures.iter().find(|measure| measure.name == name)
    }
}

fn measure(name: String, values: &[Vec<f64>], bootstrap: &Bootstrap, index: u64) -> Measure {
    let groups: Vec<&[f64]> = values.iter().map(Vec::as_slice).collect();
    let interval = resampled(&groups, bootstrap, index);
    let all = values.concat();
    let exact = |interval| with_width(interval, all.len(), bootstrap.confidence);
    let interval = if is_share(&name) { interval.map(exact) } else { interval };
    let standard_deviation = (all.len() >= 2).then(|| standard_deviation(&all));
    let by_seed = groups.iter().filter(|group| !group.is_empty()).map(|group| mean(group));
    Measure { name, n: all.len(), interval, standard_deviation, by_seed: by_seed.collect() }
}

/// Computes the bootstrap interval of a mean: over episodes, or over training seeds and then episodes where there are
/// several.
pub(super) fn resampled(groups: &[&[f64]], bootstrap: &Bootstrap, index: u64) -> Option<Interval> {
    match groups {
        [only] => bootstrap.mean(only, index),
        several => bootstrap.hierarchical_mean(several, index),
    }
}

/// Returns whether a measure lies between 0 and 1 in every episode.
pub(super) fn is_share(name: &str) -> bool {
    SHARES.contains(&name) || RATES.iter().any(|rate| rate.0 == name)
}

/// Lists the names of all measures that some summaries have, each once.
pub fn names_in<'a>(summaries: impl IntoIterator<Item = &'a Summary>) -> Vec<&'a str> {
    let mut names: Vec<&str> = Vec::new();
    for measure in summaries.into_iter().flat_map(|summary| &summary.measures) {
        if !names.contains(&measure.name.as_str()) {
            names.push(&measure.name);
        }
    }
    names
}

/// Splits measures into those that are looked at first, in that order, and the rest.
pub fn main_measures<'a>(names: &[&'a str]) -> [Vec<&'a str>; 2] {
    let find = |(main, _): &(&str, &str)| names.iter().copied().find(|name| name == main);
    let main: Vec<&str> = MAIN.iter().filter_map(find).take(N_MAIN).collect();
    let rest = names.iter().copied().filter(|name| !main.contains(name)).collect();
    [main, rest]
}

/// Returns the words for a main measure where there is little room.
pub(super) fn short_title(name: &str) -> String {
    let short = MAIN.iter().find(|(main, _)| *main == name);
    short.map_or_else(|| title(name), |(_, short)| (*short).to_owned())
}

/// Lists the measures of a task with these metrics, those in comparison with the unaided listener included.
pub fn known_measures(metrics: &[String]) -> Vec<String> {
    let mut metrics = with_outcome_names(metrics);
    if lead::is_known(&metrics) {
        metrics.extend([lead::LEAD_TIME].into_iter().chain(said::COLUMNS).map(str::to_owned));
    }
    measure_names(&metrics)
}

/// Lists the measures of an evaluation in a task with these metrics: its own, and success split by the unaided listener's.
pub fn evaluated_measures(metrics: &[String]) -> Vec<String> {
    measure_names(&with_outcome_names(metrics))
}

fn with_outcome_names(metrics: &[String]) -> Vec<String> {
    let names = [outcome::AVERTED, outcome::HARMED].into_iter();
    let names = names.filter(|_| outcome::is_known(metrics)).map(str::to_owned);
    metrics.iter().cloned().chain(names).collect()
}

/// Lists the measures of a task with these metrics, most telling first.
pub fn measure_names(metrics: &[String]) -> Vec<String> {
    let has = |name: &str| metrics.iter().any(|metric| metric == name);
    let shown = metrics.iter().map(String::as_str).filter(|name| !HIDDEN.contains(name));
    let rates = RATES.iter().filter(|(_, top, bottom)| has(top) && has(bottom)).map(|rate| rate.0);
    let mut names: Vec<&str> = ["return", "length"].into_iter().chain(shown).chain(rates).collect();
    // Stable: what has no place in the order stays as it is.
    names.sort_by_key(|name| ORDER.iter().position(|known| known == name).unwrap_or(ORDER.len()));
    names.dedup();
    names.into_iter().map(str::to_owned).collect()
}

/// Returns a measure's value in every episode in which it is defined.
pub(super) fn values(evaluation: &Evaluation, name: &str) -> Vec<f64> {
    if let Some((_, top, bottom)) = RATES.iter().find(|rate| rate.0 == name)
        && let (Some(top), Some(bottom)) = (evaluation.column(top), evaluation.column(bottom))
    {
        let pairs = top.into_iter().zip(bottom).filter(|pair| pair.1 > 0.0);
        return pairs.map(|(top, bottom)| top / bottom).collect();
    }
    let mut column = match name {
        "return" => evaluation.episodes.iter().map(|e| e.total_reward).collect(),
        "length" => evaluation.episodes.iter().map(|e| e.n_steps as f64).collect(),
        _ => evaluation.column(name).unwrap_or_default(),
    };
    if MEANS.contains(&name)
        && let Some(counts) = evaluation.column("notifications")
    {
        let pairs = column.into_iter().zip(counts).filter(|pair| pair.1 > 0.0);
        column = pairs.map(|pair| pair.0).collect();
    }
    column.retain(|value| value.is_finite());
    column
}

/// The words that a table uses for a measure, where they are not its name's.
const TITLES: [(&str, &str); 23] = [
    ("success", "success rate"),
    (outcome::AVERTED, "hazards averted"),
    (outcome::HARMED, "harm done"),
    ("notifications_per_step", "notifications per step"),
    ("notifications", "notifications per episode"),
    ("followed_of_initiated", "follow-through, of initiated"),
    ("followed_of_comprehended", "follow-through, of comprehended"),
    ("preempted_rate", "preempted, of initiated"),
    ("overwritten_rate", "overwritten, of comprehended"),
    ("long_rate", "long notifications, of initiated"),
    ("enter_danger", "enters danger"),
    ("length", "length (steps)"),
    ("mean_k", "mean comprehension time k"),
    ("mean_l", "mean conveyance time l"),
    ("first_notification", "first notification (step)"),
    ("lead_time", "lead time before the unaided hazard (steps)"),
    ("first_l", "conveyance time l of the first message"),
    ("later_l", "mean l of later messages"),
    ("per_step_before_hazard", "notifications per step before the unaided hazard"),
    ("per_step_after_hazard", "notifications per step after it"),
    ("drive_time", "duration of the drive (s)"),
    ("hardest_braking", "hardest braking (m/s²)"),
    ("jerk", "jerk, root mean square (m/s³)"),
];

/// Returns the words that a table uses for a measure.
pub fn title(name: &str) -> String {
    let known = TITLES.iter().find(|(known, _)| *known == name);
    known.map_or_else(|| name.replace('_', " "), |&(_, title)| title.to_owned())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use leadtime_proto::TaskSpec;
    use leadtime_proto::spec::COMPUTED;

    use super::*;
    use crate::measure::lead::HAZARDS;

    fn evaluation(rows: &[[f32; 5]]) -> Evaluation {
        let names = ["success", "notifications", "comprehended", "followed", "mean_k"];
        Evaluation::of(names, &rows.iter().map(|&row| (50, row)).collect::<Vec<_>>())
    }

    const ROWS: [[f32; 5]; 4] = [
        [1.0, 4.0, 2.0, 1.0, 3.0],
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 2.0, 2.0, 2.0, 2.0],
        [1.0, 1.0, 0.0, 0.0, 5.0],
    ];

    fn summary() -> Summary {
        Summary::new(&evaluation(&ROWS), &Bootstrap::new(3))
    }

    fn mean_of(name: &str) -> (usize, f64) {
        let summary = summary();
        let measure = summary.get(name).unwrap();
        (measure.n, measure.interval.unwrap().estimate)
    }

    #[test]
    fn rates_leave_out_episodes_where_they_are_undefined() {
        assert_eq!(mean_of("success"), (4, 0.75));
        assert_eq!(mean_of("followed_of_initiated"), (3, (0.25 + 1.0 + 0.0) / 3.0));
        assert_eq!(mean_of("followed_of_comprehended"), (2, 0.75));
        assert_eq!(mean_of("mean_k"), (3, 10.0 / 3.0));
        assert_eq!(mean_of("return"), (4, 75.0));
    }

    #[test]
    fn every_name_used_here_is_that_of_a_measure() {
        let registry = leadtime_worlds::builtin();
        let metrics = registry.names().flat_map(|domain| {
            let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
            registry.build(&task).unwrap().spec().metrics.clone()
        });
        let metrics: BTreeSet<String> = metrics.collect();
        let derived = ["return", "length", lead::LEAD_TIME, outcome::AVERTED, outcome::HARMED];
        let derived = derived.into_iter();
        let derived = derived.chain(RATES.map(|rate| rate.0)).chain(said::COLUMNS);
        let known: BTreeSet<&str> = metrics.iter().map(String::as_str).chain(derived).collect();
        let counts = RATES.iter().flat_map(|(_, top, bottom)| [*top, *bottom]);
        let main = MAIN.map(|(name, _)| name);
        let used = counts.chain(MEANS).chain(main).chain(ORDER).chain(HIDDEN).chain(HAZARDS);
        let used = used.chain(SHARES);
        for name in used.chain(TITLES.map(|(name, _)| name)) {
            assert!(known.contains(name), "`{name}` is no measure");
        }
    }

    #[test]
    fn no_metric_of_a_task_may_have_the_name_of_what_is_computed_here() {
        let mut metrics: Vec<String> = RATES
            .iter()
            .flat_map(|rate| [rate.1, rate.2])
            .chain(HAZARDS)
            .chain(["success", "followed_of_initiated", "followed_of_comprehended"])
            .map(str::to_owned)
            .collect();
        metrics.sort();
        metrics.dedup();
        let mut computed = known_measures(&metrics);
        computed.retain(|name| !metrics.contains(name));
        let refused = COMPUTED.iter().map(|&name| name.to_owned());
        assert_eq!(BTreeSet::from_iter(computed), refused.collect::<BTreeSet<String>>());
    }

    #[test]
    fn the_most_telling_measures_come_first_and_each_comes_once() {
        let expected = "success notifications followed_of_initiated followed_of_comprehended return length \
                        comprehended mean_k";
        assert_eq!(names_in([&summary()]).join(" "), expected);
    }

    #[test]
    fn the_first_measures_come_first_and_the_rest_keeps_its_order() {
        let names = ["return", "out", "length", "crashed", "success", "enter_danger", "landed"];
        let [main, rest] = main_measures(&names);
        assert_eq!(main, ["success", "enter_danger", "crashed", "return", "length"]);
        assert_eq!(rest, ["out", "landed"]);
        let all = MAIN.map(|(name, _)| name);
        let [main, rest] = main_measures(&all);
        assert_eq!((main, rest), (all[..N_MAIN].to_vec(), all[N_MAIN..].to_vec()));
    }

    #[test]
    fn a_rate_defined_nowhere_has_no_interval() {
        let silent = evaluation(&[[1.0, 0.0, 0.0, 0.0, 0.0]; 3]);
        let summary = Summary::new(&silent, &Bootstrap::new(3));
        let measure = summary.get("followed_of_initiated").unwrap();
        assert_eq!((measure.n, measure.interval, measure.standard_deviation), (0, None, None));
    }

    #[test]
    fn a_share_of_0_or_1_has_an_interval_with_width_and_a_count_does_not() {
        let silent = evaluation(&[[1.0, 0.0, 0.0, 0.0, 0.0]; 3]);
        let summary = Summary::new(&silent, &Bootstrap::new(3));
        let interval = |name: &str| summary.get(name).unwrap().interval.unwrap();
        let Interval { estimate, low, high } = interval("success");
        assert_eq!((estimate, high), (1.0, 1.0));
        assert!((low - 0.292).abs() < 1e-3, "three of three: {low}");
        assert_eq!(interval("notifications"), Interval { estimate: 0.0, low: 0.0, high: 0.0 });
        let loud = evaluation(&[[0.0, 2.0, 2.0, 2.0, 2.0]; 3]);
        let both = Summary::over_seeds("p", &[loud.clone(), loud], &Bootstrap::new(3));
        let followed = both.get("followed_of_initiated").unwrap().interval.unwrap();
        assert!(followed.low > 0.5 && followed.low < 0.6, "six of six: {followed:?}");
    }

    #[test]
    fn several_training_seeds_weigh_the_same() {
        let both = [evaluation(&ROWS), evaluation(&[[0.0; 5]])];
        let summary = Summary::over_seeds("p", &both, &Bootstrap::new(3));
        assert_eq!((summary.n_seeds, summary.n_episodes), (2, 5));
        let success = summary.get("success").unwrap();
        assert_eq!(success.by_seed, [0.75, 0.0]);
        assert!((success.deviation_over_seeds().unwrap() - 0.75 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(success.interval.unwrap().estimate, 0.375);
        assert_eq!(success.interquartile_mean_over_seeds(), None, "nothing is cut off two");
        let five = [0.75, 0.0, 1.0, 0.5, 1.0].map(|mean| vec![mean]).to_vec();
        let five = measure("success".to_owned(), &five, &Bootstrap::new(3), 0);
        assert_eq!(five.interquartile_mean_over_seeds(), Some(0.75));
    }
}
