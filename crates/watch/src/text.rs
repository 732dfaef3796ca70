//! One screen of text: for a terminal far away, and for people who do not see charts.

use std::time::Duration;

use leadtime_proto::phrase::{counted, duration};
use leadtime_proto::text::{printable, quoted};
use leadtime_table::Table;
use serde_json::Value;

use crate::state::RunView;

/// Width of a curve, in characters.
const WIDTH: usize = 40;
/// The heights of a curve.
const LEVELS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
/// The curves that are drawn, with the names that people read.
const CURVES: [(&str, &str); 6] = [
    ("episodes/success", "success"),
    ("episodes/return", "return"),
    ("episodes/length", "episode length"),
    ("train/entropy", "entropy"),
    ("train/approx_kl", "KL"),
    ("train/explained_variance", "explained variance"),
];
/// The most actors and lines of the log that are listed.
const N_ACTORS: usize = 12;
const N_LOG: usize = 5;

/// Writes how a run stands, as a terminal can print it.
pub fn screen(view: &RunView, now: f64) -> String {
    let (state, update) = (view.state_json(now), view.update_json(now));
    let mut lines = vec![head(&state), progress(&state)];
    lines.extend(curves(&view.history_json(0)));
    lines.extend(phases(&update["phases"]));
    lines.extend(staleness(&update["staleness_100"]));
    lines.extend(clipped(&update["clip_by_staleness"]));
    lines.extend(books(&update["books"]));
    lines.extend(actors(&view.actors_json(now)));
    let log: Vec<String> = view.log_after(0).map(|line| format!("  {}", line.text)).collect();
    if !log.is_empty() {
        lines.push(String::new());
        lines.extend(log.iter().rev().take(N_LOG).cloned());
    }
    printable(&lines.join("\n"))
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or("-")
}

fn head(state: &Value) -> String {
    let domain = state["domain"].as_str();
    let domain = domain.map(|domain| format!(" ({})", quoted(domain))).unwrap_or_default();
    format!("{}{domain}: {}", text(&state["run"]), text(&state["sentence"]))
}

fn progress(state: &Value) -> String {
    let count = |name: &str| state[name].as_u64().unwrap_or(0);
    let mut parts = vec![format!("update {} of {}", count("update"), count("total_updates"))];
    if let Some(seconds) = state["seconds_left"].as_f64() {
        let left = Duration::try_from_secs_f64(seconds.max(0.0)).unwrap_or(Duration::MAX);
        parts.push(format!("{} left", duration(left)));
    }
    if let Some(rate) = state["steps_per_second"].as_f64() {
        parts.push(format!("{rate:.0} steps/s"));
    }
    if let Some(success) = state["success"].as_f64() {
        parts.push(format!("success {success:.2}"));
    }
    if let Some(total) = state["return"].as_f64() {
        parts.push(format!("return {total:.1}"));
    }
    parts.push(counted(count("n_actors"), "actor"));
    if count("missed") > 0 {
        parts.push(format!("{} missed", counted(count("missed"), "message")));
    }
    parts.join(", ")
}

fn curves(history: &Value) -> Vec<String> {
    let mut lines = vec![String::new()];
    for (name, label) in CURVES {
        let values = history["scalars"][name]["max"].as_array();
        let values: Vec<f64> = values.into_iter().flatten().filter_map(Value::as_f64).collect();
        let Some(last) = values.last() else { continue };
        lines.push(format!("{label:>18}  {}  {}", spark(&values), number(*last)));
    }
    if lines.len() == 1 { Vec::new() } else { lines }
}

fn number(value: f64) -> String {
    match value.abs() {
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 1.0 => format!("{value:.2}"),
        size if size >= 0.01 || size == 0.0 => format!("{value:.3}"),
        _ => format!("{value:.1e}"),
    }
}

/// Draws a curve in a line.
fn spark(values: &[f64]) -> String {
    let n_columns = WIDTH.min(values.len());
    let mean = |column: usize| {
        let from = column * values.len() / n_columns;
        let part = &values[from..((column + 1) * values.len() / n_columns).max(from + 1)];
        part.iter().sum::<f64>() / part.len() as f64
    };
    let means: Vec<f64> = (0..n_columns).map(mean).collect();
    let low = means.iter().copied().fold(f64::MAX, f64::min);
    let high = means.iter().copied().fold(f64::MIN, f64::max);
    let level = |mean: &f64| {
        let share = if high > low { (mean - low) / (high - low) } else { 0.5 };
        LEVELS[((share * LEVELS.len() as f64) as usize).min(LEVELS.len() - 1)]
    };
    let line: String = means.iter().map(level).collect();
    format!("{line:<WIDTH$}")
}

fn phases(phases: &Value) -> Vec<String> {
    if phases.is_null() {
        return Vec::new();
    }
    let share = |name: &str| phases[name].as_f64().unwrap_or(0.0) * 100.0;
    let mut line = format!(
        "\nlearner: waits {:.0} %, trains {:.0} %, rest {:.0} %",
        share("wait"),
        share("train"),
        share("rest")
    );
    if let Some(sentence) = phases["sentence"].as_str().filter(|it| !it.is_empty()) {
        line = format!("{line}; {sentence}");
    }
    vec![line]
}

fn clipped(shares: &Value) -> Option<String> {
    let shares = shares.as_object()?.iter();
    let parts: Vec<String> = shares
        .filter_map(|(staleness, share)| Some((staleness, share.as_f64()?)))
        .map(|(staleness, share)| format!("{staleness}: {:.1} %", share * 100.0))
        .collect();
    Some(format!("samples clipped in the last update, by staleness: {}", parts.join(", ")))
}

fn staleness(counts: &Value) -> Vec<String> {
    let counts = counts.as_object().into_iter().flatten();
    let parts: Vec<String> = counts.map(|(staleness, n)| format!("{staleness}: {n}")).collect();
    if parts.is_empty() {
        return Vec::new();
    }
    vec![format!("staleness of the last 100 updates (versions: rollouts): {}", parts.join(", "))]
}

fn books(books: &Value) -> Vec<String> {
    if books.is_null() {
        return Vec::new();
    }
    let entries = books["entries"].as_array().into_iter().flatten();
    let parts = entries.filter_map(|entry| {
        let n = entry[1].as_i64().filter(|n| *n != 0)?;
        Some(format!("{n} {}", text(&entry[0]).replace('_', " ")))
    });
    let verdict = if books["balanced"] == true { "balanced" } else { "NOT balanced" };
    let sum = parts.collect::<Vec<_>>().join(" + ");
    vec![format!("books {verdict}: {} published = {sum}", books["published"])]
}

fn actors(actors: &Value) -> Vec<String> {
    let actors = actors.as_array().map_or(&[][..], Vec::as_slice);
    if actors.is_empty() {
        return Vec::new();
    }
    let head = ["actor", "envs", "steps/s", "iteration", "lag", "credit", "silent"];
    let mut table = Table::new(head).elastic(0);
    let cell = |value: &Value| value.as_f64().map_or("-".to_owned(), |value| format!("{value:.0}"));
    for actor in actors.iter().take(N_ACTORS) {
        let credit = &actor["credit"];
        let silent = match actor["gone_s"].as_f64() {
            Some(_) => "gone".to_owned(),
            None => format!("{:.1} s", actor["silent_s"].as_f64().unwrap_or(0.0)),
        };
        table.push([
            text(&actor["id"]).to_owned(),
            cell(&actor["envs"]),
            cell(&actor["steps_per_second"]),
            cell(&actor["iteration"]),
            cell(&actor["lag"]),
            format!("{}/{}", cell(&credit["used"]), cell(&credit["window"])),
            silent,
        ]);
    }
    let mut lines = vec![String::new()];
    lines.extend(table.text_within(leadtime_table::WIDTH).lines().map(str::to_owned));
    if actors.len() > N_ACTORS {
        lines.push(format!("and {} more", actors.len() - N_ACTORS));
    }
    lines
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_curve_rises_from_left_to_right() {
        let rising: Vec<f64> = (0..400).map(f64::from).collect();
        let drawn = spark(&rising);
        assert_eq!(drawn.chars().count(), WIDTH);
        assert!(drawn.starts_with('▁') && drawn.ends_with('█'), "{drawn}");
        assert_eq!(spark(&[1.0, 1.0]).trim_end(), "▅▅");
    }

    #[test]
    fn no_peer_writes_to_the_terminal_and_no_number_is_too_large() {
        let mut view = RunView::new("r");
        let evil = "\u{1b}[2J\nfaked";
        view.about(json!({"domain": evil, "total_updates": u64::MAX}), 0.0);
        for update in [1, 2] {
            let told = json!({"kind": "update", "update": update, "refusals": {evil: update}});
            view.learner_says("01", told, f64::from(update));
        }
        view.learner_says("01", json!({"kind": "roster", "actors": [{"id": evil}]}), 2.0);
        let told = screen(&view, 2.0);
        assert!(!told.contains('\u{1b}') && !told.lines().any(|line| line == "faked"), "{told}");
        assert!(told.contains("d 07h left"), "{told}");
        assert!(told.contains("messages are refused"), "{told}");
    }

    #[test]
    fn a_run_that_nobody_has_seen_is_a_line() {
        let told = screen(&RunView::new("lander-1"), 0.0);
        assert!(told.starts_with("lander-1: waiting for the learner\nupdate 0 of 0"), "{told}");
    }
}
