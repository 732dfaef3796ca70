//! `leadtime taxonomy report`, `export` and `validate`: what is in a call log, and in a database.

use std::path::Path;

use anyhow::Context as _;
use leadtime_proto::TaskSpec;
use leadtime_taxonomy::pipeline::job::{self, Backend, BuildJob, Format};
use leadtime_taxonomy::{Cell, Finding, Taxonomy, Topic, check};
use serde_json::json;

use super::source;
use crate::cli::{ExportFormat, TaxonomyExportArgs, TaxonomyReportArgs, TaxonomyValidateArgs};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;
use leadtime_runs::Tasks;
use leadtime_runs::write_atomically;

/// What is said where no log can be meant.
const NO_LOG: &str =
    "--log is missing: a call log comes only with the program's own plans, unchanged";

pub(super) fn report(args: &TaxonomyReportArgs) -> Result<(), Failure> {
    let plan = source::plan(&args.plan)?;
    source::directory("--prompts", args.prompts.as_deref())?;
    let made = match &args.log {
        None if source::is_shipped(&args.plan.plan) && args.plan.set.is_empty() => {
            job::replay_shipped(&plan.domain)
        }
        None => return Err(Failure::input(NO_LOG)),
        Some(log) => {
            let (log, prompts) = (log.clone(), args.prompts.clone());
            let nobody = (Backend::Replay, None, None, None);
            let (backend, embedder, rater, max_calls) = nobody;
            job::run(&plan, BuildJob { backend, log, prompts, embedder, rater, max_calls })
        }
    };
    let (built, header) = made.map_err(|error| source::failure(&error))?;
    deliver(args.output.as_deref(), &built.report(&plan, &header))
}

pub(super) fn export(args: &TaxonomyExportArgs) -> Result<(), Failure> {
    let taxonomy = source::database(&args.database)?;
    let text = match args.format {
        ExportFormat::Csv => job::export(&taxonomy, Format::Csv),
        ExportFormat::Json => job::export(&taxonomy, Format::Json),
        ExportFormat::Cells => cells(&taxonomy),
    };
    deliver(args.output.as_deref(), &text)
}

/// Writes the filled cells as a part of a configuration.
fn cells(taxonomy: &Taxonomy) -> String {
    let of_topic = |topic: &Topic| {
        let cell = |cell: Cell| {
            let (k, l) = (cell.comprehension, cell.conveyance);
            format!("[{:?}, {k}, {l}]", topic.name())
        };
        let cells: Vec<String> = topic.cells().map(|(filled, _)| cell(filled)).collect();
        format!("    {},\n", cells.join(", "))
    };
    let topics: String = taxonomy.topics().iter().map(of_topic).collect();
    format!("[notifier]\ncells = [\n{topics}]\n")
}

fn deliver(path: Option<&Path>, text: &str) -> Result<(), Failure> {
    let Some(path) = path else {
        output::line(text.trim_end());
        return Ok(());
    };
    write_atomically(path, text.as_bytes())
        .with_context(|| format!("writing {}", path.display()))
        .blame(ExitCode::WrongInput)
}

pub(super) fn validate(tasks: &Tasks, args: &TaxonomyValidateArgs) -> Result<(), Failure> {
    let taxonomy = source::database(&args.database)?;
    fits(tasks, &taxonomy).with_context(|| args.database.clone()).blame(ExitCode::WrongInput)?;
    let findings: Vec<String> =
        check(&taxonomy, args.wanted).iter().map(Finding::to_string).collect();
    let header = taxonomy.header();
    let n_kept: usize = taxonomy.topics().iter().map(|topic| topic.utterances().len()).sum();
    let n_topics = taxonomy.topics().len();
    if args.json {
        output::json(&json!({
            "database": args.database,
            "domain": header.domain,
            "fidelity": header.fidelity.name(),
            "topics": n_topics,
            "sentences": n_kept,
            "findings": findings,
        }));
    } else {
        output::line(&format!(
            "{}: domain {}, {n_kept} sentences on {n_topics} topics, fidelity {}",
            args.database,
            header.domain,
            header.fidelity.name()
        ));
        for finding in &findings {
            output::line(finding);
        }
    }
    if args.strict && !findings.is_empty() {
        return Err(Failure::silent(ExitCode::Failed));
    }
    Ok(())
}

/// Makes sure that a database of a domain that the program knows speaks of its topics.
fn fits(tasks: &Tasks, taxonomy: &Taxonomy) -> anyhow::Result<()> {
    let domain = taxonomy.header().domain.clone();
    let topics = tasks.topics(&TaskSpec { domain, settings: "{}".to_owned() });
    if topics.is_empty() {
        return Ok(());
    }
    Ok(taxonomy.expect_topics(&topics)?)
}
