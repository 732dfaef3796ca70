//! All stages, from a plan to a file: what is asked next depends only on what was answered so far.

use std::collections::BTreeMap;

use super::backend::{Call, Reply, Stage};
use super::caller::Caller;
use super::candidate::{Candidate, Reason};
use super::coverage::Coverage;
use super::curve::heard;
use super::embedding::Embedding;
use super::error::PipelineError;
use super::log::LogHeader;
use super::medoids::{Distances, medoids};
use super::plan::{Plan, RateForm, TopicPlan};
use super::prompts::{Prompts, Writer};
use super::reply;
use super::rules::Rules;
use super::{backend, export};
use crate::database::Taxonomy;
use crate::utterance::Cell;
use crate::words;

/// What a run made.
#[derive(Debug)]
pub struct Built {
    /// The database, as a file.
    pub text: String,
    /// The same, read back and checked.
    pub taxonomy: Taxonomy,
    /// Everything that was proposed, in order.
    pub candidates: Vec<Candidate>,
    /// What came of it.
    pub coverage: Coverage,
    /// Calls made in this run; what the log answered is not counted.
    pub calls: u64,
}

/// What was proposed, accepted and given up so far.
#[derive(Debug)]
struct Progress {
    candidates: Vec<Candidate>,
    /// Normalised text to its first candidate.
    seen: BTreeMap<String, usize>,
    /// Accepted sentences per topic and cell.
    accepted: BTreeMap<(usize, Cell), usize>,
    /// Generations asked per topic and cell.
    rounds: BTreeMap<(usize, Cell), u32>,
    given_up: BTreeMap<(usize, Cell), bool>,
    iterations: u32,
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
    let taxonomy = Taxonomy::from_toml(&text)?;
    let coverage = Coverage::new(plan, &progress.candidates, progress.rounds);
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
            progress.given_up.insert((topic, cell), true);
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

impl Progress {
    fn new(plan: &Plan) -> Self {
        let [from, to] = plan.words;
        let cells = |topic| Cell::feasible(from, to).map(move |cell| (topic, cell));
        let all = || (0..plan.topic.len()).flat_map(cells);
        Self {
            candidates: Vec::new(),
            seen: BTreeMap::new(),
            accepted: all().map(|key| (key, 0)).collect(),
            rounds: all().map(|key| (key, 0)).collect(),
            given_up: BTreeMap::new(),
            iterations: 0,
        }
    }

    /// Picks the emptiest cell that may still be asked for; of equals, the one asked for least.
    fn next(&mut self, plan: &Plan) -> Option<(usize, Cell, u32)> {
        let settings = &plan.settings;
        if self.iterations >= settings.max_iterations {
            return None;
        }
        let open = self.accepted.iter().filter(|(key, n)| {
            **n < settings.target
                && self.rounds[key] < settings.attempts_per_cell
                && !self.given_up.contains_key(key)
        });
        let (&(topic, cell), _) = open.min_by_key(|&(key, n)| (*n, self.rounds[key], *key))?;
        let rounds = self.rounds.entry((topic, cell)).or_default();
        let round = *rounds;
        *rounds += 1;
        self.iterations += 1;
        Some((topic, cell, round))
    }

    /// Lists the accepted sentences of a topic.
    fn texts(&self, topic: usize) -> Vec<String> {
        let of_topic = |candidate: &&Candidate| candidate.topic == topic && candidate.is_accepted();
        self.candidates.iter().filter(of_topic).map(|candidate| candidate.text.clone()).collect()
    }

    /// Tells whether the same words were proposed before; for another topic, both are turned down.
    fn repeated(&mut self, candidate: &Candidate) -> Option<Reason> {
        let first = *self.seen.get(&words::normalised(&candidate.text))?;
        let first = &mut self.candidates[first];
        if first.topic == candidate.topic {
            return Some(Reason::Duplicate);
        }
        if first.is_accepted()
            && let Some(cell) = first.landed
            && let Some(accepted) = self.accepted.get_mut(&(first.topic, cell))
        {
            *accepted = accepted.saturating_sub(1);
        }
        first.reason = Some(Reason::AmbiguousTopic);
        Some(Reason::AmbiguousTopic)
    }

    fn add(&mut self, candidate: Candidate) {
        if candidate.is_accepted()
            && let Some(cell) = candidate.landed
            && let Some(accepted) = self.accepted.get_mut(&(candidate.topic, cell))
        {
            *accepted += 1;
        }
        let place = self.candidates.len();
        if !candidate.spans.is_empty() {
            self.seen.entry(words::normalised(&candidate.text)).or_insert(place);
        }
        self.candidates.push(candidate);
    }
}

/// Chooses the representatives of every cell, and marks them; in the order of the file.
fn choose(
    plan: &Plan,
    candidates: &mut [Candidate],
    caller: &mut Caller<'_>,
) -> Result<Vec<Candidate>, PipelineError> {
    let mut cells: BTreeMap<(usize, Cell), Vec<usize>> = BTreeMap::new();
    for (i, candidate) in candidates.iter().enumerate() {
        if let Some(cell) = candidate.landed.filter(|_| candidate.is_accepted()) {
            cells.entry((candidate.topic, cell)).or_default().push(i);
        }
    }
    let mut kept = Vec::new();
    for mut members in cells.into_values() {
        let is_pinned = |i: &usize| plan.pinned.contains(&candidates[*i].text);
        // Pinned ones first, so that others are compared with them.
        members.sort_by_key(|i| !is_pinned(i));
        let n_pinned = members.iter().filter(|i| is_pinned(i)).count();
        let mut distinct: Vec<(usize, Embedding)> = Vec::new();
        for i in members {
            let embedding = caller.embed(&candidates[i].text)?;
            let near = plan.settings.near_duplicate;
            if distinct.iter().any(|(_, other)| other.cosine(&embedding) >= near) {
                candidates[i].reason = Some(Reason::NearDuplicate);
            } else {
                distinct.push((i, embedding));
            }
        }
        let chosen = representatives(&distinct, n_pinned, plan.settings.keep);
        for (rank, i) in chosen.into_iter().enumerate() {
            candidates[i].medoid = Some(rank as u32);
            kept.push(candidates[i].clone());
        }
    }
    Ok(kept)
}

/// Chooses the medoids of a cell: the pinned first members, and of the rest who stands best for it.
///
/// Who stands for most comes first, of equals who was proposed first.
fn representatives(members: &[(usize, Embedding)], n_pinned: usize, keep: usize) -> Vec<usize> {
    let n_pinned = n_pinned.min(members.len());
    let distance = |a: usize, b: usize| 1.0 - members[a].1.cosine(&members[b].1);
    let rest =
        Distances::new(members.len() - n_pinned, |a, b| distance(a + n_pinned, b + n_pinned));
    let of_rest = medoids(&rest, keep.saturating_sub(n_pinned));
    let chosen: Vec<usize> = (0..n_pinned).chain(of_rest.iter().map(|i| i + n_pinned)).collect();
    let distances = Distances::new(members.len(), distance);
    let mut sizes = vec![0_usize; chosen.len()];
    for i in 0..members.len() {
        sizes[distances.nearest(i, &chosen).0] += 1;
    }
    let mut ranked: Vec<(usize, usize)> = sizes.into_iter().zip(chosen).collect();
    ranked.sort_by_key(|(size, member)| (std::cmp::Reverse(*size), *member));
    ranked.into_iter().map(|(_, member)| members[member].0).collect()
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
