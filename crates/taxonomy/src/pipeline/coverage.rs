//! The coverage report: what a person reads before they trust a database.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use leadtime_table::Table;

use super::backend::CallStage;
use super::candidate::{Candidate, Reason};
use super::controls::{self, RaterControl};
use super::curve::listen;
use super::log::LogHeader;
use super::plan::DatabasePlan;
use super::reply::joined;
use crate::utterance::{Cell, SpanKind};

/// Thresholds that the sweep tries, in percent.
const THETAS: [u8; 5] = [50, 60, 70, 80, 90];

/// What happened in one cell of a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Representatives that the database keeps.
    pub kept: usize,
    /// Passed rules, rating and comparison with others.
    pub accepted: usize,
    /// Proposed for this cell.
    pub proposed: usize,
    /// Times that the cell was asked for.
    pub rounds: u32,
}

/// What came of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Per topic and cell.
    pub cells: BTreeMap<(usize, Cell), Counts>,
    /// Who was turned down, and why.
    pub reasons: BTreeMap<Reason, usize>,
    /// Of the accepted sentences, how many landed where they were asked for.
    pub on_target: usize,
    /// Sentences that were accepted, in all cells.
    pub accepted: usize,
    /// Sentences that were proposed, in all cells.
    pub proposed: usize,
    /// Per stage, replies that could be read and those that could not.
    pub replies: BTreeMap<CallStage, [usize; 2]>,
}

impl Coverage {
    pub(super) fn new(
        candidates: &[Candidate],
        rounds: &BTreeMap<(usize, Cell), u32>,
        replies: &BTreeMap<CallStage, [usize; 2]>,
    ) -> Self {
        let of = |rounds| Counts { rounds, ..Counts::default() };
        let mut coverage = Self {
            cells: rounds.iter().map(|(key, rounds)| (*key, of(*rounds))).collect(),
            reasons: BTreeMap::new(),
            on_target: 0,
            accepted: 0,
            proposed: candidates.len(),
            replies: replies.clone(),
        };
        for candidate in candidates {
            let requested = coverage.cells.entry((candidate.topic, candidate.requested));
            requested.or_default().proposed += 1;
            if let Some(reason) = candidate.reason {
                *coverage.reasons.entry(reason).or_default() += 1;
            } else if let Some(cell) = candidate.landed {
                let landed = coverage.cells.entry((candidate.topic, cell)).or_default();
                landed.accepted += 1;
                landed.kept += usize::from(candidate.medoid.is_some());
                coverage.accepted += 1;
                coverage.on_target += usize::from(cell == candidate.requested);
            }
        }
        coverage
    }

    pub(super) fn report(
        &self,
        plan: &DatabasePlan,
        header: &LogHeader,
        candidates: &[Candidate],
        controls: &[RaterControl],
    ) -> String {
        let LogHeader { fidelity, generator, rater, embedder, .. } = header;
        let Self { proposed, accepted, on_target, .. } = self;
        let mut out = format!(
            "# Words of the domain `{}`\n\nFidelity: **{}**. Written by {generator}; rated by {rater}; compared by \
             {embedder}; theta {} %.\n\nProposed {proposed}, accepted {accepted} ({:.0} %), of these {on_target} where \
             they were asked for.\n",
            plan.domain,
            fidelity.name(),
            plan.settings.theta,
            percent(*accepted, *proposed),
        );
        self.unreadable(&mut out);
        self.grids(&mut out, plan);
        self.gaps(&mut out, plan);
        self.turned_down(&mut out);
        landed(&mut out, plan, candidates);
        sweep(&mut out, plan, candidates);
        agreement(&mut out, plan, candidates);
        out.push_str(&controls::report(plan, controls));
        to_read(&mut out, plan, candidates);
        out
    }

    fn unreadable(&self, out: &mut String) {
        let names = [
            (CallStage::Generate, "generations"),
            (CallStage::Rate, "ratings"),
            (CallStage::Control, "ratings of controls"),
        ];
        let said = |(stage, name): &(CallStage, &str)| {
            let [good, bad] = self.replies.get(stage)?;
            Some(format!("{bad} of {} {name}", good + bad))
        };
        let said: Vec<String> = names.iter().filter_map(said).collect();
        line(out, &format!("\nReplies that could not be read: {}.", said.join(", ")));
    }

    fn grids(&self, out: &mut String, plan: &DatabasePlan) {
        let [from, to] = plan.words;
        line(out, "\n## Cells: kept / accepted / proposed (times asked)\n");
        line(out, "A dash marks what cannot be: nothing is understood after it is over.");
        for (i, topic) in plan.topic.iter().enumerate() {
            let columns = (from..=to).map(|l| format!("l = {l}"));
            let mut table = Table::new(std::iter::once("k".to_owned()).chain(columns));
            for k in from..=to {
                let column = |l| match self.cells.get(&(i, Cell::new(k, l))) {
                    Some(Counts { kept, accepted, proposed, rounds }) => {
                        format!("{kept} / {accepted} / {proposed} ({rounds})")
                    }
                    None => "-".to_owned(),
                };
                table.push(std::iter::once(k.to_string()).chain((from..=to).map(column)));
            }
            line(out, &format!("\n### {}\n", topic.id));
            out.push_str(&table.markdown());
        }
    }

    /// Names the cells without a representative, and those with only one, which is then heard again and again.
    fn gaps(&self, out: &mut String, plan: &DatabasePlan) {
        let named = |n_kept: usize| {
            let with = self.cells.iter().filter(|(_, counts)| counts.kept == n_kept);
            let name = |(topic, cell): (usize, Cell)| format!("{} {cell}", plan.topic[topic].id);
            let list: Vec<String> = with.map(|(&key, _)| name(key)).collect();
            if list.is_empty() { "none".to_owned() } else { list.join(", ") }
        };
        line(out, &format!("\nEmpty: {}.\n\nThin, with one sentence: {}.", named(0), named(1)));
    }

    fn turned_down(&self, out: &mut String) {
        line(out, "\n## Turned down\n");
        if self.reasons.is_empty() {
            line(out, "None.");
            return;
        }
        let mut table = Table::new(["reason", "sentences"]);
        for (reason, n) in &self.reasons {
            table.push([format!("`{reason}`"), n.to_string()]);
        }
        out.push_str(&table.markdown());
    }
}

fn landed(out: &mut String, plan: &DatabasePlan, candidates: &[Candidate]) {
    let [from, to] = plan.words;
    let cells: Vec<Cell> = Cell::feasible(from, to).collect();
    line(out, "\n## Where it was asked for (rows), where it landed (columns)\n");
    let columns = cells.iter().map(ToString::to_string).chain(["turned down".to_owned()]);
    let mut table = Table::new(std::iter::once("(k, l)".to_owned()).chain(columns));
    for requested in &cells {
        let of_row = || candidates.iter().filter(|candidate| candidate.requested == *requested);
        let accepted = || of_row().filter(|candidate| candidate.is_accepted());
        let count =
            |cell: &Cell| match accepted().filter(|found| found.landed == Some(*cell)).count() {
                0 => "·".to_owned(),
                n => n.to_string(),
            };
        let refused = of_row().filter(|candidate| candidate.reason.is_some()).count();
        let row = cells.iter().map(count).chain([refused.to_string()]);
        table.push(std::iter::once(requested.to_string()).chain(row));
    }
    out.push_str(&table.markdown());
}

fn sweep(out: &mut String, plan: &DatabasePlan, candidates: &[Candidate]) {
    let settings = &plan.settings;
    let [from, to] = plan.words;
    let feasible = plan.topic.len() * Cell::feasible(from, to).count();
    line(
        out,
        "\n## Threshold\n\nThe same ratings, read with other thresholds; with those of sentences that were never understood.\n",
    );
    let mut table = Table::new(["theta", "understood", "clamped", "mean k", "cells filled"]);
    for theta in THETAS {
        let mut filled: BTreeSet<(usize, Cell)> = BTreeSet::new();
        let (mut sum, mut clamped, mut n) = (0, 0, 0_u32);
        // Nothing but the threshold can turn these down.
        let depend = |candidate: &&Candidate| {
            candidate.is_accepted() || candidate.reason == Some(Reason::NeverUnderstood)
        };
        for candidate in candidates.iter().filter(depend) {
            if let Ok(heard) = listen(&candidate.rated, theta, from, settings.max_drop) {
                let cell = Cell::new(heard.comprehension, heard.curve.len() as u32);
                filled.insert((candidate.topic, cell));
                sum += heard.comprehension;
                clamped += usize::from(heard.clamped);
                n += 1;
            }
        }
        let mean = format!("{:.2}", f64::from(sum) / f64::from(n.max(1)));
        let filled = format!("{} of {feasible}", filled.len());
        table.push([theta.to_string(), n.to_string(), clamped.to_string(), mean, filled]);
    }
    out.push_str(&table.markdown());
}

fn agreement(out: &mut String, plan: &DatabasePlan, candidates: &[Candidate]) {
    line(out, "\n## Rated k against the place of the directive's last word\n");
    let head = ["topic", "same", "within a word", "earlier", "later", "clamped", "with a reason"];
    let mut table = Table::new(head);
    for (i, topic) in plan.topic.iter().enumerate() {
        // Rated k, place of the directive's last word, clamped, with a reason.
        let facts = |candidate: &Candidate| {
            let Candidate { topic, landed, spans, clamped, .. } = candidate;
            let what = spans.iter().find(|span| span.part == SpanKind::What)?;
            let rated = landed.filter(|_| *topic == i && candidate.is_accepted())?.comprehension;
            let has_reason = spans.iter().any(|span| span.part == SpanKind::Why);
            Some((rated, what.to, *clamped, has_reason))
        };
        let rows: Vec<(u32, u32, bool, bool)> = candidates.iter().filter_map(facts).collect();
        let count = |holds: fn(&&(u32, u32, bool, bool)) -> bool| rows.iter().filter(holds).count();
        let share = |part| format!("{:.0} %", percent(part, rows.len()));
        let cells = [
            share(count(|(rated, structural, ..)| rated == structural)),
            share(count(|(rated, structural, ..)| rated.abs_diff(*structural) <= 1)),
            count(|(rated, structural, ..)| rated < structural).to_string(),
            count(|(rated, structural, ..)| rated > structural).to_string(),
            count(|(_, _, clamped, _)| *clamped).to_string(),
            share(count(|(.., has_reason)| *has_reason)),
        ];
        table.push(std::iter::once(topic.id.clone()).chain(cells));
    }
    out.push_str(&table.markdown());
}

fn to_read(out: &mut String, plan: &DatabasePlan, candidates: &[Candidate]) {
    line(
        out,
        "\n## To be read\n\nThe first representative of every cell, with its comprehension after each word.",
    );
    for (i, topic) in plan.topic.iter().enumerate() {
        line(out, &format!("\n### {}\n", topic.id));
        let first = |candidate: &&Candidate| candidate.topic == i && candidate.medoid == Some(0);
        let mut best: Vec<&Candidate> = candidates.iter().filter(first).collect();
        best.sort_by_key(|candidate| candidate.landed);
        for candidate in best {
            let cell = candidate.landed.map(|cell| cell.to_string()).unwrap_or_default();
            line(out, &format!("* {cell} {} [{}]", candidate.text, joined(&candidate.rated)));
        }
    }
    let keep = plan.settings.keep;
    let head = format!(
        "Accepted, not kept\n\nA cell keeps {keep} sentences (`settings.keep`), those that stand best for the others; a \
         sentence in the plan's list `pinned` is always one of them."
    );
    let left_out = |candidate: &&Candidate| candidate.is_accepted() && candidate.medoid.is_none();
    listed(out, plan, &head, candidates.iter().filter(left_out));
    listed(out, plan, "Turned down", candidates.iter().filter(|found| found.reason.is_some()));
}

/// Lists sentences with what became of them; nothing if there are none.
fn listed<'a>(
    out: &mut String,
    plan: &DatabasePlan,
    head: &str,
    candidates: impl Iterator<Item = &'a Candidate>,
) {
    let mut head = Some(head);
    for candidate in candidates {
        if let Some(head) = head.take() {
            line(out, &format!("\n### {head}\n"));
        }
        let Candidate { topic, requested, landed, text, .. } = candidate;
        let (topic, cell) = (&plan.topic[*topic].id, landed.unwrap_or(*requested));
        let reason = candidate.reason.map(|reason| format!("`{reason}`, ")).unwrap_or_default();
        line(out, &format!("* {reason}{topic} {cell}: {text}"));
    }
}

fn line(out: &mut String, text: &str) {
    // Writing to a string cannot fail.
    let _written = writeln!(out, "{text}");
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}
