//! `report.html` of a run, from what lies in its directory and from an evaluation, if there was one.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use leadtime_config::Config;
use leadtime_eval::figure::{Band, BandPanel, ShareRow};
use leadtime_eval::measure::Comparison;
use leadtime_eval::report::{Book, Fact, Picture, Report, Verdict};
use leadtime_runs::{ProgramBuild, RunRecord, journal};
use serde_json::{Map, Value};

use crate::output;

/// Points of a learning curve.
const N_POINTS: usize = 120;

/// What an evaluation adds to a run's own records.
#[derive(Debug, Default)]
pub(super) struct Findings {
    /// Introduction for readers who do not know the run.
    pub(super) lead: String,
    /// Claims, and whether they hold.
    pub(super) verdicts: Vec<Verdict>,
    /// The players side by side.
    pub(super) comparison: Option<Comparison>,
    /// Playthroughs.
    pub(super) pictures: Vec<Picture>,
    /// Remarks for the reader.
    pub(super) notes: Vec<String>,
}

impl Findings {
    /// Describes a run whose policy has not been evaluated.
    pub(super) fn of_training(config: &Config) -> Self {
        let (domain, n_updates) = (&config.domain, config.learner.n_updates());
        let n_steps = config.steps_per_update();
        let lead = format!(
            "Training on domain {domain}, {n_updates} updates of {n_steps} steps by a learner and separate actors. The \
             policy was not evaluated here: the curves are of training episodes (see `leadtime eval`)."
        );
        Self { lead, ..Self::default() }
    }
}

/// Writes the report into the run's directory.
pub(super) fn write(directory: &Path, findings: Findings) -> anyhow::Result<()> {
    let record = RunRecord::read(directory)?;
    let journal = journal::read(directory).context("reading metrics.jsonl")?;
    let books = record.result.as_ref().map(|result| &result.books);
    let report = Report {
        title: format!("Run {}", record.name),
        lead: findings.lead,
        verdicts: findings.verdicts,
        comparison: findings.comparison,
        pictures: findings.pictures,
        curves: curves(&journal),
        staleness: staleness(&journal),
        phases: phases(&journal),
        books: books.map(account).unwrap_or_default(),
        books_balance: books.and_then(|books| books["balanced"].as_bool()),
        provenance: provenance(&record),
        notes: findings.notes,
    };
    output::file(&directory.join("report.html"), report.html().as_bytes())
}

fn curves(journal: &[Map<String, Value>]) -> Vec<BandPanel> {
    let panels: [(&str, &str, Option<[f64; 2]>); 5] = [
        ("episodes/success", "success", Some([0.0, 1.0])),
        ("episodes/return", "return", None),
        ("episodes/length", "episode length (steps)", None),
        ("train/entropy", "entropy (nats)", None),
        ("train/approx_kl", "approximate KL (nats)", None),
    ];
    let panel = |(key, label, range): (&str, &str, Option<[f64; 2]>)| {
        let points = points(journal, key);
        let (label, bands) = (label.to_owned(), vec![Band::summary(&points, N_POINTS)]);
        (!points.is_empty()).then_some(BandPanel { label, range, bands })
    };
    panels.into_iter().filter_map(panel).collect()
}

fn points(journal: &[Map<String, Value>], key: &str) -> Vec<[f64; 2]> {
    let point =
        |line: &Map<String, Value>| Some([line.get("steps")?.as_f64()?, line.get(key)?.as_f64()?]);
    journal.iter().filter_map(point).collect()
}

fn staleness(journal: &[Map<String, Value>]) -> BTreeMap<u64, u64> {
    let mut counts = BTreeMap::new();
    for line in journal {
        let update = line.get("staleness").and_then(Value::as_object);
        for (staleness, n) in update.into_iter().flatten() {
            if let (Ok(staleness), Some(n)) = (staleness.parse(), n.as_u64()) {
                *counts.entry(staleness).or_default() += n;
            }
        }
    }
    counts
}

fn phases(journal: &[Map<String, Value>]) -> Vec<ShareRow> {
    let sum = |key: &str| journal.iter().filter_map(|line| line.get(key)?.as_f64()).sum();
    let training = ("training".to_owned(), sum("system/train_seconds"));
    let waiting = ("waiting for rollouts".to_owned(), sum("system/wait_seconds"));
    vec![ShareRow { label: "learner".to_owned(), parts: vec![training, waiting] }]
}

fn account(books: &Value) -> Vec<Book> {
    let meanings = [
        ("published", "arrived in order, over all actors and their starts"),
        ("trained", "an update trained on them"),
        ("dropped_stale", "too stale to use"),
        ("refused", "broke a rule of the wire or of the run"),
        ("superseded", "their environment had moved on"),
        ("unused_at_end", "waited when the run ended"),
        ("rolled_back", "made again after a learner was killed"),
        ("duplicates", "copies, not part of published"),
    ];
    let book = |(name, meaning): (&str, &str)| Book {
        name: name.to_owned(),
        count: books[name].as_u64().unwrap_or(0),
        meaning: meaning.to_owned(),
    };
    meanings.into_iter().map(book).collect()
}

fn provenance(record: &RunRecord) -> Vec<Fact> {
    let mut facts = vec![
        Fact::new("domain", &record.domain),
        Fact::new("seed", record.seed.to_string()),
        Fact::new("started", &record.started),
    ];
    if let Some(origin) = &record.origin {
        facts.push(Fact::new("forked from", &origin.run));
        facts.push(Fact::new("SHA-256 of the starting weights", &origin.weights_sha256));
    }
    for build in &record.builds {
        let ProgramBuild { since, program, commit, cpu, threads } = build;
        let commit = commit.as_deref().unwrap_or("unknown");
        let text =
            format!("{program}, commit {commit}, on {cpu} with {threads} threads per process");
        facts.push(Fact::new(format!("program since {since}"), text));
    }
    if let Some(result) = &record.result {
        facts.push(Fact::new("finished", &result.finished));
        facts.push(Fact::new("updates", result.updates.to_string()));
        facts.push(Fact::new("steps", result.steps.to_string()));
        facts.push(Fact::new("SHA-256 of the weights", &result.weights_sha256));
        let answer = if result.reproducible { "yes" } else { "no" };
        facts.push(Fact::new("same weights again", answer));
    }
    facts
}
