//! What a person need not write of a sentence that they add: spans by the phrases of the plan, the rest as `rate` finds it.

use super::curve::listen;
use super::error::PipelineError;
use super::grammar::understood;
use super::plan::DatabasePlan;
use super::presuppose::Presuppositions;
use super::structure::Lexicon;
use crate::raw::RawUtterance;
use crate::utterance::{Cell, WordSpan};
use crate::words;

/// Takes sentences apart and rates them by the phrases of a plan.
#[derive(Debug)]
pub(super) struct Completer<'a> {
    plan: &'a DatabasePlan,
    lexicon: Lexicon,
}

impl<'a> Completer<'a> {
    pub(super) fn new(plan: &'a DatabasePlan) -> Self {
        Self { plan, lexicon: Lexicon::new(plan) }
    }

    /// Takes a sentence of a topic apart; the error says why the plan's phrases do not suffice.
    pub(super) fn spans(&self, topic: &str, text: &str) -> Result<Vec<WordSpan>, String> {
        let phrases =
            format!("add a phrase to `what` or `also_what` of topic `{topic}` in the plan");
        let found = self.lexicon.analyse(&words::words(text));
        let found =
            found.map_err(|reason| format!("it cannot be taken apart (`{reason}`): {phrases}"))?;
        let other = &self.plan.topic[found.topic].id;
        if other == topic {
            return Ok(found.spans);
        }
        Err(format!("it says what topic `{other}` says"))
    }

    /// Rates a sentence of a topic, and finds its cell; the error says why that cannot be done.
    pub(super) fn rate(&self, topic: &str, text: &str) -> Result<(Cell, Vec<u8>), String> {
        let curve = understood(&self.spans(topic, text)?, words::count(text) as usize);
        Ok((self.cell(&curve)?, curve))
    }

    /// Finds the cell of a rating; the error says why it has none.
    pub(super) fn cell(&self, curve: &[u8]) -> Result<Cell, String> {
        let DatabasePlan { settings, words: [from, to], .. } = self.plan;
        let n_words = curve.len() as u32;
        if !(*from..=*to).contains(&n_words) {
            return Err(format!("it has {n_words} words; allowed: {from} to {to}"));
        }
        let heard = listen(curve, settings.theta, *from, settings.max_drop);
        let heard = heard.map_err(|reason| format!("it has no cell (`{reason}`)"))?;
        Ok(Cell::new(heard.comprehension, n_words))
    }
}

/// Fills in what sentences presuppose that do not say so, by the phrases of the plan of their domain.
pub(super) fn presuppose(utterances: &mut [RawUtterance], plan: &DatabasePlan) {
    let presupposed = Presuppositions::new(plan);
    for raw in utterances.iter_mut().filter(|raw| raw.facts.is_none()) {
        raw.facts = plan.topic_idx(&raw.topic).map(|topic| presupposed.facts(topic, &raw.text));
    }
}

/// Fills in what a sentence of a database lacks, where it can be made; the error says what is wrong with the sentence.
///
/// `plan` is that of the database's domain, if there is one; spans cannot be made without.
pub(super) fn complete(
    raw: &mut RawUtterance,
    theta: u8,
    least: u32,
    plan: &Result<DatabasePlan, PipelineError>,
) -> Result<(), String> {
    if raw.spans.is_empty() {
        let plan = plan.as_ref().map_err(|_unknown| {
            "it lacks `spans`, and its domain has no plan here from which they could be made"
                .to_owned()
        })?;
        raw.spans = Completer::new(plan).spans(&raw.topic, &raw.text)?;
    }
    if raw.conveyance == 0 {
        raw.conveyance = words::count(&raw.text);
    }
    if raw.curve.is_empty() {
        raw.curve = understood(&raw.spans, raw.conveyance as usize);
    }
    if raw.comprehension == 0 {
        // A curve that falls or stays too low is refused when the whole sentence is checked.
        if let Ok(heard) = listen(&raw.curve, theta, least, 0) {
            (raw.comprehension, raw.clamped) = (heard.comprehension, heard.clamped);
        } else {
            raw.comprehension = raw.conveyance;
        }
    }
    Ok(())
}
