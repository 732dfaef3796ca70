//! Everything that a page knows of a run, from what an observer hears or from a run's directory.
//!
//! Pure: times are handed in, as seconds since the Unix epoch. What comes over the network is believed as far as it can
//! be read; what cannot is left out.

use std::collections::{BTreeMap, VecDeque};

use leadtime_numerics::thin::ThinSeries;
use serde_json::{Map, Value, json};

use crate::actors::{ActorTable, round};

/// The layout of what is told to pages and scripts.
pub const SCHEMA: u32 = 1;
/// The most points of a curve.
const MAX_POINTS: usize = 2_000;
/// Updates over which staleness is summed.
const N_STALENESS: usize = 100;
/// Lines of the log.
const N_LOG: usize = 200;
/// The time over which phases and speed are computed, in seconds.
const WINDOW: f64 = 60.0;
/// The most updates in that window: five a second are told.
const N_WINDOW: usize = 400;
/// After so long without an update something is missing, in seconds.
const STALLED: f64 = 30.0;
/// From this share on the learner's waiting is worth a sentence, and the actors'.
const LEARNER_WAITS: f64 = 0.3;
const ACTORS_WAIT: f64 = 0.5;
/// What a line of the log about a checkpoint begins with.
const CHECKPOINT: &str = "checkpoint of update ";
/// The name of the time since the first update among the curves.
const ELAPSED: &str = "elapsed";
/// Numbers that are shown as they are now, and not as curves.
const NO_CURVES: [&str; 5] =
    ["books/", "episodes/finished", "train/samples", "system/queued", "held_out/"];

/// How a run is, in a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunPhase {
    /// Its learner has not been seen.
    Unknown,
    /// Too few actors.
    Gathering,
    /// Updates come, or will.
    Training,
    /// No update for a while.
    Stalled,
    /// All updates are done.
    Finished,
    /// Stopped, or a directory in which nobody works: it can be resumed.
    Stopped,
    /// The learner ended with an error.
    Failed,
    /// The learner is gone without a word.
    Lost,
}

impl RunPhase {
    /// Returns the name that pages and scripts see.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Gathering => "gathering",
            Self::Training => "training",
            Self::Stalled => "stalled",
            Self::Finished => "finished",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Lost => "lost",
        }
    }
}

/// One line of the log.
#[derive(Clone, Debug, PartialEq)]
pub struct WatchLine {
    /// Its number, from 1.
    pub number: u64,
    /// When, in seconds since the Unix epoch.
    pub at: f64,
    /// `info` or `warn`.
    pub level: &'static str,
    /// A sentence.
    pub text: String,
}

impl WatchLine {
    /// Writes it as pages see it.
    pub fn json(&self) -> Value {
        json!({"number": self.number, "at": round(self.at), "level": self.level, "text": self.text})
    }
}

/// What has changed since it was last asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// What the run is, and the curves as a whole.
    pub history: bool,
    /// The newest update.
    pub update: bool,
    /// The actors.
    pub actors: bool,
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
#[derive(Clone, Debug)]
pub struct RunView {
    run: String,
    about: Value,
    series: ThinSeries,
    marks: Vec<(u64, String)>,
    last: Map<String, Value>,
    last_at: Option<f64>,
    /// When the newest update was made, as its learner's clock says.
    made: Option<f64>,
    started: Option<f64>,
    staleness: VecDeque<(u64, BTreeMap<u64, u64>)>,
    actors: ActorTable,
    window: VecDeque<UpdateTimes>,
    learner: Option<String>,
    /// The first update that this start of the learner told of.
    first_told: Option<u64>,
    /// Whether it told how the run went before.
    knows_history: bool,
    lost_at: Option<f64>,
    ended: Option<&'static str>,
    n_needed: Option<u64>,
    total_updates: u64,
    checkpoint: u64,
    version: u64,
    refusals: BTreeMap<String, u64>,
    n_missed: u64,
    n_skipped: u64,
    log: VecDeque<WatchLine>,
    n_logged: u64,
    changes: Changes,
}

impl RunView {
    /// Starts with a name.
    pub fn new(run: &str) -> Self {
        Self {
            run: run.to_owned(),
            about: Value::Null,
            series: ThinSeries::new(MAX_POINTS),
            marks: Vec::new(),
            last: Map::new(),
            last_at: None,
            made: None,
            started: None,
            staleness: VecDeque::new(),
            actors: ActorTable::default(),
            window: VecDeque::new(),
            learner: None,
            first_told: None,
            knows_history: false,
            lost_at: None,
            ended: None,
            n_needed: None,
            total_updates: 0,
            checkpoint: 0,
            version: 0,
            refusals: BTreeMap::new(),
            n_missed: 0,
            n_skipped: 0,
            log: VecDeque::new(),
            n_logged: 0,
            changes: Changes::default(),
        }
    }

    /// Takes in what the run is.
    pub fn about(&mut self, about: Value, now: f64) {
        self.total_updates = about["total_updates"].as_u64().unwrap_or(self.total_updates);
        if let (Some(update), true) = (about["resumed_from"].as_u64(), self.about.is_null()) {
            self.mark(update, "resumed", now);
        }
        self.about = about;
        self.changes.history = true;
    }

    /// Returns the configuration of the run, as TOML.
    pub fn config(&self) -> Option<&str> {
        self.about["config"].as_str()
    }

    /// Takes in the history from an update on; what is known of later updates than it tells stays.
    pub fn history(&mut self, history: &Value, now: f64) {
        let from = history["from"].as_u64().unwrap_or(0);
        let Ok(told) = serde_json::from_value::<ThinSeries>(history.clone()) else { return };
        self.started = history["started"].as_f64().or(self.started);
        let newer = self.points_after(told.last());
        let mut series = if from == 0 { told.resume(MAX_POINTS) } else { self.series.clone() };
        if from > 0 {
            // A part of it: joined point by point.
            for (x, numbers) in points(&told_series(history)) {
                series.push(x, numbers.iter().map(|(name, value)| (name.as_str(), *value)));
            }
        }
        for (x, numbers) in newer {
            series.push(x, numbers.iter().map(|(name, value)| (name.as_str(), *value)));
        }
        series.scalars.retain(|name, _| is_curve(name));
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

    /// Returns the points after an update that the learner which is there now told of: those of one before it may have
    /// been rolled back.
    fn points_after(&self, update: u64) -> Vec<(u64, Vec<(String, f64)>)> {
        let first = self.first_told.map(|first| first.max(update + 1));
        first.map_or_else(Vec::new, |first| points(&self.series.since(first)))
    }

    /// Takes in what a learner publishes: an update, its roster, or its end.
    pub fn learner_says(&mut self, incarnation: &str, told: Value, now: f64) {
        self.learner_joined(incarnation, now);
        match told["kind"].as_str() {
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
                self.changes.actors = true;
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
        self.series.push(update, numbers.chain([(ELAPSED, elapsed.max(0.0))]));
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

    fn trim(&mut self, now: f64) {
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
            let n = n.as_u64().unwrap_or(0);
            if n > 0 && !self.refusals.contains_key(&cause) {
                self.say("warn", format!("messages are refused: {}", cause.replace('_', " ")), now);
            }
            self.refusals.insert(cause, n);
        }
    }

    /// Notes that a learner is there. Returns whether it is another start than before.
    pub fn learner_joined(&mut self, incarnation: &str, now: f64) -> bool {
        if self.learner.as_deref() == Some(incarnation) {
            self.lost_at = None;
            return false;
        }
        if self.learner.is_some() {
            self.mark(update_of(&self.last), "learner restarted", now);
        } else {
            self.say("info", "the learner is there".to_owned(), now);
        }
        self.learner = Some(incarnation.to_owned());
        (self.lost_at, self.ended, self.first_told) = (None, None, None);
        self.knows_history = false;
        self.window.clear();
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
            self.changes.actors = true;
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
            self.changes.actors = true;
        }
    }

    /// Takes in an actor's own sums.
    pub fn actor_says(&mut self, id: &str, incarnation: &str, told: Value, now: f64) {
        self.actors.report(id, incarnation, told, now);
        self.changes.actors = true;
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

    /// Writes a line into the log.
    pub fn say(&mut self, level: &'static str, text: String, now: f64) {
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

    fn mark(&mut self, update: u64, what: &str, now: f64) {
        self.marks.push((update, what.to_owned()));
        self.say("info", format!("{what} at update {update}"), now);
        self.changes.history = true;
    }

    /// Returns what has changed since the last call.
    pub fn take_changes(&mut self) -> Changes {
        std::mem::take(&mut self.changes)
    }

    /// Returns the lines of the log after a number.
    pub fn log_after(&self, number: u64) -> impl Iterator<Item = &WatchLine> {
        self.log.iter().filter(move |line| line.number > number)
    }

    /// Returns the number of the newest line of the log.
    pub fn n_logged(&self) -> u64 {
        self.n_logged
    }

    /// Counts the actors that are shown, those that are gone included.
    pub fn n_shown_actors(&self) -> usize {
        self.actors.n_shown()
    }

    /// Returns the number of the newest update.
    pub fn newest(&self) -> u64 {
        update_of(&self.last)
    }

    /// Tells whether a learner is there.
    pub fn has_learner(&self) -> bool {
        self.learner.is_some() && self.lost_at.is_none()
    }

    /// Counts how often the learner was started anew while it was watched: updates before that may have been made again.
    pub fn generation(&self) -> usize {
        self.marks.len()
    }

    /// Says how the run is.
    pub fn phase(&self, now: f64) -> RunPhase {
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

    /// Tells whether the learner of the run has ended, in whatever way.
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
            RunPhase::Stalled => format!("no update since {} s", since(self.last_at)),
            RunPhase::Finished => "finished".to_owned(),
            RunPhase::Stopped => "stopped; it can be resumed".to_owned(),
            RunPhase::Failed => "the learner ended with an error".to_owned(),
            RunPhase::Lost => format!("learner lost since {} s", since(self.lost_at)),
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
        let rate = self.speed().map(|speed| (speed * self.steps_per_update()).round());
        json!({
            "schema": SCHEMA,
            "run": self.run,
            "domain": self.about["domain"],
            "state": phase.name(),
            "sentence": self.sentence(now),
            "update": newest,
            "total_updates": self.total_updates,
            "steps": self.last.get("steps"),
            "seconds_left": left.map(|speed| (n_left as f64 / speed).round()),
            "steps_per_second": rate.or_else(|| number("system/steps_per_second").map(f64::round)),
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
        let series = self.series.since(from);
        let marks: Vec<Value> = self
            .marks
            .iter()
            .map(|(update, what)| json!({"update": update, "what": what}))
            .collect();
        json!({
            "from": from,
            "to": series.last(),
            "started": self.started,
            "steps_per_update": self.steps_per_update(),
            "x": series.x,
            "scalars": series.scalars,
            "marks": marks,
        })
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
            *sum.entry(*staleness).or_default() += n;
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
            "refusals": self.last.get("refusals").cloned().unwrap_or_else(|| json!({})),
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
        let count = |name: &str| {
            self.last.get(&format!("books/{name}")).and_then(Value::as_f64).unwrap_or(0.0) as i64
        };
        if self.last.is_empty() {
            return Value::Null;
        }
        let waiting = self.last.get("system/queued").and_then(Value::as_f64).unwrap_or(0.0) as i64;
        let names = ["trained", "dropped_stale", "refused", "superseded", "rolled_back"];
        let mut entries: Vec<Value> = names.iter().map(|name| json!([name, count(name)])).collect();
        entries.push(json!(["on_their_way", waiting]));
        let accounted = names.iter().map(|name| count(name)).sum::<i64>() + waiting;
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

fn told_series(history: &Value) -> ThinSeries {
    serde_json::from_value(history.clone()).unwrap_or_else(|_unreadable| ThinSeries::new(2))
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
    let counts = counts.as_object()?.iter();
    Some(counts.filter_map(|(staleness, n)| Some((staleness.parse().ok()?, n.as_u64()?))).collect())
}

fn is_curve(name: &str) -> bool {
    !NO_CURVES.iter().any(|prefix| name.starts_with(prefix))
}

#[cfg(test)]
#[path = "state_tests.rs"]
mod tests;
