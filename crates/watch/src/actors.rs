//! The actors of a run, as the learner's roster and their own sums show them.

use std::collections::{BTreeMap, VecDeque};

use leadtime_proto::ActorId;
use serde_json::{Value, json};

/// How long an actor that is gone is still shown, and one that has never declared its presence and is not named any more, in seconds.
const GONE_FOR: f64 = 60.0;
/// An actor of which nothing is heard for so long is silent, in seconds.
const SILENT: f64 = 2.0;
/// Reports of an actor over which its rates are computed.
const N_REPORTS: usize = 10;
/// The most actors that are kept; more than a roster lists, with those that are gone.
const MAX_ACTORS: usize = 512;
/// Where an actor's time goes, as its sums are named.
const SHARES: [&str; 5] = ["infer", "simulate", "encode", "publish", "wait"];

/// One report of an actor: when it came, and its sums.
#[derive(Clone, Debug)]
struct ActorSums {
    at: f64,
    n_steps: f64,
    seconds: [f64; SHARES.len()],
}

/// What is known of one actor.
#[derive(Clone, Debug, Default)]
struct ActorRow {
    incarnation: String,
    /// What the learner says of it.
    entry: Value,
    /// How many rollouts it has published, as it says itself.
    n_published: Option<u64>,
    reports: VecDeque<ActorSums>,
    /// It has declared its presence: it is there until it leaves.
    is_declared: bool,
    /// When it was last heard of, by itself or in the roster.
    named_at: f64,
    seen_at: f64,
    gone_at: Option<f64>,
}

impl ActorRow {
    /// Returns steps per second and the shares of its time over the last reports.
    fn rates(&self) -> Option<(f64, [f64; SHARES.len()])> {
        let (first, last) = (self.reports.front()?, self.reports.back()?);
        let took = last.at - first.at;
        if took <= 0.0 {
            return None;
        }
        let share = |i: usize| ((last.seconds[i] - first.seconds[i]) / took).clamp(0.0, 1.0);
        let shares = std::array::from_fn(share);
        Some((((last.n_steps - first.n_steps) / took).max(0.0), shares))
    }
}

/// Every actor that was seen lately.
#[derive(Clone, Debug, Default)]
pub(crate) struct ActorTable {
    rows: BTreeMap<String, ActorRow>,
    /// What the roster says of those that it does not list.
    others: Value,
}

impl ActorTable {
    /// Notes that a start of an actor has declared its presence. Returns whether it was not there.
    pub(crate) fn joined(&mut self, id: &str, incarnation: &str, now: f64) -> bool {
        let is_new = self.entered(id, incarnation, now);
        if let Some(row) = self.rows.get_mut(id) {
            row.is_declared = true;
        }
        is_new
    }

    /// Makes a row for a start of an actor, if there is room. Returns whether it had none.
    fn entered(&mut self, id: &str, incarnation: &str, now: f64) -> bool {
        if self.rows.len() >= MAX_ACTORS && !self.rows.contains_key(id) {
            return false;
        }
        let row = self.rows.entry(id.to_owned()).or_default();
        let is_new = row.incarnation != incarnation || row.gone_at.is_some();
        if is_new {
            let incarnation = incarnation.to_owned();
            *row = ActorRow { incarnation, seen_at: now, ..ActorRow::default() };
        }
        is_new
    }

    /// Notes that a start of an actor was heard of. Returns whether it is there: one that has left comes back only when it
    /// joins, for what is heard of it may have been said before.
    fn heard(&mut self, id: &str, incarnation: &str, now: f64) -> bool {
        let has_left = |row: &ActorRow| row.incarnation == incarnation && row.gone_at.is_some();
        if self.rows.get(id).is_some_and(has_left) {
            return false;
        }
        self.entered(id, incarnation, now);
        if let Some(row) = self.rows.get_mut(id) {
            row.named_at = now;
        }
        true
    }

    /// Notes the end of a start. Returns how many environments the actor had, if it was there.
    pub(crate) fn left(&mut self, id: &str, incarnation: &str, now: f64) -> Option<u64> {
        let row = self.rows.get_mut(id)?;
        if row.incarnation != incarnation || row.gone_at.is_some() {
            return None;
        }
        row.gone_at = Some(now);
        Some(row.entry["envs"].as_u64().unwrap_or(0))
    }

    /// Takes in an actor's own sums.
    pub(crate) fn report(&mut self, id: &str, incarnation: &str, told: &Value, now: f64) {
        if !self.heard(id, incarnation, now) {
            return;
        }
        let Some(row) = self.rows.get_mut(id) else { return };
        let number = |name: &str| told[name].as_f64().unwrap_or(0.0);
        let seconds = SHARES.map(|share| number(&format!("{share}_s")));
        let report = ActorSums { at: now, n_steps: number("n_steps"), seconds };
        row.reports.push_back(report);
        if row.reports.len() > N_REPORTS {
            row.reports.pop_front();
        }
        row.n_published = told["n_rollouts_published"].as_u64();
        row.seen_at = now;
    }

    /// Takes in what the learner says of everybody.
    pub(crate) fn roster(&mut self, roster: &Value, now: f64) {
        for entry in roster["actors"].as_array().into_iter().flatten() {
            let id = entry["id"].as_str().unwrap_or_default();
            let incarnation = entry["incarnation"].as_str().unwrap_or_default();
            if ActorId::new(id.to_owned()).is_err() || !self.heard(id, incarnation, now) {
                continue;
            }
            if let Some(row) = self.rows.get_mut(id) {
                row.entry = entry.clone();
            }
        }
        self.others = roster["others"].clone();
    }

    /// Forgets those that are gone for long, and names that somebody has made up. What lies ahead of a clock that was set back counts from now on.
    pub(crate) fn forget(&mut self, now: f64) {
        for row in self.rows.values_mut() {
            row.reports.retain(|report| report.at <= now);
            row.seen_at = row.seen_at.min(now);
            row.named_at = row.named_at.min(now);
            row.gone_at = row.gone_at.map(|at| at.min(now));
        }
        self.rows.retain(|_, row| {
            let since = row.gone_at.or((!row.is_declared).then_some(row.named_at));
            since.is_none_or(|at| now - at < GONE_FOR)
        });
    }

    /// Counts those that are here.
    pub(crate) fn n_here(&self) -> usize {
        self.rows.values().filter(|row| row.gone_at.is_none()).count()
    }

    /// Returns the mean share of their time that the actors which are here wait; `None` where none is known.
    pub(crate) fn mean_wait(&self) -> Option<f64> {
        let here = self.rows.values().filter(|row| row.gone_at.is_none());
        let waits: Vec<f64> =
            here.filter_map(|row| Some(row.rates()?.1[SHARES.len() - 1])).collect();
        (!waits.is_empty()).then(|| waits.iter().sum::<f64>() / waits.len() as f64)
    }

    /// Writes the table as the page shows it.
    pub(crate) fn json(&self, newest: u64, now: f64) -> Value {
        let rows: Vec<Value> =
            self.rows.iter().map(|(id, row)| row_json(id, row, newest, now)).collect();
        rows.into()
    }

    /// Returns how many actors, environments and refusals the roster does not list one by one.
    pub(crate) fn others(&self) -> &Value {
        &self.others
    }
}

fn row_json(id: &str, row: &ActorRow, newest: u64, now: f64) -> Value {
    let entry = &row.entry;
    let count = |of: &Value, name: &str| of[name].as_u64();
    let acknowledged = count(entry, "acknowledged");
    let behind = |limit: Option<u64>| Some(limit?.saturating_sub(acknowledged?));
    let refused = entry["refused"].as_object().into_iter().flatten();
    let refused = refused.filter_map(|it| it.1.as_u64()).fold(0, u64::saturating_add);
    let silent = (now - row.seen_at).max(0.0);
    let rates = row.rates();
    let shares = rates.map(|(_, shares)| {
        SHARES
            .iter()
            .zip(shares)
            .map(|(name, share)| (*name, round(share)))
            .collect::<BTreeMap<_, _>>()
    });
    let version = entry["iteration"].as_u64().zip(entry["staleness"].as_u64());
    json!({
        "id": id,
        "incarnation": row.incarnation,
        "envs": count(entry, "envs").unwrap_or(0),
        "steps_per_second": rates.map(|(steps, _)| steps.round()),
        "iteration": entry["iteration"],
        "staleness": entry["staleness"],
        "lag": version.map(|(iteration, _)| newest.saturating_sub(iteration)),
        "credit": {
            "used": behind(row.n_published),
            "window": behind(count(entry, "limit")),
        },
        "refused": refused,
        "refusals": entry["refused"],
        "queued_bytes": entry["queued_bytes"],
        "last_rollout_s": entry["silent_s"],
        "silent_s": round(silent),
        "is_silent": row.gone_at.is_none() && silent > SILENT,
        "gone_s": row.gone_at.map(|at| round(now - at)),
        "shares": shares,
    })
}

/// Rounds to a thousandth.
pub(crate) fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sums(seconds: f64) -> Value {
        json!({"n_steps": 100.0 * seconds, "wait_s": 0.75 * seconds, "infer_s": 0.1 * seconds, "n_rollouts_published": 9})
    }

    #[test]
    fn rates_come_from_sums_and_credit_from_both_sides() {
        let mut table = ActorTable::default();
        assert!(table.joined("a", "01", 0.0) && !table.joined("a", "01", 1.0));
        for second in 1..=20 {
            table.report("a", "01", &sums(f64::from(second)), f64::from(second));
        }
        let roster = json!({"actors": [{
            "id": "a", "incarnation": "01", "envs": 4, "iteration": 10, "staleness": 1, "acknowledged": 6, "limit": 14,
            "refused": {"credit": 2}, "silent_s": 0.5,
        }]});
        table.roster(&roster, 20.0);
        let row = &table.json(12, 20.5)[0];
        assert_eq!(row["steps_per_second"], 100.0);
        assert_eq!(row["shares"]["wait"], 0.75);
        assert_eq!(row["credit"], json!({"used": 3, "window": 8}));
        assert_eq!(
            (&row["lag"], &row["refused"], &row["is_silent"]),
            (&json!(2), &json!(2), &json!(false))
        );
        assert_eq!(table.json(12, 22.5)[0]["is_silent"], true);
        assert_eq!(table.mean_wait(), Some(0.75));
    }

    #[test]
    fn an_actor_that_is_gone_is_shown_for_a_minute_and_may_come_back() {
        let mut table = ActorTable::default();
        table.joined("a", "01", 0.0);
        table.joined("b", "02", 0.0);
        assert_eq!(table.left("a", "other", 1.0), None, "another start of it");
        assert_eq!(table.left("a", "01", 1.0), Some(0));
        assert_eq!(table.left("a", "01", 1.0), None, "told twice");
        assert_eq!((table.n_here(), table.json(0, 2.0)[0]["gone_s"].clone()), (1, json!(1.0)));
        assert!(table.joined("a", "03", 3.0));
        assert_eq!(table.n_here(), 2);
        table.left("a", "03", 4.0);
        table.forget(63.9);
        assert_eq!(table.json(0, 63.9).as_array().unwrap().len(), 2);
        table.forget(64.1);
        assert_eq!(table.json(0, 64.1).as_array().unwrap().len(), 1);
    }

    #[test]
    fn names_that_somebody_made_up_keep_nobody_out_for_longer_than_they_are_said() {
        let mut table = ActorTable::default();
        table.joined("a", "01", 0.0);
        for i in 0..MAX_ACTORS {
            table.report(&format!("made-up-{i}"), "01", &sums(1.0), 0.0);
        }
        table.report("late", "01", &sums(1.0), 59.0);
        assert_eq!(table.rows.len(), MAX_ACTORS);
        // The roster names one of them.
        table.roster(&json!({"actors": [{"id": "made-up-7", "incarnation": "01"}]}), 50.0);
        table.forget(60.5);
        assert_eq!(table.rows.keys().collect::<Vec<_>>(), ["a", "made-up-7"]);
        table.report("late", "01", &sums(1.0), 61.0);
        assert_eq!(table.rows.len(), 3);
    }

    #[test]
    fn an_actor_that_has_left_comes_back_only_by_joining() {
        let mut table = ActorTable::default();
        table.joined("a", "01", 0.0);
        table.left("a", "01", 1.0);
        // Its last words, and the roster of a learner that has not seen it leave.
        table.report("a", "01", &sums(1.0), 1.1);
        table.roster(&json!({"actors": [{"id": "a", "incarnation": "01"}]}), 1.2);
        assert_eq!(table.n_here(), 0);
        assert!(table.joined("a", "01", 2.0));
        assert_eq!(table.n_here(), 1);
        table.left("a", "01", 3.0);
        table.report("a", "02", &sums(1.0), 4.0);
        assert_eq!(table.n_here(), 1, "another start of it");
    }

    #[test]
    fn a_name_that_no_actor_can_have_is_left_out_and_sums_have_a_limit() {
        let mut table = ActorTable::default();
        let refused = json!({"credit": u64::MAX, "non_finite": 2});
        let actor = |id: &str| json!({"id": id, "incarnation": "01", "refused": refused});
        table.roster(&json!({"actors": [actor("\u{1b}[2J"), actor(""), actor("a")]}), 0.0);
        let rows = table.json(0, 0.0);
        assert_eq!((rows.as_array().unwrap().len(), &rows[0]["refused"]), (1, &json!(u64::MAX)));
    }
}
