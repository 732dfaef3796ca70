//! `leadtime taxonomy report`, `export` and `validate`: what is in a call log, and in a database.

use std::path::Path;

use anyhow::Context as _;
use leadtime_proto::TaskSpec;
use leadtime_runs::Tasks;
use leadtime_taxonomy::pipeline::job::{self, Backend, BuildJob, Format};
use leadtime_taxonomy::{Cell, Finding, Taxonomy, Topic, Utterance, check, check_facts};
use serde_json::json;

use super::source;
use crate::cli::{ExportFormat, TaxonomyExportArgs, TaxonomyReportArgs, TaxonomyValidateArgs};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// What is said where no log can be meant.
const NO_LOG: &str =
    "--log is missing: a call log comes only with the program's own plans, unchanged";

pub(in crate::commands) fn report(args: &TaxonomyReportArgs) -> Result<(), Failure> {
    let plan = source::plan(&args.plan)?;
    source::directory("--prompts", args.prompts.as_deref())?;
    let made = match &args.log {
        None if source::is_shipped(&args.plan.plan) && args.plan.set.is_empty() => {
            job::replay_shipped(&plan.domain)
        }
        None => return Err(Failure::input(NO_LOG)),
        Some(log) => {
            let job = BuildJob {
                backend: Backend::Replay,
                log: log.clone(),
                prompts: args.prompts.clone(),
                embedder: None,
                rater: None,
                max_calls: None,
            };
            job::run(&plan, job)
        }
    };
    let (built, header) = made.map_err(|error| source::failure(&error))?;
    deliver(args.output.as_deref(), &built.report(&plan, &header))
}

pub(in crate::commands) fn export(args: &TaxonomyExportArgs) -> Result<(), Failure> {
    let taxonomy = source::database(&args.database)?;
    let text = match args.format {
        ExportFormat::Csv => job::export(&taxonomy, Format::Csv),
        ExportFormat::Json => job::export(&taxonomy, Format::Json),
        ExportFormat::Cells => cells(&taxonomy),
    };
    deliver(args.output.as_deref(), &text)
}

/// Writes the filled cells as a part of a configuration, and how often their sentences state a reason.
fn cells(taxonomy: &Taxonomy) -> String {
    let filled = table("cells", taxonomy, |_| Some(String::new()));
    let reasons = table("reasons", taxonomy, |said| {
        let n_stating = said.iter().filter(|utterance| utterance.states_reason()).count();
        (n_stating > 0)
            .then(|| format!(", {:?}", thousandths(n_stating as f64 / said.len() as f64)))
    });
    format!("[notifier]\n{filled}{reasons}")
}

fn thousandths(share: f64) -> f64 {
    (1000.0 * share).round() / 1000.0
}

/// Writes a list of `[topic, k, l ...]`, a line per topic: the cells for whose sentences there is something to write after l.
fn table(key: &str, taxonomy: &Taxonomy, more: impl Fn(&[Utterance]) -> Option<String>) -> String {
    let entry = |topic: &Topic, cell: Cell, said: &[Utterance]| {
        let (name, Cell { comprehension, conveyance }) = (topic.name(), cell);
        more(said).map(|more| format!("[{name:?}, {comprehension}, {conveyance}{more}]"))
    };
    let line = |topic: &Topic| {
        let cells = topic.cells().filter_map(|(cell, said)| entry(topic, cell, said));
        let cells: Vec<String> = cells.collect();
        if cells.is_empty() { String::new() } else { format!("    {},\n", cells.join(", ")) }
    };
    let lines: String = taxonomy.topics().iter().map(line).collect();
    if lines.is_empty() { String::new() } else { format!("{key} = [\n{lines}]\n") }
}

fn deliver(path: Option<&Path>, text: &str) -> Result<(), Failure> {
    let Some(path) = path else {
        output::data(text.trim_end());
        return Ok(());
    };
    output::file(path, text.as_bytes()).blame(ExitCode::WrongInput)
}

pub(in crate::commands) fn validate(
    tasks: &Tasks,
    args: &TaxonomyValidateArgs,
) -> Result<(), Failure> {
    let taxonomy = source::database(&args.database)?;
    let told = fits(tasks, &taxonomy).with_context(|| args.database.display().to_string());
    let told = told.blame(ExitCode::WrongInput)?;
    let mut findings = check(&taxonomy, args.wanted);
    findings.extend(job::check_words(&taxonomy));
    findings.extend(told.iter().flat_map(|told| check_facts(&taxonomy, told)));
    let findings: Vec<String> = findings.iter().map(Finding::to_string).collect();
    let told = told.unwrap_or_default();
    let unused: Vec<&str> = told.into_iter().filter(|fact| !names(&taxonomy, fact)).collect();
    let header = taxonomy.header();
    let n_kept: usize = taxonomy.topics().iter().map(|topic| topic.utterances().len()).sum();
    let n_topics = taxonomy.topics().len();
    if args.json {
        output::json(&json!({
            "database": args.database.display().to_string(),
            "domain": header.domain,
            "fidelity": header.fidelity.name(),
            "topics": n_topics,
            "sentences": n_kept,
            "findings": findings,
            "unused_facts": unused,
        }));
    } else {
        let (database, domain, fidelity) =
            (args.database.display(), &header.domain, header.fidelity.name());
        let sentences = format!("{n_kept} sentences on {n_topics} topics");
        output::line(&format!("{database}: domain {domain}, {sentences}, fidelity {fidelity}"));
        findings.iter().map(String::as_str).for_each(output::line);
        if !unused.is_empty() {
            output::line(&format!("no sentence presupposes {}", unused.join(", ")));
        }
    }
    if args.strict && !findings.is_empty() {
        return Err(Failure::silent(ExitCode::Failed));
    }
    Ok(())
}

/// Returns whether some sentence presupposes a fact.
fn names(taxonomy: &Taxonomy, fact: &str) -> bool {
    taxonomy.facts().iter().any(|name| name == fact)
}

/// Makes sure that a database of a domain that the program knows speaks of its topics and presupposes what it tells; returns
/// the names of that; `None` if it does not know the domain.
fn fits(tasks: &Tasks, taxonomy: &Taxonomy) -> anyhow::Result<Option<Vec<&'static str>>> {
    let domain = taxonomy.header().domain.clone();
    let task = TaskSpec { domain, settings: "{}".to_owned() };
    let topics = tasks.topics(&task);
    if topics.is_empty() {
        return Ok(None);
    }
    taxonomy.expect_topics(&topics)?;
    let told: Vec<&str> = tasks.facts(&task).iter().map(|fact| fact.name).collect();
    taxonomy.expect_facts(&told)?;
    Ok(Some(told))
}
