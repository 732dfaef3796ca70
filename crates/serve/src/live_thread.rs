//! A thread that speaks for up to 16 sessions: it sleeps until something arrives or is due, and never waits for anything else.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use leadtime_link::live::{LivePort, LiveTopic};
use leadtime_proto::{ClientName, Incarnation};
use leadtime_voice::{Loudspeaker, SpokenSentence};
use tracing::debug;

use crate::live_clock::LiveClock;
use crate::live_session::{LiveSession, LiveSnapshot, ObservationBytes};
use crate::robot::RobotWriter;
use crate::say::SayTo;
use crate::status::{LiveState, Silence};
use crate::taken::{TakenInput, TakenLog};
use crate::working_policy::LiveDecider;

pub(crate) const SESSIONS_PER_THREAD: usize = 16;
/// The most orders to a thread, and reports of it, that wait.
const MAX_WAITING: usize = 256;
/// The most reports of a client that are taken at a time: the other sessions of the thread wait meanwhile.
const MAX_REPORTS: usize = 4;
/// The last part of a sleep that is waited awake, because a sleeper wakes up late.
const SPIN: Duration = Duration::from_micros(300);
/// The longest sleep; a thread without work wakes up this often.
const LONGEST_SLEEP: Duration = Duration::from_secs(1);
/// How often the state of every session is reported, in nanoseconds.
const SNAPSHOT_EVERY: u64 = 1_000_000_000;

#[derive(Debug)]
pub(crate) enum ThreadOrder {
    /// Speak for one more client.
    Add(Box<Hosted>),
    /// This start of a client has appeared or disappeared.
    Presence(ClientName, Incarnation, bool),
    /// A client's session is replaced by another one, or ends for this reason.
    Remove(ClientName, Option<Silence>),
}

#[derive(Debug)]
pub(crate) enum ThreadReport {
    /// The state of a session.
    State {
        client: ClientName,
        id: String,
        /// The notifier's time of the snapshot, in nanoseconds.
        now: u64,
        state: LiveState,
        /// How many messages were refused, and why the last one was.
        refusals: (u64, String),
        /// How it could go on in another process.
        snapshot: Box<LiveSnapshot>,
    },
    /// A session is over, for this reason.
    Over { client: ClientName, id: String, why: Silence },
}

/// A session with its client.
#[derive(Debug)]
pub(crate) struct Hosted {
    pub(crate) client: ClientName,
    pub(crate) incarnation: Option<Incarnation>,
    pub(crate) session: LiveSession,
    pub(crate) port: LivePort,
    /// What publishes the same on a robot's own keys.
    pub(crate) writer: Option<RobotWriter>,
    pub(crate) taken: TakenLog,
    /// The number after which the client has to count on, for the answer to a client that asks again.
    pub(crate) last_seq: Arc<AtomicU64>,
}

impl Hosted {
    /// Returns the session, and what it speaks to.
    fn parts<'a>(
        &'a mut self,
        clock: LiveClock,
        loudspeaker: Option<&'a Loudspeaker>,
    ) -> (&'a mut LiveSession, ToPort<'a>) {
        let Self { session, port, writer, taken, .. } = self;
        (session, ToPort { port, writer: writer.as_mut(), taken, loudspeaker, clock })
    }

    /// Publishes to recorders what a robot observed on a key of its own.
    fn tell_robot_observation(&self) {
        let Some(message) = self.session.robot_observation() else { return };
        if let Err(error) = self.port.observed(&message) {
            debug!(%error, "an observation could not be put");
        }
    }

    /// Publishes to recorders what was taken in, after what was said in response.
    fn tell_taken(&mut self, now: u64, input: TakenInput) {
        let session = &self.session;
        let (seq, step) = (session.last_seq(), session.step_of_episode());
        let message = self.taken.write(session.id(), now, seq, step, input);
        if let Err(error) = self.port.taken(message) {
            debug!(%error, "what was taken in could not be put");
        }
    }
}

/// A running thread, by which orders reach it.
#[derive(Debug)]
pub(crate) struct LiveThread {
    orders: SyncSender<ThreadOrder>,
    handle: JoinHandle<()>,
}

impl LiveThread {
    /// Starts the thread of a session.
    pub(crate) fn start(
        name: String,
        decider: LiveDecider,
        clock: LiveClock,
        spins: bool,
        loudspeaker: Option<Loudspeaker>,
        reports: flume::Sender<ThreadReport>,
    ) -> std::io::Result<Self> {
        let (orders, receiver) = sync_channel(MAX_WAITING);
        let work = move || {
            let hosted = Vec::with_capacity(SESSIONS_PER_THREAD);
            let snapshots_due = 0;
            Loop { hosted, decider, clock, spins, loudspeaker, reports, snapshots_due }
                .run(&receiver);
        };
        let handle = thread::Builder::new().name(name).spawn(work)?;
        Ok(Self { orders, handle })
    }

    /// Makes a thread that follows no orders, and returns those that it is given.
    #[cfg(test)]
    pub(crate) fn ended() -> (Self, Receiver<ThreadOrder>) {
        let (orders, receiver) = sync_channel(MAX_WAITING);
        (Self { orders, handle: thread::Builder::new().spawn(|| ()).unwrap() }, receiver)
    }

    /// Gives an order, without waiting; `false` if the thread has ended, or has too many already.
    pub(crate) fn order(&self, order: ThreadOrder) -> bool {
        let given = self.orders.try_send(order).is_ok();
        self.handle.thread().unpark();
        given
    }

    /// Returns what wakes the thread.
    pub(crate) fn waker(&self) -> Arc<dyn Fn() + Send + Sync> {
        let thread = self.handle.thread().clone();
        Arc::new(move || thread.unpark())
    }

    /// Ends the thread, once it has followed its orders, and waits for it.
    pub(crate) fn stop(self) {
        let Self { orders, handle } = self;
        // With the sender gone the thread ends, even if orders still wait.
        drop(orders);
        handle.thread().unpark();
        drop(handle.join());
    }
}

/// Puts a session's events at its port and on the keys of its robot, and its sentences at the loudspeaker.
struct ToPort<'a> {
    port: &'a LivePort,
    writer: Option<&'a mut RobotWriter>,
    taken: &'a mut TakenLog,
    loudspeaker: Option<&'a Loudspeaker>,
    clock: LiveClock,
}

impl SayTo for ToPort<'_> {
    fn say(&mut self, bytes: &[u8]) {
        self.taken.count_said();
        if let Some(writer) = &mut self.writer {
            writer.put(self.port, LiveTopic::Say, bytes, self.clock.now());
        }
        if let Err(error) = self.port.say(bytes) {
            debug!(%error, "an event could not be put");
        }
    }

    fn status(&mut self, bytes: &[u8]) {
        if let Some(writer) = &mut self.writer {
            writer.put(self.port, LiveTopic::Status, bytes, self.clock.now());
        }
        if let Err(error) = self.port.status(bytes) {
            debug!(%error, "a status could not be put");
        }
    }

    fn play(&mut self, sentence: &Arc<SpokenSentence>) {
        if let Some(loudspeaker) = self.loudspeaker {
            loudspeaker.play(sentence);
        }
    }

    fn hush(&mut self) {
        if let Some(loudspeaker) = self.loudspeaker {
            loudspeaker.hush();
        }
    }
}

struct Loop {
    hosted: Vec<Hosted>,
    decider: LiveDecider,
    clock: LiveClock,
    spins: bool,
    loudspeaker: Option<Loudspeaker>,
    reports: flume::Sender<ThreadReport>,
    snapshots_due: u64,
}

impl Loop {
    fn run(mut self, orders: &Receiver<ThreadOrder>) {
        loop {
            loop {
                match orders.try_recv() {
                    Ok(ThreadOrder::Add(hosted)) => self.hosted.push(*hosted),
                    Ok(ThreadOrder::Remove(client, why)) => self.remove(&client, why.as_ref()),
                    Ok(ThreadOrder::Presence(client, start, is_here)) => {
                        self.note_presence(&client, start, is_here);
                    }
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return self.end(),
                }
            }
            let mut has_more = false;
            for hosted in &mut self.hosted {
                let loudspeaker = self.loudspeaker.as_ref();
                has_more |= serve(hosted, &mut self.decider, self.clock, loudspeaker);
            }
            self.report();
            if !has_more {
                self.sleep();
            }
        }
    }

    /// Cuts what a session says and forgets it. Without a reason its status is not published: the client has another session by
    /// now.
    fn remove(&mut self, client: &ClientName, why: Option<&Silence>) {
        let (now, clock, loudspeaker) = (self.clock.now(), self.clock, self.loudspeaker.as_ref());
        self.hosted.retain_mut(|hosted| {
            let is_removed = hosted.client == *client;
            if is_removed {
                let (session, mut out) = hosted.parts(clock, loudspeaker);
                match why {
                    Some(why) => session.close(now, why.clone(), &mut out),
                    None => session.break_off(now, &mut out),
                }
            }
            !is_removed
        });
    }

    fn note_presence(&mut self, client: &ClientName, start: Incarnation, is_here: bool) {
        let of_client = self.hosted.iter_mut().filter(|hosted| hosted.client == *client);
        for hosted in of_client.filter(|hosted| hosted.incarnation == Some(start)) {
            hosted.session.note_presence(is_here);
            hosted.tell_taken(self.clock.now(), TakenInput::Presence { is_here });
        }
    }

    fn report(&mut self) {
        let (now, clock) = (self.clock.now(), self.clock);
        let (reports, loudspeaker) = (&self.reports, self.loudspeaker.as_ref());
        self.hosted.retain_mut(|hosted| {
            let (session, mut out) = hosted.parts(clock, loudspeaker);
            let Some(why) = session.end(now, &mut out).cloned() else { return true };
            let (client, id) = (hosted.client.clone(), hosted.session.id().to_owned());
            // Without room it is reported at the next look: nothing else frees the session's place.
            reports.try_send(ThreadReport::Over { client, id, why }).is_err()
        });
        if now >= self.snapshots_due {
            self.snapshots_due = now + SNAPSHOT_EVERY;
            self.hosted.iter().for_each(|hosted| self.report_state(now, hosted));
        }
    }

    fn report_state(&self, now: u64, hosted: &Hosted) {
        let (n_refused, reason) = hosted.session.refusals();
        let report = ThreadReport::State {
            client: hosted.client.clone(),
            id: hosted.session.id().to_owned(),
            now,
            state: hosted.session.state(),
            refusals: (n_refused, reason.to_owned()),
            snapshot: Box::new(hosted.session.snapshot(now)),
        };
        // A lost report does not matter: the next one follows within a second.
        drop(self.reports.try_send(report));
    }

    fn sleep(&self) {
        let deadlines = self.hosted.iter().map(|hosted| hosted.session.next_deadline());
        let next = deadlines.fold(self.snapshots_due, u64::min);
        let left = self.clock.until(next).min(LONGEST_SLEEP);
        if !self.spins {
            thread::park_timeout(left);
        } else if left > SPIN {
            thread::park_timeout(left.saturating_sub(SPIN));
        } else {
            std::hint::spin_loop();
        }
    }

    fn end(mut self) {
        let now = self.clock.now();
        for hosted in &mut self.hosted {
            let (session, mut out) = hosted.parts(self.clock, self.loudspeaker.as_ref());
            session.close(now, Silence::Closing, &mut out);
        }
    }
}

/// Takes the next few reports: a client that sends them faster than they are read must not hold up the others.
fn next_reports(take: impl FnMut() -> Option<Vec<u8>>) -> Vec<Vec<u8>> {
    std::iter::from_fn(take).take(MAX_REPORTS).collect()
}

/// Does for a client whatever is to be done now; returns whether further reports of it may wait.
fn serve(
    hosted: &mut Hosted,
    decider: &mut LiveDecider,
    clock: LiveClock,
    loudspeaker: Option<&Loudspeaker>,
) -> bool {
    hosted.session.note_mute(loudspeaker.is_some_and(Loudspeaker::is_mute));
    let reports = next_reports(|| hosted.port.take_heard());
    for bytes in &reports {
        let now = clock.now();
        let (session, mut out) = hosted.parts(clock, loudspeaker);
        if let Some(report) = session.hear(now, bytes, decider, &mut out) {
            hosted.tell_taken(now, TakenInput::Heard { report });
        }
    }
    if let Some(arrival) = hosted.port.take() {
        let n_overwritten = hosted.port.take_overwritten();
        let (session, mut out) = hosted.parts(clock, loudspeaker);
        let (payload, beside, at) = (arrival.payload(), arrival.attachment(), clock.at(arrival.at));
        session.note_overwritten(n_overwritten);
        let encoding = &arrival.encoding();
        let bytes = ObservationBytes { encoding, payload: &payload, beside: beside.as_deref() };
        let (now, n_before) = (clock.now(), session.counts().taken);
        session.arrive(now, at, bytes, decider, &mut out);
        session.record_latency(clock.now().saturating_sub(at));
        if session.counts().taken > n_before {
            let (is_other_clock, last_seq) = (session.is_other_clock(), session.last_seq());
            hosted.last_seq.store(last_seq, Ordering::Relaxed);
            hosted.tell_robot_observation();
            hosted.tell_taken(now, TakenInput::Observation { at, is_other_clock });
        }
    }
    let now = clock.now();
    if hosted.session.next_deadline() <= now {
        let (session, mut out) = hosted.parts(clock, loudspeaker);
        session.tick(now, decider, &mut out);
        hosted.tell_taken(now, TakenInput::Tick);
    }
    reports.len() == MAX_REPORTS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_that_come_without_end_do_not_hold_up_other_sessions() {
        assert_eq!(next_reports(|| Some(Vec::new())).len(), MAX_REPORTS);
        let mut waiting = [b"1".to_vec(), b"2".to_vec()].into_iter();
        assert_eq!(next_reports(|| waiting.next()), [b"1", b"2"]);
    }
}
