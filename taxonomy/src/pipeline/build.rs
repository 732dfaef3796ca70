//! All stages, from a plan to a file: what is asked next depends only on what was answered so far.

use super::backend::{Call, Reply, Stage};
use super::caller::Caller;
use super::candidate::{Candidate, Reason};
use super::coverage::Coverage;
use super::curve::heard;
use super::error::PipelineError;
use super::log::LogHeader;
use super::plan::{Plan, RateForm, TopicPlan};
use super::progress::Progress;
use super::prompts::{Prompts, Writer};
use super::reply;
use super::representatives::choose;
use super::rules::Rules;
use super::{backend, export};
use crate::database::Taxonomy;
use crate::error::TaxonomyError;
use crate::utterance::Cell;
use crate::words;

/// What a run made.
#[derive(Debug)]
pub struct Built {
    /// The database, as a file.
    pub text: String,
    /// The same, read back and checked; an error if a topic got nothing.
    pub taxonomy: Result<Taxonomy, TaxonomyError>,
    /// Everything that was proposed, in order.
    pub candidates: Vec<Candidate>,
    /// What came of it.
    pub coverage: Coverage,
    /// Calls made in this run; what the log answered is not counted.
    pub calls: u64,
}

/// Makes a database.
///
/// # Errors
///
/// [`PipelineError`] if a backend cannot answer, answers nonsense, or a budget is spent: the log keeps what was paid,
/// and the next run goes on from there.
pub fn build(
    plan: &Plan,
    prompts: &Prompts,
    caller: &mut Caller<'_>,
) -> Result<Built, PipelineError> {
    let writer = Writer::new(plan, prompts);
    let summary = caller.ask(&writer.summarise()?)?.1.text;
    let mut progress = propose(plan, &writer, &summary, caller)?;
    let kept = choose(plan, &mut progress.candidates, caller)?;
    let text = export::database(plan, &caller.header(), &kept);
    let taxonomy = Taxonomy::from_toml(&text);
    let coverage = Coverage::new(plan, &progress.candidates, &progress.rounds);
    let calls = caller.calls();
    Ok(Built { text, taxonomy, candidates: progress.candidates, coverage, calls })
}

/// Asks for sentences and rates them until every cell has enough, or was asked often enough.
fn propose(
    plan: &Plan,
    writer: &Writer<'_>,
    summary: &str,
    caller: &mut Caller<'_>,
) -> Result<Progress, PipelineError> {
    let rules = Rules::new(plan);
    let mut progress = Progress::new(plan);
    while let Some((topic, cell, round)) = progress.next(plan) {
        let there = progress.texts(topic);
        let call = writer.generate(summary, &plan.topic[topic], (cell, round), &there)?;
        let (source, answer) = caller.ask(&call)?;
        if answer.finish == backend::Finish::Exhausted {
            progress.given_up.insert((topic, cell));
            continue;
        }
        let sentences = reply::sentences(&answer);
        caller.judge(Stage::Generate, !sentences.is_empty())?;
        for text in sentences {
            let mut candidate = Candidate {
                topic,
                requested: cell,
                text,
                spans: Vec::new(),
                rated: Vec::new(),
                curve: Vec::new(),
                landed: None,
                clamped: false,
                reason: None,
                medoid: None,
                source: source.clone(),
            };
            if let Err(reason) =
                examine(plan, writer, &rules, (&mut progress, caller), &mut candidate)?
            {
                candidate.reason = Some(reason);
            }
            progress.add(candidate);
        }
    }
    Ok(progress)
}

/// Applies the rules to a proposal, has it rated, and finds where it lands.
fn examine(
    plan: &Plan,
    writer: &Writer<'_>,
    rules: &Rules,
    (progress, caller): (&mut Progress, &mut Caller<'_>),
    candidate: &mut Candidate,
) -> Result<Result<(), Reason>, PipelineError> {
    let structure = match rules.check(&candidate.text, candidate.topic) {
        Ok(structure) => structure,
        Err(reason) => return Ok(Err(reason)),
    };
    candidate.spans = structure.spans;
    if let Some(reason) = progress.repeated(candidate) {
        return Ok(Err(reason));
    }
    let topic = &plan.topic[candidate.topic];
    let Some(rated) = rate(plan, writer, caller, topic, &candidate.text)? else {
        return Ok(Err(Reason::Malformed));
    };
    candidate.rated = rated;
    let settings = &plan.settings;
    let heard = match heard(&candidate.rated, settings.theta, plan.words[0], settings.max_drop) {
        Ok(heard) => heard,
        Err(reason) => return Ok(Err(reason)),
    };
    candidate.landed = Some(Cell::new(heard.comprehension, heard.curve.len() as u32));
    candidate.curve = heard.curve;
    candidate.clamped = heard.clamped;
    Ok(Ok(()))
}

/// Has a sentence rated, word by word; none if no reply can be read. Shape `[l]`.
///
/// # Errors
///
/// [`PipelineError`] if there are no replies.
pub fn rate(
    plan: &Plan,
    writer: &Writer<'_>,
    caller: &mut Caller<'_>,
    topic: &TopicPlan,
    text: &str,
) -> Result<Option<Vec<u8>>, PipelineError> {
    let n_words = words::count(text) as usize;
    let mut ratings: Vec<Vec<u8>> = Vec::new();
    for repeat in 0..plan.settings.repeats {
        let first = repeat * plan.settings.tries;
        let rating = match plan.settings.rate {
            RateForm::Joint => {
                let ask = |attempt| writer.rate_joint(topic, text, attempt);
                let read = |reply: &Reply| reply::joint_rating(reply, n_words);
                readable(caller, first..first + plan.settings.tries, ask, read)?
            }
            RateForm::Prefix => {
                let mut curve = Some(Vec::with_capacity(n_words));
                for n in 1..=n_words {
                    let ask = |attempt| writer.rate_prefix(topic, text, n, attempt);
                    let tries = first..first + plan.settings.tries;
                    let percent = readable(caller, tries, ask, reply::percentage)?;
                    curve = curve.zip(percent).map(|(mut curve, percent)| {
                        curve.push(percent);
                        curve
                    });
                    if curve.is_none() {
                        break;
                    }
                }
                curve
            }
        };
        let Some(rating) = rating else { return Ok(None) };
        ratings.push(rating);
    }
    Ok(Some((0..n_words).map(|word| median(&ratings, word)).collect()))
}

/// Asks again, with another seed, until a reply can be read.
fn readable<T>(
    caller: &mut Caller<'_>,
    attempts: std::ops::Range<u32>,
    ask: impl Fn(u32) -> Result<Call, PipelineError>,
    read: impl Fn(&Reply) -> Option<T>,
) -> Result<Option<T>, PipelineError> {
    for attempt in attempts {
        let found = read(&caller.ask(&ask(attempt)?)?.1);
        caller.judge(Stage::Rate, found.is_some())?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

fn median(ratings: &[Vec<u8>], word: usize) -> u8 {
    let mut values: Vec<u8> = ratings.iter().map(|rating| rating[word]).collect();
    values.sort_unstable();
    values[values.len() / 2]
}

impl Built {
    /// Writes everything that was proposed, one JSON object per line.
    pub fn candidates_jsonl(&self) -> String {
        let line = |candidate| serde_json::to_string(candidate).unwrap_or_default() + "\n";
        self.candidates.iter().map(line).collect()
    }

    /// Writes the report.
    pub fn report(&self, plan: &Plan, header: &LogHeader) -> String {
        self.coverage.report(plan, header, &self.candidates)
    }
}

#[cfg(test)]
#[path = "build_tests.rs"]
mod tests;
