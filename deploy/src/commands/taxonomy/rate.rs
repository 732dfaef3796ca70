//! `leadtime taxonomy rate`: where would sentences of one's own land?

use anyhow::Context as _;
use leadtime_taxonomy::pipeline::curve::listen;
use leadtime_taxonomy::pipeline::{DatabasePlan, Reason, job};
use leadtime_taxonomy::{Cell, words};
use serde_json::json;

use super::{backend, source};
use crate::cli::TaxonomyRateArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(in crate::commands) fn run(args: &TaxonomyRateArgs) -> Result<(), Failure> {
    let plan = source::plan(&args.plan)?;
    let empty = args.sentences.iter().find(|sentence| words::count(sentence) == 0);
    if let Some(sentence) = empty {
        return Err(Failure::input(format!("\"{sentence}\" has no words")));
    }
    let backend = backend::backend(&args.backend)?;
    // Replies have to be kept somewhere while the command runs.
    let scratch = tempfile::tempdir().context("a temporary directory").blame(ExitCode::Failed)?;
    let log = args.log.clone().unwrap_or_else(|| scratch.path().join("calls.jsonl"));
    let ratings = job::rate_texts(&plan, &backend, &log, &args.topic, &args.sentences)
        .map_err(|error| source::failure(&error))?;
    for (sentence, rating) in args.sentences.iter().zip(ratings) {
        print(args, &plan, sentence, rating.as_deref());
    }
    Ok(())
}

/// Finds the cell of a rating, or why it has none.
fn cell(plan: &DatabasePlan, rating: Option<&[u8]>) -> Result<Cell, Reason> {
    let rating = rating.ok_or(Reason::Malformed)?;
    let settings = &plan.settings;
    let heard = listen(rating, settings.theta, plan.words[0], settings.max_drop)?;
    Ok(Cell::new(heard.comprehension, heard.curve.len() as u32))
}

fn print(args: &TaxonomyRateArgs, plan: &DatabasePlan, sentence: &str, rating: Option<&[u8]>) {
    let cell = cell(plan, rating);
    if args.json {
        output::json(&json!({
            "text": sentence,
            "topic": args.topic,
            "comprehension": cell.ok().map(|cell| cell.comprehension),
            "conveyance": words::count(sentence),
            "rated": rating,
            "reason": cell.err(),
        }));
        return;
    }
    let place = match cell {
        Ok(cell) => format!("(k, l) = {cell}"),
        Err(reason) => reason.to_string(),
    };
    let percents = rating.unwrap_or_default().iter().map(u8::to_string).collect::<Vec<_>>();
    output::line(&format!("{place}  {sentence}  [{}]", percents.join(", ")));
}
