//! The thread that keeps the states of sessions: a disk that is slow to write delays it, and no client.
//!
//! ```text
//! notifier --keep, forget, sweep--> one place per client: the newest counts --thread--> StateStore
//!          <------find------
//! ```

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt;
use std::ops::Bound;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use leadtime_proto::ClientName;
use tracing::warn;

/// The most clients whose states wait: of sessions that last, and of some that are over.
const MAX_WAITING: usize = 1_024;
/// Beyond them as many wait to be forgotten: a client must not get a session again that is over.
const MAX_CHANGES: usize = 2 * MAX_WAITING;
/// How long the last states may take once the notifier ends.
const LAST_STATES: Duration = Duration::from_secs(5);

/// Where the state of sessions is kept, so that a restarted notifier goes on with them.
pub trait StateStore: Send + Sync + fmt::Debug {
    /// Keeps the state of a client's session, instead of what was kept of it.
    ///
    /// # Errors
    ///
    /// What the system reports if the state cannot be written.
    fn keep(&self, client: &ClientName, state: &[u8]) -> std::io::Result<()>;

    /// Returns what was kept.
    fn find(&self, client: &ClientName) -> Option<Vec<u8>>;

    /// Forgets what was kept, if anything was: the session has ended for good.
    ///
    /// # Errors
    ///
    /// What the system reports if the state cannot be removed.
    fn forget(&self, client: &ClientName) -> std::io::Result<()>;

    /// Removes the states of clients that have not been here for long: nobody is remembered for ever.
    fn sweep(&self);
}

/// What is to become of a client's kept state.
#[derive(Clone, Debug)]
enum StateChange {
    Keep(Arc<[u8]>),
    Forget,
}

/// What the thread does next.
#[derive(Debug)]
enum StateWork {
    Change(ClientName, StateChange),
    Sweep,
}

#[derive(Debug, Default)]
struct WaitingChanges {
    /// The newest one of each client.
    newest: BTreeMap<ClientName, StateChange>,
    /// The one that is on its way to the disk.
    under_way: Option<(ClientName, StateChange)>,
    is_sweep_due: bool,
    has_ended: bool,
    is_full_told: bool,
}

/// What the thread shares with those who give it something to keep.
#[derive(Debug, Default)]
struct StatePlaces {
    waiting: Mutex<WaitingChanges>,
    changed: Condvar,
}

impl StatePlaces {
    fn lock(&self) -> MutexGuard<'_, WaitingChanges> {
        // Nothing is half done in between: it is whole even if a thread has panicked.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn put(&self, client: &ClientName, change: StateChange) {
        let mut waiting = self.lock();
        let most = match change {
            StateChange::Keep(_) => MAX_WAITING,
            StateChange::Forget => MAX_CHANGES,
        };
        if waiting.newest.len() < most || waiting.newest.contains_key(client) {
            waiting.newest.insert(client.clone(), change);
            self.changed.notify_one();
        } else if !std::mem::replace(&mut waiting.is_full_told, true) {
            warn!(%client, "the disk is too slow for the states of so many clients; some are not kept, or not removed");
        }
    }

    /// Returns what is to become of a client's state, if that is not done yet.
    fn find(&self, client: &ClientName) -> Option<StateChange> {
        let waiting = self.lock();
        let under_way = || {
            let (of, change) = waiting.under_way.as_ref()?;
            (of == client).then_some(change)
        };
        waiting.newest.get(client).or_else(under_way).cloned()
    }

    /// Waits for the next work, client after client in turn; `None` once all is done and no more will come.
    fn next(&self) -> Option<StateWork> {
        let mut waiting = self.lock();
        let last = waiting.under_way.take().map(|(client, _)| client);
        loop {
            if std::mem::take(&mut waiting.is_sweep_due) {
                return Some(StateWork::Sweep);
            }
            let after = last.as_ref().map_or(Bound::Unbounded, Bound::Excluded);
            let later: (Bound<&ClientName>, Bound<&ClientName>) = (after, Bound::Unbounded);
            let later = waiting.newest.range::<ClientName, _>(later).next();
            let next = later.or_else(|| waiting.newest.first_key_value());
            if let Some((client, change)) = next.map(|(client, it)| (client.clone(), it.clone())) {
                waiting.newest.remove(&client);
                waiting.under_way = Some((client.clone(), change.clone()));
                return Some(StateWork::Change(client, change));
            }
            if waiting.has_ended {
                return None;
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// Keeps states in a store, on a thread of its own; once it is dropped, what waits is kept, within [`LAST_STATES`], and the thread
/// ends.
#[derive(Debug)]
pub(crate) struct StateKeeper {
    store: Arc<dyn StateStore>,
    places: Arc<StatePlaces>,
    /// Disconnected once the thread has ended.
    ended: flume::Receiver<Infallible>,
}

impl StateKeeper {
    pub(crate) fn start(store: Arc<dyn StateStore>) -> std::io::Result<Self> {
        let places = Arc::new(StatePlaces::default());
        let (into, from) = (Arc::clone(&store), Arc::clone(&places));
        let (at_work, ended) = flume::bounded(0);
        let work = move || {
            keep_all(into.as_ref(), &from);
            drop(at_work);
        };
        thread::Builder::new().name("live-state".to_owned()).spawn(work)?;
        Ok(Self { store, places, ended })
    }

    /// Keeps the state of a client's session soon, instead of what was kept of it. Never waits for the disk.
    pub(crate) fn keep(&self, client: &ClientName, state: Vec<u8>) {
        self.places.put(client, StateChange::Keep(state.into()));
    }

    /// Forgets soon what was kept. Never waits for the disk.
    pub(crate) fn forget(&self, client: &ClientName) {
        self.places.put(client, StateChange::Forget);
    }

    /// Removes soon what is too old. Never waits for the disk.
    pub(crate) fn sweep(&self) {
        self.places.lock().is_sweep_due = true;
        self.places.changed.notify_one();
    }

    /// Returns what was kept, or is about to be.
    pub(crate) fn find(&self, client: &ClientName) -> Option<Vec<u8>> {
        match self.places.find(client) {
            Some(StateChange::Keep(state)) => Some(state.to_vec()),
            Some(StateChange::Forget) => None,
            None => self.store.find(client),
        }
    }
}

impl Drop for StateKeeper {
    fn drop(&mut self) {
        self.places.lock().has_ended = true;
        self.places.changed.notify_one();
        if let Err(flume::RecvTimeoutError::Timeout) = self.ended.recv_timeout(LAST_STATES) {
            warn!("the disk is too slow for the last states of sessions; they are not kept");
        }
    }
}

fn keep_all(store: &dyn StateStore, places: &StatePlaces) {
    let mut is_told = false;
    while let Some(work) = places.next() {
        match work {
            StateWork::Sweep => store.sweep(),
            StateWork::Change(client, StateChange::Keep(state)) => {
                if let Err(error) = store.keep(&client, &state)
                    && !std::mem::replace(&mut is_told, true)
                {
                    warn!(%error, "the state of sessions cannot be kept; they will not survive this process");
                }
            }
            StateWork::Change(client, StateChange::Forget) => {
                if let Err(error) = store.forget(&client) {
                    warn!(%client, %error, "the state of a closed session cannot be removed; the client may get that session again");
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk whose every change waits until it is let go, and then is told.
    #[derive(Debug)]
    struct HangingDisk {
        go: flume::Receiver<()>,
        done: flume::Sender<String>,
    }

    impl HangingDisk {
        fn work(&self, what: String) {
            // Once the test has let go of it for good, nothing waits any more.
            if self.go.recv().is_ok() || self.go.is_disconnected() {
                drop(self.done.send(what));
            }
        }
    }

    impl StateStore for HangingDisk {
        fn keep(&self, client: &ClientName, state: &[u8]) -> std::io::Result<()> {
            self.work(format!("{client} {}", String::from_utf8_lossy(state)));
            Ok(())
        }

        fn find(&self, client: &ClientName) -> Option<Vec<u8>> {
            Some(format!("old of {client}").into_bytes())
        }

        fn forget(&self, client: &ClientName) -> std::io::Result<()> {
            self.work(format!("{client} is forgotten"));
            Ok(())
        }

        fn sweep(&self) {
            self.work("swept".to_owned());
        }
    }

    #[test]
    fn a_disk_that_hangs_delays_nobody_and_gets_the_newest_state_of_each_client_in_turn() {
        let (let_go, go) = flume::bounded(0);
        let (done, told) = flume::bounded(16);
        let keeper = StateKeeper::start(Arc::new(HangingDisk { go, done })).unwrap();
        let [a, b, c] = ["a", "b", "c"].map(|name| ClientName::new(name).unwrap());
        keeper.keep(&b, b"1".to_vec());
        let_go.send(()).unwrap();
        assert_eq!(told.recv().unwrap(), "b 1");
        keeper.sweep();
        let_go.send(()).unwrap();
        assert_eq!(told.recv().unwrap(), "swept");
        // From here on nothing is done until it is let go, and nobody waits for it.
        for i in 2..=100 {
            for client in [&a, &b, &c] {
                keeper.keep(client, format!("{i}").into_bytes());
            }
        }
        let found = |client: &ClientName| {
            keeper.find(client).map(|state| String::from_utf8(state).unwrap())
        };
        for client in [&a, &b, &c] {
            assert_eq!(found(client).as_deref(), Some("100"));
        }
        let d = ClientName::new("d").unwrap();
        assert_eq!(found(&d).as_deref(), Some("old of d"));
        keeper.forget(&a);
        assert_eq!(found(&a), None);
        drop(let_go);
        drop(keeper);
        let done: Vec<String> = told.iter().collect();
        // One of them was on its way before there was a newer one.
        let last = |client: &str| done.iter().rfind(|it| it.starts_with(client)).unwrap().as_str();
        assert_eq!(["a", "b", "c"].map(last), ["a is forgotten", "b 100", "c 100"]);
        assert!(done.len() <= 4, "{done:?}");
    }
}
