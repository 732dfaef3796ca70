//! All stages, from a plan to a file: what is asked next depends only on what was answered so far.

use super::backend::{Call, CallStage, Finish};
use super::caller::Caller;
use super::candidate::{Candidate, Reason};
use super::controls::{self, RaterControl};
use super::coverage::Coverage;
use super::curve::listen;
use super::error::PipelineError;
use super::export;
use super::log::LogHeader;
use super::plan::DatabasePlan;
use super::progress::BuildProgress;
use super::prompts::{PromptWriter, Prompts};
use super::rating::Rating;
use super::reply::{self, Proposals};
use super::representatives::choose;
use super::rules::Rules;
use crate::database::Taxonomy;
use crate::error::TaxonomyError;
use crate::utterance::Cell;

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
    /// What the rater made of nothing and of words in another order.
    pub controls: Vec<RaterControl>,
    /// Calls made in this run; what the log answered is not counted.
    pub calls: u64,
}

/// Makes a database.
///
/// If a backend cannot answer, answers nonsense, or a budget is spent, the log keeps what was paid, and the next run
/// goes on from there.
pub(super) fn build(
    plan: &DatabasePlan,
    prompts: &Prompts,
    caller: &mut Caller<'_>,
) -> Result<Built, PipelineError> {
    let writer = PromptWriter { plan, prompts };
    let summary = caller.ask(&writer.summarise()?)?.1.text;
    let mut progress = propose(plan, &writer, &summary, caller)?;
    let kept = choose(plan, &mut progress.candidates, caller)?;
    let text = export::database(plan, &caller.header, &kept);
    let taxonomy = Taxonomy::from_toml(&text);
    let rating = Rating { writer: &writer, stage: CallStage::Control };
    let controls = controls::controls(&rating, caller, &kept)?;
    let BuildProgress { candidates, rounds, .. } = progress;
    let coverage = Coverage::new(&candidates, &rounds, &caller.replies);
    Ok(Built { text, taxonomy, candidates, coverage, controls, calls: caller.calls })
}

/// Asks for sentences and rates them until every cell has enough, or was asked often enough.
fn propose(
    plan: &DatabasePlan,
    writer: &PromptWriter<'_>,
    summary: &str,
    caller: &mut Caller<'_>,
) -> Result<BuildProgress, PipelineError> {
    let rules = Rules::new(plan);
    let rating = Rating { writer, stage: CallStage::Rate };
    let mut progress = BuildProgress::new(plan);
    while let Some((topic, cell, round)) = progress.next(plan) {
        let there = progress.texts(topic);
        let call = writer.generate(summary, &plan.topic[topic], cell, round, &there)?;
        take(&rules, &rating, &mut progress, caller, topic, cell, &call)?;
    }
    // Cells that others have filled, or that the number of generations did not reach.
    for (topic, cell) in progress.never_asked() {
        let there = progress.texts(topic);
        let call = writer.generate(summary, &plan.topic[topic], cell, 0, &there)?;
        if caller.holds(&call) {
            progress.ask(topic, cell);
            take(&rules, &rating, &mut progress, caller, topic, cell, &call)?;
        }
    }
    Ok(progress)
}

/// Asks for sentences, and examines them.
fn take(
    rules: &Rules,
    rating: &Rating<'_>,
    progress: &mut BuildProgress,
    caller: &mut Caller<'_>,
    topic: usize,
    cell: Cell,
    call: &Call,
) -> Result<(), PipelineError> {
    let (source, answer) = caller.ask(call)?;
    if answer.finish == Finish::Exhausted {
        progress.given_up.insert((topic, cell));
        return Ok(());
    }
    let Proposals { whole, cut } = reply::sentences(&answer);
    caller.judge(CallStage::Generate, !whole.is_empty())?;
    for text in whole {
        let mut candidate = Candidate::new(topic, cell, text, &source);
        candidate.reason = examine(rules, rating, progress, caller, &mut candidate)?.err();
        progress.add(candidate);
    }
    if let Some(text) = cut {
        let mut candidate = Candidate::new(topic, cell, text, &source);
        candidate.reason = Some(Reason::Truncated);
        progress.add(candidate);
    }
    Ok(())
}

/// Applies the rules to a proposal, has it rated, and finds where it lands.
fn examine(
    rules: &Rules,
    rating: &Rating<'_>,
    progress: &mut BuildProgress,
    caller: &mut Caller<'_>,
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
    let Some(rated) = rating.words(caller, candidate.topic, &candidate.text)? else {
        return Ok(Err(Reason::Malformed));
    };
    candidate.rated = rated;
    let DatabasePlan { settings, words, .. } = rating.writer.plan;
    let heard = match listen(&candidate.rated, settings.theta, words[0], settings.max_drop) {
        Ok(heard) => heard,
        Err(reason) => return Ok(Err(reason)),
    };
    candidate.landed = Some(Cell::new(heard.comprehension, heard.curve.len() as u32));
    candidate.curve = heard.curve;
    candidate.clamped = heard.clamped;
    rating.margin(caller, candidate)
}

impl Built {
    /// Writes everything that was proposed, one JSON object per line.
    pub fn candidates_jsonl(&self) -> String {
        let line = |candidate| serde_json::to_string(candidate).unwrap_or_default() + "\n";
        self.candidates.iter().map(line).collect()
    }

    /// Writes the coverage report, which a person reads before they trust a database.
    pub fn report(&self, plan: &DatabasePlan, header: &LogHeader) -> String {
        self.coverage.report(plan, header, &self.candidates, &self.controls)
    }
}

#[cfg(test)]
#[path = "build_tests.rs"]
mod tests;
