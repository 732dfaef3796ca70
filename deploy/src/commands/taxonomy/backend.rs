//! From the command line to who writes, rates and compares.

use std::env;
use std::path::Path;

use leadtime_taxonomy::Fidelity;
use leadtime_taxonomy::pipeline::closed_set::ClosedSet;
use leadtime_taxonomy::pipeline::http::HttpSettings;
use leadtime_taxonomy::pipeline::job::Backend;
use leadtime_taxonomy::pipeline::lexical::Lexical;
use leadtime_taxonomy::pipeline::{Embedder, Model, Plan};

use super::source::failure;
use crate::cli::{BackendArgs, BackendName, Claim};
use crate::exit::Failure;

/// What is said where the program lacks the feature.
#[cfg(not(feature = "local-models"))]
const NOT_BUILT_IN: &str =
    "this program was built without local models: build it with `--features local-models`";

/// Returns who writes and rates.
///
/// # Errors
///
/// Wrong input: a key that is not there, a backend that was not built in.
pub(super) fn backend(args: &BackendArgs) -> Result<Backend, Failure> {
    match args.backend {
        Some(BackendName::Authored) => Ok(Backend::Authored(args.annotations.clone())),
        Some(BackendName::Grammar) => Ok(Backend::Grammar),
        Some(BackendName::Http) => Ok(Backend::Http(http(args)?)),
        #[cfg(feature = "local-models")]
        Some(BackendName::Local) => Ok(local(args)),
        #[cfg(not(feature = "local-models"))]
        Some(BackendName::Local) => Err(Failure::input(NOT_BUILT_IN)),
        None => Ok(Backend::Replay),
    }
}

fn http(args: &BackendArgs) -> Result<HttpSettings, Failure> {
    let text = |value: &Option<String>| value.clone().unwrap_or_default();
    let mut settings = HttpSettings::new(&text(&args.url), &text(&args.model));
    settings.api_key = match &args.api_key_env {
        Some(variable) => Some(
            env::var(variable)
                .map_err(|error| Failure::input(format!("--api-key-env {variable}: {error}")))?,
        ),
        None => None,
    };
    settings.fidelity = match args.fidelity {
        Claim::Paper => Fidelity::Paper,
        Claim::Local => Fidelity::Local,
    };
    (settings.timeout, settings.tries, settings.backoff) = (args.timeout, args.tries, args.backoff);
    Ok(settings)
}

#[cfg(feature = "local-models")]
fn local(args: &BackendArgs) -> Backend {
    use leadtime_taxonomy::pipeline::local::{LlamaSettings, Style};
    Backend::Local(LlamaSettings {
        path: args.gguf.clone().unwrap_or_default(),
        sha256: args.sha256.clone().unwrap_or_default().to_lowercase(),
        style: if args.completion { Style::Completion } else { Style::Chat },
        // candle reads the variable itself; what it does to the text belongs to the model's name.
        dequantized: env::var("CANDLE_DEQUANTIZE_ALL")
            .is_ok_and(|all| !all.is_empty() && all != "0"),
    })
}

/// Returns who rates in the writer's place, if anybody.
///
/// # Errors
///
/// As [`embedder`].
pub(super) fn rater(
    plan: &Plan,
    by_likeness: bool,
    directory: Option<&Path>,
) -> Result<Option<Box<dyn Model>>, Failure> {
    if !by_likeness {
        return Ok(None);
    }
    let embedder = embedder(directory)?.unwrap_or_else(|| Box::new(Lexical));
    let rater = ClosedSet::new(plan, embedder).map_err(|error| failure(&error.into()))?;
    Ok(Some(Box::new(rater)))
}

/// Returns who compares sentences; nobody if no model is named.
///
/// # Errors
///
/// Wrong input: a model that is not the one it should be, or cannot be loaded here.
#[cfg(feature = "local-models")]
pub(super) fn embedder(directory: Option<&Path>) -> Result<Option<Box<dyn Embedder>>, Failure> {
    use leadtime_taxonomy::pipeline::local::MiniLm;
    let Some(directory) = directory else { return Ok(None) };
    let minilm = MiniLm::load(directory).map_err(|error| failure(&error.into()))?;
    Ok(Some(Box::new(minilm)))
}

/// Returns who compares sentences; nobody if no model is named.
///
/// # Errors
///
/// Wrong input: no model can be loaded here.
#[cfg(not(feature = "local-models"))]
pub(super) fn embedder(directory: Option<&Path>) -> Result<Option<Box<dyn Embedder>>, Failure> {
    match directory {
        Some(_) => Err(Failure::input(NOT_BUILT_IN)),
        None => Ok(None),
    }
}
