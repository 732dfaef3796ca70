//! Does the rater listen? It is also asked about nothing, and about words in another order.
//!
//! A rater that is sure of an action before it has heard a word rates the action and not the sentence; one that finds
//! shuffled words as clear as the sentence listens for single words.

use std::fmt::Write as _;

use leadtime_numerics::Pcg64;
use leadtime_table::Table;

use super::caller::Caller;
use super::candidate::Candidate;
use super::error::PipelineError;
use super::plan::{DatabasePlan, hash};
use super::rating::Rating;
use super::reply::joined;
use crate::words;

/// Shuffles until the order is another one, at most this often: some sentences say one word twice.
const MAX_SHUFFLES: usize = 20;

/// What the rater made of one topic's controls.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RaterControl {
    /// Index of the topic.
    pub topic: usize,
    /// Percent after nothing; none if the rater does not say.
    pub silence: Option<u8>,
    /// Sentences in another order.
    pub shuffled: Vec<Shuffled>,
}

/// A sentence and its words in another order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shuffled {
    /// The sentence in its own order.
    pub said: String,
    /// Percent after each of its words. Shape `[l]`.
    pub rated: Vec<u8>,
    /// Its words in another order.
    pub text: String,
    /// Percent after each of these; none if the rater does not say. Shape `[l]`.
    pub text_rated: Option<Vec<u8>>,
}

/// Has the controls rated: of each topic the longest representatives, from early to late understood.
pub(super) fn controls(
    rating: &Rating<'_>,
    caller: &mut Caller<'_>,
    kept: &[Candidate],
) -> Result<Vec<RaterControl>, PipelineError> {
    let plan = rating.writer.plan;
    let n_wanted = plan.settings.controls;
    let n_topics = if n_wanted > 0 { plan.topic.len() } else { 0 };
    let mut found = Vec::new();
    for topic in 0..n_topics {
        let silence = rating.after(caller, topic, "", 0, 0)?;
        let mut shuffled = Vec::new();
        for candidate in chosen(kept, topic, n_wanted) {
            let text = shuffle(plan, candidate);
            let text_rated = rating.words(caller, topic, &text)?;
            let (said, rated) = (candidate.text.clone(), candidate.rated.clone());
            shuffled.push(Shuffled { said, rated, text, text_rated });
        }
        found.push(RaterControl { topic, silence, shuffled });
    }
    Ok(found)
}

/// Takes the first representatives of the longest cells, evenly spread over k.
fn chosen(kept: &[Candidate], topic: usize, n_wanted: usize) -> Vec<&Candidate> {
    let of_topic = |candidate: &&Candidate| candidate.topic == topic;
    let l = |candidate: &Candidate| candidate.landed.map_or(0, |cell| cell.conveyance);
    let longest = kept.iter().filter(of_topic).map(l).max().unwrap_or_default();
    let first = |candidate: &&Candidate| candidate.medoid == Some(0) && l(candidate) == longest;
    let mut list: Vec<&Candidate> = kept.iter().filter(of_topic).filter(first).collect();
    list.sort_by_key(|candidate| candidate.landed);
    let n = n_wanted.min(list.len());
    (0..n).map(|i| list[if n > 1 { i * (list.len() - 1) / (n - 1) } else { 0 }]).collect()
}

fn shuffle(plan: &DatabasePlan, candidate: &Candidate) -> String {
    let said = words::words(&candidate.text);
    let name = hash(format!("{} control {}", plan.settings.seed, candidate.text).as_bytes());
    let seed = u64::from_str_radix(&name[..16], 16).unwrap_or_default();
    let mut generator = Pcg64::seed_from_u64(seed);
    let mut other = said.clone();
    for _ in 0..MAX_SHUFFLES {
        generator.shuffle(&mut other);
        if other != said {
            break;
        }
    }
    other.join(" ")
}

pub(super) fn report(plan: &DatabasePlan, controls: &[RaterControl]) -> String {
    if controls.is_empty() {
        return String::new();
    }
    let percent = |percent: Option<u8>| {
        percent.map_or_else(|| "not rated".to_owned(), |percent| format!("{percent} %"))
    };
    let mut out = String::from(
        "\n## Does the rater listen?\n\nPercent before the first word, and after each word of sentences in another \
         order.\n\n",
    );
    let mut table = Table::new(["topic", "before", "sentence", "words in another order"]);
    for control in controls {
        let id = &plan.topic[control.topic].id;
        let silence = percent(control.silence);
        for Shuffled { said, rated, text, text_rated } in &control.shuffled {
            let other = text_rated.as_deref().map_or_else(|| "not rated".to_owned(), joined);
            let (said, text) = (format!("{said} [{}]", joined(rated)), format!("{text} [{other}]"));
            table.push([id, &silence, &said, &text]);
        }
    }
    out.push_str(&table.markdown());
    let last = |rated: &[u8]| f64::from(rated.last().copied().unwrap_or_default());
    let pairs = controls.iter().flat_map(|control| &control.shuffled);
    let both: Vec<(f64, f64)> = pairs
        .filter_map(|pair| Some((last(&pair.rated), last(pair.text_rated.as_deref()?))))
        .collect();
    if !both.is_empty() {
        let mean =
            |of: fn(&(f64, f64)) -> f64| both.iter().map(of).sum::<f64>() / both.len() as f64;
        let (said, other) = (mean(|pair| pair.0), mean(|pair| pair.1));
        // Writing to a string cannot fail.
        let _written = writeln!(
            out,
            "\nAfter the last word, on average: {said:.0} % as it is said, {other:.0} % in another order."
        );
    }
    out
}
