//! What everybody shares: the run as it is seen, and who listens.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use leadtime_web::axum::body::Bytes;
use serde_json::Value;

use crate::events::{EventBytes, EventHub, EventKind, NoPlace, Wanted, event};
use crate::flight::FlightWatcher;
use crate::state::{Changes, RunView, WatchLine};

/// How often it is looked whether something is due.
pub const TICK: Duration = Duration::from_millis(50);
/// The mean time between two updates that pages receive, at least.
const UPDATE_PAUSE: Duration = Duration::from_millis(200);
/// The shortest time for the table of actors and the head line, which say nothing new more often, and for the curves as a whole.
const TABLE_PAUSE: Duration = Duration::from_secs(1);

/// Reads the time, in seconds since the Unix epoch.
pub type Clock = fn() -> f64;

/// A run as it is seen, and its pages.
pub struct Page {
    clock: Clock,
    /// When the watcher started, in milliseconds since the Unix epoch: it distinguishes this one from others at the
    /// same address.
    epoch: u64,
    shared: Mutex<SharedView>,
}

#[derive(Default)]
struct SharedView {
    view: RunView,
    hub: EventHub,
    /// What has changed and was not sent yet.
    due: Changes,
    history_told_at: Option<Instant>,
    /// When the last update was told, or should have been: one that came late does not delay the next.
    updates_told_at: Option<Instant>,
    tables_told_at: Option<Instant>,
    n_log_told: u64,
    /// The beginning of the episode that is being played, for those who come in the middle of it.
    flight: Option<Bytes>,
}

impl SharedView {
    /// Notes what has changed since it was last asked.
    fn note_changes(&mut self) {
        let new = self.view.take_changes();
        self.due.history |= new.history;
        self.due.update |= new.update;
    }

    /// Sends what the run is and its curves as a whole, if they have changed.
    fn tell_history(&mut self, epoch: u64, now: Instant) {
        if std::mem::take(&mut self.due.history) {
            self.history_told_at = Some(now);
            let Self { view, hub, .. } = self;
            hub.send(EventKind::About, None, &about_json(view, epoch).to_string(), now);
            hub.send(EventKind::History, None, &view.history_text(0), now);
        }
    }

    /// Sends the newest update, if there is one.
    fn tell_update(&mut self, epoch: u64, time: f64, now: Instant) {
        if std::mem::take(&mut self.due.update) {
            let latest = now.checked_sub(UPDATE_PAUSE).unwrap_or(now);
            let planned = self.updates_told_at.map_or(latest, |at| at + UPDATE_PAUSE);
            self.updates_told_at = Some(planned.clamp(latest, now));
            let Self { view, hub, .. } = self;
            let id = event_id(view.newest(), view, epoch);
            hub.send(EventKind::Update, Some(&id), &view.update_json(time).to_string(), now);
        }
    }

    /// Sends new lines of the log.
    fn tell_log(&mut self, now: Instant) {
        let Self { view, hub, n_log_told, .. } = self;
        let lines: Vec<Value> = view.log_after(*n_log_told).map(WatchLine::json).collect();
        if !lines.is_empty() {
            *n_log_told = view.n_logged();
            hub.send(EventKind::Log, None, &Value::from(lines).to_string(), now);
        }
    }
}

impl fmt::Debug for Page {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Page").finish_non_exhaustive()
    }
}

impl Page {
    /// Starts with an empty view of a run.
    pub fn new(run: &str, clock: Clock) -> Arc<Self> {
        let shared = SharedView { view: RunView::new(run), ..SharedView::default() };
        Arc::new(Self { clock, epoch: (clock() * 1e3) as u64, shared: Mutex::new(shared) })
    }

    fn shared(&self) -> MutexGuard<'_, SharedView> {
        // A panic while it was held left at worst one event untold.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at the view, or changes it; the function gets the time.
    pub fn with<T>(&self, work: impl FnOnce(&mut RunView, f64) -> T) -> T {
        let now = (self.clock)();
        work(&mut self.shared().view, now)
    }

    /// Sends pages what has changed, as often as they may get it. Call it at every [`TICK`], and after changes
    /// that are wanted at once.
    pub fn flush(&self, now: Instant) {
        let time = (self.clock)();
        let mut guard = self.shared();
        let shared = &mut *guard;
        shared.view.forget_gone(time);
        shared.note_changes();
        let is_due = |told_at: Option<Instant>, pause: Duration| {
            told_at.is_none_or(|at| now.saturating_duration_since(at) >= pause)
        };
        if is_due(shared.history_told_at, TABLE_PAUSE) {
            shared.tell_history(self.epoch, now);
        }
        // An update that follows a resume goes on from curves that a page must have.
        if !shared.due.history && is_due(shared.updates_told_at, UPDATE_PAUSE) {
            shared.tell_update(self.epoch, time, now);
        }
        if is_due(shared.tables_told_at, TABLE_PAUSE) {
            shared.tables_told_at = Some(now);
            let SharedView { view, hub, .. } = &mut *shared;
            hub.send(EventKind::State, None, &view.state_json(time).to_string(), now);
            hub.send(EventKind::Actors, None, &view.actors_json(time).to_string(), now);
        }
        shared.tell_log(now);
    }

    /// Takes in a page, which gets everything so far, or what came after an event that it knows.
    ///
    /// # Errors
    ///
    /// [`NoPlace`] if there are as many pages as there may be, or the watcher ends.
    pub(crate) fn join(
        &self,
        wanted: Wanted,
        last_event: Option<&str>,
        now: Instant,
    ) -> Result<flume::Receiver<EventBytes>, NoPlace> {
        let time = (self.clock)();
        let mut shared = self.shared();
        shared.note_changes();
        // Curves that are new to all are not told from where a client left off.
        let last_event = last_event.filter(|_| !shared.due.history);
        // What is due is told to the others first: what this client gets now has it, and it must not get it again.
        shared.tell_history(self.epoch, now);
        shared.tell_update(self.epoch, time, now);
        shared.tell_log(now);
        let SharedView { view, hub, flight, .. } = &mut *shared;
        let from = last_event.map_or(0, |id| known_until(id, view, self.epoch));
        let id = event_id(view.newest(), view, self.epoch);
        let log: Vec<Value> = view.log_after(0).map(WatchLine::json).collect();
        let mut first = Vec::new();
        let mut tell = |kind: EventKind, id: Option<&str>, data: &dyn Fn() -> String| {
            if wanted.has(kind) {
                first.push(event(kind, id, &data()));
            }
        };
        tell(EventKind::About, None, &|| about_json(view, self.epoch).to_string());
        tell(EventKind::State, None, &|| view.state_json(time).to_string());
        tell(EventKind::History, None, &|| view.history_text(from));
        tell(EventKind::Update, Some(&id), &|| view.update_json(time).to_string());
        tell(EventKind::Actors, None, &|| view.actors_json(time).to_string());
        tell(EventKind::Log, None, &|| Value::from(log.clone()).to_string());
        if wanted.has(EventKind::Flight) {
            first.extend(flight.clone());
        }
        hub.join(wanted, &first, now)
    }

    /// Counts the pages on which the policy is seen at work.
    pub fn n_watching(&self) -> usize {
        self.shared().hub.n_watching()
    }

    /// Sends every page how the run stands now, and says goodbye.
    pub fn close(&self) {
        let now = Instant::now();
        {
            let mut shared = self.shared();
            (shared.history_told_at, shared.updates_told_at, shared.tables_told_at) =
                (None, None, None);
        }
        self.flush(now);
        self.shared().hub.close(now);
    }
}

impl FlightWatcher for Page {
    fn is_watched(&self) -> bool {
        self.n_watching() > 0
    }

    fn tell(&self, kind: EventKind, data: &Value) {
        let text = data.to_string();
        let mut shared = self.shared();
        if kind == EventKind::Flight {
            shared.flight = Some(event(kind, None, &text));
        }
        shared.hub.send(kind, None, &text, Instant::now());
    }
}

/// Writes what the run is, and who says so.
fn about_json(view: &RunView, epoch: u64) -> Value {
    let mut about = view.about_json();
    about["watcher"] = epoch.into();
    about
}

/// Names an update by its number, how often updates may have been made again before, and the watcher that sends it.
fn event_id(update: u64, view: &RunView, epoch: u64) -> String {
    format!("{update}.{}.{epoch}", view.generation())
}

/// Returns the update up to which a client knows the curves, by the last event that it got; 0 where the event is another
/// watcher's, or updates may have been made again since.
fn known_until(id: &str, view: &RunView, epoch: u64) -> u64 {
    let update = id.split('.').next().and_then(|update| update.parse().ok()).unwrap_or(0);
    if update <= view.newest() && id == event_id(update, view, epoch) { update } else { 0 }
}
