//! The parts of the page; a part without contents is an empty string.

use leadtime_proto::phrase::counted;
use leadtime_table::{Table, escape};

use super::contents::{Book, Picture, Provenance, ProvenanceDetail, Report, Verdict};
use crate::figure;
use crate::measure::{Comparison, main_measures, meaning, names_in, title};

fn section(id: &str, heading: &str, body: &str) -> String {
    if body.is_empty() {
        return String::new();
    }
    format!("<section id=\"{id}\">\n<h2>{}</h2>\n{body}</section>\n", escape(heading))
}

/// Writes what is shown on demand only.
fn folded(summary: &str, body: &str) -> String {
    if body.is_empty() {
        return String::new();
    }
    format!("<details>\n<summary>{}</summary>\n{body}</details>\n", escape(summary))
}

/// Writes a picture in its own size; it scrolls sideways where the screen is narrower.
fn drawing(svg: &str, caption: &str) -> String {
    format!(
        "<figure>\n<p class=\"hint\">Scroll sideways to see the whole picture.</p>\n\
         <div class=\"wide\" tabindex=\"0\" role=\"group\" aria-label=\"picture\">\n{svg}</div>\n\
         <figcaption>{}</figcaption>\n</figure>\n",
        escape(caption)
    )
}

/// Escapes text; what stands between backticks is set as code.
pub(super) fn prose(text: &str) -> String {
    let part = |(i, part): (usize, &str)| {
        let part = escape(part);
        if i % 2 == 1 { format!("<code>{part}</code>") } else { part.into_owned() }
    };
    text.split('`').enumerate().map(part).collect()
}

fn list(attributes: &str, items: impl Iterator<Item = String>) -> String {
    let items: String = items.collect();
    if items.is_empty() { items } else { format!("<ul{attributes}>\n{items}</ul>\n") }
}

/// Writes a table that scrolls sideways where the screen is narrow; shadows show on which side there is more.
fn scrolled(table: &Table, class: &str) -> String {
    format!(
        "<div class=\"scroll\" tabindex=\"0\" role=\"group\" aria-label=\"table\">{}</div>\n",
        table.html(class)
    )
}

pub(super) fn verdicts(report: &Report) -> String {
    let items = report.verdicts.iter().map(|Verdict { holds, sentence }| {
        let word = if *holds { "holds" } else { "fails" };
        format!("<li class=\"{word}\"><b>{word}</b> {}</li>\n", escape(sentence))
    });
    list(" class=\"verdicts\"", items)
}

pub(super) fn notes(report: &Report) -> String {
    let items = report.notes.iter().map(|note| format!("<li>{}</li>\n", prose(note)));
    list(" class=\"notes\"", items)
}

pub(super) fn pictures(report: &Report) -> String {
    let each = report.pictures.iter().map(|picture| {
        let heading = format!("<h3>{}</h3>\n", escape(&picture.title));
        heading + &described(picture)
    });
    section("playthroughs", "Playthroughs", &each.collect::<String>())
}

/// Writes a picture with its caption, and the same in words below it.
pub(super) fn described(picture: &Picture) -> String {
    let words = escape(&picture.transcript);
    let words = if words.is_empty() { String::new() } else { listing(&words) };
    drawing(&picture.svg, &picture.caption)
        + &folded("Transcript: what was said, word by word", &words)
}

/// Writes text that is already escaped as it stands.
fn listing(text: &str) -> String {
    format!("<pre tabindex=\"0\"><code>{text}</code></pre>\n")
}

pub(super) fn comparison(report: &Report) -> String {
    let Some(comparison) = &report.comparison else { return String::new() };
    let [main, rest] = main_measures(&names_in(&comparison.summaries));
    let reading = comparison.reading() + " A rate counts only the episodes in which it is defined.";
    let intro = format!("<p>{}</p>\n", escape(&reading));
    let differences = comparison.differences.iter().map(|difference| {
        let sentence = difference.sentence(comparison.bootstrap.confidence);
        format!("<p><strong>Difference.</strong> {}.</p>\n", escape(&sentence))
    });
    let body = [
        intro,
        scrolled(&comparison.table_of(&main), "numbers"),
        differences.collect(),
        more_measures(comparison, &rest),
        folded("What the measures mean", &meanings(&[main, rest].concat())),
    ];
    section("results", "Results", &body.concat())
}

/// Folds measures away, and names those that are 0 for everybody.
fn more_measures(comparison: &Comparison, names: &[&str]) -> String {
    let (zero, others): (Vec<&str>, Vec<&str>) =
        names.iter().partition(|name| comparison.is_zero(name));
    let mut body = String::new();
    if !others.is_empty() {
        body.push_str(&scrolled(&comparison.table_of(&others), "numbers"));
    }
    if !zero.is_empty() {
        let zero = zero.into_iter().map(title).collect::<Vec<_>>().join("; ");
        body.extend(["<p>0 in every episode: ", &*escape(&zero), ".</p>\n"]);
    }
    folded(&counted(names.len(), "more measure"), &body)
}

fn meanings(names: &[&str]) -> String {
    let mut table = Table::new(["measure", "meaning"]);
    let known: Vec<_> = names.iter().filter_map(|name| Some((*name, meaning(name)?))).collect();
    for &(name, meaning) in &known {
        table.push([title(name), meaning.to_owned()]);
    }
    if known.is_empty() { String::new() } else { scrolled(&table, "accounts") }
}

pub(super) fn training(report: &Report) -> String {
    if report.curves.is_empty() {
        return String::new();
    }
    let svg = figure::bands("curves", "Learning curve", "environment steps", 7, &report.curves);
    let caption =
        "Line: mean over neighbouring updates. Band: from the lowest to the highest of them.";
    section("training", "Training", &drawing(&svg.text, caption))
}

pub(super) fn system(report: &Report) -> String {
    let mut body = String::new();
    if !report.staleness.is_empty() {
        let axis = "policy versions behind the learner";
        let svg = figure::histogram("staleness", "Staleness of rollouts", axis, &report.staleness);
        let caption = "How many versions older than the learner's the policy was that acted in a rollout, when \
                       the learner used it.";
        body.push_str(&drawing(&svg.text, caption));
    }
    if !report.phases.is_empty() {
        let svg = figure::shares("phases", "What the time went into", &report.phases);
        let caption = "Share of each process' time; the total in seconds on the right.";
        body.push_str(&drawing(&svg.text, caption));
    }
    body.push_str(&books(report));
    section("system", "Learner and actors", &folded("Staleness, time, books", &body))
}

fn books(report: &Report) -> String {
    if report.books.is_empty() {
        return String::new();
    }
    let mut table = Table::new(["account", "rollouts", "meaning"]);
    for Book { name, count, meaning } in &report.books {
        table.push([name, &count.to_string(), meaning]);
    }
    let balance = match report.books_balance {
        Some(true) => "The books balance: every rollout that was published is accounted for.",
        Some(false) => "<strong>The books do not balance.</strong>",
        None => "",
    };
    let balance = if balance.is_empty() { String::new() } else { format!("<p>{balance}</p>\n") };
    format!("<h3>Books</h3>\n{balance}{}", scrolled(&table, "accounts"))
}

/// Heads what belongs to one of several runs.
fn heading(report: &Report, run: &str) -> String {
    let alone = report.provenance.len() < 2;
    if alone { String::new() } else { format!("<h3>{}</h3>\n", escape(run)) }
}

pub(super) fn provenance(report: &Report) -> String {
    let of_run = |Provenance { run, details, command, .. }: &Provenance| {
        let mut table = Table::new(["", ""]);
        for ProvenanceDetail { name, value } in details {
            table.push([name, value]);
        }
        let command = match command.as_str() {
            "" => String::new(),
            command => format!(
                "<p>The command that trains it again:</p>\n<pre class=\"command\"><code>{}</code></pre>\n",
                escape(command)
            ),
        };
        heading(report, run) + &scrolled(&table, "facts") + &command
    };
    let body: String = report.provenance.iter().map(of_run).collect();
    section("provenance", "Where the numbers come from", &body)
}

pub(super) fn settings(report: &Report) -> String {
    let changed = report.changed.as_ref().map_or_else(String::new, |table| {
        let intro = "<p>What differs from the built-in configuration:</p>\n";
        format!("{intro}{}", scrolled(table, "facts"))
    });
    let with_settings = report.provenance.iter().filter(|of| !of.settings.is_empty());
    let all = with_settings.map(|Provenance { run, settings, .. }| {
        folded(&format!("All settings of {run}"), &listing(&escape(settings)))
    });
    section("settings", "Settings", &(changed + &all.collect::<String>()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_stands_between_backticks_is_code() {
        assert_eq!(prose("see `leadtime <x>`, then"), "see <code>leadtime &lt;x&gt;</code>, then");
        assert_eq!(prose("plain & simple"), "plain &amp; simple");
    }
}
