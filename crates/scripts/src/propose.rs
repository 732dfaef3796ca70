//! What the search proposes: scripts drawn at random, and small changes of good ones.
//!
//! Thresholds are drawn between values that the task's numbers really took, so no unit has to be known. Half of the random
//! scripts are *bands*: one number, cut into intervals, a message or silence in each. That is what a person would write first.

use leadtime_numerics::Pcg64;
use leadtime_sims::{Message, Scriptable};

use crate::script::{Script, ScriptCondition, ScriptMessage, ScriptRule};

/// The most rules of a script that the search proposes.
const MAX_RULES: usize = 6;
/// The most conditions of a rule that it proposes.
const MAX_CONDITIONS: usize = 3;
/// The longest pause that it proposes, in steps.
const MAX_PAUSE: usize = 10;
/// The farthest look ahead that it proposes, in steps.
const MAX_AHEAD: f64 = 4.0;
/// The most values of a number that are kept.
const MAX_VALUES: usize = 512;
/// Share of proposals for numbers that the world adds for scripts, where it adds some.
const ADDED: f64 = 0.5;

/// A number of the task, with values that it took.
#[derive(Debug)]
struct ObservedNumber {
    name: String,
    /// Different ones, rising, at least two.
    values: Vec<f64>,
    /// It was seen to change from one step to the next; what is not remembered for a step never is.
    changes: bool,
}

/// Draws scripts for a search, and changes good ones.
#[derive(Debug)]
pub(crate) struct Proposer {
    observed: Vec<ObservedNumber>,
    /// What the world adds for scripts, and the step.
    added: Vec<ObservedNumber>,
    topics: Vec<&'static str>,
    messages: Vec<Message>,
    draws: Pcg64,
}

/// Collects the values that the numbers of a task take.
#[derive(Debug)]
pub(crate) struct ValueLog {
    /// By number: every value that was seen.
    values: Vec<Vec<f64>>,
    changes: Vec<bool>,
}

impl ValueLog {
    pub(crate) fn new(n_quantities: usize) -> Self {
        Self { values: vec![Vec::new(); n_quantities], changes: vec![false; n_quantities] }
    }

    pub(crate) fn look(&mut self, now: &[f32], before: &[f32]) {
        for (i, (&now, &before)) in now.iter().zip(before).enumerate() {
            self.values[i].push(f64::from(now));
            // What is no number differs from itself, and is no change.
            self.changes[i] |= (now - before).abs() > 0.0;
        }
    }
}

impl Proposer {
    pub(crate) fn new(task: &dyn Scriptable, log: ValueLog, draws: Pcg64) -> Self {
        let seen = |((quantity, values), changes): ((leadtime_sims::Quantity, Vec<f64>), bool)| {
            ObservedNumber { name: quantity.name, values: spread(values), changes }
        };
        let all = task.quantities().into_iter().zip(log.values).zip(log.changes).map(seen);
        let mut observed: Vec<ObservedNumber> = all.collect();
        let mut added = observed.split_off(task.n_observed());
        // What never differs cannot decide anything.
        for part in [&mut observed, &mut added] {
            part.retain(|it| it.values.len() > 1);
        }
        Self { observed, added, topics: task.topics().to_vec(), messages: task.messages(), draws }
    }

    /// Draws a script that owes nothing to another one.
    pub(crate) fn random(&mut self) -> Script {
        let n = 1 + self.draws.below(4);
        if self.chance(0.5) {
            return Script { rules: self.bands(n) };
        }
        Script { rules: (0..n).map(|_| self.rule()).collect() }
    }

    /// Changes a script a little.
    pub(crate) fn changed(&mut self, script: &Script) -> Script {
        let mut changed = script.clone();
        for _ in 0..=self.draws.below(2) {
            self.change(&mut changed.rules);
        }
        changed
    }

    fn change(&mut self, rules: &mut Vec<ScriptRule>) {
        let place = self.draws.below(rules.len().max(1));
        if rules.is_empty() {
            rules.push(self.rule());
            return;
        }
        match self.draws.below(10) {
            0 if rules.len() < MAX_RULES => rules.insert(place, self.rule()),
            1 if rules.len() > 1 => drop(rules.remove(place)),
            2 => {
                let other = self.draws.below(rules.len());
                rules.swap(place, other);
            }
            3 if rules.len() < MAX_RULES => {
                // The same again with another message: the first of both is then made narrower.
                let mut twin = rules[place].clone();
                twin.say = Some(self.message());
                if let Some(condition) = twin.when.last_mut() {
                    self.move_bound(condition);
                }
                rules.insert(place, twin);
            }
            4 => rules[place].pause = self.pause(),
            5 => rules[place].say = Some(self.message()),
            6 => self.change_conditions(&mut rules[place].when),
            _ => {
                let n = rules[place].when.len();
                if n == 0 {
                    rules[place].when.push(self.condition());
                } else {
                    let which = self.draws.below(n);
                    self.move_bound(&mut rules[place].when[which]);
                }
            }
        }
    }

    fn change_conditions(&mut self, when: &mut Vec<ScriptCondition>) {
        let n = when.len();
        if n > 0 && self.chance(0.4) {
            drop(when.remove(self.draws.below(n)));
        } else if n < MAX_CONDITIONS {
            when.push(self.condition());
        }
    }

    /// Moves one of a condition's bounds, or how far it looks ahead.
    fn move_bound(&mut self, condition: &mut ScriptCondition) {
        let Some(place) = self.place(&condition.of) else { return };
        if self.seen(place).changes && self.chance(0.25) {
            condition.ahead = self.ahead(place);
            return;
        }
        let far = if self.chance(0.3) { 1.0 } else { 0.08 };
        let (first, second) = (&mut condition.above, &mut condition.below);
        let bound = match (first.is_some(), second.is_some()) {
            (true, true) if self.draws.below(2) == 0 => first,
            (true, false) => first,
            _ => second,
        };
        let from = bound.unwrap_or_default();
        *bound = Some(self.near(place, from, far));
    }

    /// Draws bands of one number: silence or a message in each, from the highest down.
    fn bands(&mut self, n: usize) -> Vec<ScriptRule> {
        let place = self.any_number();
        let ahead = self.ahead(place);
        let mut bounds: Vec<f64> = (0..n).map(|_| self.bound(place)).collect();
        bounds.sort_by(|a, b| b.total_cmp(a));
        let of = self.seen(place).name.clone();
        let mut rules = Vec::new();
        for bound in bounds {
            let silent = self.chance(0.25);
            let say = (!silent).then(|| self.message());
            let condition =
                ScriptCondition { of: of.clone(), ahead, above: Some(bound), below: None };
            rules.push(ScriptRule { say, pause: self.pause(), when: vec![condition] });
        }
        if self.chance(0.5) {
            rules.push(ScriptRule { say: Some(self.message()), pause: self.pause(), when: vec![] });
        }
        rules
    }

    fn rule(&mut self) -> ScriptRule {
        let n = 1 + usize::from(self.chance(0.5));
        let when = (0..n).map(|_| self.condition()).collect();
        ScriptRule { say: Some(self.message()), pause: self.pause(), when }
    }

    fn condition(&mut self) -> ScriptCondition {
        let place = self.any_number();
        let (of, ahead) = (self.seen(place).name.clone(), self.ahead(place));
        let [one, other] = [self.bound(place), self.bound(place)];
        let (above, below) = match self.draws.below(4) {
            0 => (Some(one.min(other)), Some(one.max(other))),
            1 => (Some(one), None),
            _ => (None, Some(one)),
        };
        ScriptCondition { of, ahead, above, below }
    }

    fn message(&mut self) -> ScriptMessage {
        let any = self.messages[self.draws.below(self.messages.len())];
        let topic = self.topics[any.topic].to_owned();
        ScriptMessage { topic, k: any.comprehension, l: any.conveyance }
    }

    fn pause(&mut self) -> u32 {
        if self.chance(0.3) { 0 } else { self.draws.below(MAX_PAUSE + 1) as u32 }
    }

    fn ahead(&mut self, place: Place) -> f64 {
        if !self.seen(place).changes || self.chance(0.5) {
            return 0.0;
        }
        rounded(self.draws.uniform(0.0, MAX_AHEAD))
    }

    fn any_number(&mut self) -> Place {
        let use_added =
            self.observed.is_empty() || (!self.added.is_empty() && self.chance(self.share_added()));
        let n = if use_added { self.added.len() } else { self.observed.len() };
        Place { added: use_added, index: self.draws.below(n.max(1)) }
    }

    /// Returns the share of proposals for what the world adds; the step alone counts like any other number.
    fn share_added(&self) -> f64 {
        let n_all = self.added.len() + self.observed.len();
        if self.added.len() > 1 { ADDED } else { self.added.len() as f64 / n_all as f64 }
    }

    /// Draws a bound between two neighbouring values of a number.
    fn bound(&mut self, place: Place) -> f64 {
        let rank = self.draws.unit();
        self.value_at(place, rank)
    }

    /// Draws a bound near another one, by rank.
    fn near(&mut self, place: Place, bound: f64, far: f64) -> f64 {
        let values = &self.seen(place).values;
        let rank = values.partition_point(|value| *value < bound) as f64 / values.len() as f64;
        let moved = (rank + far * self.draws.normal()).clamp(0.0, 1.0);
        self.value_at(place, moved)
    }

    fn value_at(&self, place: Place, rank: f64) -> f64 {
        let values = &self.seen(place).values;
        let lower = ((rank * (values.len() - 1) as f64) as usize).min(values.len() - 2);
        rounded(f64::midpoint(values[lower], values[lower + 1]))
    }

    fn seen(&self, place: Place) -> &ObservedNumber {
        let part = if place.added { &self.added } else { &self.observed };
        &part[place.index]
    }

    fn place(&self, name: &str) -> Option<Place> {
        let find = |part: &[ObservedNumber]| part.iter().position(|it| it.name == name);
        let observed = find(&self.observed).map(|index| Place { added: false, index });
        observed.or_else(|| find(&self.added).map(|index| Place { added: true, index }))
    }

    fn chance(&mut self, share: f64) -> bool {
        self.draws.unit() < share
    }
}

/// Where a number stands in a [`Proposer`].
#[derive(Clone, Copy, Debug)]
struct Place {
    added: bool,
    index: usize,
}

/// Sorts values, drops equal ones, and keeps so many evenly spread ones.
fn spread(mut values: Vec<f64>) -> Vec<f64> {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    values.dedup();
    if values.len() <= MAX_VALUES {
        return values;
    }
    let step = (values.len() - 1) as f64 / (MAX_VALUES - 1) as f64;
    (0..MAX_VALUES).map(|i| values[(i as f64 * step) as usize]).collect()
}

/// Rounds to three significant digits, so that a script can be read.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
