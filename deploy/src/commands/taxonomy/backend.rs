//! From the command line to the writer, the rater and the embedder.

use std::env;
use std::path::Path;

use leadtime_taxonomy::Fidelity;
use leadtime_taxonomy::pipeline::Embedder;
use leadtime_taxonomy::pipeline::http::HttpSettings;
use leadtime_taxonomy::pipeline::job::Backend;

use crate::cli::{BackendArgs, BackendName, Claim};
use crate::exit::Failure;

/// Returns who writes and rates; refuses what only another one would heed.
pub(super) fn backend(args: &BackendArgs) -> Result<Backend, Failure> {
    let (authored, http) = (BackendName::Authored, BackendName::Http);
    for (option, is_given, who, name) in [
        ("--annotations", args.annotations.is_some(), authored, "authored"),
        ("--url", args.url.is_some(), http, "http"),
        ("--model", args.model.is_some(), http, "http"),
        ("--api-key-env", args.api_key_env.is_some(), http, "http"),
        ("--fidelity", args.fidelity.is_some(), http, "http"),
    ] {
        if is_given && args.backend != Some(who) {
            let told = format!("{option} is for --backend {name}; leave it out");
            return Err(Failure::input(told));
        }
    }
    match args.backend {
        Some(BackendName::Authored) => Ok(Backend::Authored(args.annotations.clone())),
        Some(BackendName::Grammar) => Ok(Backend::Grammar),
        Some(BackendName::Http) => Ok(Backend::Http(http_settings(args)?)),
        None => Ok(Backend::Replay),
    }
}

fn http_settings(args: &BackendArgs) -> Result<HttpSettings, Failure> {
    let text = |value: &Option<String>| value.clone().unwrap_or_default();
    let key = |variable: &String| {
        let missing = |error| Failure::input(format!("--api-key-env {variable}: {error}"));
        env::var(variable).map_err(missing)
    };
    Ok(HttpSettings {
        url: text(&args.url),
        model: text(&args.model),
        api_key: args.api_key_env.as_ref().map(key).transpose()?,
        fidelity: match args.fidelity.unwrap_or_default() {
            Claim::Paper => Fidelity::Paper,
            Claim::Local => Fidelity::Local,
        },
        timeout: args.timeout,
        tries: args.tries,
        backoff: args.backoff,
    })
}

/// Returns the embedder that compares sentences, if one is named.
pub(super) fn embedder(directory: Option<&Path>) -> Result<Option<Box<dyn Embedder>>, Failure> {
    directory.map(load).transpose()
}

#[cfg(feature = "minilm")]
fn load(directory: &Path) -> Result<Box<dyn Embedder>, Failure> {
    use leadtime_taxonomy::pipeline::minilm::MiniLm;
    Ok(Box::new(MiniLm::load(directory).map_err(|error| super::source::failure(&error.into()))?))
}

#[cfg(not(feature = "minilm"))]
fn load(_directory: &Path) -> Result<Box<dyn Embedder>, Failure> {
    let sentence = "this program was built without an embedder: build it with `--features minilm`";
    Err(Failure::input(sentence))
}
