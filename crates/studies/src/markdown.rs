//! A study's results as a page of Markdown: tables, differences, pictures, provenance.

use leadtime_eval::measure::{Choice, Measure, names_in, title, written};
use leadtime_eval::report::Fact;
use leadtime_table::Table;

use crate::result::{ConditionResult, FigureLink, PartResult, RowResult, StudyResult, TrainedRun};
use crate::study::{Layout, Published};

/// What stands for a number that there is none of.
const NONE: &str = "\u{2013}";

impl StudyResult {
    /// Writes the whole page.
    pub(crate) fn markdown(&self) -> String {
        let percent = 100.0 * self.bootstrap.confidence;
        let reading = format!(
            "Cells: mean ± standard deviation over training seeds [{percent:.0} % bootstrap interval over training \
             seeds and episodes]. With one training seed there is no deviation, and the interval is over episodes \
             alone.\n\n"
        );
        let mut page = self.heading() + &reading;
        for part in &self.parts {
            page.push_str(&part.summary("", self.bootstrap.confidence));
            page.extend(part.rows.iter().map(details));
        }
        page.push_str("## Where these numbers are from\n\n");
        let facts = self.provenance.iter();
        page.extend(facts.map(|Fact { name, value }| format!("* {name}: {value}\n")));
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
        text + &format!(
            "All measures, greedy choices, runs and provenance: [{name}.md]({folder}{name}.md), as data: \
             [{name}.json]({folder}{name}.json).\n\n"
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
            Layout::Grid => text.extend(self.columns.iter().map(|measure| self.grid(measure))),
        }
        text.extend(self.differences.iter().map(|d| format!("* {}\n", d.sentence(confidence))));
        if !self.differences.is_empty() {
            text.push('\n');
        }
        text.extend(self.pictures.iter().map(|FigureLink { file, caption }| {
            format!("![{}]({folder}{file})\n\n*{caption}*\n\n", plain(caption))
        }));
        text
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
                let cells = self.columns.iter().map(|c| measured(result.summary.get(c)));
                table.push([name, result.title.clone()].into_iter().chain(cells));
                name = String::new();
            }
        }
        table.markdown() + "\n"
    }

    /// Writes one measure: a line per policy, a column per condition.
    fn grid(&self, measure: &str) -> String {
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
                measured(result.and_then(|result| result.summary.get(measure)))
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

/// Folds a text away under its summary.
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

/// Writes a published number.
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
