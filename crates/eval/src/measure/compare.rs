//! Several players on the same task, side by side.

use leadtime_numerics::proportion::with_width;
use leadtime_numerics::stats::{Bootstrap, Interval, mean};
use leadtime_table::{Table, TableCell, WIDTH};
use serde::{Deserialize, Serialize};

use super::evaluation::Evaluation;
use super::summary::{self, Summary};

/// Index of the draws for differences: one that no mean uses.
const DIFFERENCE: u64 = u32::MAX as u64;

/// How one measure of two players differs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Name of the metric or rate, such as `success`.
    pub measure: String,
    /// Whose mean is taken.
    pub of: String,
    /// Whose mean is subtracted.
    pub minus: String,
    /// The difference of means. The two samples are resampled independently, which is the careful choice where
    /// both met the same worlds.
    pub interval: Interval,
}

impl Difference {
    /// Computes `of - minus` over the evaluations of several training seeds each; intervals resample seeds, then
    /// episodes. `None` if the measure is undefined for one of them.
    pub fn over_seeds(
        of: (&str, &[Evaluation]),
        minus: (&str, &[Evaluation]),
        measure: &str,
        bootstrap: &Bootstrap,
    ) -> Option<Self> {
        let values =
            [of.1, minus.1].map(|all| all.iter().map(|e| summary::values(e, measure)).collect());
        let all: [Vec<Vec<f64>>; 2] = values;
        let [a, b] = all.each_ref().map(|of| of.iter().map(Vec::as_slice).collect::<Vec<&[f64]>>());
        let interval = bootstrap.hierarchical_difference(&a, &b, DIFFERENCE)?;
        let interval = widened(interval, [a.as_slice(), b.as_slice()], measure, bootstrap);
        let (of, minus) = (of.0.to_owned(), minus.0.to_owned());
        Some(Self { measure: measure.to_owned(), of, minus, interval })
    }

    /// Writes the difference as a sentence.
    pub fn sentence(&self, confidence: f64) -> String {
        let Interval { estimate, low, high } = self.interval;
        format!(
            "{}, {} minus {}: {estimate:+.3}, {:.0} % interval [{low:+.3}, {high:+.3}]",
            summary::title(&self.measure),
            self.of,
            self.minus,
            100.0 * confidence,
        )
    }
}

/// Makes the interval of a difference of shares from the intervals of the two where one of them was 0, or 1, in all
/// episodes: the bootstrap takes such a share for certain. Returns every other difference as it is.
///
/// # Shapes
///
/// `sides`: episodes by training seed, of the one and of the one that is subtracted.
fn widened(
    interval: Interval,
    sides: [&[&[f64]]; 2],
    measure: &str,
    bootstrap: &Bootstrap,
) -> Interval {
    let exact = sides.map(|groups| of_all_or_none(&groups.concat(), bootstrap.confidence));
    if !summary::is_share(measure) || exact.iter().all(Option::is_none) {
        return interval;
    }
    let alone = |i: usize| exact[i].or_else(|| summary::resampled(sides[i], bootstrap, DIFFERENCE));
    let both = alone(0).zip(alone(1));
    both.map_or(interval, |(of, minus)| of.minus(&minus))
}

/// Returns the exact interval of a share that was 0, or 1, in all episodes; `None` for any other.
fn of_all_or_none(values: &[f64], confidence: f64) -> Option<Interval> {
    let estimate = mean(values);
    let flat = Interval { estimate, low: estimate, high: estimate };
    let exact = with_width(flat, values.len(), confidence);
    (exact.low < exact.high).then_some(exact)
}

/// Summaries of several players, and the differences that were asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// How intervals were made.
    pub bootstrap: Bootstrap,
    /// One summary per player.
    pub summaries: Vec<Summary>,
    /// Differences of measures between two players.
    pub differences: Vec<Difference>,
}

impl Comparison {
    /// Sums up evaluations of several players.
    pub fn new(evaluations: &[Evaluation], bootstrap: Bootstrap) -> Self {
        let summaries = evaluations.iter().map(|e| Summary::new(e, &bootstrap)).collect();
        Self { bootstrap, summaries, differences: Vec::new() }
    }

    /// Adds the difference `of - minus` in one measure, if it is defined for both.
    pub fn with_difference(mut self, of: &Evaluation, minus: &Evaluation, measure: &str) -> Self {
        let values = [of, minus].map(|evaluation| summary::values(evaluation, measure));
        let interval = self.bootstrap.difference(&values[0], &values[1], DIFFERENCE);
        let difference = interval.map(|interval| {
            let [a, b] = values.each_ref().map(|values| [values.as_slice()]);
            let interval =
                widened(interval, [a.as_slice(), b.as_slice()], measure, &self.bootstrap);
            let (of, minus) = (of.player.clone(), minus.player.clone());
            Difference { measure: measure.to_owned(), of, minus, interval }
        });
        self.differences.extend(difference);
        self
    }

    /// Lays the summaries out: one row per measure, one column per player.
    pub fn table(&self) -> Table {
        self.table_of(&summary::names_in(&self.summaries))
    }

    /// Lays some measures out, in the given order.
    pub fn table_of(&self, measures: &[&str]) -> Table {
        self.lay_out(measures.iter().map(|name| (*name, summary::title(name))))
    }

    fn lay_out<'a>(&self, measures: impl Iterator<Item = (&'a str, String)>) -> Table {
        let players = self.summaries.iter().map(|summary| summary.player.as_str());
        let mut table = Table::new(std::iter::once("").chain(players));
        for (name, title) in measures {
            let interval = |summary: &Summary| summary.get(name).and_then(|m| m.interval);
            let cells = self.summaries.iter().map(|summary| cell(interval(summary)));
            table.push(std::iter::once(TableCell::from(title)).chain(cells));
        }
        table
    }

    /// Returns whether a measure is 0 in every episode in which anybody has it.
    pub(crate) fn is_zero(&self, measure: &str) -> bool {
        let has = |summary: &'_ Summary| {
            let measure = summary.get(measure)?;
            // A share of none has an interval with width all the same.
            let varies = measure.standard_deviation.is_some_and(|deviation| deviation > 0.0);
            Some(measure.interval?.estimate == 0.0 && !varies)
        };
        let mut all = self.summaries.iter().filter_map(has).peekable();
        all.peek().is_some() && all.all(|zero| zero)
    }

    /// Writes table and differences as plain text: all measures, or only the main ones.
    pub fn text(&self, all: bool) -> String {
        let [main, _] = summary::main_measures(&summary::names_in(&self.summaries));
        let short = main.into_iter().map(|name| (name, summary::short_title(name)));
        let table = if all { self.table() } else { self.lay_out(short) };
        let sentences = self.differences.iter().map(|d| d.sentence(self.bootstrap.confidence));
        let lines: Vec<String> = std::iter::once(self.reading()).chain(sentences).collect();
        format!("{}{}\n", table.text_within(WIDTH), lines.join("\n"))
    }

    /// Counts the measures that only the whole table has.
    pub fn n_further(&self) -> usize {
        let [_, rest] = summary::main_measures(&summary::names_in(&self.summaries));
        rest.len()
    }

    /// Says how the table's cells are to be read.
    pub(crate) fn reading(&self) -> String {
        let percent = 100.0 * self.bootstrap.confidence;
        let episodes = self.summaries.iter().map(|summary| summary.n_episodes.to_string());
        let episodes = episodes.collect::<Vec<_>>().join(", ");
        format!("Means with {percent:.0} % bootstrap intervals; episodes: {episodes}.")
    }
}

/// Writes a mean with its bounds as a note; a dash where there is none.
pub(crate) fn cell(interval: Option<Interval>) -> TableCell {
    let Some(interval) = interval else { return TableCell::from("\u{2013}") };
    let [mean, bounds] = written(&interval);
    TableCell::noted(mean, bounds)
}

/// Writes a mean, and its bounds in brackets, with digits that suit their size.
pub fn written(interval: &Interval) -> [String; 2] {
    let Interval { estimate, low, high } = interval;
    let digits = match [*estimate, *low, *high].map(f64::abs).into_iter().fold(0.0, f64::max) {
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size > 1.0 => 2,
        _ => 3,
    };
    let texts = [format!("{estimate:.digits$}"), format!("[{low:.digits$}, {high:.digits$}]")];
    texts.map(|text| text.replace('-', "\u{2212}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn player(name: &str, successes: &[f32]) -> Evaluation {
        let rows: Vec<_> = successes.iter().map(|&success| (80, [success])).collect();
        let mut evaluation = Evaluation::of(["success"], &rows);
        for episode in &mut evaluation.episodes {
            episode.total_reward = f64::from(episode.metrics[0]) * 400.0 - 150.0;
        }
        Evaluation { player: name.to_owned(), ..evaluation }
    }

    fn comparison() -> Comparison {
        let trained = player("trained", &[1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
        let unaided = player("unaided", &[0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        Comparison::new(&[trained.clone(), unaided.clone()], Bootstrap::new(1))
            .with_difference(&trained, &unaided, "success")
            .with_difference(&trained, &unaided, "no such measure")
    }

    #[test]
    fn a_difference_has_its_own_interval() {
        let [difference] = &comparison().differences[..] else { panic!("one is defined") };
        assert_eq!(difference.interval.estimate, 0.75);
        assert!(difference.interval.low > 0.3 && difference.interval.high <= 1.0);
    }

    #[test]
    fn a_difference_of_all_and_none_has_width_where_it_is_one_of_shares() {
        let of = |success: f32| vec![player("p", &[success; 3]), player("p", &[success; 3])];
        let (all, none) = (of(1.0), of(0.0));
        let plan = Bootstrap::new(1);
        let single = Comparison::new(&all, plan).with_difference(&all[0], &none[0], "success");
        let several = Difference::over_seeds(("a", &all), ("b", &none), "success", &plan).unwrap();
        for (interval, low) in [(single.differences[0].interval, -0.001), (several.interval, 0.351)]
        {
            assert_eq!((interval.estimate, interval.high), (1.0, 1.0));
            assert!((interval.low - low).abs() < 1e-3, "{interval:?}");
        }
        let lengths = Difference::over_seeds(("a", &all), ("b", &none), "length", &plan).unwrap();
        assert_eq!(lengths.interval, Interval { estimate: 0.0, low: 0.0, high: 0.0 });
    }

    #[test]
    fn a_share_of_all_is_not_taken_for_certain_beside_one_that_varies() {
        let plan = Bootstrap::new(1);
        let (all, half) = (player("all", &[1.0; 4]), player("half", &[1.0, 0.0, 1.0, 0.0]));
        let single = Comparison::new(&[all.clone(), half.clone()], plan)
            .with_difference(&all, &half, "success");
        let (all, half) = (vec![all.clone(), all], vec![half.clone(), half]);
        let several = Difference::over_seeds(("a", &all), ("b", &half), "success", &plan).unwrap();
        // Four of four may be 40 %, and two of four nearly all; eight of eight 63 %, and four of eight 88 %.
        for (interval, low) in
            [(single.differences[0].interval, -0.283), (several.interval, -0.026)]
        {
            assert_eq!(interval.estimate, 0.5);
            assert!((interval.low - low).abs() < 2e-3 && interval.high > 0.85, "{interval:?}");
        }
    }

    #[test]
    fn the_table_lines_up_before_and_after_json() {
        let json = serde_json::to_string(&comparison()).unwrap();
        let again: Comparison = serde_json::from_str(&json).unwrap();
        assert_eq!(again.text(true), comparison().text(true));
        insta::assert_snapshot!("the_table_lines_up", again.text(true));
    }

    #[test]
    fn four_players_fit_a_terminal_and_each_domain_shows_its_own_main_measures() {
        let names = ["success", "notifications", "followed", "enter_danger", "crashed", "fuel"];
        let rows =
            [(800, [1.0, 12.0, 11.0, 0.0, 0.0, 3.0]), (1_200, [0.0, 9.0, 8.0, 1.0, 0.0, 9.0])];
        let player =
            |name: &str| Evaluation { player: name.to_owned(), ..Evaluation::of(names, &rows) };
        let players = ["trained", "unaided", "inform_at_start", "heuristic", "untrained"];
        let evaluations = players.map(player);
        let comparison = Comparison::new(&evaluations, Bootstrap::new(1));
        for (all, n) in [(false, 4), (true, 4), (false, 5), (true, 5)] {
            let few = Comparison::new(&evaluations[..n], Bootstrap::new(1)).text(all);
            assert!(few.lines().all(|line| line.chars().count() <= WIDTH), "{few}");
            assert!(few.contains("enters danger"), "{few}");
            assert_eq!(few.contains("fuel"), all, "{few}");
        }
        assert_eq!(comparison.n_further(), 1, "fuel");
    }
}
