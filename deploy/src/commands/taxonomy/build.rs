//! `leadtime taxonomy build`: a plan becomes a database, by asking or from a finished call log.

use std::fs;
use std::path::Path;

use anyhow::Context as _;
use leadtime_taxonomy::pipeline::build::Built;
use leadtime_taxonomy::pipeline::job::{self, BuildJob};
use leadtime_taxonomy::pipeline::log::LogHeader;
use leadtime_taxonomy::pipeline::{DatabasePlan, PipelineError};
use leadtime_taxonomy::{Finding, check};
use serde_json::json;

use super::{backend, source};
use crate::cli::TaxonomyBuildArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// Names of the files in the output directory.
const LOG: &str = "calls.jsonl";
const DATABASE: &str = "taxonomy.toml";
const REPORT: &str = "coverage.md";
const CANDIDATES: &str = "candidates.jsonl";
/// Sentences that a cell should have, to take turns.
const WANTED: usize = 3;

pub(in crate::commands) fn run(args: &TaxonomyBuildArgs) -> Result<(), Failure> {
    let plan = source::plan(&args.plan)?;
    source::directory("--prompts", args.prompts.as_deref())?;
    source::directory("--embedder", args.embedder.as_deref())?;
    let job = job(args)?;
    fs::create_dir_all(&args.output)
        .with_context(|| format!("--output {}", args.output.display()))
        .blame(ExitCode::WrongInput)?;
    tracing::info!(domain = %plan.domain, log = %job.log.display(), "making words");
    let (built, header) = match job::run(&plan, job) {
        Ok(made) => made,
        Err(PipelineError::BudgetSpent { calls }) => {
            output::say(&PipelineError::BudgetSpent { calls }.to_string());
            // A script has to tell it from a database that was made.
            if args.json {
                output::json(&json!({"database": null, "calls": calls, "stopped": true}));
            }
            return Ok(());
        }
        Err(error) => return Err(source::failure(&error)),
    };
    write(&args.output, &plan, &built, &header).blame(ExitCode::WrongInput)?;
    print(args, &built, &header)
}

fn job(args: &TaxonomyBuildArgs) -> Result<BuildJob, Failure> {
    Ok(BuildJob {
        backend: backend::backend(&args.backend)?,
        log: args.replay.clone().unwrap_or_else(|| args.output.join(LOG)),
        prompts: args.prompts.clone(),
        embedder: backend::embedder(args.embedder.as_deref())?,
        rater: None,
        max_calls: args.max_calls,
    })
}

/// Writes report, proposals and, if it can be used, the database.
fn write(
    directory: &Path,
    plan: &DatabasePlan,
    built: &Built,
    header: &LogHeader,
) -> anyhow::Result<()> {
    let write = |name, text: &str| output::file(&directory.join(name), text.as_bytes());
    write(REPORT, &built.report(plan, header))?;
    write(CANDIDATES, &built.candidates_jsonl())?;
    if built.taxonomy.is_ok() { write(DATABASE, &built.text) } else { Ok(()) }
}

fn print(args: &TaxonomyBuildArgs, built: &Built, header: &LogHeader) -> Result<(), Failure> {
    let coverage = &built.coverage;
    let taxonomy = built.taxonomy.as_ref().map_err(|error| {
        let report = args.output.join(REPORT);
        anyhow::anyhow!(
            "what came out cannot be used: {error}; {} says what was turned down and why",
            report.display()
        )
    })?;
    let n_kept: usize = taxonomy.topics().iter().map(|topic| topic.utterances().len()).sum();
    let n_filled = coverage.cells.values().filter(|counts| counts.kept > 0).count();
    let (n_cells, database) = (coverage.cells.len(), args.output.join(DATABASE));
    let findings: Vec<String> = check(taxonomy, WANTED).iter().map(Finding::to_string).collect();
    if args.json {
        output::json(&json!({
            "database": database,
            "fidelity": header.fidelity.name(),
            "generator": header.generator,
            "rater": header.rater,
            "embedder": header.embedder,
            "proposed": coverage.proposed,
            "accepted": coverage.accepted,
            "kept": n_kept,
            "cells": n_cells,
            "filled": n_filled,
            "calls": built.calls,
            "findings": findings,
        }));
        return Ok(());
    }
    let (shown, fidelity) = (database.display(), header.fidelity.name());
    output::line(&format!(
        "{shown}: {n_kept} sentences in {n_filled} of {n_cells} cells, fidelity {fidelity}"
    ));
    let (proposed, accepted, calls) = (coverage.proposed, coverage.accepted, built.calls);
    output::line(&format!("proposed {proposed}, accepted {accepted}, calls {calls}"));
    findings.iter().map(String::as_str).for_each(output::line);
    Ok(())
}
