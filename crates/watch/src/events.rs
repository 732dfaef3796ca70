//! Events for pages: one bounded queue per client, no client is waited for.
//!
//! ```text
//! id: 413.0.1769860800000
//! event: update
//! data: {"update": 413, ...}
//! ```
//!
//! A client that does not read is cut off: it reconnects by itself, and gets everything that it missed. Long events go out
//! in pieces, so that one who reads slowly is told from one who does not read; it misses what is soon told anew.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::time::{Duration, Instant};

use leadtime_web::axum::body::Bytes;

/// Pieces that wait for one client, besides those that it gets first, and those of its longest event.
const QUEUED: usize = 256;
/// The longest piece of an event, in bytes: the curves of a long run take many.
const PIECE: usize = 16 << 10;
/// A client for which more pieces wait is behind.
const BEHIND: usize = 32;
/// The most clients at a time.
pub(crate) const MAX_CLIENTS: usize = 32;
/// A client that reads nothing for so long is cut off, if there is something to read.
const PATIENCE: Duration = Duration::from_secs(5);

/// What an event stream yields.
pub(crate) type EventBytes = Result<Bytes, Infallible>;

/// The kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EventKind {
    /// What the run is.
    About,
    /// The curves so far.
    History,
    /// An update, with its numbers.
    Update,
    /// The head line of the page.
    State,
    /// The table of actors.
    Actors,
    /// An episode begins to be played: what stands still in it.
    Flight,
    /// A moment of it.
    Frame,
    /// A line of the log.
    Log,
    /// The server ends: do not reconnect.
    Bye,
}

impl EventKind {
    /// Every kind with its name on the wire, in the order of the variants.
    const NAMED: [(Self, &'static str); 9] = [
        (Self::About, "about"),
        (Self::History, "history"),
        (Self::Update, "update"),
        (Self::State, "state"),
        (Self::Actors, "actors"),
        (Self::Flight, "flight"),
        (Self::Frame, "frame"),
        (Self::Log, "log"),
        (Self::Bye, "bye"),
    ];

    fn name(self) -> &'static str {
        Self::NAMED[self as usize].1
    }

    /// Tells whether the next event of the kind makes up for one that was left out.
    fn is_soon_told_anew(self) -> bool {
        matches!(self, Self::State | Self::Actors | Self::Frame)
    }
}

/// Which kinds a client wants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Wanted(BTreeSet<EventKind>);

impl Wanted {
    /// Reads a list such as `update,actors`; nothing means everything.
    ///
    /// # Errors
    ///
    /// A sentence that lists the known kinds, if the list names an unknown one.
    pub(crate) fn parse(list: Option<&str>) -> Result<Self, String> {
        let Some(list) = list.filter(|list| !list.is_empty()) else {
            return Ok(Self(EventKind::NAMED.map(|(kind, _)| kind).into()));
        };
        let named = |name: &str| EventKind::NAMED.into_iter().find(|(_, own)| *own == name);
        let kinds = list.split(',').map(|name| Some(named(name)?.0)).collect::<Option<_>>();
        kinds.map(Self).ok_or_else(|| {
            let names = EventKind::NAMED.map(|(_, name)| name).join(", ");
            format!("there is an event of another name in `only`; there are: {names}\n")
        })
    }

    pub(crate) fn has(&self, kind: EventKind) -> bool {
        self.0.contains(&kind)
    }
}

/// Writes an event as it is sent.
pub(crate) fn event(kind: EventKind, id: Option<&str>, data: &str) -> Bytes {
    let id = id.map_or_else(String::new, |id| format!("id: {id}\n"));
    // JSON has no line ends of its own.
    format!("{id}event: {}\ndata: {data}\n\n", kind.name()).into()
}

/// Takes an event apart, without a copy.
fn pieces(event: &Bytes) -> impl Iterator<Item = Bytes> {
    let starts = (0..event.len()).step_by(PIECE);
    starts.map(move |start| event.slice(start..event.len().min(start + PIECE)))
}

/// A client, as far as events go to it, in pieces.
#[derive(Debug)]
struct Client {
    queue: flume::Sender<EventBytes>,
    wanted: Wanted,
    /// Pieces that may wait before an event goes in.
    most: usize,
    n_sent: u64,
    n_taken: u64,
    taken_at: Instant,
}

impl Client {
    /// Sends an event if there is room. Returns whether the client may stay.
    fn send(&mut self, kind: EventKind, event: &Bytes, now: Instant) -> bool {
        if self.queue.is_disconnected() {
            return false;
        }
        let n_taken = self.n_sent - self.queue.len() as u64;
        if n_taken > self.n_taken || n_taken == self.n_sent {
            (self.n_taken, self.taken_at) = (n_taken, now);
        }
        if now.saturating_duration_since(self.taken_at) > PATIENCE {
            return false;
        }
        if kind.is_soon_told_anew() && self.queue.len() > BEHIND {
            return true;
        }
        if self.queue.len() >= self.most {
            return false;
        }
        // An event goes in whole, however long it is: curves may be many times as long as everything that waits otherwise.
        self.most = self.most.max(QUEUED + event.len() / PIECE);
        pieces(event).all(|piece| {
            self.n_sent += 1;
            self.queue.send(Ok(piece)).is_ok()
        })
    }
}

/// Why a client is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoPlace {
    /// The most clients are connected.
    Full,
    /// The watcher ends and takes no one in.
    Closed,
}

/// The clients, and the events that they get.
#[derive(Debug, Default)]
pub(crate) struct EventHub {
    clients: Vec<Client>,
    is_closed: bool,
}

impl EventHub {
    /// Counts those who listen.
    fn n_clients(&mut self) -> usize {
        self.clients.retain(|client| !client.queue.is_disconnected());
        self.clients.len()
    }

    /// Counts those who look at the policy at work.
    pub(crate) fn n_watching(&self) -> usize {
        let is_there = |client: &&Client| !client.queue.is_disconnected();
        let there = self.clients.iter().filter(is_there);
        there.filter(|client| client.wanted.has(EventKind::Frame)).count()
    }

    /// Takes in a client, who gets these events first.
    ///
    /// # Errors
    ///
    /// [`NoPlace::Closed`] after [`Self::close`], [`NoPlace::Full`] if there are too many.
    pub(crate) fn join(
        &mut self,
        wanted: Wanted,
        first: &[Bytes],
        now: Instant,
    ) -> Result<flume::Receiver<EventBytes>, NoPlace> {
        if self.is_closed {
            return Err(NoPlace::Closed);
        }
        if self.n_clients() >= MAX_CLIENTS {
            return Err(NoPlace::Full);
        }
        let first: Vec<Bytes> = first.iter().flat_map(pieces).collect();
        // Bounded by `most` before every event.
        let (queue, events) = flume::unbounded();
        let (n_sent, most) = (first.len() as u64, QUEUED + first.len());
        for piece in first {
            drop(queue.send(Ok(piece)));
        }
        self.clients.push(Client { queue, wanted, most, n_sent, n_taken: 0, taken_at: now });
        Ok(events)
    }

    /// Sends an event to everyone who wants it; a reader that does not keep up is cut off.
    pub(crate) fn send(&mut self, kind: EventKind, id: Option<&str>, data: &str, now: Instant) {
        if !self.clients.iter().any(|client| client.wanted.has(kind)) {
            return;
        }
        let event = event(kind, id, data);
        let stays = |client: &mut Client| client.send(kind, &event, now);
        self.clients.retain_mut(|client| !client.wanted.has(kind) || stays(client));
    }

    /// Says goodbye to everyone, and takes no client in any more.
    pub(crate) fn close(&mut self, now: Instant) {
        self.send(EventKind::Bye, None, "{}", now);
        self.clients.clear();
        self.is_closed = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(event: EventBytes) -> String {
        let Ok(bytes) = event;
        String::from_utf8(bytes.to_vec()).unwrap()
    }

    fn all() -> Wanted {
        Wanted::parse(None).unwrap()
    }

    #[test]
    fn a_client_gets_what_it_wants_and_what_came_before_it() {
        let (mut hub, now) = (EventHub::default(), Instant::now());
        let wanted = Wanted::parse(Some("update,actors")).unwrap();
        let first = vec![event(EventKind::Update, Some("7.0"), "{\"update\":7}")];
        let events = hub.join(wanted, &first, now).unwrap();
        hub.send(EventKind::Log, None, "{}", now);
        hub.send(EventKind::Actors, None, "[]", now);
        hub.close(now);
        let heard: Vec<String> = events.drain().map(text).collect();
        assert_eq!(heard[0], "id: 7.0\nevent: update\ndata: {\"update\":7}\n\n");
        assert_eq!(heard[1..], ["event: actors\ndata: []\n\n"]);
        assert!(events.is_disconnected());
        assert_eq!(hub.join(all(), &[], now).unwrap_err(), NoPlace::Closed);
    }

    #[test]
    fn an_unknown_kind_of_event_is_reported() {
        let refused = Wanted::parse(Some("update,everything")).unwrap_err();
        assert!(refused.contains("about, history, update"), "{refused}");
        assert_eq!(Wanted::parse(Some("")).unwrap(), all());
    }

    #[test]
    fn a_client_that_does_not_read_is_cut_off_and_the_others_stay() {
        let (mut hub, start) = (EventHub::default(), Instant::now());
        let slow = hub.join(all(), &[], start).unwrap();
        let quick = hub.join(all(), &[], start).unwrap();
        for second in 0..=6 {
            hub.send(EventKind::State, None, "{}", start + Duration::from_secs(second));
            assert_eq!(quick.drain().count(), 1);
        }
        assert_eq!((hub.n_clients(), slow.is_disconnected()), (1, true));
        // One that is flooded is cut off at once.
        for _ in 0..=QUEUED {
            hub.send(EventKind::Log, None, "{}", start + Duration::from_secs(7));
        }
        assert_eq!(hub.n_clients(), 0);
    }

    #[test]
    fn a_client_that_reads_long_curves_slowly_stays_and_one_that_ceases_is_cut_off() {
        let (mut hub, start) = (EventHub::default(), Instant::now());
        let curves = event(EventKind::History, None, &"7".repeat(1 << 20));
        let events = hub.join(all(), std::slice::from_ref(&curves), start).unwrap();
        let mut read = Vec::new();
        let mut second = |second, reads: bool| {
            let now = start + Duration::from_secs(second);
            (0..20).for_each(|_| hub.send(EventKind::Frame, None, "{}", now));
            hub.send(EventKind::State, None, "{}", now);
            if reads {
                let piece = events.try_recv().unwrap().unwrap();
                assert!(piece.len() <= PIECE, "{}", piece.len());
                read.extend(piece);
            }
            hub.n_clients()
        };
        assert!((0..20).all(|i| second(i, true) == 1));
        assert_eq!([20, 24, 26].map(|i| second(i, false)), [1, 1, 0]);
        // The curves are whole, and nothing came between their pieces.
        read.extend(events.drain().flat_map(Result::unwrap));
        assert!(curves == read, "{} of {} bytes", read.len(), curves.len());
    }

    #[test]
    fn curves_that_are_longer_than_a_queue_cut_nobody_off_who_reads() {
        let (mut hub, start) = (EventHub::default(), Instant::now());
        let events = hub.join(all(), &[], start).unwrap();
        let curves = "7".repeat(2 * QUEUED * PIECE);
        for second in 0..10 {
            let now = start + Duration::from_secs(second);
            hub.send(EventKind::History, None, &curves, now);
            hub.send(EventKind::Update, None, "{}", now);
            let read: usize = events.drain().map(|piece| piece.unwrap().len()).sum();
            assert!(read > curves.len(), "{read}");
        }
        assert_eq!(hub.n_clients(), 1);
        for _ in 0..10 {
            hub.send(EventKind::History, None, &curves, start + Duration::from_secs(10));
        }
        assert_eq!(hub.n_clients(), 0, "what waits has an end");
    }

    #[test]
    fn a_client_that_reads_slowly_stays() {
        let (mut hub, start) = (EventHub::default(), Instant::now());
        let events = hub.join(all(), &[], start).unwrap();
        for second in 0..60 {
            for _ in 0..2 {
                hub.send(EventKind::State, None, "{}", start + Duration::from_secs(second));
            }
            assert!(events.try_recv().is_ok());
        }
        assert_eq!(hub.n_clients(), 1);
    }

    #[test]
    fn there_is_a_limit_and_who_leaves_makes_room() {
        let (mut hub, now) = (EventHub::default(), Instant::now());
        let mut clients: Vec<_> =
            (0..MAX_CLIENTS).map(|_| hub.join(all(), &[], now).unwrap()).collect();
        assert_eq!(hub.join(all(), &[], now).unwrap_err(), NoPlace::Full);
        clients.pop();
        assert!(hub.join(all(), &[], now).is_ok());
    }

    #[test]
    fn only_subscribers_who_want_moments_count_as_watching() {
        let (mut hub, now) = (EventHub::default(), Instant::now());
        let wanted = Wanted::parse(Some("state,update")).unwrap();
        let _script = hub.join(wanted, &[], now).unwrap();
        assert_eq!(hub.n_watching(), 0);
        let page = hub.join(all(), &[], now).unwrap();
        assert_eq!(hub.n_watching(), 1);
        drop(page);
        assert_eq!((hub.n_watching(), hub.n_clients()), (0, 1));
    }
}
