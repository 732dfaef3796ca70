//! `leadtime taxonomy ...`: how the sentences of a domain are made, looked at and checked.

use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgGroup, Args, Subcommand, ValueEnum};

use super::duration;
use leadtime_config::Override;
use leadtime_voice::VoiceChoice;

/// `leadtime taxonomy ...`
#[derive(Debug, Subcommand)]
pub(crate) enum TaxonomyCommand {
    /// Build a database from a plan: ask for sentences, rate them word by word, keep the most representative.
    Build(TaxonomyBuildArgs),
    /// Rate your own sentences word by word: which cells would they fill?
    Rate(TaxonomyRateArgs),
    /// Print the report of a finished call log: cells, rejections, thresholds, sentences to review.
    Report(TaxonomyReportArgs),
    /// Print a database in another form.
    Export(TaxonomyExportArgs),
    /// Check a database and list its empty cells.
    Validate(TaxonomyValidateArgs),
    /// Speak every sentence of a database into a file of sound, with the time of each word, for `serve --voice recorded:DIR`.
    Speak(TaxonomySpeakArgs),
}

/// Who writes and rates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BackendName {
    /// An annotator's file of sentences and ratings.
    Authored,
    /// The phrase lists of the plan.
    Grammar,
    /// A language model behind HTTP, by the chat API that llama.cpp's server, vLLM and Ollama share.
    Http,
}

/// What may be claimed of what a language model writes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum Claim {
    /// An instruct model of the source's class (Llama-3-8B or more) wrote and rated.
    Paper,
    /// A smaller stand-in.
    #[default]
    Local,
}

/// What sentences are made for.
#[derive(Clone, Debug, Args)]
pub(crate) struct PlanArgs {
    /// The plan: `highway`, `lander`, `steakhouse`, or a file.
    pub plan: PathBuf,
    /// Change one key of the plan: `--set settings.theta=60`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
}

/// Who writes and rates, and how to reach them.
#[derive(Clone, Debug, Args)]
pub(crate) struct BackendArgs {
    /// Who writes and rates.
    #[arg(long, value_enum, value_name = "WHO")]
    pub backend: Option<BackendName>,
    /// Annotations for `authored` (default: those that come with the plan's domain).
    #[arg(long, value_name = "FILE")]
    pub annotations: Option<PathBuf>,
    /// Base of the server's API for `http`: `http://127.0.0.1:8080/v1`.
    #[arg(long, value_name = "URL", required_if_eq("backend", "http"))]
    pub url: Option<String>,
    /// Model for `http`, as the server names it.
    #[arg(long, value_name = "MODEL", required_if_eq("backend", "http"))]
    pub model: Option<String>,
    /// Environment variable that holds the key for `http`, sent as bearer token and never logged.
    #[arg(long, value_name = "VARIABLE")]
    pub api_key_env: Option<String>,
    /// What may be claimed of what the model for `http` writes (default: `local`).
    #[arg(long, value_enum)]
    pub fidelity: Option<Claim>,
    /// How long to wait for an answer over `http`.
    #[arg(long, value_name = "DURATION", default_value = "2m", value_parser = duration)]
    pub timeout: Duration,
    /// How often a call over `http` is tried, 1 to 10.
    #[arg(long, default_value_t = 5)]
    pub tries: u32,
    /// Wait before the second try over `http`; doubles with each further one.
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = duration)]
    pub backoff: Duration,
}

/// `leadtime taxonomy build`
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("who").required(true).args(["backend", "replay"])))]
pub(crate) struct TaxonomyBuildArgs {
    #[command(flatten)]
    pub plan: PlanArgs,
    /// Directory for call log, database, report and everything that was proposed; a run that was cut off goes on from
    /// the call log in it.
    #[arg(short, long, alias = "out", value_name = "DIR", default_value = "words")]
    pub output: PathBuf,
    /// Make no calls: rebuild the database of a finished call log, byte for byte.
    #[arg(long, value_name = "LOG")]
    pub replay: Option<PathBuf>,
    #[command(flatten)]
    pub backend: BackendArgs,
    /// Directory of prompt templates; those that it lacks are the built-in ones.
    #[arg(long, value_name = "DIR")]
    pub prompts: Option<PathBuf>,
    /// Compare sentences by the `MiniLM` embedder in this directory (only if built with the feature `minilm`), instead of
    /// by the words they share.
    #[arg(long, value_name = "DIR", conflicts_with = "replay")]
    pub embedder: Option<PathBuf>,
    /// Stop after this many calls; the same command continues.
    #[arg(long, value_name = "CALLS", conflicts_with = "replay")]
    pub max_calls: Option<u64>,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `leadtime taxonomy rate`
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("who").required(true).args(["backend"])))]
#[command(
    override_usage = "leadtime taxonomy rate [OPTIONS] --topic <TOPIC> --backend <WHO>\n       <PLAN> <SENTENCE>..."
)]
pub(crate) struct TaxonomyRateArgs {
    #[command(flatten)]
    pub plan: PlanArgs,
    /// The topic of the sentences.
    #[arg(long)]
    pub topic: String,
    /// The sentences, one argument each.
    #[arg(required = true, value_name = "SENTENCE")]
    pub sentences: Vec<String>,
    #[command(flatten)]
    pub backend: BackendArgs,
    /// Keep the replies in this call log, and do not repeat the calls that it holds.
    #[arg(long, value_name = "LOG")]
    pub log: Option<PathBuf>,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `leadtime taxonomy report`
#[derive(Debug, Args)]
pub(crate) struct TaxonomyReportArgs {
    #[command(flatten)]
    pub plan: PlanArgs,
    /// The call log (default: the one that comes with the plan's domain).
    #[arg(long, value_name = "LOG")]
    pub log: Option<PathBuf>,
    /// Directory of the prompt templates that the log was made with.
    #[arg(long, value_name = "DIR", requires = "log")]
    pub prompts: Option<PathBuf>,
    /// Write the report here instead of printing it.
    #[arg(short, long, alias = "out", value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// A form in which a database can be printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExportFormat {
    /// One line per sentence.
    Csv,
    /// One object.
    Json,
    /// The filled cells, as `notifier.cells` of a configuration.
    Cells,
}

/// `leadtime taxonomy export`
#[derive(Debug, Args)]
pub(crate) struct TaxonomyExportArgs {
    /// The database: a file, or the domain whose shipped one is meant.
    pub database: PathBuf,
    /// The form.
    #[arg(long, value_enum, default_value = "csv")]
    pub format: ExportFormat,
    /// Write it here instead of printing it.
    #[arg(short, long, alias = "out", value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// `leadtime taxonomy speak`
#[derive(Debug, Args)]
pub(crate) struct TaxonomySpeakArgs {
    /// The database: a file, or the domain whose shipped one is meant.
    pub database: PathBuf,
    /// Who speaks: `flite[:VOICE]`, `espeak`, or a helper by `pipe:COMMAND`.
    #[arg(long, value_name = "VOICE", default_value = "flite")]
    pub voice: VoiceChoice,
    /// Directory for `sound.wav` and `voice.json`.
    #[arg(short, long, alias = "out", value_name = "DIR")]
    pub output: PathBuf,
}

/// `leadtime taxonomy validate`
#[derive(Debug, Args)]
pub(crate) struct TaxonomyValidateArgs {
    /// The database: a file, or the domain whose shipped one is meant.
    pub database: PathBuf,
    /// Sentences that every cell should have, to take turns.
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub wanted: usize,
    /// End with exit code 1 if the database lacks anything.
    #[arg(long)]
    pub strict: bool,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
}
