//! Who gets a session, on which thread; what becomes of it when its client, or this process, ends.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use leadtime_link::RareLine;
use leadtime_link::live::{LiveEvent, LiveServiceLink, OpenResponder, RobotKeys};
use leadtime_proto::phrase::counted;
use leadtime_proto::{ClientName, Incarnation};
use leadtime_sims::SnapshotError;
use leadtime_sims::environment::{read_snapshot, write_snapshot};
use leadtime_voice::Loudspeaker;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use tracing::{info, warn};

use crate::live_clock::LiveClock;
use crate::live_session::{LiveSession, LiveSnapshot};
use crate::live_thread::{Hosted, LiveThread, SESSIONS_PER_THREAD, ThreadOrder, ThreadReport};
use crate::open::{OpenRefusal, SayForm, SessionAnswer, SessionNote, SessionPlan};
use crate::robot::{ObservationSource, RobotSession, RobotWriter};
use crate::state_keeper::{StateKeeper, StateStore};
use crate::status::{LiveState, Silence};
use crate::taken::TakenLog;
use crate::working_policy::{LiveDecider, PolicyOrigin, WorkingPolicy};

/// The most sessions of a notifier.
pub const MAX_SESSIONS: usize = 64;
/// The most reports of threads that wait.
const MAX_REPORTS: usize = 1_024;
/// How often the states of clients that stay away are looked for, in nanoseconds.
const SWEEP_EVERY: u64 = 3_600_000_000_000;
/// Between two lines in the log about the refused observations of one session, in nanoseconds.
const REFUSALS_PAUSE: u64 = 60_000_000_000;
/// The most lines in the log, of a kind and in a minute, about sessions that come and go: as many as there can be at once.
const SESSION_LINES: u32 = MAX_SESSIONS as u32;

/// What a session does whose client says nothing.
const QUIET: [LiveState; 3] = [LiveState::Waiting, LiveState::Lost, LiveState::Closed];

/// How a notifier works.
#[derive(Clone, Debug)]
pub struct ServiceSettings {
    /// The most sessions at once, up to [`MAX_SESSIONS`].
    pub max_sessions: usize,
    /// Seed of sessions whose client names none.
    pub seed: u64,
    /// Whether threads wait awake for the last fraction of a millisecond.
    pub spins: bool,
    /// Where states are kept; nowhere by default.
    pub store: Option<Arc<dyn StateStore>>,
    /// What plays the sentences here; nothing by default.
    pub loudspeaker: Option<Loudspeaker>,
    /// What the wall clock shows now, in nanoseconds: how old a kept state is.
    pub unix: i64,
}

/// Why a notifier cannot work.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// A thread could not be started.
    #[error("cannot start a thread for sessions")]
    Thread(#[source] std::io::Error),
}

/// What is known of an open session.
#[derive(Debug)]
struct Registered {
    incarnation: Option<Incarnation>,
    id: String,
    thread: usize,
    state: LiveState,
    question: Vec<u8>,
    /// What was answered, but for the number after which the client has to count on.
    plan: SessionPlan,
    /// That number, by the session's thread.
    last_seq: Arc<AtomicU64>,
    /// The answer as a client is given it that has room for everything, for recorders.
    whole: Vec<u8>,
    /// The key and the form of a robot's observations.
    place: Option<String>,
    /// The command line opened it, and no other client may have its place.
    is_standing: bool,
    refusals: RefusalLog,
}

/// How many refused observations of a session have been logged, and when.
#[derive(Debug, Default)]
struct RefusalLog {
    n_told: u64,
    told_at: Option<u64>,
}

impl RefusalLog {
    /// Returns how many were refused since the last line, if it is time for another one.
    fn look(&mut self, now: u64, n_refused: u64) -> Option<u64> {
        let n_new = n_refused.saturating_sub(self.n_told);
        let is_due = self.told_at.is_none_or(|at| now.saturating_sub(at) >= REFUSALS_PAUSE);
        if n_new == 0 || !is_due {
            return None;
        }
        (self.n_told, self.told_at) = (n_refused, Some(now));
        Some(n_new)
    }
}

/// Lines of the log that clients cause, which can ask as often as they like.
#[derive(Debug)]
struct SessionLines {
    refused: RareLine,
    opened: RareLine,
    displaced: RareLine,
    over: RareLine,
    /// About messages that were refused: each session's first is told at once.
    unusable: RareLine,
}

impl Default for SessionLines {
    fn default() -> Self {
        let line = || RareLine::of_many(SESSION_LINES);
        Self { refused: line(), opened: line(), displaced: line(), over: line(), unusable: line() }
    }
}

/// A session's state as it is kept.
#[derive(Serialize, Deserialize)]
struct KeptSession {
    id: String,
    origin: PolicyOrigin,
    words: u32,
    voice: Option<String>,
    place: Option<String>,
    question: Vec<u8>,
    /// When, by the wall clock, in nanoseconds.
    at: i64,
    snapshot: LiveSnapshot,
}

/// Why the kept state of a session cannot be read.
#[derive(Debug, Error)]
enum KeptFault {
    /// It was torn or changed, or a release without checksums wrote it.
    #[error("its checksum is wrong")]
    Checksum,
    /// Another release wrote it.
    #[error(transparent)]
    Content(#[from] SnapshotError),
}

/// Writes a session's state, and a checksum behind it: with one wrong number nobody might be spoken to any more.
fn write_kept(kept: &KeptSession) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_snapshot(kept, &mut bytes);
    let checksum = crc32c::crc32c(&bytes);
    bytes.extend_from_slice(&checksum.to_le_bytes());
    bytes
}

fn read_kept(bytes: &[u8]) -> Result<KeptSession, KeptFault> {
    let (state, checksum) = bytes.split_last_chunk::<4>().ok_or(KeptFault::Checksum)?;
    if crc32c::crc32c(state) != u32::from_le_bytes(*checksum) {
        return Err(KeptFault::Checksum);
    }
    Ok(read_snapshot(state)?)
}

/// Returns a time in nanoseconds as a number that may be less than zero.
fn signed(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

/// A notifier at work.
#[derive(Debug)]
pub struct LiveService {
    policy: WorkingPolicy,
    decider: LiveDecider,
    settings: ServiceSettings,
    link: LiveServiceLink,
    events: flume::Receiver<LiveEvent>,
    own: Incarnation,
    clock: LiveClock,
    /// What the wall clock showed when the notifier's own clock was at zero, in nanoseconds.
    epoch: i64,
    threads: Vec<LiveThread>,
    n_opened: u64,
    open: BTreeMap<ClientName, Registered>,
    present: BTreeMap<ClientName, BTreeSet<Incarnation>>,
    reports: flume::Receiver<ThreadReport>,
    /// What keeps the states of sessions, if they are kept.
    keeper: Option<StateKeeper>,
    sweep_due: u64,
    /// The checksum over the words.
    words: u32,
    lines: SessionLines,
}

impl LiveService {
    /// Prepares a notifier; it works once [`LiveService::run`] is called.
    ///
    /// # Errors
    ///
    /// [`ServiceError::Thread`] if the system starts no further thread.
    pub fn new(
        policy: WorkingPolicy,
        settings: ServiceSettings,
        link: LiveServiceLink,
        events: flume::Receiver<LiveEvent>,
        own: Incarnation,
    ) -> Result<Self, ServiceError> {
        let (sender, reports) = flume::bounded(MAX_REPORTS);
        let (decider, clock) = (policy.decider(), LiveClock::start());
        let words = policy.words_checksum();
        let n_threads = settings.max_sessions.div_ceil(SESSIONS_PER_THREAD).max(1);
        let start = |i| {
            let (decider, sender) = (decider.clone(), sender.clone());
            let (spins, loudspeaker) = (settings.spins, settings.loudspeaker.clone());
            LiveThread::start(format!("live-{i}"), decider, clock, spins, loudspeaker, sender)
        };
        let threads = (0..n_threads).map(start).collect::<Result<_, _>>();
        let keeper = settings.store.clone().map(StateKeeper::start).transpose();
        let epoch = settings.unix.saturating_sub(signed(clock.now()));
        Ok(Self {
            epoch,
            threads: threads.map_err(ServiceError::Thread)?,
            decider,
            policy,
            settings,
            link,
            events,
            own,
            clock,
            n_opened: 0,
            open: BTreeMap::new(),
            present: BTreeMap::new(),
            reports,
            keeper: keeper.map_err(ServiceError::Thread)?,
            sweep_due: 0,
            words,
            lines: SessionLines::default(),
        })
    }

    /// Works until it is asked to stop, then notifies every client and leaves.
    ///
    /// # Errors
    ///
    /// [`leadtime_link::Error`] if the network ends, or leaving it takes too long.
    pub async fn run(mut self, stop: impl Future<Output = ()>) -> leadtime_link::Result<()> {
        let mut stop = std::pin::pin!(stop);
        let mut looks = tokio::time::interval(std::time::Duration::from_secs(1));
        let (events, reports) = (self.events.clone(), self.reports.clone());
        loop {
            tokio::select! {
                () = &mut stop => break,
                event = events.recv_async() => match event {
                    Ok(event) => self.take(event),
                    Err(_ended) => break,
                },
                report = reports.recv_async() => match report {
                    Ok(report) => self.note(report),
                    Err(_ended) => break,
                },
                _ = looks.tick() => {
                    self.link.health().await?;
                    self.sweep();
                    self.recount().await;
                }
            }
        }
        self.threads.into_iter().for_each(LiveThread::stop);
        let closed = self.link.close().await;
        // After the farewell: a slow disk keeps no client waiting for it.
        drop(self.keeper);
        closed
    }

    fn take(&mut self, event: LiveEvent) {
        match event {
            LiveEvent::Open { client, question, responder } => {
                // A client that asks because its session has ended asks for another one.
                while let Ok(report) = self.reports.try_recv() {
                    self.note(report);
                }
                self.answer(&client, question, responder);
            }
            LiveEvent::Describe(client, responder) => {
                // A client without a session gets no answer, and asks again.
                if let Some(note) = self.open.get(&client).and_then(|it| self.note_of(&client, it))
                {
                    responder.reply(note);
                }
            }
            LiveEvent::Here(client, start) => {
                self.present.entry(client.clone()).or_default().insert(start);
                self.tell_thread(client, start, true);
            }
            LiveEvent::Gone(client, start) => {
                if let Some(starts) = self.present.get_mut(&client) {
                    starts.remove(&start);
                    if starts.is_empty() {
                        self.present.remove(&client);
                    }
                }
                self.tell_thread(client, start, false);
            }
        }
    }

    /// Asks who is there if something of that was not told, for want of room.
    async fn recount(&mut self) {
        if !self.link.take_missed() {
            return;
        }
        // What waits is older than the answer.
        for event in self.events.drain().collect::<Vec<_>>() {
            self.take(event);
        }
        if let Some(here) = self.link.clients().await {
            self.reconcile(&here);
        }
    }

    fn reconcile(&mut self, here: &BTreeSet<(ClientName, Incarnation)>) {
        let starts = |(client, starts): (&ClientName, &BTreeSet<Incarnation>)| {
            starts.iter().map(|start| (client.clone(), *start)).collect::<Vec<_>>()
        };
        let known: BTreeSet<_> = self.present.iter().flat_map(starts).collect();
        for (client, start) in known.difference(here) {
            self.take(LiveEvent::Gone(client.clone(), *start));
        }
        for (client, start) in here.difference(&known) {
            self.take(LiveEvent::Here(client.clone(), *start));
        }
    }

    fn tell_thread(&self, client: ClientName, start: Incarnation, is_here: bool) {
        // Another start is none of the session's, and anybody may show thousands of them.
        let own = self.open.get(&client).filter(|it| it.incarnation == Some(start));
        if let Some(registered) = own {
            self.threads[registered.thread].order(ThreadOrder::Presence(client, start, is_here));
        }
    }

    fn answer(&mut self, client: &ClientName, question: Vec<u8>, responder: OpenResponder) {
        match self.open_session(client, question) {
            Ok(answer) => responder.reply(answer),
            Err(refusal) => {
                if let Some(more) = self.lines.refused.suffix(Instant::now()) {
                    info!(%client, %refusal, "a session was refused{more}");
                }
                responder.refuse(refusal.to_string());
            }
        }
    }

    /// Returns what a recorder has to know of a session.
    fn note_of(&self, client: &ClientName, registered: &Registered) -> Option<Vec<u8>> {
        let note = SessionNote {
            client: client.to_string(),
            session: registered.id.clone(),
            start: self.own.hex(),
            question: serde_json::from_slice(&registered.question).ok()?,
            answer: serde_json::from_slice(&registered.whole).ok()?,
            policy: self.policy.origin.clone(),
            words_checksum: self.words,
        };
        serde_json::to_vec(&note).ok()
    }

    fn open_session(
        &mut self,
        client: &ClientName,
        question: Vec<u8>,
    ) -> Result<Vec<u8>, OpenRefusal> {
        let plan = SessionPlan::read(&question, &self.policy, self.settings.seed)?;
        let start = plan.incarnation;
        if let Some(registered) = self.open.get(client) {
            let is_same = start.is_some() && start == registered.incarnation;
            if is_same && registered.question == question {
                let last_seq = registered.last_seq.load(Ordering::Relaxed);
                let (id, plan) = (&registered.id, &registered.plan);
                return Ok(self.answer_of(id, plan, last_seq)?);
            }
            if !is_same && self.is_there(client, registered) {
                return Err(OpenRefusal::Taken(client.to_string()));
            }
            let thread = registered.thread;
            self.remove(client, thread, None)?;
        }
        if self.open.len() >= self.settings.max_sessions {
            self.make_room()?;
        }
        self.host(client, question, &plan, None)
    }

    /// Opens the session of a robot that does not ask for one; it stays as long as the notifier.
    ///
    /// # Errors
    ///
    /// [`OpenRefusal`] if the question cannot be met or the session's keys cannot be used; a client would get the same
    /// sentence.
    pub fn stand(&mut self, robot_session: RobotSession) -> Result<(), OpenRefusal> {
        let plan = SessionPlan::read(&robot_session.question, &self.policy, self.settings.seed)?;
        let plan = SessionPlan { source: ObservationSource::Robot(robot_session.form), ..plan };
        let RobotSession { client, question, keys, writer, .. } = robot_session;
        for note in &plan.notes {
            info!(%client, note, "what the robot would be told");
        }
        let writer = writer.started_at(self.clock.now());
        self.host(&client, question, &plan, Some((keys, writer))).map(drop)
    }

    /// Makes a session and gives it to a thread; returns the answer to its question.
    fn host(
        &mut self,
        client: &ClientName,
        question: Vec<u8>,
        plan: &SessionPlan,
        robot: Option<(RobotKeys, RobotWriter)>,
    ) -> Result<Vec<u8>, OpenRefusal> {
        let start = plan.incarnation;
        let place =
            robot.as_ref().map(|(keys, _)| format!("{} {:?}", keys.observations, plan.source));
        let (session, notes) = self.session(client, &question, place.as_deref(), plan.clone());
        let taken = TakenLog::new(self.own, session.counts().taken > 0);
        let answered = SessionPlan { notes, ..plan.clone() };
        let answer = self.answer_of(session.id(), &answered, session.last_seq())?;
        let whole = SessionPlan { form: SayForm::Json, ..answered.clone() };
        let whole = self.answer_of(session.id(), &whole, session.last_seq())?;
        let thread = self.idlest_thread();
        let is_raw = plan.form == SayForm::Binary;
        let (keys, writer) = robot.unzip();
        let port = self.link.port(client, is_raw, keys.as_ref(), self.threads[thread].waker())?;
        let (client, id) = (client.clone(), session.id().to_owned());
        let is_standing = writer.is_some();
        let name = client.clone();
        let last_seq = Arc::new(AtomicU64::new(session.last_seq()));
        let told = Arc::clone(&last_seq);
        let hosted = Hosted {
            client: name,
            incarnation: start,
            session,
            port,
            writer,
            taken,
            last_seq: told,
        };
        if !self.threads[thread].order(ThreadOrder::Add(Box::new(hosted))) {
            return Err(OpenRefusal::Busy);
        }
        if let Some(more) = self.lines.opened.suffix(Instant::now()) {
            info!(%client, session = id, "a session is open{more}");
        }
        let state = LiveState::Waiting;
        let registered = Registered {
            incarnation: start,
            id,
            thread,
            state,
            question,
            plan: answered,
            last_seq,
            whole,
            place,
            is_standing,
            refusals: RefusalLog::default(),
        };
        self.open.insert(client, registered);
        Ok(answer)
    }

    /// Returns the answer to a client, as JSON.
    fn answer_of(
        &self,
        id: &str,
        plan: &SessionPlan,
        last_seq: u64,
    ) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(&SessionAnswer::new(id, self.own, plan, &self.policy, last_seq))
    }

    /// Has a thread end a session. As long as the thread does not know of it, the session goes on.
    fn remove(
        &mut self,
        client: &ClientName,
        thread: usize,
        why: Option<Silence>,
    ) -> Result<Option<Registered>, OpenRefusal> {
        if !self.threads[thread].order(ThreadOrder::Remove(client.clone(), why)) {
            return Err(OpenRefusal::Busy);
        }
        Ok(self.open.remove(client))
    }

    /// Ends the session of a client that is not there any more, if there is one. One that says something is the last to go.
    fn make_room(&mut self) -> Result<(), OpenRefusal> {
        let gone = self.open.iter().filter(|(client, it)| !self.is_there(client, it));
        let gone = gone.min_by_key(|(_, it)| !QUIET.contains(&it.state));
        let Some((client, thread)) = gone.map(|(client, it)| (client.clone(), it.thread)) else {
            // With a loudspeaker the command line has no other limit.
            let has_loudspeaker = self.settings.loudspeaker.is_some();
            let full = OpenRefusal::Full(self.settings.max_sessions);
            return Err(if has_loudspeaker { OpenRefusal::OneLoudspeaker } else { full });
        };
        if let Some(registered) = self.remove(&client, thread, Some(Silence::NoPlace))?
            && let Some(more) = self.lines.displaced.suffix(Instant::now())
        {
            info!(%client, session = registered.id, "a session gives up its place to another client{more}");
        }
        Ok(())
    }

    /// Makes a session, or goes on with the one that was kept.
    fn session(
        &mut self,
        client: &ClientName,
        question: &[u8],
        place: Option<&str>,
        plan: SessionPlan,
    ) -> (LiveSession, Vec<String>) {
        let mut notes = plan.notes.clone();
        let kept = self.keeper.as_ref().and_then(|keeper| keeper.find(client));
        let kept: Option<KeptSession> = kept.and_then(|bytes| {
            let read = read_kept(&bytes);
            read.inspect_err(|error| {
                warn!(%client, %error, "the kept state of a session cannot be read; the client gets a new one");
            })
            .ok()
        });
        let is_same = |kept: &KeptSession| {
            let is_known = plan.incarnation.is_some() || plan.source != ObservationSource::Client;
            let is_policy = kept.origin == self.policy.origin
                && self.policy.has_words(kept.words)
                && kept.voice == self.voice_name();
            is_policy && kept.place.as_deref() == place && kept.question == question && is_known
        };
        let now = self.clock.now();
        let make = |id, plan| LiveSession::new(id, plan, &self.policy, &self.decider, now);
        if let Some(kept) = kept.filter(is_same) {
            let mut session = make(kept.id, plan.clone());
            if session.restore(kept.snapshot) {
                let age = u64::try_from(self.unix(now).saturating_sub(kept.at));
                if !age.is_ok_and(|age| age <= session.kept_for()) {
                    session.forget();
                }
                let note = if session.goes_on() {
                    "the session goes on where it was"
                } else {
                    "the numbers continue; what was said before is too long ago, so a new episode begins"
                };
                notes.push(note.to_owned());
                return (session, notes);
            }
        }
        self.n_opened += 1;
        let id = self.own.0.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(self.n_opened);
        (make(format!("{:08x}", id as u32), plan), notes)
    }

    /// Forgets the state of a session that was closed: with what closed it, it would be closed again.
    fn forget(&self, client: &ClientName) {
        if let Some(keeper) = &self.keeper {
            keeper.forget(client);
        }
    }

    /// Has the states of clients removed that stay away, at the start and once an hour.
    fn sweep(&mut self) {
        let now = self.clock.now();
        if let Some(keeper) = self.keeper.as_ref().filter(|_| now >= self.sweep_due) {
            keeper.sweep();
            self.sweep_due = now + SWEEP_EVERY;
        }
    }

    /// Returns what the wall clock shows when the notifier's own clock shows `now`, in nanoseconds.
    fn unix(&self, now: u64) -> i64 {
        self.epoch.saturating_add(signed(now))
    }

    /// Returns the name of the voice, with everything that belongs to it.
    fn voice_name(&self) -> Option<String> {
        self.policy.voice().map(|voice| voice.name.clone())
    }

    /// Returns whether the client of a session is there.
    fn is_there(&self, client: &ClientName, registered: &Registered) -> bool {
        if registered.is_standing {
            return true;
        }
        if let Some(start) = registered.incarnation {
            return self.present.get(client).is_some_and(|starts| starts.contains(&start));
        }
        // One that shows no presence is there as long as it says something.
        !QUIET.contains(&registered.state)
    }

    fn idlest_thread(&self) -> usize {
        let n_of = |thread: &usize| self.open.values().filter(|it| it.thread == *thread).count();
        (0..self.threads.len()).min_by_key(n_of).unwrap_or(0)
    }

    fn note(&mut self, report: ThreadReport) {
        match report {
            ThreadReport::Over { client, id, why } => {
                if self.open.get(&client).is_some_and(|registered| registered.id == id) {
                    self.open.remove(&client);
                    if let Some(more) = self.lines.over.suffix(Instant::now()) {
                        info!(%client, session = id, %why, "a session is over{more}");
                    }
                    // Who said nothing for long may come back: nothing in its state would end the session again.
                    if why != Silence::Forgotten {
                        self.forget(&client);
                    }
                }
            }
            ThreadReport::State { client, id, now, state, refusals, snapshot } => {
                let (at, voice) = (self.unix(now), self.voice_name());
                let Some(registered) = self.open.get_mut(&client) else { return };
                if registered.id != id {
                    return;
                }
                registered.state = state;
                let (n_refused, reason) = refusals;
                if let Some(n) = registered.refusals.look(now, n_refused)
                    && let Some(more) = self.lines.unusable.suffix(Instant::now())
                {
                    let n = counted(n, "message");
                    warn!(%client, session = id, "{n} refused; of the last one: {reason}{more}");
                }
                let Some(keeper) = &self.keeper else { return };
                let kept = KeptSession {
                    id,
                    origin: self.policy.origin.clone(),
                    words: self.words,
                    voice,
                    place: registered.place.clone(),
                    at,
                    question: registered.question.clone(),
                    snapshot: *snapshot,
                };
                keeper.keep(&client, write_kept(&kept));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::time::Duration;

    use leadtime_link::live::{LiveClientLink, LiveMessage};
    use leadtime_link::{ConnectSettings, Endpoint, ListenSettings};
    use leadtime_proto::ServiceName;
    use serde_json::Value;
    use tokio::task::JoinHandle;

    use super::*;
    use crate::client::{ClientError, ClientSettings, LiveClient};
    use crate::open::StepClock;
    use crate::test_support::policy;

    /// A disk that hangs once something is to be written, until its test lets it go.
    #[derive(Debug)]
    struct HangingStore {
        swept: flume::Sender<()>,
        hangs: flume::Sender<()>,
        go: flume::Receiver<()>,
    }

    impl StateStore for HangingStore {
        fn keep(&self, _client: &ClientName, _state: &[u8]) -> std::io::Result<()> {
            if self.hangs.try_send(()).is_ok() {
                while self.go.recv().is_ok() {}
            }
            Ok(())
        }

        fn find(&self, _client: &ClientName) -> Option<Vec<u8>> {
            None
        }

        fn forget(&self, _client: &ClientName) -> std::io::Result<()> {
            Ok(())
        }

        fn sweep(&self) {
            self.swept.try_send(()).ok();
        }
    }

    /// Keeps states in memory.
    #[derive(Debug, Default)]
    struct MemoryStore(Mutex<BTreeMap<ClientName, Vec<u8>>>);

    impl StateStore for MemoryStore {
        fn keep(&self, client: &ClientName, state: &[u8]) -> std::io::Result<()> {
            self.0.lock().unwrap().insert(client.clone(), state.to_vec());
            Ok(())
        }

        fn find(&self, client: &ClientName) -> Option<Vec<u8>> {
            self.0.lock().unwrap().get(client).cloned()
        }

        fn forget(&self, client: &ClientName) -> std::io::Result<()> {
            self.0.lock().unwrap().remove(client);
            Ok(())
        }

        fn sweep(&self) {}
    }

    /// Prepares a notifier for two clients that keeps its states there.
    async fn prepared(store: Arc<dyn StateStore>) -> LiveService {
        let own = Incarnation(7);
        let settings = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
        let service = ServiceName::new("n").unwrap();
        let (link, events) = LiveServiceLink::open(&settings, &service, own).await.unwrap();
        let settings = ServiceSettings {
            max_sessions: 2,
            seed: 1,
            spins: false,
            store: Some(store),
            loudspeaker: None,
            unix: 0,
        };
        LiveService::new(policy("lander", None), settings, link, events, own).unwrap()
    }

    /// Puts a notifier to work until the sender is dropped.
    fn at_work(
        notifier: LiveService,
    ) -> (flume::Sender<()>, JoinHandle<leadtime_link::Result<()>>) {
        let (stop, stopped) = flume::bounded::<()>(1);
        let runtime = tokio::runtime::Handle::current();
        let work = tokio::task::spawn_blocking(move || {
            runtime.block_on(notifier.run(async move { stopped.recv_async().await.unwrap_or(()) }))
        });
        (stop, work)
    }

    async fn ended(notifier: LiveService) {
        notifier.threads.into_iter().for_each(LiveThread::stop);
        notifier.link.close().await.unwrap();
    }

    /// Opens a session; returns its name, or the sentence that says no.
    fn opened(notifier: &mut LiveService, client: &str) -> Result<String, String> {
        let question = br#"{"protocol":1,"domain":"lander","incarnation":"0000000000000003"}"#;
        let client = ClientName::new(client).unwrap();
        let answer = notifier.open_session(&client, question.to_vec());
        let answer = answer.map_err(|refusal| refusal.to_string())?;
        let answer: Value = serde_json::from_slice(&answer).unwrap();
        Ok(answer["session"].as_str().unwrap().to_owned())
    }

    fn asked(client: &str) -> ClientSettings {
        ClientSettings {
            service: ServiceName::new("n").unwrap(),
            client: ClientName::new(client).unwrap(),
            incarnation: Incarnation(3),
            domain: "lander".to_owned(),
            obs_dim: None,
            clock: StepClock::Observation,
            seconds_per_step: 0.3,
            seed: 1,
            form: SayForm::Json,
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_disk_that_hangs_keeps_no_client_waiting_and_is_swept_at_the_start() {
        let (swept, sweeping) = flume::bounded(1);
        let (hangs, hanging) = flume::bounded(1);
        let (let_go, go) = flume::bounded::<()>(1);
        let notifier = prepared(Arc::new(HangingStore { swept, hangs, go })).await;
        let endpoint = notifier.link.locators()[0].parse().unwrap();
        let (stop, work) = at_work(notifier);
        sweeping.recv_async().await.unwrap();
        let clients = LiveClientLink::open(&ConnectSettings::new(vec![endpoint])).await.unwrap();
        let first = LiveClient::open(&clients, asked("first")).await.unwrap();
        hanging.recv_async().await.unwrap();
        let second = LiveClient::open(&clients, asked("second")).await.unwrap();
        assert_ne!(first.answer()["session"], second.answer()["session"]);
        drop((first, second));
        clients.close().await.unwrap();
        drop((let_go, stop));
        work.await.unwrap().unwrap();
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_client_that_was_quiet_for_long_finds_its_session_and_one_that_was_closed_does_not() {
        let mut notifier = prepared(Arc::new(MemoryStore::default())).await;
        let id = opened(&mut notifier, "car-1").unwrap();
        // Within a second its thread reports a state, which is kept.
        let report = notifier.reports.recv_async().await.unwrap();
        notifier.note(report);
        let client = ClientName::new("car-1").unwrap();
        let over = |why| ThreadReport::Over { client: client.clone(), id: id.clone(), why };
        notifier.note(over(Silence::Forgotten));
        assert_eq!(opened(&mut notifier, "car-1").unwrap(), id);
        notifier.note(over(Silence::Refused(16, "noise".to_owned())));
        assert_ne!(opened(&mut notifier, "car-1").unwrap(), id);
        ended(notifier).await;
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_thread_without_room_for_orders_keeps_its_sessions_and_other_starts_take_no_room() {
        let mut notifier = prepared(Arc::new(MemoryStore::default())).await;
        let (thread, orders) = LiveThread::ended();
        std::mem::replace(&mut notifier.threads, vec![thread])
            .into_iter()
            .for_each(LiveThread::stop);
        let id = opened(&mut notifier, "car-1").unwrap();
        let client = ClientName::new("car-1").unwrap();
        let here = |start| LiveEvent::Here(client.clone(), Incarnation(start));
        (4..1_000).for_each(|other| notifier.take(here(other)));
        assert!(matches!(orders.try_recv(), Ok(ThreadOrder::Add(_))));
        assert!(orders.try_recv().is_err());
        // Its own start goes and comes, faster than the thread takes note of it.
        (0..1_000).for_each(|_| notifier.take(here(3)));
        let gone = LiveEvent::Gone(client.clone(), Incarnation(3));
        notifier.take(gone);
        let busy = OpenRefusal::Busy.to_string();
        notifier.settings.max_sessions = 1;
        assert_eq!(opened(&mut notifier, "car-2").unwrap_err(), busy);
        notifier.open.get_mut(&client).unwrap().incarnation = Some(Incarnation(2));
        assert_eq!(opened(&mut notifier, "car-1").unwrap_err(), busy);
        assert_eq!(notifier.open[&client].id, id);
        // Its thread has taken note of it all.
        assert!(orders.try_iter().all(|order| matches!(order, ThreadOrder::Presence(..))));
        opened(&mut notifier, "car-1").unwrap();
        let orders: Vec<_> = orders.try_iter().collect();
        assert!(matches!(&*orders, [ThreadOrder::Remove(_, None), ThreadOrder::Add(_)]));
        ended(notifier).await;
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn who_finds_no_place_is_told_which_option_allows_no_more() {
        let player = Loudspeaker::start(Some("cat > /dev/null"), 8_000).unwrap();
        for (max_sessions, loudspeaker, told) in [
            (2, None, "no place is free: --max-sessions allows 2 sessions"),
            (1, None, "no place is free: --max-sessions allows 1 session"),
            (1, Some(player), "no place is free: the loudspeaker of --play speaks to one client"),
        ] {
            let mut notifier = prepared(Arc::new(MemoryStore::default())).await;
            let settings = &mut notifier.settings;
            (settings.max_sessions, settings.loudspeaker) = (max_sessions, loudspeaker);
            for client in ["car-1", "car-2"].into_iter().take(max_sessions) {
                opened(&mut notifier, client).unwrap();
                let here = LiveEvent::Here(ClientName::new(client).unwrap(), Incarnation(3));
                notifier.take(here);
            }
            assert_eq!(opened(&mut notifier, "car-3").unwrap_err(), told);
            ended(notifier).await;
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_client_is_left_by_the_start_that_answered_and_by_no_other() {
        const PATIENCE: Duration = Duration::from_secs(20);
        let notifier = prepared(Arc::new(MemoryStore::default())).await;
        let endpoint: Endpoint = notifier.link.locators()[0].parse().unwrap();
        let (stop, work) = at_work(notifier);
        let settings = ConnectSettings::new(vec![endpoint.clone()]);
        let clients = LiveClientLink::open(&settings).await.unwrap();
        let mut client = LiveClient::open(&clients, asked("car-1")).await.unwrap();
        // One that was killed before, as it looks to a client: its token goes late.
        let (service, other) = (ServiceName::new("n").unwrap(), Incarnation(8));
        let witness = ClientName::new("car-2").unwrap();
        let witness = clients.port(&service, &witness, Incarnation(4)).unwrap();
        let settings = ListenSettings { connect: vec![endpoint], ..ListenSettings::new(vec![]) };
        let (killed, _events) = LiveServiceLink::open(&settings, &service, other).await.unwrap();
        killed.close().await.unwrap();
        let mut told = std::iter::from_fn(|| witness.next(PATIENCE));
        assert!(told.any(|message| message == LiveMessage::ServiceGone(other)));
        assert!(client.step(&[0.0; 8], 0, PATIENCE).unwrap().last().unwrap().last);

        drop(stop);
        work.await.unwrap().unwrap();
        let mut heard = std::iter::from_fn(|| client.next(PATIENCE).transpose());
        assert!(heard.any(|heard| matches!(heard, Err(ClientError::Gone))));
        clients.close().await.unwrap();
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn clients_that_are_there_are_those_that_the_network_tells() {
        let mut notifier = prepared(Arc::new(MemoryStore::default())).await;
        let start = |name, start| (ClientName::new(name).unwrap(), Incarnation(start));
        for (client, start) in [start("a", 1), start("a", 2), start("b", 3)] {
            notifier.take(LiveEvent::Here(client, start));
        }
        // The first start of `a` and `b` went, `c` came, and nothing of that found room.
        let here = BTreeSet::from([start("a", 2), start("c", 4)]);
        notifier.reconcile(&here);
        let starts = here.into_iter().map(|(client, start)| (client, BTreeSet::from([start])));
        assert_eq!(notifier.present, starts.collect());
        notifier.link.close().await.unwrap();
    }

    #[test]
    fn a_flood_of_sessions_is_a_limited_number_of_lines() {
        let (mut lines, start) = (SessionLines::default(), Instant::now());
        let SessionLines { refused, opened, displaced, over, unusable } = &mut lines;
        for line in [refused, opened, displaced, over, unusable] {
            let told = (0..1_000).filter(|_| line.suffix(start).is_some());
            assert_eq!(told.count(), MAX_SESSIONS);
            let later = line.suffix(start + std::time::Duration::from_mins(1));
            assert_eq!(later.unwrap(), " (937 times since the last line)");
        }
    }

    #[test]
    fn refused_observations_are_told_at_once_and_then_once_a_minute() {
        let mut log = RefusalLog::default();
        let looks = [(1, 0), (2, 1), (3, 1), (4, 40), (2 + REFUSALS_PAUSE, 90), (u64::MAX, 90)];
        let told = looks.map(|(now, n)| log.look(now, n));
        assert_eq!(told, [None, Some(1), None, None, Some(89), None]);
    }
}
