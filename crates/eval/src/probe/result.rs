//! What a probe found, as data, as text and as a section of a page.

use leadtime_numerics::stats::{Bootstrap, Interval};
use leadtime_table::{Table, TableCell, WIDTH, wrapped};
use serde::{Deserialize, Serialize};

use crate::measure::{Difference, cell};
use crate::report::ProvenanceDetail;

/// A stage that fewer episodes of either half reached is not scored.
pub const MIN_EPISODES: usize = 20;

/// Stands for a number that is undefined.
const NONE: &str = "\u{2013}";

/// How well the listener's reaction delay can be predicted, by how much they have done so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProbeResult {
    /// Name of the policy whose features are read.
    pub player: String,
    /// Seed of the episodes.
    pub seed: u64,
    /// Episodes that readers learned from.
    pub n_learned_from: u64,
    /// Episodes that they were evaluated on.
    pub n_evaluated_on: u64,
    /// How intervals were made, by resampling episodes.
    pub bootstrap: Bootstrap,
    /// The ways to predict the delay, weakest first.
    pub readers: Vec<ReaderScore>,
    /// The stages, by reactions begun.
    pub stages: Vec<ProbeStage>,
    /// All stages that enough episodes reached; every episode counts once.
    pub overall: ProbeStage,
    /// What reading the features changes in the error, over all stages; the same episodes are compared.
    pub differences: Vec<Difference>,
}

/// A way to predict the delay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReaderScore {
    /// Name of the reader, as tables show it.
    pub name: String,
    /// Numbers that it looks at.
    pub n_features: usize,
    /// Penalty of its regression, if it is one.
    pub penalty: Option<f64>,
    /// Share of the delay's variance that it explains over all scored stages, `R²`: 0 for always predicting the mean of
    /// what was learned from, negative for less than that. `None` if the delay does not vary there.
    pub r_squared: Option<f64>,
}

/// The time during which the listener has begun to react to the same number of messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProbeStage {
    /// How many reactions have begun.
    pub name: String,
    /// Episodes with this stage that readers learned from.
    pub n_learned_from: usize,
    /// Episodes with this stage that they were evaluated on.
    pub n_evaluated_on: usize,
    /// Steps that the stage has in the latter.
    pub n_steps: u64,
    /// Mean reaction delay in the latter, in steps.
    pub mean_delay: Option<f64>,
    /// Mean number of messages understood in the latter.
    pub mean_comprehended: Option<f64>,
    /// One per reader; none if too few episodes have the stage.
    pub scores: Vec<Score>,
}

/// How well a reader predicts the delay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Mean absolute error, in steps.
    pub error: Interval,
    /// Share of episodes in which the rounded delay is right.
    pub exact: Interval,
}

impl ProbeResult {
    /// Writes the tables as plain text that fits a terminal.
    pub fn text(&self) -> String {
        let [errors, exact] = self.tables("reactions").map(|table| table.text_within(WIDTH));
        let lines = std::iter::once(self.reading()).chain(self.results());
        let lines: String = lines.map(|line| wrapped(&line, WIDTH, 2) + "\n").collect();
        format!(
            "Mean absolute error of d_r, in steps, by how many reactions have begun\n\n{errors}\nShare of exact predictions, \
             rounded\n\n{exact}\n{lines}"
        )
    }

    /// Writes a section of a page: tables, how to read them, and where they are from.
    pub fn markdown(&self, title: &str, provenance: &[ProvenanceDetail]) -> String {
        let [errors, exact] = self.tables("reactions begun").map(|table| table.markdown());
        let details = provenance
            .iter()
            .map(|ProvenanceDetail { name, value }| format!("* {name}: {value}\n"));
        let results = self.results().map(|line| format!("* {line}\n"));
        let (results, details): (String, String) = (results.collect(), details.collect());
        format!(
            "## {title}\n\n{}\n\nMean absolute error of d_r, in steps:\n\n{errors}\nShare of exact predictions, rounded:\n\
             \n{exact}\n{results}\n<details><summary>Where these numbers are from</summary>\n\n{details}\n</details>\n",
            self.reading()
        )
    }

    /// Lays out errors, and shares of exact predictions; `stages` heads the names of the stages.
    fn tables(&self, stages: &'static str) -> [Table; 2] {
        let counts = ["episodes", "steps", "mean d_r", "understood"];
        let readers = || self.readers.iter().map(|reader| reader.name.as_str());
        let first = || std::iter::once(stages);
        let mut errors = Table::new(first().chain(counts).chain(readers()));
        let mut exact = Table::new(first().chain(readers()));
        for stage in self.stages.iter().chain([&self.overall]) {
            let name = || std::iter::once(TableCell::from(stage.name.as_str()));
            let counts = [
                stage.n_evaluated_on.to_string(),
                stage.n_steps.to_string(),
                number(stage.mean_delay),
                number(stage.mean_comprehended),
            ];
            let counts = counts.map(TableCell::from);
            errors.push(name().chain(counts).chain(self.cells(stage, |score| score.error)));
            exact.push(name().chain(self.cells(stage, |score| score.exact)));
        }
        [errors, exact]
    }

    fn cells(&self, stage: &ProbeStage, which: fn(&Score) -> Interval) -> Vec<TableCell> {
        (0..self.readers.len()).map(|i| cell(stage.scores.get(i).map(which))).collect()
    }

    fn reading(&self) -> String {
        let percent = 100.0 * self.bootstrap.confidence;
        format!(
            "Learned from {} episodes, evaluated on {} others (counted in the table), at one step of every stage of an \
             episode; {percent:.0} % bootstrap intervals over episodes. {NONE}: fewer than {MIN_EPISODES} episodes.",
            self.n_learned_from, self.n_evaluated_on
        )
    }

    /// Writes `R²` and what reading the features changes.
    fn results(&self) -> impl Iterator<Item = String> {
        let regression = |reader: &ReaderScore| {
            let penalty = reader.penalty?;
            Some(format!(
                "R\u{b2} of {}: {} ({} numbers, penalty {penalty:e})",
                reader.name,
                number(reader.r_squared),
                reader.n_features
            ))
        };
        let changes = self.differences.iter().map(|d| d.sentence(self.bootstrap.confidence));
        self.readers.iter().filter_map(regression).chain(changes)
    }
}

fn number(value: Option<f64>) -> String {
    let text = value.map_or_else(|| NONE.to_owned(), |value| format!("{value:.2}"));
    text.replace('-', "\u{2212}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn knowledge() -> ProbeResult {
        let interval =
            |estimate| Interval { estimate, low: estimate - 0.125, high: estimate + 0.125 };
        let reader = |name: &str, penalty| {
            let (name, r_squared) = (name.to_owned(), Some(-0.25));
            ReaderScore { name, n_features: 64, penalty, r_squared }
        };
        let score = |error| Score { error: interval(error), exact: interval(error / 2.0) };
        let stage = |name: &str, n: usize| ProbeStage {
            name: name.to_owned(),
            n_learned_from: n,
            n_evaluated_on: n,
            n_steps: 10 * n as u64,
            mean_delay: (n > 0).then_some(2.5),
            mean_comprehended: (n > 0).then_some(1.0),
            scores: if n < MIN_EPISODES { Vec::new() } else { [1.5, 0.25].map(score).to_vec() },
        };
        ProbeResult {
            player: "policy".to_owned(),
            seed: 1,
            n_learned_from: 20,
            n_evaluated_on: 20,
            bootstrap: Bootstrap::new(1),
            readers: vec![reader("constant", None), reader("hidden features", Some(0.1))],
            stages: vec![stage("0", 20), stage("1", 0)],
            overall: stage("all", 20),
            differences: vec![Difference {
                measure: "mean_absolute_error".to_owned(),
                of: "hidden features".to_owned(),
                minus: "constant".to_owned(),
                interval: interval(-1.25),
            }],
        }
    }

    #[test]
    fn the_tables_line_up_before_and_after_json() {
        let json = serde_json::to_string(&knowledge()).unwrap();
        let again: ProbeResult = serde_json::from_str(&json).unwrap();
        assert_eq!(again.text(), knowledge().text());
        insta::assert_snapshot!("the_tables_line_up", again.text());
    }

    #[test]
    fn a_section_has_the_tables_and_says_where_they_are_from() {
        let command = ProvenanceDetail::new("command", "`leadtime probe r`");
        insta::assert_snapshot!(knowledge().markdown("What `r` knows", &[command]));
    }
}
