//! `report.html` of one run or several, from what lies in their directories and from an evaluation, if there was one.

use std::collections::BTreeSet;

use leadtime_config::identity::{Change, difference};
use leadtime_config::{Config, ConfigSource, Override};
use leadtime_eval::figure::{Band, BandPanel, ShareRow};
use leadtime_eval::playthrough::Spoken;
use leadtime_eval::report::{Book, Picture, Provenance, ProvenanceDetail, Report};
use leadtime_table::Table;
use serde_json::{Map, Value};

use crate::command_line::command_line;
use crate::findings::Findings;
use crate::record::INITIAL_POLICY;
use crate::run_files::{RunFiles, point};
use crate::{ProgramBuild, ResultCause, RunResult, Tasks, held_out};

/// Points of a learning curve.
const N_POINTS: usize = 120;
/// Settings that say nothing about what a run computes, and the seed, which has an option of its own.
const NOT_SETTINGS: [&str; 3] = ["run.name", "run.directory", "seed"];

/// Puts a report together: one run in full, or several side by side. `program` trains them again.
pub fn report(tasks: &Tasks, runs: &[RunFiles], findings: Findings, program: &str) -> Report {
    let alone = match runs {
        [only] => Some(only),
        _ => None,
    };
    let books = alone.and_then(|run| Some(&run.record.result.as_ref()?.books));
    let names: Vec<&str> = runs.iter().map(RunFiles::name).collect();
    let nearest: Vec<NearestBuiltIn> =
        runs.iter().map(|run| NearestBuiltIn::of(tasks, &run.config)).collect();
    Report {
        title: format!("Run{} {}", if alone.is_some() { "" } else { "s" }, names.join(", ")),
        lead: findings.lead,
        verdicts: findings.verdict.into_iter().collect(),
        notes: findings.notes,
        pictures: pictures(&findings.episodes),
        comparison: findings.comparison,
        curves: curves(runs),
        staleness: alone.map(|run| run.journal.staleness.clone()).unwrap_or_default(),
        phases: runs.iter().map(|run| phases(run, alone.is_some())).collect(),
        books: books.map(account).unwrap_or_default(),
        books_balance: books.and_then(|books| books["balanced"].as_bool()),
        provenance: runs
            .iter()
            .zip(&nearest)
            .map(|(run, nearest)| provenance(tasks, run, nearest, program))
            .collect(),
        changed: changed(&names, &nearest),
    }
}

fn pictures(episodes: &[Spoken]) -> Vec<Picture> {
    let numbered = episodes.iter().enumerate();
    numbered.map(|(i, spoken)| Picture::playthrough(spoken, &format!("playthrough-{i}"))).collect()
}

fn curves(runs: &[RunFiles]) -> Vec<BandPanel> {
    let panels: [(&str, &str, Option<[f64; 2]>); 6] = [
        ("episodes/success", "success", Some([0.0, 1.0])),
        ("held_out/success", "success, held out", Some([0.0, 1.0])),
        ("episodes/return", "return", None),
        ("episodes/length", "episode length (steps)", None),
        ("train/entropy", "entropy (nats)", None),
        ("train/approx_kl", "approximate KL (nats)", None),
    ];
    let band = |run: &RunFiles, key: &str| {
        let evaluated: Vec<[f64; 2]> =
            run.held_out.iter().filter_map(|line| point(line, key)).collect();
        let is_held_out = key.starts_with("held_out/");
        let points: &[[f64; 2]] = if is_held_out { &evaluated } else { run.journal.curve(key) };
        let band = Band::summary(points, N_POINTS);
        let label = if runs.len() > 1 { run.name().to_owned() } else { String::new() };
        Band { label, ..band }
    };
    let panel = |(key, label, range): (&str, &str, Option<[f64; 2]>)| {
        let bands: Vec<Band> = runs.iter().map(|run| band(run, key)).collect();
        let is_empty = bands.iter().all(|band| band.points.is_empty());
        (!is_empty).then(|| BandPanel { label: label.to_owned(), range, bands })
    };
    panels.into_iter().filter_map(panel).collect()
}

fn phases(run: &RunFiles, alone: bool) -> ShareRow {
    let training = ("training".to_owned(), run.journal.sum("system/train_seconds"));
    let waiting = ("waiting for rollouts".to_owned(), run.journal.sum("system/wait_seconds"));
    let label = if alone { "learner" } else { run.name() };
    ShareRow { label: label.to_owned(), parts: vec![training, waiting] }
}

fn account(books: &Value) -> Vec<Book> {
    let meanings = [
        ("published", "arrived in order, over all actors and their starts"),
        ("trained", "an update trained on them"),
        ("dropped_stale", "too stale to use"),
        ("refused", "broke a rule of the wire or of the run"),
        ("superseded", "their environment had moved on"),
        ("unused_at_end", "waited when the run ended"),
        ("rolled_back", "rolled back on resuming and made again"),
        ("duplicates", "copies, not part of published"),
    ];
    let book = |(name, meaning): (&str, &str)| Book {
        name: name.to_owned(),
        count: books[name].as_u64().unwrap_or(0),
        meaning: meaning.to_owned(),
    };
    meanings.into_iter().map(book).collect()
}

fn provenance(
    tasks: &Tasks,
    run: &RunFiles,
    nearest: &NearestBuiltIn,
    program: &str,
) -> Provenance {
    Provenance {
        run: run.name().to_owned(),
        details: details(run),
        command: command(tasks, run, nearest, program),
        settings: run.config.to_string(),
    }
}

fn details(run: &RunFiles) -> Vec<ProvenanceDetail> {
    let record = &run.record;
    let mut details = vec![
        ProvenanceDetail::new("domain", &record.domain),
        ProvenanceDetail::new("seed", record.seed.to_string()),
        ProvenanceDetail::new("started", &record.started),
    ];
    if let Some(origin) = &record.origin {
        details.push(ProvenanceDetail::new("forked from", &origin.run));
        details
            .push(ProvenanceDetail::new("SHA-256 of the starting weights", &origin.weights_sha256));
    }
    for build in &record.builds {
        let ProgramBuild { since, program, commit, cpu, threads } = build;
        let commit = commit.as_deref().unwrap_or("unknown");
        let text =
            format!("{program}, commit {commit}, on {cpu} with {threads} threads per process");
        details.push(ProvenanceDetail::new(format!("program since {since}"), text));
    }
    for change in &record.changes {
        details.push(ProvenanceDetail::new("changed while it went on", change.to_string()));
    }
    if let Some(result) = &record.result {
        details.push(ProvenanceDetail::new("finished", &result.finished));
        details.push(ProvenanceDetail::new("ended by", ended_by(run, result)));
        details.push(ProvenanceDetail::new("updates", result.updates.to_string()));
        details.push(ProvenanceDetail::new("steps", result.steps.to_string()));
        details.push(ProvenanceDetail::new("SHA-256 of the weights", &result.weights_sha256));
        details.extend(best(run));
        let same = record.is_reproducible(&run.directory).unwrap_or(false);
        details.push(ProvenanceDetail::new("same weights again", if same { "yes" } else { "no" }));
    }
    details
}

/// Says which setting ended a run, and where it stood.
fn ended_by(run: &RunFiles, result: &RunResult) -> String {
    let setting = |section: &str, key: &str| {
        let value = run.config.get(section).and_then(|section| section.get(key));
        let value = value.map_or_else(String::new, |value| format!(" = {value}"));
        format!("{section}.{key}{value}")
    };
    match result.end {
        ResultCause::TotalSteps => setting("learner", "total_steps"),
        ResultCause::StopAt => {
            let last = run.held_out.last().and_then(score_sentence).unwrap_or_default();
            format!("{}: {last}", setting("evaluation", "stop_at"))
        }
    }
}

/// Says which policy is the best, and by what; nothing where none was evaluated while the run trained.
fn best(run: &RunFiles) -> Option<ProvenanceDetail> {
    let line = held_out::of_best(&run.directory)?;
    Some(ProvenanceDetail::new("best policy", score_sentence(&line)?))
}

/// Says what an evaluation on held-out episodes found.
fn score_sentence(line: &Map<String, Value>) -> Option<String> {
    let number = |key: &str| line.get(key).and_then(Value::as_f64);
    let (measure, score) = match number("held_out/success") {
        Some(success) => ("success", success),
        None => ("return", number("held_out/return")?),
    };
    Some(format!(
        "from update {}: {measure} {score:.2} \u{b1} {:.2} over {} held-out episodes",
        number("update")?,
        number("held_out/error")?,
        number("held_out/episodes")?
    ))
}

/// The built-in configuration that a run's own is nearest to.
#[derive(Debug, Default)]
struct NearestBuiltIn {
    /// Its name; `None` if there is none for the domain.
    name: Option<String>,
    /// What differs from it: before, it; after, the run.
    changes: Vec<Change>,
}

impl NearestBuiltIn {
    fn of(tasks: &Tasks, config: &toml::Table) -> Self {
        let domain = config.get("domain").and_then(toml::Value::as_str);
        // What such a task is has to be found out by starting what steps it.
        if domain.is_none_or(|domain| tasks.registry.asks(domain)) {
            return Self::default();
        }
        let changes = |name: &str| {
            let file = tasks.catalog.file(name);
            let source = ConfigSource { file, ..ConfigSource::default() };
            if tasks.catalog.domain(name).as_deref() != domain {
                return None;
            }
            let built_in = Config::load(&source, &tasks.catalog, &tasks.registry).ok()?;
            let mut changes = difference(&built_in.table, config);
            changes.retain(|change| !NOT_SETTINGS.contains(&change.key.as_str()));
            Some(Self { name: Some(name.to_owned()), changes })
        };
        let all = tasks.catalog.names().filter_map(changes);
        // The first of those with the fewest: a domain's own comes before its variants.
        all.min_by_key(|nearest| nearest.changes.len()).unwrap_or_default()
    }
}

/// Lays out the settings in which any run differs from its built-in configuration; `None` if there are none.
fn changed(names: &[&str], all_nearest: &[NearestBuiltIn]) -> Option<Table> {
    let all = || all_nearest.iter().flat_map(|nearest| &nearest.changes);
    let keys: BTreeSet<&str> = all().map(|change| change.key.as_str()).collect();
    if keys.is_empty() {
        return None;
    }
    let built_in =
        |nearest: &NearestBuiltIn| nearest.name.clone().unwrap_or_else(|| "built in".to_owned());
    let alone = all_nearest.len() == 1;
    let first = all_nearest.first().filter(|_| alone).map(built_in);
    let mut table = Table::new(
        [String::new()].into_iter().chain(first).chain(names.iter().map(|&name| name.to_owned())),
    );
    for key in keys {
        let find = |nearest: &NearestBuiltIn| {
            nearest.changes.iter().find(|change| change.key == key).cloned()
        };
        let written = |text: String| if text.is_empty() { "\u{2013}".to_owned() } else { text };
        let mut row = vec![key.to_owned()];
        if alone {
            row.extend(all_nearest.iter().filter_map(find).map(|change| written(change.before)));
        }
        let as_built_in = || "as built in".to_owned();
        let value =
            |nearest: &NearestBuiltIn| find(nearest).map_or_else(as_built_in, |c| written(c.after));
        row.extend(all_nearest.iter().map(value));
        table.push(row);
    }
    Some(table)
}

/// Writes the command that trains a run again: from its built-in configuration if that gives the same settings, else from
/// the file in its directory.
fn command(tasks: &Tasks, run: &RunFiles, nearest: &NearestBuiltIn, program: &str) -> String {
    let mut changes: Vec<String> = Vec::new();
    for change in &nearest.changes {
        let mut parts = change.key.splitn(3, '.');
        let (section, key) = (parts.next().unwrap_or_default(), parts.next());
        // A table inside a section is a choice, and is written whole.
        let (path, value) = match key {
            Some(key) => {
                let value = run.config.get(section).and_then(|section| section.get(key));
                (format!("{section}.{key}"), value)
            }
            None => (section.to_owned(), run.config.get(section)),
        };
        let change = value.map(|value| format!("{path}={value}"));
        changes.extend(change.filter(|change| !changes.contains(change)));
    }
    let seed = run.record.seed;
    let set = changes.iter().map(|change| Override::parse(change)).collect::<Result<Vec<_>, _>>();
    let again = nearest.name.as_deref().zip(set.ok()).and_then(|(name, set)| {
        let (file, seed) = (tasks.catalog.file(name), Some(seed));
        let source = ConfigSource { file, set, seed, ..ConfigSource::default() };
        let config = Config::load(&source, &tasks.catalog, &tasks.registry).ok()?;
        let mut changes = difference(&config.table, &run.config);
        changes.retain(|change| !change.key.starts_with("run."));
        changes.is_empty().then_some(name)
    });
    let mut words = vec!["up".to_owned(), "-c".to_owned()];
    match again {
        Some(name) => {
            words.extend([name.to_owned(), "--seed".to_owned(), seed.to_string()]);
            words.extend(changes.into_iter().flat_map(|change| ["--set".to_owned(), change]));
        }
        None => words.push(run.directory.join("config.toml").display().to_string()),
    }
    // A name has at most 64 characters; that of a directory may be none.
    let name: String = run.record.name.chars().take(58).collect();
    words.extend(["--name".to_owned(), format!("{name}-again")]);
    if run.record.origin.is_some() {
        // The run that it was forked from may have gone on since.
        let initial = run.directory.join(INITIAL_POLICY).display().to_string();
        words.extend(["--fork".to_owned(), initial]);
    }
    command_line(program, words.into_iter().map(Into::into))
}

#[cfg(test)]
#[path = "report_tests.rs"]
mod tests;
