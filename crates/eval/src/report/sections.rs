//! The parts of the page; a part without contents is an empty string.

use super::contents::Report;
use crate::draw::escape;
use crate::figure;
use crate::measure::{Comparison, Summary, title, written};

fn section(id: &str, heading: &str, body: &str) -> String {
    if body.is_empty() {
        return String::new();
    }
    format!("<section id=\"{id}\">\n<h2>{}</h2>\n{body}</section>\n", escape(heading))
}

fn drawing(svg: &str, caption: &str) -> String {
    format!("<figure>\n{svg}<figcaption>{}</figcaption>\n</figure>\n", escape(caption))
}

pub(super) fn verdicts(report: &Report) -> String {
    if report.verdicts.is_empty() {
        return String::new();
    }
    let items = report.verdicts.iter().map(|verdict| {
        let (class, word) = if verdict.holds { ("holds", "holds") } else { ("fails", "fails") };
        format!("<li class=\"{class}\"><b>{word}</b> {}</li>\n", escape(&verdict.sentence))
    });
    format!("<ul class=\"verdicts\">\n{}</ul>\n", items.collect::<String>())
}

pub(super) fn comparison(report: &Report) -> String {
    let Some(comparison) = &report.comparison else { return String::new() };
    let percent = 100.0 * comparison.bootstrap.confidence;
    let intro = format!(
        "<p>Means over episodes, with {percent:.0} % bootstrap intervals in brackets. A rate counts only the \
         episodes in which it is defined.</p>\n"
    );
    let differences = comparison.differences.iter().map(|difference| {
        let sentence = difference.sentence(comparison.bootstrap.confidence);
        format!("<p><strong>Difference.</strong> {}.</p>\n", escape(&sentence))
    });
    let body = [intro, numbers(comparison), differences.collect()].concat();
    section("results", "Results", &body)
}

fn numbers(comparison: &Comparison) -> String {
    let heads = comparison.summaries.iter().map(|summary| {
        let (player, n) = (escape(&summary.player), summary.n_episodes);
        format!("<th scope=\"col\">{player}<br/><span class=\"muted\">{n} episodes</span></th>")
    });
    let heads: String = heads.collect();
    let names = comparison.measure_names();
    let row = |name: &&str| {
        let cells: String =
            comparison.summaries.iter().map(|summary| cell(summary, name)).collect();
        format!("<tr><th scope=\"row\">{}</th>{cells}</tr>\n", escape(&title(name)))
    };
    let rows: String = names.iter().map(row).collect();
    format!(
        "<div class=\"scroll\"><table class=\"numbers\">\n<thead><tr><th scope=\"col\">measure</th>{heads}</tr>\
         </thead>\n<tbody>\n{rows}</tbody>\n</table></div>\n"
    )
}

fn cell(summary: &Summary, name: &str) -> String {
    let interval = summary.get(name).and_then(|measure| measure.interval);
    let Some(interval) = interval else { return "<td>\u{2013}</td>".to_owned() };
    let [mean, bounds] = written(&interval);
    format!("<td>{mean} <span>{bounds}</span></td>")
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
    let svg = figure::curves("curves", "Learning curve", "environment steps", &report.curves);
    let caption = "Faint: as recorded. Strong: centred moving average.";
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
        body.push_str(&drawing(
            &svg.text,
            "Share of each process' time; the total in seconds on the right.",
        ));
    }
    body.push_str(&books(report));
    section("system", "Learner and actors", &body)
}

fn books(report: &Report) -> String {
    if report.books.is_empty() {
        return String::new();
    }
    let row = |book: &super::contents::Book| {
        let (name, meaning) = (escape(&book.name), escape(&book.meaning));
        format!("<tr><th scope=\"row\">{name}</th><td>{}</td><td>{meaning}</td></tr>\n", book.count)
    };
    let rows: String = report.books.iter().map(row).collect();
    let balance = match report.books_balance {
        Some(true) => {
            "<p>The books balance: every rollout that was published is accounted for.</p>\n"
        }
        Some(false) => "<p><strong>The books do not balance.</strong></p>\n",
        None => "",
    };
    format!(
        "<h3>Books</h3>\n{balance}<div class=\"scroll\"><table>\n<thead><tr><th scope=\"col\">account</th>\
         <th scope=\"col\">rollouts</th><th scope=\"col\">meaning</th></tr></thead>\n<tbody>\n{rows}</tbody>\n\
         </table></div>\n"
    )
}

pub(super) fn provenance(report: &Report) -> String {
    if report.provenance.is_empty() {
        return String::new();
    }
    let row = |fact: &super::contents::Fact| {
        let (name, value) = (escape(&fact.name), escape(&fact.value));
        format!("<tr><th scope=\"row\">{name}</th><td>{value}</td></tr>\n")
    };
    let rows: String = report.provenance.iter().map(row).collect();
    let table = format!(
        "<div class=\"scroll\"><table class=\"facts\">\n<tbody>\n{rows}</tbody>\n</table></div>\n"
    );
    section("provenance", "Where the numbers come from", &table)
}

pub(super) fn notes(report: &Report) -> String {
    if report.notes.is_empty() {
        return String::new();
    }
    let items = report.notes.iter().map(|note| format!("<li>{}</li>\n", escape(note)));
    section("notes", "Notes", &format!("<ul>\n{}</ul>\n", items.collect::<String>()))
}
