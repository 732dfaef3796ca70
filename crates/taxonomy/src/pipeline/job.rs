//! Whole jobs from files, for the program: build, rate, report, export, validate.

use std::path::{Path, PathBuf};

use super::annotator::Annotator;
use super::backend::{CallStage, Embedder, LoggedBackend, Model};
use super::build::{Built, build};
use super::caller::{Backends, CallMode, Caller, not_in_log};
use super::complete::{complete, presuppose};
use super::error::PipelineError;
use super::export;
use super::grammar::Grammar;
use super::http::{Http, HttpSettings};
use super::lexical::Lexical;
use super::log::{CallLog, LogHeader};
use super::plan::DatabasePlan;
use super::presuppose::Presuppositions;
use super::prompts::{PromptWriter, Prompts};
use super::rating::Rating;
use super::regular;
use crate::check::Finding;
use crate::database::Taxonomy;
use crate::error::TaxonomyError;
use crate::raw::RawDatabase;
use crate::utterance::{Fidelity, SpanKind, WordSpan};

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
    let allowed = "highway, lander or steakhouse, or the path of a plan";
    let found = SOURCES.iter().find(|source| source.domain == domain);
    found.ok_or_else(|| PipelineError::plan("domain", domain, allowed))
}

/// Reads a plan that comes with the crate.
///
/// # Errors
///
/// [`PipelineError::Unusable`] if none is shipped for the domain.
pub fn plan(domain: &str) -> Result<DatabasePlan, PipelineError> {
    DatabasePlan::from_toml(source(domain)?.plan)
}

/// Reads a plan from a file, or the one that comes with the crate under that name.
///
/// # Errors
///
/// [`PipelineError`] if it is neither a shipped plan nor a file that can be read, or if the plan breaks a rule.
pub fn plan_or_file(name_or_path: &Path) -> Result<DatabasePlan, PipelineError> {
    if let Some(source) = SOURCES.iter().find(|source| name_or_path.as_os_str() == source.domain) {
        return plan(source.domain);
    }
    DatabasePlan::from_toml(&regular::read_to_string(name_or_path)?)
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
    /// No model: the log holds every reply.
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

/// Makes a database from a plan.
///
/// # Errors
///
/// [`PipelineError`] if the log is another job's or lacks a reply that may not be asked for, if a model cannot be
/// reached, refuses or answers wrongly too often, or if the calls are spent. It is one sentence that says what to do.
pub fn run(plan: &DatabasePlan, job: BuildJob) -> Result<(Built, LogHeader), PipelineError> {
    let prompts = match &job.prompts {
        Some(directory) => Prompts::from_directory(directory)?,
        None => Prompts::default(),
    };
    if matches!(job.backend, Backend::Replay) {
        return replay(plan, &prompts, &job.log, &regular::read_to_string(&job.log)?);
    }
    PromptWriter { plan, prompts: &prompts }.check()?;
    let generator = generator(plan, &job.backend)?;
    let embedder = job.embedder.unwrap_or_else(|| Box::new(Lexical));
    let backends = Backends { generator, rater: job.rater, embedder };
    let mut log = CallLog::open(&job.log)?;
    let mode = CallMode::Live { max_calls: job.max_calls };
    let mut caller = Caller::new(backends, &mut log, mode, &plan.domain)?;
    let built = build(plan, &prompts, &mut caller)?;
    Ok((built, caller.header))
}

fn generator(plan: &DatabasePlan, backend: &Backend) -> Result<Box<dyn Model>, PipelineError> {
    Ok(match backend {
        Backend::Authored(Some(path)) => {
            Box::new(Annotator::parse(&regular::read_to_string(path)?, plan)?)
        }
        Backend::Authored(None) => {
            let shipped = source(&plan.domain).map_err(|_unknown| {
                let (domain, known) = (&plan.domain, SOURCES.map(|source| source.domain));
                PipelineError::Unusable(format!(
                    "--annotations is missing: none come with `{domain}`, only with {}",
                    known.join(", ")
                ))
            })?;
            Box::new(Annotator::parse(shipped.annotations, plan)?)
        }
        Backend::Grammar => Box::new(Grammar::new(plan)),
        Backend::Http(settings) => Box::new(Http::new(settings.clone())?),
        Backend::Replay => Box::new(LoggedBackend { id: String::new(), fidelity: Fidelity::Local }),
    })
}

/// Makes the database of a finished log again, without asking anybody.
pub(super) fn replay(
    plan: &DatabasePlan,
    prompts: &Prompts,
    path: &Path,
    log: &str,
) -> Result<(Built, LogHeader), PipelineError> {
    let mut log = CallLog::read(path, log)?;
    let header = log.header.clone();
    let header = header.ok_or_else(|| not_in_log("who was asked: the log is empty"))?;
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
/// [`PipelineError`] if none is shipped for the domain.
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
    let topic = plan.topic_idx(topic).ok_or_else(|| {
        let known: Vec<&str> = plan.topic.iter().map(|topic| topic.id.as_str()).collect();
        let (domain, known) = (&plan.domain, known.join(", "));
        PipelineError::Unusable(format!(
            "--topic {topic}: the plan of `{domain}` has no such topic; its topics: {known}"
        ))
    })?;
    let writer = PromptWriter { plan, prompts: &Prompts::default() };
    let generator = generator(plan, backend)?;
    let backends = Backends { generator, rater: None, embedder: Box::new(Lexical) };
    let mut log = CallLog::open(log)?;
    let mode = CallMode::Live { max_calls: None };
    let mut caller = Caller::new(backends, &mut log, mode, &plan.domain)?;
    let rating = Rating { writer: &writer, stage: CallStage::Rate };
    texts.iter().map(|text| rating.words(&mut caller, topic, text)).collect()
}

/// Reads a database in which a sentence needs no more than its topic and its text.
///
/// `spans`, `curve`, `comprehension` and `conveyance` are made where they are missing, as [`rate_texts`] makes them with
/// [`Backend::Grammar`]; spans need a domain whose plan comes with the crate. For such a domain `facts` are made as well,
/// by the plan's phrases.
///
/// # Errors
///
/// [`TaxonomyError`] if a sentence breaks a rule, in the cases of [`Taxonomy::from_toml`]; it names the sentence and
/// what is wrong with it.
pub fn database(text: &str) -> Result<Taxonomy, TaxonomyError> {
    let mut raw = RawDatabase::read(text)?;
    let plan = plan(&raw.domain);
    for (index, utterance) in raw.utterance.iter_mut().enumerate() {
        if !utterance.lacks().is_empty() {
            complete(utterance, raw.theta, raw.words[0], &plan)
                .map_err(|defect| utterance.wrong(index, &defect))?;
        }
    }
    let Ok(plan) = plan else { return Taxonomy::from_raw(raw) };
    presuppose(&mut raw.utterance, &plan);
    Ok(Taxonomy::from_raw(raw)?.planned(plan.facts()))
}

/// Lists what is wrong between the words of sentences and the facts that they presuppose: a reason that names no fact, and
/// a phrase of the domain's plan whose fact is left out.
pub fn check_words(taxonomy: &Taxonomy) -> Vec<Finding> {
    let presupposed = plan(&taxonomy.header().domain).ok().map(|plan| Presuppositions::new(&plan));
    let mut findings = Vec::new();
    for (topic_idx, topic) in taxonomy.topics().iter().enumerate() {
        for utterance in topic.utterances() {
            let stated: Vec<&str> = taxonomy.fact_names(utterance.facts).collect();
            let phrases = presupposed.as_ref().map(|known| known.named(topic_idx, &utterance.text));
            let phrases = phrases.unwrap_or_default();
            let mut named = phrases.iter().flat_map(|phrase| phrase.facts);
            let mut find = |says: &str| {
                let says = format!(", \"{}\": {says}", utterance.text);
                findings.push(Finding::new(topic.name(), says));
            };
            let mut reasons = utterance.spans.iter().filter(|span| span.part == SpanKind::Why);
            let is_known = |span: &WordSpan| {
                phrases.iter().any(|it| it.from < span.to as usize && span.from < it.to as u32)
            };
            if let Some(left_out) = named.find(|fact| !stated.contains(&fact.as_str())) {
                find(&format!("its words presuppose `{left_out}`, its `facts` do not"));
            } else if stated.is_empty() && reasons.any(|span| !is_known(span)) {
                find("it gives a reason and presupposes no fact");
            }
        }
    }
    findings
}

/// A form for other tools.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One line per sentence.
    Csv,
    /// One object with all sentences.
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
        let says = "--topic stop: the plan of `highway` has no such topic; its topics: slow_down, speed_up, \
                    merge_left, merge_right";
        assert_eq!(error, says);
    }

    #[test]
    fn a_fact_of_the_plan_that_its_world_does_not_tell_makes_no_other_sentence_useless() {
        let added = |entry: &str| {
            let shipped = crate::shipped::text("highway").unwrap();
            database(&format!("{shipped}\n[[utterance]]\ntopic = \"slow_down\"\n{entry}\n"))
                .unwrap()
        };
        let shipped = crate::shipped("highway").unwrap();
        let told: Vec<&str> = shipped.facts().iter().map(String::as_str).collect();
        let truck = added("text = \"Truck ahead, slow down.\"");
        truck.expect_facts(&told).unwrap();
        let findings = crate::check_facts(&truck, &told);
        assert_eq!(findings.len(), 1);
        assert!(
            findings[0]
                .to_string()
                .contains("it is never said, because it presupposes `truck_near`")
        );
        let error = added("text = \"Moon up, slow down.\"\nfacts = [\"moon_up\", \"truck_near\"]");
        let error = error.expect_facts(&told).unwrap_err().to_string();
        assert!(error.contains("presupposes `moon_up`, which the domain does not tell"), "{error}");
    }

    #[test]
    fn a_sentence_that_is_added_to_a_database_needs_its_topic_and_its_text() {
        let added = |text: &str| {
            let shipped = crate::shipped::text("lander").unwrap();
            database(&format!("{shipped}\n[[utterance]]\ntopic = \"ascend\"\n{text}\n"))
        };
        let taxonomy = added("text = \"Zone ahead, climb up now.\"").unwrap();
        let cell = taxonomy.topics()[0].cell(crate::Cell::new(4, 5));
        let sentence = cell.iter().find(|found| found.text == "Zone ahead, climb up now.").unwrap();
        assert_eq!(sentence.curve, [10, 18, 26, 95, 95]);
        assert_eq!(sentence.what().map(|what| (what.from, what.to)), Some((2, 4)));
        let taxonomy =
            added("text = \"Higher, please.\"\nspans = [[\"what\", 0, 1]]\ncurve = [60, 90]")
                .unwrap();
        assert_eq!(taxonomy.topics()[0].cell(crate::Cell::new(2, 2)).len(), 5);
        for (text, says) in [
            (
                "text = \"Higher, please.\"",
                "utterance 161 of topic `ascend`, \"Higher, please.\": it cannot be taken apart",
            ),
            ("text = \"Go down soon.\"", "\"Go down soon.\": it says what topic `descend` says"),
            (
                "text = \"Climb up at once, danger ahead.\"",
                "its (k, l) is (2, 6); allowed: 2 <= k <= l <= 5",
            ),
            (
                "text = \"Zone ahead, climb up.\"\ncomprehension = 2",
                "reaches 70 percent at word 4; `comprehension` says word 2",
            ),
            ("text = \"Climb up soon.\"\ncurve = [10, 20, 30]", "reaches 70 percent at no word"),
        ] {
            let error = added(text).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
        let own = "schema = 1\ndomain = \"road\"\nfidelity = \"authored\"\ngenerator = \"\"\nrater = \"\"\nembedder = \"\"\n\
            theta = 70\nwords = [2, 5]\ntopics = [\"left\"]\nconfig = \"\"\n[[utterance]]\ntopic = \"left\"\ntext = \"Go left.\"\n";
        let error = database(own).unwrap_err().to_string();
        assert!(
            error.ends_with(
                "it lacks `spans`, and its domain has no plan here from which they could be made"
            ),
            "{error}"
        );
        let taxonomy = database(&format!("{own}spans = [[\"what\", 0, 2]]\n")).unwrap();
        assert_eq!(taxonomy.topics()[0].cell(crate::Cell::new(2, 2)).len(), 1);
    }
}
