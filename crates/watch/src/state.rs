//! Everything that a page knows of a run, from what an observer hears or from a run's directory.
//!
//! Pure: times are handed in, as seconds since the Unix epoch. What comes over the network is believed as far as it can
//! be read; what cannot is left out.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use leadtime_numerics::thin::{Extremes, ThinSeries};
use leadtime_proto::text::quoted;
use serde::{Deserialize as _, Serialize};
use serde_json::{Map, Value, json};

use crate::actors::{ActorTable, round};

/// The layout of what pages and scripts receive.
const SCHEMA: u32 = 1;
/// The most points of a curve.
pub const MAX_POINTS: usize = 2_000;
/// The most curves that are kept.
const MAX_CURVES: usize = 256;
/// The most updates that a learner's curves may have per point.
const MAX_STRIDE: u64 = 1 << 40;
/// The most marks at which a learner went on; the newest stay.
const MAX_MARKS: usize = 256;
/// The most causes of refusals that are logged.
const MAX_CAUSES: usize = 64;
/// The most kinds of staleness that are kept of an update.
const MAX_STALENESS: usize = 64;
/// Updates over which staleness is summed.
const N_STALENESS: usize = 100;
/// Lines of the log.
const N_LOG: usize = 200;
/// The time over which phases and speed are computed, in seconds.
const WINDOW: f64 = 60.0;
/// The most updates in that window: five a second are published.
const N_WINDOW: usize = 400;
/// After so long without an update something is missing, in seconds.
const STALLED: f64 = 30.0;
/// After so long without a word of its learner another start may take its place, in seconds; a learner says something every second.
const SILENT: f64 = 10.0;
/// Shares from which on the waiting of the learner, and of the actors, is worth a sentence.
const LEARNER_WAITS: f64 = 0.3;
const ACTORS_WAIT: f64 = 0.5;
/// What a line of the log about a checkpoint begins with.
const CHECKPOINT: &str = "checkpoint of update ";
/// The name of the time since the first update among the curves.
const ELAPSED: &str = "elapsed";
/// Numbers that are shown as they are now, and not as curves.
const NO_CURVES: [&str; 5] =
    ["books/", "episodes/finished", "train/samples", "system/queued", "held_out/"];

/// How a run is, in a word, which pages and scripts see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum RunPhase {
    /// Its learner has not been seen.
    Unknown,
    /// There are too few actors.
    Gathering,
    /// Updates come, or will.
    Training,
    /// No update for a while.
    Stalled,
    /// All updates are done.
    Finished,
    /// Stopped, or a directory in which no learner works: it can be resumed.
    Stopped,
    /// The learner ended with an error.
    Failed,
    /// The learner disappeared without announcing its end.
    Lost,
}

/// The curves, as pages read them.
#[derive(Debug, Serialize)]
struct Curves {
    from: u64,
    to: u64,
    started: Option<f64>,
    steps_per_update: f64,
    stride: u64,
    x: Vec<u64>,
    scalars: BTreeMap<String, Extremes>,
    marks: Vec<CurveMark>,
}

/// Where a learner went on.
#[derive(Debug, Serialize)]
struct CurveMark {
    update: u64,
    what: &'static str,
}

/// One line of the log.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WatchLine {
    /// Its number, from 1.
    number: u64,
    /// When, in seconds since the Unix epoch.
    at: f64,
    /// Either `info` or `warn`.
    level: &'static str,
    /// What happened, as a sentence.
    pub text: String,
}

impl WatchLine {
    /// Writes it as pages see it.
    pub(crate) fn json(&self) -> Value {
        json!({"number": self.number, "at": round(self.at), "level": self.level, "text": self.text})
    }
}

/// What has changed since it was last asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Changes {
    /// What the run is, and the curves as a whole.
    pub history: bool,
    /// The newest update came.
    pub update: bool,
}

/// One update of the window, for phases and speed.
#[derive(Clone, Copy, Debug)]
struct UpdateTimes {
    at: f64,
    update: u64,
    wait: f64,
    train: f64,
    interval: f64,
}

/// A run as it is seen.
#[derive(Clone, Debug, Default)]
pub struct RunView {
    run: String,
    about: Value,
    series: ThinSeries,
    /// The update at which a learner went on, and why, the oldest first.
    marks: VecDeque<(u64, &'static str)>,
    generation: u64,
    last: Map<String, Value>,
    last_at: Option<f64>,
    /// When the newest update was made, as its learner's clock says.
    made: Option<f64>,
    started: Option<f64>,
    staleness: VecDeque<(u64, BTreeMap<u64, u64>)>,
    actors: ActorTable,
    window: VecDeque<UpdateTimes>,
    learner: Option<String>,
    /// The start of the learner before that one.
    previous: Option<String>,
    /// When the learner was found to be there, or said something last.
    heard_at: Option<f64>,
    /// The first update that this start of the learner published.
    first_told: Option<u64>,
    /// Whether it reported how the run went before.
    knows_history: bool,
    lost_at: Option<f64>,
    ended: Option<&'static str>,
    /// The books of a finished run, as its record keeps them: those of the last update know nothing of the end.
    settled: Option<Value>,
    n_needed: Option<u64>,
    total_updates: u64,
    checkpoint: u64,
    version: u64,
    /// The causes of refusals that were logged.
    refusals: BTreeSet<String>,
    n_missed: u64,
    n_skipped: u64,
    log: VecDeque<WatchLine>,
    n_logged: u64,
    changes: Changes,
}

impl RunView {
    /// Starts with a name.
    pub fn new(run: &str) -> Self {
        let series = ThinSeries::new(MAX_POINTS);
        Self { run: run.to_owned(), series, ..Self::default() }
    }

    /// Takes in what the run is.
    pub fn about(&mut self, about: Value, now: f64) {
        self.total_updates = about["total_updates"].as_u64().unwrap_or(self.total_updates);
        if let Some(update) = about["resumed_from"].as_u64() {
            match self.marks.back_mut() {
                Some((at, _)) if *at == update => {}
                // When it was started anew, it was not known from which checkpoint.
                Some((at, _)) => {
                    *at = update;
                    self.say("info", format!("the learner goes on after update {update}"), now);
                }
                None => self.mark(update, "resumed", now),
            }
        }
        self.about = about;
        self.changes.history = true;
    }

    /// Takes in the history; what the learner published of later updates stays.
    pub fn history(&mut self, history: &Value, now: f64) {
        let Some(told) = told_series(history) else { return };
        self.started = history["started"].as_f64().or(self.started);
        let newer = self.points_after(told.last());
        let mut series = told.resume(MAX_POINTS);
        for (x, numbers) in newer {
            series.push(x, numbers.iter().map(|(name, value)| (name.as_str(), *value)));
        }
        series.scalars.retain(|name, _| is_curve(name));
        while series.scalars.len() > MAX_CURVES {
            series.scalars.pop_last();
        }
        self.series = series;
        self.n_skipped = history["skipped"].as_u64().unwrap_or(0);
        for line in history["staleness"].as_array().into_iter().flatten() {
            if let (Some(update), Some(counts)) = (line[0].as_u64(), staleness_of(&line[1])) {
                self.note_staleness(update, counts);
            }
        }
        if let Some(last) = history["last"].as_object()
            && update_of(last) > update_of(&self.last)
        {
            self.last.clone_from(last);
            self.version = self.version.max(update_of(last));
            self.note_refusals(now);
            self.changes.update = true;
        }
        self.knows_history = true;
        self.changes.history = true;
    }

    /// Returns the points after an update that the learner which is there now published: those of one before it may
    /// have been rolled back.
    fn points_after(&self, update: u64) -> Vec<(u64, Vec<(String, f64)>)> {
        let first = self.first_told.map(|first| first.max(update.saturating_add(1)));
        first.map_or_else(Vec::new, |first| points(&self.series.since(first)))
    }

    /// Notes that a run on the disk went back to an update and goes on from there; its history is to be sent again.
    pub fn rewound(&mut self, to: u64, now: f64) {
        self.mark(to, "resumed", now);
        self.forget_newest();
    }

    /// Forgets what may have been rolled back, but for the curves, which the history replaces.
    fn forget_newest(&mut self) {
        (self.first_told, self.knows_history) = (None, false);
        (self.made, self.version) = (None, 0);
        self.last.clear();
        self.staleness.clear();
        self.window.clear();
    }

    /// Takes in what a learner publishes: an update, its roster, or its end. Returns whether it is another start than
    /// before.
    pub fn learner_says(&mut self, incarnation: &str, told: Value, now: f64) -> bool {
        let is_new = self.learner.as_deref() != Some(incarnation);
        // Words may come after the end of the start that said them was seen: they bring no learner back.
        let is_old = self.previous.as_deref() == Some(incarnation) && !self.is_silent(now);
        if is_new && (is_old || !self.learner_joined(incarnation, now)) {
            return false;
        }
        self.heard_at = Some(now);
        let kind = told["kind"].as_str();
        if self.ended.is_some() && matches!(kind, Some("update" | "roster")) {
            self.ended = None;
            self.say(
                "warn",
                "the learner is still at work: another process told of its end".to_owned(),
                now,
            );
        }
        match kind {
            Some("update") => {
                if let Value::Object(line) = told {
                    self.update(line, now);
                }
            }
            Some("roster") => {
                self.n_needed = told["n_needed"].as_u64();
                self.total_updates = told["total_updates"].as_u64().unwrap_or(self.total_updates);
                self.version = told["version"].as_u64().unwrap_or(self.version);
                let checkpoint = told["checkpoint"].as_u64().unwrap_or(0);
                if checkpoint > self.checkpoint {
                    self.say("info", format!("{CHECKPOINT}{checkpoint} written"), now);
                }
                self.checkpoint = checkpoint;
                self.actors.roster(&told, now);
            }
            Some("end") => {
                let (ended, sentence) = match told["how"].as_str() {
                    Some("finished") => ("finished", "the run is finished"),
                    Some("stopped") => ("stopped", "the learner was asked to stop"),
                    _ => ("failed", "the learner ended with an error"),
                };
                self.ended = Some(ended);
                self.say(if ended == "failed" { "warn" } else { "info" }, sentence.to_owned(), now);
            }
            _ => {}
        }
        is_new
    }

    /// Takes in one line of a run's metrics.
    pub fn update(&mut self, line: Map<String, Value>, now: f64) {
        let update = update_of(&line);
        // What was on its way while the history was asked for is in it.
        let is_known = self.knows_history && update <= self.series.last();
        if update == 0 || is_known {
            return;
        }
        let number = |name: &str| line.get(name).and_then(Value::as_f64);
        self.first_told.get_or_insert(update);
        self.made = number("made");
        let started = *self.started.get_or_insert(self.made.unwrap_or(now));
        let elapsed = self.made.map_or(now, |made| made) - started;
        let curves = line.iter().filter(|(name, _)| name.contains('/') && is_curve(name));
        let numbers = curves.filter_map(|(name, value)| Some((name.as_str(), value.as_f64()?)));
        let numbers = [(ELAPSED, elapsed.max(0.0))].into_iter().chain(numbers);
        let is_known = |(name, _): &(&str, f64)| self.series.scalars.contains_key(*name);
        let (known, new): (Vec<_>, Vec<_>) = numbers.partition(is_known);
        let room = MAX_CURVES.saturating_sub(self.series.scalars.len());
        self.series.push(update, known.into_iter().chain(new.into_iter().take(room)));
        self.window.retain(|times| times.update < update);
        let steps_per_update =
            self.about["steps_per_update"].as_f64().or_else(|| number("train/samples"));
        let per_second = number("system/steps_per_second").filter(|it| *it > 0.0);
        let interval = steps_per_update.zip(per_second).map_or(0.0, |(steps, rate)| steps / rate);
        let (wait, train) = (number("system/wait_seconds"), number("system/train_seconds"));
        let (wait, train) = (wait.unwrap_or(0.0), train.unwrap_or(0.0));
        self.window.push_back(UpdateTimes { at: now, update, wait, train, interval });
        if let Some(counts) = line.get("staleness").and_then(staleness_of) {
            self.note_staleness(update, counts);
        }
        self.last = line;
        self.last_at = Some(now);
        self.version = update;
        self.note_refusals(now);
        self.trim(now);
        self.changes.update = true;
    }

    /// Goes on where the clock was set back: what lies ahead of it would count as new until it is there again.
    fn follow_clock(&mut self, now: f64) {
        self.window.retain(|times| times.at <= now);
        for at in [&mut self.last_at, &mut self.lost_at, &mut self.heard_at] {
            *at = at.map(|at| at.min(now));
        }
    }

    fn trim(&mut self, now: f64) {
        self.follow_clock(now);
        while self.window.len() > N_WINDOW
            || (self.window.len() > 2 && self.window.front().is_some_and(|it| now - it.at > WINDOW))
        {
            self.window.pop_front();
        }
    }

    fn note_staleness(&mut self, update: u64, counts: BTreeMap<u64, u64>) {
        self.staleness.retain(|(known, _)| *known < update);
        self.staleness.push_back((update, counts));
        if self.staleness.len() > N_STALENESS {
            self.staleness.pop_front();
        }
    }

    /// Logs causes for which messages were refused for the first time.
    fn note_refusals(&mut self, now: f64) {
        let told =
            self.last.get("refusals").and_then(Value::as_object).cloned().unwrap_or_default();
        for (cause, n) in told {
            let is_new = n.as_u64() > Some(0) && !self.refusals.contains(&cause);
            if is_new && self.refusals.len() < MAX_CAUSES {
                let shown = quoted(&cause.replace('_', " "));
                self.say("warn", format!("messages are refused: {shown}"), now);
                self.refusals.insert(cause);
            }
        }
    }

    /// Returns whether the learner that is followed has said nothing for long.
    fn is_silent(&self, now: f64) -> bool {
        self.heard_at.is_none_or(|at| now - at >= SILENT)
    }

    /// Notes that a learner is there. Returns whether it is another start than before, which is followed from now on: anybody can show
    /// that a learner is there, so as long as one is there and says something, no other takes its place.
    pub fn learner_joined(&mut self, incarnation: &str, now: f64) -> bool {
        if self.learner.as_deref() == Some(incarnation) {
            self.lost_at = None;
            return false;
        }
        if self.has_learner() && !self.is_silent(now) {
            return false;
        }
        self.heard_at = Some(now);
        if self.learner.is_some() {
            self.mark(update_of(&self.last), "learner restarted", now);
        } else {
            self.say("info", "the learner is there".to_owned(), now);
        }
        self.previous = self.learner.replace(incarnation.to_owned());
        (self.lost_at, self.ended) = (None, None);
        self.forget_newest();
        true
    }

    /// Notes that a start of a learner is gone.
    pub fn learner_left(&mut self, incarnation: &str, now: f64) {
        if self.learner.as_deref() != Some(incarnation) || self.lost_at.is_some() {
            return;
        }
        self.lost_at = Some(now);
        if self.ended.is_none() {
            self.say("warn", "the learner is gone".to_owned(), now);
        }
    }

    /// Notes a start of an actor.
    pub fn actor_joined(&mut self, id: &str, incarnation: &str, now: f64) {
        if self.actors.joined(id, incarnation, now) {
            let n_actors = self.actors.n_here();
            self.say("info", format!("actor {id} joined ({n_actors} now)"), now);
        }
    }

    /// Notes that a start of an actor is gone.
    pub fn actor_left(&mut self, id: &str, incarnation: &str, now: f64) {
        if let Some(n_envs) = self.actors.left(id, incarnation, now) {
            let moved = match (n_envs, self.actors.n_here()) {
                (0, _) => String::new(),
                (_, 0) => format!("; its {n_envs} environments wait"),
                _ => format!("; its {n_envs} environments move"),
            };
            self.say("warn", format!("actor {id} left{moved}"), now);
        }
    }

    /// Takes in an actor's own sums.
    pub fn actor_says(&mut self, id: &str, incarnation: &str, told: &Value, now: f64) {
        self.actors.report(id, incarnation, told, now);
    }

    /// Forgets the actors that are gone for long, and what lies ahead of a clock that was set back.
    pub(crate) fn forget_gone(&mut self, now: f64) {
        self.follow_clock(now);
        self.actors.forget(now);
    }

    /// Says how many messages there was no room for.
    pub fn missed(&mut self, n_missed: u64) {
        self.n_missed = n_missed;
    }

    /// Says how a run on the disk stands: `finished`, `stopped`, or still being worked on.
    pub fn on_disk(&mut self, ended: Option<&'static str>, now: f64) {
        if self.ended != ended && ended == Some("finished") {
            self.say("info", "the run is finished".to_owned(), now);
        }
        self.ended = ended;
        self.learner.get_or_insert_with(|| "disk".to_owned());
    }

    /// Takes in the books of a finished run's record.
    pub fn settle(&mut self, books: Option<Value>) {
        let books = books.filter(Value::is_object);
        self.changes.update |= books != self.settled;
        self.settled = books;
    }

    /// Writes a line into the log.
    fn say(&mut self, level: &'static str, text: String, now: f64) {
        self.n_logged += 1;
        // One checkpoint after the other would push out everything else.
        let is_checkpoint = |text: &str| text.starts_with(CHECKPOINT);
        if is_checkpoint(&text) && self.log.back().is_some_and(|line| is_checkpoint(&line.text)) {
            self.log.pop_back();
        }
        self.log.push_back(WatchLine { number: self.n_logged, at: now, level, text });
        if self.log.len() > N_LOG {
            self.log.pop_front();
        }
    }

    fn mark(&mut self, update: u64, what: &'static str, now: f64) {
        self.generation += 1;
        self.marks.push_back((update, what));
        if self.marks.len() > MAX_MARKS {
            self.marks.pop_front();
        }
        self.say("info", format!("{what} at update {update}"), now);
        self.changes.history = true;
    }

    /// Returns what has changed since the last call.
    pub(crate) fn take_changes(&mut self) -> Changes {
        std::mem::take(&mut self.changes)
    }

    pub(crate) fn log_after(&self, number: u64) -> impl Iterator<Item = &WatchLine> {
        self.log.iter().filter(move |line| line.number > number)
    }

    /// Returns the number of the newest line of the log.
    pub(crate) fn n_logged(&self) -> u64 {
        self.n_logged
    }

    /// Returns the number of the newest update.
    pub(crate) fn newest(&self) -> u64 {
        update_of(&self.last)
    }

    /// Returns the start of the learner that is followed.
    pub(crate) fn learner(&self) -> Option<&str> {
        self.learner.as_deref()
    }

    pub(crate) fn has_learner(&self) -> bool {
        self.learner.is_some() && self.lost_at.is_none()
    }

    /// Counts how often the run was seen to go on from an update: those published before may have been made again.
    pub(crate) fn generation(&self) -> u64 {
        self.generation
    }

    /// Says how the run is.
    pub(crate) fn phase(&self, now: f64) -> RunPhase {
        let is_complete = self.total_updates > 0 && self.newest() >= self.total_updates;
        match (self.ended, &self.learner) {
            (Some("finished"), _) => RunPhase::Finished,
            (Some("stopped"), _) => RunPhase::Stopped,
            (Some(_), _) => RunPhase::Failed,
            _ if self.lost_at.is_some() && is_complete => RunPhase::Finished,
            (None, None) => RunPhase::Unknown,
            _ if self.lost_at.is_some() => RunPhase::Lost,
            _ if self.n_needed.is_some() => RunPhase::Gathering,
            _ if self.last_at.is_some_and(|at| now - at > STALLED) => RunPhase::Stalled,
            _ => RunPhase::Training,
        }
    }

    /// Returns whether the learner of the run has ended, in whatever way.
    pub fn is_over(&self, now: f64) -> bool {
        use RunPhase::{Failed, Finished, Lost, Stopped};
        matches!(self.phase(now), Failed | Finished | Lost | Stopped)
    }

    /// Says how the run is, in a sentence.
    fn sentence(&self, now: f64) -> String {
        let since = |at: Option<f64>| at.map_or(0.0, |at| (now - at).max(0.0)).round();
        match self.phase(now) {
            RunPhase::Unknown => "waiting for the learner".to_owned(),
            RunPhase::Gathering => {
                let n_needed = self.n_needed.unwrap_or(1);
                format!("waiting for actors: {} of {n_needed}", self.actors.n_here())
            }
            RunPhase::Training if self.newest() == 0 => "waiting for the first update".to_owned(),
            RunPhase::Training => "training".to_owned(),
            RunPhase::Stalled => format!("no update for {} s", since(self.last_at)),
            RunPhase::Finished => "finished".to_owned(),
            RunPhase::Stopped => "stopped; it can be resumed".to_owned(),
            RunPhase::Failed => "the learner ended with an error".to_owned(),
            RunPhase::Lost => format!("learner lost for {} s", since(self.lost_at)),
        }
    }

    /// Updates per second over the window.
    fn speed(&self) -> Option<f64> {
        let (first, last) = (self.window.front()?, self.window.back()?);
        let took = last.at - first.at;
        (took > 0.5).then(|| last.update.saturating_sub(first.update) as f64 / took)
    }

    fn steps_per_update(&self) -> f64 {
        let known = self.about["steps_per_update"].as_f64();
        let of_last = || Some(self.last.get("steps")?.as_f64()? / self.newest().max(1) as f64);
        known.or_else(of_last).unwrap_or(0.0)
    }

    /// Writes the head line.
    pub fn state_json(&self, now: f64) -> Value {
        let number = |name: &str| self.last.get(name).and_then(Value::as_f64);
        let (newest, phase) = (self.newest(), self.phase(now));
        let n_left = self.total_updates.saturating_sub(newest);
        let is_going = phase == RunPhase::Training && n_left > 0;
        let left = self.speed().filter(|speed| is_going && *speed > 0.0);
        let rate = self.speed().map(|speed| speed * self.steps_per_update());
        // The speed of a single update says little, but it is all there is at first. A run that has ended has no speed.
        let rate =
            rate.or_else(|| number("system/steps_per_second")).filter(|_| !self.is_over(now));
        json!({
            "schema": SCHEMA,
            "run": self.run,
            "domain": self.about["domain"],
            "state": phase,
            "sentence": self.sentence(now),
            "update": newest,
            "total_updates": self.total_updates,
            "steps": self.last.get("steps"),
            "seconds_left": left.map(|speed| (n_left as f64 / speed).round()),
            "steps_per_second": rate.map(f64::round),
            "success": number("episodes/success"),
            "return": number("episodes/return"),
            "version": self.version,
            "n_actors": self.actors.n_here(),
            "missed": self.n_missed,
            "skipped": self.n_skipped,
            "checkpoint": self.checkpoint,
            "generation": self.generation(),
        })
    }

    /// Writes what the run is.
    pub fn about_json(&self) -> Value {
        let mut about = json!({"schema": SCHEMA, "run": self.run});
        if let (Some(told), Some(about)) = (self.about.as_object(), about.as_object_mut()) {
            about.extend(told.clone());
            about.insert("schema".to_owned(), SCHEMA.into());
        }
        about
    }

    /// Writes the curves from an update on.
    pub fn history_json(&self, from: u64) -> Value {
        json!(self.curves(from))
    }

    /// Does the same as text: in half the bytes, as every number keeps the few digits that it has.
    pub(crate) fn history_text(&self, from: u64) -> String {
        // The names are text, and numbers that are none become null: nothing can fail.
        serde_json::to_string(&self.curves(from)).unwrap_or_default()
    }

    fn curves(&self, from: u64) -> Curves {
        let series = self.series.since(from);
        let mark = |&(update, what): &(u64, &'static str)| CurveMark { update, what };
        Curves {
            from,
            to: series.last(),
            started: self.started,
            steps_per_update: self.steps_per_update(),
            stride: series.stride(),
            marks: self.marks.iter().map(mark).collect(),
            x: series.x,
            scalars: series.scalars,
        }
    }

    /// Writes the newest update, and what is made of it and of those before.
    pub fn update_json(&self, now: f64) -> Value {
        let scalars: Map<String, Value> = self
            .last
            .iter()
            .filter(|(name, _)| name.contains('/'))
            .map(|(n, v)| (n.clone(), v.clone()))
            .collect();
        let newest = self.staleness.back().map(|(_, counts)| counts.clone()).unwrap_or_default();
        let mut sum: BTreeMap<u64, u64> = BTreeMap::new();
        for (staleness, n) in self.staleness.iter().flat_map(|(_, counts)| counts) {
            let sum = sum.entry(*staleness).or_default();
            *sum = sum.saturating_add(*n);
        }
        let elapsed =
            self.made.or(self.last_at).zip(self.started).map(|(made, started)| made - started);
        json!({
            "update": self.newest(),
            "steps": self.last.get("steps"),
            "elapsed": elapsed.map(round),
            "made": self.made,
            "age_ms": self.made.map(|made| ((now - made) * 1e3).round()),
            "scalars": scalars,
            "staleness": newest,
            "staleness_100": sum,
            "clip_by_staleness": self.last.get("clip_by_staleness").and_then(shares_of),
            // A page goes through its entries, whatever a learner tells.
            "refusals": self.last.get("refusals").and_then(Value::as_object).cloned().unwrap_or_default(),
            "phases": self.phases(),
            "books": self.books(),
        })
    }

    /// Returns the shares of the last minute, and what they mean.
    fn phases(&self) -> Value {
        let sum = |of: fn(&UpdateTimes) -> f64| self.window.iter().map(of).sum::<f64>();
        let (wait, train) = (sum(|it| it.wait), sum(|it| it.train));
        let all = sum(|it| it.interval).max(wait + train);
        if all <= 0.0 {
            return Value::Null;
        }
        let (wait, train) = (wait / all, train / all);
        let actors_wait = self.actors.mean_wait();
        let percent = |share: f64| (share * 100.0).round();
        let sentence = if wait > LEARNER_WAITS && actors_wait.is_some_and(|it| it > ACTORS_WAIT) {
            "learner and actors wait for each other: a lag, or more steps per update, would help"
                .to_owned()
        } else if wait > LEARNER_WAITS {
            format!("the learner waits {} % of the time: more actors would help", percent(wait))
        } else if let Some(share) = actors_wait.filter(|share| *share > ACTORS_WAIT) {
            format!("actors wait for the learner {} % of their time", percent(share))
        } else {
            String::new()
        };
        json!({
            "wait": round(wait),
            "train": round(train),
            "rest": round((1.0 - wait - train).max(0.0)),
            "sentence": sentence,
        })
    }

    /// Writes where every rollout went, and whether that adds up.
    fn books(&self) -> Value {
        let settled = self.settled.as_ref().filter(|_| self.ended == Some("finished"));
        if self.last.is_empty() && settled.is_none() {
            return Value::Null;
        }
        let number = |told: Option<&Value>| told.and_then(Value::as_f64).unwrap_or(0.0) as i64;
        let count = |name: &str| match settled {
            Some(books) => number(books.get(name)),
            None => number(self.last.get(&format!("books/{name}"))),
        };
        let (rest, waiting) = match settled {
            Some(_) => ("unused_at_end", count("unused_at_end")),
            None => ("on_their_way", number(self.last.get("system/queued"))),
        };
        let names = ["trained", "dropped_stale", "refused", "superseded", "rolled_back"];
        let mut entries: Vec<Value> = names.iter().map(|name| json!([name, count(name)])).collect();
        entries.push(json!([rest, waiting]));
        let accounted = names.iter().map(|name| count(name)).fold(waiting, i64::saturating_add);
        json!({
            "published": count("published"),
            "entries": entries,
            "balanced": accounted == count("published"),
            "duplicates": count("duplicates"),
            "steps_redone": count("steps_redone"),
        })
    }

    /// Writes the table of actors.
    pub fn actors_json(&self, now: f64) -> Value {
        self.actors.json(self.version, now)
    }

    /// Writes everything at once, for scripts.
    pub fn json(&self, now: f64) -> Value {
        json!({
            "schema": SCHEMA,
            "about": self.about_json(),
            "state": self.state_json(now),
            "update": self.update_json(now),
            "actors": self.actors_json(now),
            "others": self.actors.others(),
            "history": self.history_json(0),
            "log": self.log.iter().map(WatchLine::json).collect::<Vec<_>>(),
        })
    }
}

/// Reads shares by staleness, as many as are kept of an update.
fn shares_of(told: &Value) -> Option<BTreeMap<u64, f64>> {
    let told = told.as_object()?.iter().take(MAX_STALENESS);
    let share = |(staleness, share): (&String, &Value)| {
        Some((staleness.parse().ok()?, share.as_f64().filter(|it| (0.0..=1.0).contains(it))?))
    };
    Some(told.filter_map(share).collect())
}

/// Reads a learner's curves, if their points are in order.
fn told_series(history: &Value) -> Option<ThinSeries> {
    let told = ThinSeries::deserialize(history).ok()?;
    (told.x.is_sorted_by(|a, b| a < b) && told.stride() <= MAX_STRIDE).then_some(told)
}

/// Takes a series apart: the largest value of every number at every point.
fn points(series: &ThinSeries) -> Vec<(u64, Vec<(String, f64)>)> {
    let at = |i: usize| {
        let numbers = series.scalars.iter().filter_map(|(name, extremes)| {
            Some((name.clone(), f64::from((*extremes.max.get(i)?)?)))
        });
        numbers.collect()
    };
    series.x.iter().enumerate().map(|(i, x)| (*x, at(i))).collect()
}

fn update_of(line: &Map<String, Value>) -> u64 {
    line.get("update").and_then(Value::as_u64).unwrap_or(0)
}

fn staleness_of(counts: &Value) -> Option<BTreeMap<u64, u64>> {
    let counts = counts.as_object()?.iter().take(MAX_STALENESS);
    Some(counts.filter_map(|(staleness, n)| Some((staleness.parse().ok()?, n.as_u64()?))).collect())
}

fn is_curve(name: &str) -> bool {
    !NO_CURVES.iter().any(|prefix| name.starts_with(prefix))
}

#[cfg(test)]
#[path = "state_tests.rs"]
mod tests;
