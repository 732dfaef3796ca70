//! Answers from phrase lists: What, How and Why in every natural order, with k and l exact by construction.

use leadtime_numerics::Pcg64;

use super::backend::{Call, Input, Model, Reply};
use super::error::BackendError;
use super::plan::{DatabasePlan, hash};
use super::presuppose::Presuppositions;
use super::reply::joined;
use super::structure::Lexicon;
use crate::utterance::{Cell, Fidelity, SpanKind, WordSpan};
use crate::words;

/// Orders in which people say it; a reason between manner and directive is not one of them.
const ORDERS: [&[SpanKind]; 9] = [
    &[SpanKind::What],
    &[SpanKind::What, SpanKind::How],
    &[SpanKind::How, SpanKind::What],
    &[SpanKind::What, SpanKind::Why],
    &[SpanKind::Why, SpanKind::What],
    &[SpanKind::What, SpanKind::How, SpanKind::Why],
    &[SpanKind::How, SpanKind::What, SpanKind::Why],
    &[SpanKind::Why, SpanKind::What, SpanKind::How],
    &[SpanKind::Why, SpanKind::How, SpanKind::What],
];

/// Comprehension once the directive is out, in percent.
const UNDERSTOOD: u8 = 95;

/// Answers from the phrase lists of a plan.
#[derive(Clone, Debug)]
pub(super) struct Grammar {
    plan: DatabasePlan,
    lexicon: Lexicon,
    presupposed: Presuppositions,
}

impl Grammar {
    /// Takes a plan's phrases.
    pub(super) fn new(plan: &DatabasePlan) -> Self {
        let presupposed = Presuppositions::new(plan);
        Self { plan: plan.clone(), lexicon: Lexicon::new(plan), presupposed }
    }

    /// Lists every sentence of a topic that lands in a cell, in a fixed order without a pattern; first one that is always true.
    fn sentences(&self, topic: &str, cell: Cell) -> Vec<String> {
        let Some(topic_idx) = self.plan.topic_idx(topic) else { return Vec::new() };
        let topic = &self.plan.topic[topic_idx];
        let nothing = [String::new()];
        let hows = if topic.how.is_empty() { &self.plan.how } else { &topic.how };
        let mut found = Vec::new();
        for order in ORDERS {
            let list = |part| if order.contains(&part) { None } else { Some(&nothing[..]) };
            let hows = list(SpanKind::How).unwrap_or(hows);
            let whys = list(SpanKind::Why).unwrap_or(&topic.why);
            for what in &topic.what {
                let pairs = hows.iter().flat_map(|how| whys.iter().map(move |why| (how, why)));
                found
                    .extend(pairs.filter_map(|(how, why)| sentence(order, [what, how, why], cell)));
            }
        }
        found.sort_unstable();
        found.dedup();
        let name = hash(format!("{} {} {cell}", self.plan.domain, topic.id).as_bytes());
        let seed = u64::from_str_radix(&name[..16], 16).unwrap_or_default();
        Pcg64::seed_from_u64(seed).shuffle(&mut found);
        let is_always_true = |text: &String| self.presupposed.facts(topic_idx, text).is_empty();
        if let Some(place) = found.iter().position(is_always_true) {
            found[..=place].rotate_right(1);
        }
        found
    }

    fn rate(&self, topic: &str, text: &str, n_words: Option<usize>) -> Reply {
        let spoken = words::words(text);
        let topic = self.plan.topic_idx(topic);
        let structure = self.lexicon.analyse(&spoken).ok();
        let spans = structure.filter(|found| Some(found.topic) == topic).map(|found| found.spans);
        let numbers = understood(&spans.unwrap_or_default(), spoken.len());
        if let Some(n) = n_words {
            let heard = n.checked_sub(1).and_then(|word| numbers.get(word)).copied();
            return Reply::complete(heard.unwrap_or_default().to_string());
        }
        Reply::complete(format!("Comprehension after each word: {}", joined(&numbers)))
    }
}

/// Rates a sentence of `n_words` by its spans alone: it is understood with the last word of its directive. Shape `[n_words]`.
pub(super) fn understood(spans: &[WordSpan], n_words: usize) -> Vec<u8> {
    let what = spans.iter().find(|span| span.part == SpanKind::What);
    let end = what.map_or(usize::MAX, |what| what.to as usize);
    let percent = |i: usize| if i + 1 >= end { UNDERSTOOD } else { 10 + (40 * i / n_words) as u8 };
    (0..n_words).map(percent).collect()
}

/// Puts phrases together, if that gives the k and l of a cell.
fn sentence(order: &[SpanKind], phrases: [&str; 3], cell: Cell) -> Option<String> {
    let phrase = |part| phrases[part as usize];
    let mut n_words = 0;
    let mut comprehension = 0;
    let mut text = String::new();
    for (i, &part) in order.iter().enumerate() {
        n_words += words::count(phrase(part));
        if part == SpanKind::What {
            comprehension = n_words;
        }
        // A reason is set off, wherever it stands.
        let comma = i > 0 && (part == SpanKind::Why || order[i - 1] == SpanKind::Why);
        let set_off = if comma { "," } else { "" };
        let space = if i > 0 { " " } else { "" };
        text.extend([set_off, space, phrase(part)]);
    }
    if (comprehension, n_words) != (cell.comprehension, cell.conveyance) {
        return None;
    }
    let mut letters = text.chars();
    let first = letters.next()?.to_uppercase();
    Some(format!("{first}{}.", letters.as_str()))
}

impl Model for Grammar {
    fn id(&self) -> &'static str {
        "grammar of phrases"
    }

    fn fidelity(&self) -> Fidelity {
        Fidelity::Grammar
    }

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        Ok(match &call.input {
            Input::Domain => Reply::complete(self.plan.missing.trim()),
            Input::Sentences { topic, cell, n, round } => {
                let all = self.sentences(topic, *cell);
                Reply::page(all.iter().map(String::as_str), *n, *round)
            }
            Input::Sentence { topic, text, words } => self.rate(topic, text, *words),
            Input::Text { text } => Reply::complete(text.clone()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::job;
    use crate::pipeline::reply::joint_rating;

    #[test]
    fn every_cell_of_every_domain_has_sentences_with_exact_k_and_l() {
        for domain in crate::shipped::domains() {
            let plan = job::plan(domain).unwrap();
            let grammar = Grammar::new(&plan);
            for topic in &plan.topic {
                for cell in Cell::feasible(2, 5) {
                    let list = grammar.sentences(&topic.id, cell);
                    assert!(list.len() >= 3, "{domain} {} {cell}: {list:?}", topic.id);
                    let rating = grammar.rate(&topic.id, &list[0], None);
                    let rated = joint_rating(&rating, cell.conveyance as usize).unwrap();
                    let crossing = rated.iter().position(|p| *p >= 70).unwrap() as u32 + 1;
                    assert_eq!(crossing, cell.comprehension, "{}", list[0]);
                }
            }
        }
    }
}
