//! A study's results as a page of Markdown: tables, differences, pictures, provenance.

use leadtime_eval::measure::{Choice, Measure, names_in, title, written};
use leadtime_eval::report::ProvenanceDetail;
use leadtime_numerics::stats::Interval;
use leadtime_table::Table;

use crate::provenance::{COMMAND, PROGRAM};
use crate::result::{ConditionResult, FigureLink, PartResult, RowResult, StudyResult, TrainedRun};
use crate::study::{Layout, Published};
use crate::trainings::RowTrainings;

/// What a table shows where there is no number.
const NONE: &str = "\u{2013}";

impl StudyResult {
    /// Writes the whole page.
    pub(crate) fn markdown(&self) -> String {
        let percent = 100.0 * self.bootstrap.confidence;
        let n_differences: usize = self.parts.iter().map(|part| part.differences.len()).sum();
        let reading = format!(
            "Cells: mean ± standard deviation over training seeds [{percent:.0} % bootstrap interval over training \
             seeds and episodes]; in the first column of numbers also the interquartile mean (IQM) over training \
             seeds. With one training seed, and for a script, there is no deviation, and the interval is over episodes \
             alone. A share of nothing but successes, or of none, has an exact interval. Where one training in some fails, \
             the intervals are too narrow: docs/studies.md says by how much. Differences are not corrected for their \
             number (this page states {n_differences}): take them as exploratory.\n\n"
        );
        let mut page = self.heading() + &reading;
        for part in &self.parts {
            page.push_str(&part.summary("", self.bootstrap.confidence));
            page.extend(part.rows.iter().map(details));
        }
        page.push_str("## Where these numbers are from\n\n");
        let details = self.provenance.iter();
        page.extend(details.map(|ProvenanceDetail { name, value }| format!("* {name}: {value}\n")));
        page.push('\n');
        page.extend(self.parts.iter().map(PartResult::runs));
        page
    }

    /// Writes the study as a section of an index: its main tables and pictures. `folder` is where its files lie, as
    /// seen from the index: empty, or with a slash at the end.
    pub(crate) fn section(&self, folder: &str) -> String {
        let name = &self.study;
        let mut text = self.heading();
        text.extend(self.parts.iter().map(|p| p.summary(folder, self.bootstrap.confidence)));
        let fact = |name: &str| self.provenance.iter().find(|fact| fact.name == name);
        let made = fact(COMMAND)
            .zip(fact(PROGRAM))
            .map(|(command, program)| format!("Made with {}, {}. ", command.value, program.value));
        text + &format!(
            "{}All measures, greedy choices, runs and provenance: [{name}.md]({folder}{name}.md), as data: \
             [{name}.json]({folder}{name}.json).\n\n",
            made.unwrap_or_default()
        )
    }

    /// Writes title, lead and warnings.
    fn heading(&self) -> String {
        let mut text = format!("# {}\n\n{}\n\n", self.title, self.lead.trim());
        text.extend(self.warnings.iter().map(|text| format!("> **{}**\n\n", plain(text))));
        text
    }
}

impl PartResult {
    /// Writes heading, main table, differences and pictures.
    fn summary(&self, folder: &str, confidence: f64) -> String {
        let mut text = format!("## {}\n\nProfile: {}.\n\n", self.title, self.profile);
        match self.layout {
            Layout::Lines => text.push_str(&self.lines()),
            Layout::Grid => text.extend((0..self.columns.len()).map(|i| self.grid(i))),
        }
        text.extend(self.differences.iter().map(|d| format!("* {}\n", d.sentence(confidence))));
        if !self.differences.is_empty() {
            text.push('\n');
        }
        text.push_str(&self.trainings(confidence));
        text.extend(self.pictures.iter().map(|FigureLink { file, caption }| {
            format!("![{}]({folder}{file})\n\n*{caption}*\n\n", plain(caption))
        }));
        text
    }

    /// Writes how the trainings of every row came out; nothing where no row has several.
    fn trainings(&self, confidence: f64) -> String {
        let rows = || self.rows.iter().filter_map(|row| Some((row, row.trainings.as_ref()?)));
        let Some((_, RowTrainings { failed_below, .. })) = rows().next() else {
            return String::new();
        };
        let percent = 100.0 * confidence;
        let intro = format!(
            "Trainings, each evaluated with the listener it trained with. One has *failed* if its success is more than \
             {failed_below} below the best of its row; the share that failed has its exact {percent:.0} % interval. The \
             interval of the mean is cautious: no distribution of trainings is known for which it fails, though nobody has \
             proved that there is none.\n\n"
        );
        let head =
            ["notifier", "trainings", "failed", "share failed", "best", "mean success", "IQM"];
        let mut table = Table::new(head);
        for (row, trainings) in rows() {
            let [failed, mean] = [&trainings.failed, &trainings.mean].map(with_bounds);
            table.push([
                format!("**{}**, {}", row.title, row.notification),
                trainings.success.len().to_string(),
                trainings.n_failed.to_string(),
                failed,
                format!("{:.3}", trainings.best()),
                mean,
                format!("{:.3}", trainings.interquartile_mean),
            ]);
        }
        intro + &table.markdown() + "\n"
    }

    /// Writes a line per policy and condition, what was published above what was measured.
    fn lines(&self) -> String {
        let head = ["notifier", "evaluated on"].map(str::to_owned).into_iter();
        let mut table = Table::new(head.chain(self.columns.iter().map(|name| title(name))));
        for row in &self.rows {
            let mut name = format!("**{}**, {}", row.title, row.notification);
            if !row.published.is_empty() {
                let cells = self.columns.iter().map(|c| published(row.published(None, c)));
                table.push([name, "*the paper*".to_owned()].into_iter().chain(cells));
                name = String::new();
            }
            for result in row.results.iter().filter(|result| result.choice == Choice::Sample) {
                let columns = self.columns.iter().enumerate();
                let cells = columns.map(|(i, column)| in_column(i, result.summary.get(column)));
                table.push([name, result.title.clone()].into_iter().chain(cells));
                name = String::new();
            }
        }
        table.markdown() + "\n"
    }

    /// Writes one measure: a line per policy, a column per condition.
    fn grid(&self, column: usize) -> String {
        let measure = self.columns[column].as_str();
        let conditions = self.conditions();
        let titles = conditions.iter().map(|(_, title)| title.clone());
        let mut table = Table::new([title(measure), String::new()].into_iter().chain(titles));
        for rows in self.rows.chunk_by(|a, b| a.title == b.title) {
            let mut name = format!("**{}**, {}", rows[0].title, rows[0].notification);
            let said = conditions.iter().map(|(condition, _)| {
                rows.iter().find_map(|row| row.published(Some(condition), measure))
            });
            if said.clone().any(|said| said.is_some()) {
                let cells = said.map(published);
                table.push([name, "*the paper*".to_owned()].into_iter().chain(cells));
                name = String::new();
            }
            let cells = conditions.iter().map(|(condition, _)| {
                let result = rows.iter().find_map(|row| row.result(condition, Choice::Sample));
                in_column(column, result.and_then(|result| result.summary.get(measure)))
            });
            table.push([name, "ours".to_owned()].into_iter().chain(cells));
        }
        table.markdown() + "\n"
    }

    /// Lists the conditions of all rows, in the order in which they first occur: name, title.
    fn conditions(&self) -> Vec<(String, String)> {
        let mut conditions: Vec<(String, String)> = Vec::new();
        for result in self.rows.iter().flat_map(|row| &row.results) {
            let name = result.evaluations.first().cloned().unwrap_or_default();
            if !conditions.iter().any(|(known, _)| result.is(known)) {
                conditions.push((name, result.title.clone()));
            }
        }
        conditions
    }

    fn runs(&self) -> String {
        let runs: Vec<&TrainedRun> = self.rows.iter().flat_map(|row| &row.runs).collect();
        if runs.is_empty() {
            return String::new();
        }
        let head = ["run", "seed", "configuration", "steps", "minutes", "weights", "program"];
        let mut table = Table::new(head);
        for run in runs {
            let mark = if run.reproducible { "" } else { " (not reproducible)" };
            table.push([
                format!("`{}`", run.name),
                run.seed.to_string(),
                format!("`{}`", run.configuration),
                run.steps.to_string(),
                format!("{:.1}", run.minutes),
                format!("`{}`{mark}", run.weights),
                run.program.clone(),
            ]);
        }
        folded(&format!("{}: runs", self.title), &table.markdown())
    }
}

/// Writes every measure of one policy, folded away: a line per measure, a column per condition and way of choosing.
fn details(row: &RowResult) -> String {
    let mut text = String::new();
    if !row.settings.is_empty() {
        let settings = row.settings.iter().map(|setting| format!("`{}`", plain(setting)));
        let settings: Vec<String> = settings.collect();
        text = format!("Differs from the profile in {}.\n\n", settings.join(", "));
    }
    let heading = |result: &ConditionResult| match result.choice {
        Choice::Sample => result.title.clone(),
        Choice::Greedy => format!("{}, greedy", result.title),
    };
    let head = std::iter::once("measure".to_owned()).chain(row.results.iter().map(heading));
    let mut table = Table::new(head);
    for name in names_in(row.results.iter().map(|result| &result.summary)) {
        let cells = row.results.iter().map(|result| measured(result.summary.get(name)));
        table.push(std::iter::once(title(name)).chain(cells));
    }
    text.push_str(&table.markdown());
    folded(&format!("{}, {}: every measure", row.title, row.notification), &text)
}

fn folded(summary: &str, text: &str) -> String {
    format!("<details><summary>{summary}</summary>\n\n{text}\n</details>\n\n")
}

/// Keeps a text on one line, outside every table.
fn plain(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

/// Writes a measured number: mean, standard deviation over training seeds, interval.
fn measured(measure: Option<&Measure>) -> String {
    let Some((measure, interval)) = measure.and_then(|m| Some((m, m.interval?))) else {
        return NONE.to_owned();
    };
    let [mean, bounds] = written(&interval);
    // As many digits as the mean has.
    let digits = mean.split_once('.').map_or(0, |(_, digits)| digits.len());
    match measure.deviation_over_seeds() {
        Some(deviation) => format!("{mean} ± {deviation:.digits$} {bounds}"),
        None => format!("{mean} {bounds}"),
    }
}

/// Writes a measured number for a column of a main table: the first one's has its interquartile mean.
fn in_column(column: usize, measure: Option<&Measure>) -> String {
    if column == 0 { with_quartiles(measure) } else { measured(measure) }
}

/// Writes a measured number, and behind it the interquartile mean over training seeds.
fn with_quartiles(measure: Option<&Measure>) -> String {
    let text = measured(measure);
    match measure.and_then(Measure::interquartile_mean_over_seeds) {
        Some(mean) => format!("{text}, IQM {mean:.3}"),
        None => text,
    }
}

fn with_bounds(interval: &Interval) -> String {
    written(interval).join(" ")
}

fn published(published: Option<&Published>) -> String {
    let Some(published) = published else { return NONE.to_owned() };
    let mean = published.mean;
    match published.deviation {
        Some(deviation) => format!("{mean:.2} ± {deviation:.2}"),
        None => format!("{mean:.2}"),
    }
}

#[cfg(test)]
#[path = "markdown_tests.rs"]
mod tests;
