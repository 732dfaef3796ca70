//! Whole jobs from files, for the program: build, rate, report, export, validate.

use std::path::{Path, PathBuf};

use super::annotator::Annotator;
use super::backend::{CallStage, Embedder, LoggedBackend, Model};
use super::build::{Built, build};
use super::caller::{Backends, CallMode, Caller};
use super::error::PipelineError;
use super::export;
use super::grammar::Grammar;
use super::http::{Http, HttpSettings};
use super::lexical::Lexical;
use super::log::{CallLog, LogHeader};
use super::plan::DatabasePlan;
use super::prompts::{PromptWriter, Prompts};
use super::rating::Rating;
use crate::check::{Finding, check};
use crate::database::Taxonomy;

/// What comes with the crate for one domain: its plan, and the annotations and call log of its database.
#[derive(Clone, Copy, Debug)]
struct ShippedSource {
    domain: &'static str,
    plan: &'static str,
    annotations: &'static str,
    log: &'static str,
}

macro_rules! source {
    ($domain:literal) => {
        ShippedSource {
            domain: $domain,
            plan: include_str!(concat!("../../data/", $domain, "/plan.toml")),
            annotations: include_str!(concat!("../../data/", $domain, "/annotations.txt")),
            log: include_str!(concat!("../../data/", $domain, "/calls.jsonl")),
        }
    };
}

const SOURCES: [ShippedSource; 3] = [source!("highway"), source!("lander"), source!("steakhouse")];

fn source(domain: &str) -> Result<&'static ShippedSource, PipelineError> {
    SOURCES.iter().find(|source| source.domain == domain).ok_or_else(|| PipelineError::Plan {
        key: "domain".to_owned(),
        given: domain.to_owned(),
        allowed: "highway, lander or steakhouse, or the path of a plan".to_owned(),
    })
}

/// Reads a plan that comes with the crate.
///
/// # Errors
///
/// [`PipelineError::Plan`] if there is none for the domain.
pub fn plan(domain: &str) -> Result<DatabasePlan, PipelineError> {
    DatabasePlan::from_toml(source(domain)?.plan)
}

/// Reads a plan from a file, or the one that comes with the crate under that name.
///
/// # Errors
///
/// [`PipelineError`] naming what cannot be read.
pub fn plan_or_file(name_or_path: &str) -> Result<DatabasePlan, PipelineError> {
    if SOURCES.iter().any(|source| source.domain == name_or_path) {
        return plan(name_or_path);
    }
    let path = Path::new(name_or_path);
    DatabasePlan::from_toml(&std::fs::read_to_string(path).map_err(PipelineError::file(path))?)
}

/// Who writes and rates.
#[derive(Clone, Debug)]
pub enum Backend {
    /// The annotations of a file; those that come with the crate if none is given.
    Authored(Option<PathBuf>),
    /// The phrase lists of the plan.
    Grammar,
    /// A model behind HTTP.
    Http(HttpSettings),
    /// Nobody: the log holds every reply.
    Replay,
}

/// Everything about a build that is not the plan.
#[derive(Debug)]
pub struct BuildJob {
    /// Who writes and rates.
    pub backend: Backend,
    /// The call log, gone on with if it is there.
    pub log: PathBuf,
    /// Directory of prompt templates in place of the built-in ones.
    pub prompts: Option<PathBuf>,
    /// Who embeds; by shared words if none is given.
    pub embedder: Option<Box<dyn Embedder>>,
    /// Who rates; the writer if none is given.
    pub rater: Option<Box<dyn Model>>,
    /// Calls after which the run stops.
    pub max_calls: Option<u64>,
}

impl std::fmt::Debug for dyn Embedder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.id())
    }
}

impl std::fmt::Debug for dyn Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.id())
    }
}

/// Makes a database from a plan.
///
/// # Errors
///
/// [`PipelineError`] saying in one sentence what to do.
pub fn run(plan: &DatabasePlan, job: BuildJob) -> Result<(Built, LogHeader), PipelineError> {
    let prompts = match &job.prompts {
        Some(directory) => Prompts::from_directory(directory)?,
        None => Prompts::default(),
    };
    if matches!(job.backend, Backend::Replay) {
        let text = std::fs::read_to_string(&job.log).map_err(PipelineError::file(&job.log))?;
        return replay(plan, &prompts, &job.log, &text);
    }
    PromptWriter::new(plan, &prompts).check()?;
    let generator = generator(plan, &job.backend)?;
    let embedder = job.embedder.unwrap_or_else(|| Box::new(Lexical));
    let backends = Backends { generator, rater: job.rater, embedder };
    let mut log = CallLog::open(&job.log)?;
    let mode = CallMode::Live { max_calls: job.max_calls };
    let mut caller = Caller::new(backends, &mut log, mode, &plan.domain)?;
    let header = caller.header();
    Ok((build(plan, &prompts, &mut caller)?, header))
}

fn generator(plan: &DatabasePlan, backend: &Backend) -> Result<Box<dyn Model>, PipelineError> {
    Ok(match backend {
        Backend::Authored(Some(path)) => {
            let text = std::fs::read_to_string(path).map_err(PipelineError::file(path))?;
            Box::new(Annotator::parse(&text)?)
        }
        Backend::Authored(None) => Box::new(Annotator::parse(source(&plan.domain)?.annotations)?),
        Backend::Grammar => Box::new(Grammar::new(plan)),
        Backend::Http(settings) => Box::new(Http::new(settings.clone())?),
        Backend::Replay => Box::new(LoggedBackend {
            id: String::new(),
            fidelity: crate::utterance::Fidelity::Local,
        }),
    })
}

/// Makes the database of a finished log again, without asking anybody.
///
/// # Errors
///
/// [`PipelineError::NotInLog`] if the plan, a prompt or the log has changed since.
pub fn replay(
    plan: &DatabasePlan,
    prompts: &Prompts,
    path: &Path,
    log: &str,
) -> Result<(Built, LogHeader), PipelineError> {
    let mut log = CallLog::finished(path, log)?;
    let header = log.header().cloned().ok_or_else(|| PipelineError::NotInLog {
        what: "who was asked: the log is empty".to_owned(),
    })?;
    let absent = |id: &str| LoggedBackend { id: id.to_owned(), fidelity: header.fidelity };
    let backends = Backends {
        generator: Box::new(absent(&header.generator)),
        rater: Some(Box::new(absent(&header.rater))),
        embedder: Box::new(absent(&header.embedder)),
    };
    let mut caller = Caller::new(backends, &mut log, CallMode::Replay, &plan.domain)?;
    Ok((build(plan, prompts, &mut caller)?, header))
}

/// Makes a shipped database again from the log that comes with the crate.
///
/// # Errors
///
/// As [`replay`].
pub fn replay_shipped(domain: &str) -> Result<(Built, LogHeader), PipelineError> {
    let path = PathBuf::from(format!("crates/taxonomy/data/{domain}/calls.jsonl"));
    replay(&plan(domain)?, &Prompts::default(), &path, source(domain)?.log)
}

/// Has sentences of one topic rated; none where no reply could be read.
///
/// # Errors
///
/// [`PipelineError`] if the topic is unknown or there are no replies.
pub fn rate_texts(
    plan: &DatabasePlan,
    backend: &Backend,
    log: &Path,
    topic: &str,
    texts: &[String],
) -> Result<Vec<Option<Vec<u8>>>, PipelineError> {
    let known = || plan.topic.iter().map(|topic| topic.id.as_str()).collect::<Vec<_>>().join(", ");
    let topic = plan.topic_idx(topic).ok_or_else(|| PipelineError::Plan {
        key: "topic".to_owned(),
        given: topic.to_owned(),
        allowed: known(),
    })?;
    let prompts = Prompts::default();
    let writer = PromptWriter::new(plan, &prompts);
    let generator = generator(plan, backend)?;
    let backends = Backends { generator, rater: None, embedder: Box::new(Lexical) };
    let mut log = CallLog::open(log)?;
    let mode = CallMode::Live { max_calls: None };
    let mut caller = Caller::new(backends, &mut log, mode, &plan.domain)?;
    let rating = Rating::new(plan, &writer, CallStage::Rate);
    texts.iter().map(|text| rating.words(&mut caller, topic, text)).collect()
}

/// Reads a database and lists what it lacks.
///
/// # Errors
///
/// [`PipelineError`] if it cannot be read or is wrong.
pub fn validate(path: &Path, wanted: usize) -> Result<(Taxonomy, Vec<Finding>), PipelineError> {
    let text = std::fs::read_to_string(path).map_err(PipelineError::file(path))?;
    let taxonomy = Taxonomy::from_toml(&text)?;
    let findings = check(&taxonomy, wanted);
    Ok((taxonomy, findings))
}

/// A form for other tools.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One line per sentence.
    Csv,
    /// One object.
    Json,
}

/// Writes a database for other tools.
pub fn export(taxonomy: &Taxonomy, format: Format) -> String {
    match format {
        Format::Csv => export::csv(taxonomy),
        Format::Json => export::json(taxonomy),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_of_ones_own_can_be_rated() {
        let directory = tempfile::tempdir().unwrap();
        let log = directory.path().join("calls.jsonl");
        let plan = plan("highway").unwrap();
        let texts = ["Traffic, slow down.".to_owned(), "Lovely day.".to_owned()];
        let rate = |topic| rate_texts(&plan, &Backend::Grammar, &log, topic, &texts);
        let rated = rate("slow_down").unwrap();
        assert_eq!(rated[0].as_ref().unwrap()[2], 95);
        assert!(rated[1].as_ref().unwrap().iter().all(|percent| *percent < 50));
        let error = rate("stop").unwrap_err().to_string();
        let says =
            "`topic` of the plan is stop; allowed: slow_down, speed_up, merge_left, merge_right";
        assert_eq!(error, says);
    }

    #[test]
    fn files_are_validated_by_name() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("taxonomy.toml");
        let error = validate(&path, 3).unwrap_err().to_string();
        assert!(error.starts_with(&path.display().to_string()), "{error}");
        std::fs::write(&path, crate::shipped::text("lander").unwrap()).unwrap();
        let (taxonomy, findings) = validate(&path, 3).unwrap();
        assert_eq!(taxonomy.header().domain, "lander");
        assert!(findings.is_empty());
        assert!(!validate(&path, 100).unwrap().1.is_empty());
        std::fs::write(&path, "schema = ").unwrap();
        let error = validate(&path, 3).unwrap_err().to_string();
        assert!(error.contains("line 1 of the utterance database"), "{error}");
    }
}
