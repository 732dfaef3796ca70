//! `leadtime taxonomy report`, `export` and `validate`: what is in a call log, and in a database.

use std::path::Path;

use anyhow::Context as _;
use leadtime_proto::TaskSpec;
use leadtime_runs::Tasks;
use leadtime_taxonomy::pipeline::job::{self, Backend, BuildJob, Format};
use leadtime_taxonomy::{Cell, Finding, Taxonomy, Topic, check};
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
    output::file(path, text.as_bytes()).blame(ExitCode::WrongInput)
}

pub(in crate::commands) fn validate(
    tasks: &Tasks,
    args: &TaxonomyValidateArgs,
) -> Result<(), Failure> {
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
        let (database, domain, fidelity) = (&args.database, &header.domain, header.fidelity.name());
        let sentences = format!("{n_kept} sentences on {n_topics} topics");
        output::line(&format!("{database}: domain {domain}, {sentences}, fidelity {fidelity}"));
        findings.iter().map(String::as_str).for_each(output::line);
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
