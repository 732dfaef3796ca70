//! The parts of the page; a part without contents is an empty string.

use leadtime_table::{Table, escape};

use super::contents::{Book, Fact, Report, Verdict};
use crate::figure;

fn section(id: &str, heading: &str, body: &str) -> String {
    if body.is_empty() {
        return String::new();
    }
    format!("<section id=\"{id}\">\n<h2>{}</h2>\n{body}</section>\n", escape(heading))
}

fn drawing(svg: &str, caption: &str) -> String {
    format!("<figure>\n{svg}<figcaption>{}</figcaption>\n</figure>\n", escape(caption))
}

fn list(attributes: &str, items: impl Iterator<Item = String>) -> String {
    let items: String = items.collect();
    if items.is_empty() { items } else { format!("<ul{attributes}>\n{items}</ul>\n") }
}

/// Writes a table that scrolls sideways where the screen is narrow.
fn scrolled(table: &Table, class: &str) -> String {
    format!("<div class=\"scroll\">{}</div>\n", table.html(class))
}

pub(super) fn verdicts(report: &Report) -> String {
    let items = report.verdicts.iter().map(|Verdict { holds, sentence }| {
        let word = if *holds { "holds" } else { "fails" };
        format!("<li class=\"{word}\"><b>{word}</b> {}</li>\n", escape(sentence))
    });
    list(" class=\"verdicts\"", items)
}

pub(super) fn comparison(report: &Report) -> String {
    let Some(comparison) = &report.comparison else { return String::new() };
    let reading = comparison.reading() + " A rate counts only the episodes in which it is defined.";
    let intro = format!("<p>{}</p>\n", escape(&reading));
    let differences = comparison.differences.iter().map(|difference| {
        let sentence = difference.sentence(comparison.bootstrap.confidence);
        format!("<p><strong>Difference.</strong> {}.</p>\n", escape(&sentence))
    });
    let body = [intro, scrolled(&comparison.table(), "numbers"), differences.collect()].concat();
    section("results", "Results", &body)
}

pub(super) fn pictures(report: &Report) -> String {
    let each = report.pictures.iter().map(|picture| {
        let heading = format!("<h3>{}</h3>\n", escape(&picture.title));
        heading + &drawing(&picture.svg, &picture.caption)
    });
    section("playthroughs", "Playthroughs", &each.collect::<String>())
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
    section("system", "Learner and actors", &body)
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

pub(super) fn provenance(report: &Report) -> String {
    if report.provenance.is_empty() {
        return String::new();
    }
    let mut table = Table::new(["", ""]);
    for Fact { name, value } in &report.provenance {
        table.push([name, value]);
    }
    section("provenance", "Where the numbers come from", &scrolled(&table, "facts"))
}

pub(super) fn notes(report: &Report) -> String {
    let items = report.notes.iter().map(|note| format!("<li>{}</li>\n", escape(note)));
    section("notes", "Notes", &list("", items))
}
