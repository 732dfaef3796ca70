//! Clients whose connection is replaced where it leads nowhere.
//!
//! The library looks for a lost other end again by itself, but not where a connection ended while the library was still noting
//! that it had begun, as happens on a starved machine. Then nobody is at the other end, and nobody ever would be.

use std::fmt;
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use tokio::time::interval;
use tracing::{debug, info};
use zenoh::pubsub::Subscriber;
use zenoh::session::Session;

use crate::keys::Keys;
use crate::lock::lock;
use crate::session::{ACTOR_WAIT_BEFORE_CLOSE_US, LEARNER_WAIT_BEFORE_CLOSE_US};
use crate::{ConnectSettings, ListenSettings, Result, session};

/// How long a connection may have nobody at its other end before another is opened beside it.
pub(crate) const STRANDED: Duration = Duration::from_secs(10);
/// Pause between two looks at whether anybody is there.
pub(crate) const LOOK_EVERY: Duration = Duration::from_secs(5);

/// A client's session, whose place another one can take.
#[derive(Debug)]
pub(crate) struct ClientSession {
    /// How to open another; `None` for a session that listens, whose place none takes.
    settings: Option<ConnectSettings>,
    /// How long a message may wait for a stalled peer before the connection is given up, in microseconds.
    wait_us: u64,
    session: Mutex<Session>,
    /// Since when nobody has been at the other end.
    alone: Mutex<Option<Instant>>,
}

impl ClientSession {
    /// Connects to a learner or a router.
    pub(crate) async fn open(settings: &ConnectSettings) -> Result<Self> {
        let session = session::connect(settings).await?;
        Ok(Self::new(session, Some(settings.clone()), ACTOR_WAIT_BEFORE_CLOSE_US))
    }

    /// Opens a learner's session, which is a client's if it only connects to a router. What arrives at the keys `own` is for it alone.
    pub(crate) async fn of_learner(settings: &ListenSettings, own: Keys<'_>) -> Result<Self> {
        let session = session::listen(settings, own).await?;
        let above = settings.endpoints.is_empty().then(|| session::upwards(settings));
        Ok(Self::new(session, above, LEARNER_WAIT_BEFORE_CLOSE_US))
    }

    fn new(session: Session, settings: Option<ConnectSettings>, wait_us: u64) -> Self {
        Self { settings, wait_us, session: Mutex::new(session), alone: Mutex::default() }
    }

    /// Returns the session that is there now.
    pub(crate) fn now(&self) -> Session {
        lock(&self.session).clone()
    }

    /// Replaces this session if it has had nobody at its other end for [`STRANDED`] and one attempt opens another: `take_over` moves
    /// to the new one what was declared, and returns the one before it. Where that fails, this one stays.
    pub(crate) async fn renew(&self, take_over: impl FnOnce(&Session) -> Result<Session>) {
        let Some(session) = self.successor().await else { return };
        let done_with = take_over(&session).unwrap_or_else(|error| {
            debug!(%error, "nothing can be declared on the new connection");
            session
        });
        drop(session::close(&done_with).await);
    }

    /// Opens another connection if this one has had nobody at its other end for [`STRANDED`]; `None` if that is not so, if this one
    /// was closed on purpose or listens, or if one attempt opens none.
    async fn successor(&self) -> Option<Session> {
        let settings = self.settings.as_ref()?;
        let before = self.now();
        if before.is_closed() {
            return None;
        }
        if session::has_peer(&before).await {
            *lock(&self.alone) = None;
            return None;
        }
        if lock(&self.alone).get_or_insert_with(Instant::now).elapsed() < STRANDED {
            return None;
        }
        match session::reconnect(settings, self.wait_us).await {
            Ok(session) if before.is_closed() => {
                drop(session::close(&session).await);
                None
            }
            Ok(session) => {
                info!("nobody is at the other end of this connection; continuing on a new one");
                Some(session)
            }
            Err(error) => {
                debug!(%error, "no other connection can be opened");
                None
            }
        }
    }

    /// Lets another session take the place of the one that is there, and returns that one, to be closed.
    pub(crate) fn replace(&self, session: Session) -> Session {
        *lock(&self.alone) = None;
        std::mem::replace(&mut *lock(&self.session), session)
    }

    /// Leaves the network, within a limited time.
    pub(crate) async fn close(&self) -> Result<()> {
        session::close(&self.now()).await
    }

    /// Lets so much time have passed that the session is replaced at the next look, if nobody is at its other end.
    #[cfg(test)]
    pub(crate) fn wait_long(&self) {
        *lock(&self.alone) = Instant::now().checked_sub(STRANDED);
    }
}

/// Subscribes on a session to what its owner wants to hear.
type Subscribe = dyn Fn(&Session) -> Result<Vec<Subscriber<()>>> + Send + Sync;

/// What is subscribed to, and how to do it again.
struct Subscription {
    again: Box<Subscribe>,
    subscribers: Vec<Subscriber<()>>,
}

impl fmt::Debug for Subscription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Subscription")
            .field("subscribers", &self.subscribers)
            .finish_non_exhaustive()
    }
}

/// The session of a client that subscribes and asks: what it subscribed to lasts when another session takes this one's place.
#[derive(Debug)]
pub(crate) struct LastingSession {
    subscriptions: Mutex<Vec<Subscription>>,
    /// Last, because fields are dropped in order: everything declared on the session is undeclared before it closes.
    client: ClientSession,
}

impl LastingSession {
    /// Connects, and looks from now on whether anybody is at the other end.
    pub(crate) async fn open(settings: &ConnectSettings) -> Result<Arc<Self>> {
        let client = ClientSession::open(settings).await?;
        let session = Arc::new(Self { subscriptions: Mutex::default(), client });
        tokio::spawn(look_after(Arc::downgrade(&session)));
        Ok(session)
    }

    /// Returns the session that is there now, to ask on.
    pub(crate) fn now(&self) -> Session {
        self.client.now()
    }

    /// Subscribes by calling `again`, now and on every session that takes this one's place.
    pub(crate) fn subscribe(
        &self,
        again: impl Fn(&Session) -> Result<Vec<Subscriber<()>>> + Send + Sync + 'static,
    ) -> Result<()> {
        // Locked, so that no other session takes this one's place meanwhile.
        let mut subscriptions = lock(&self.subscriptions);
        let subscribers = again(&self.now())?;
        subscriptions.push(Subscription { again: Box::new(again), subscribers });
        Ok(())
    }

    /// Leaves the network, within a limited time.
    pub(crate) async fn close(&self) -> Result<()> {
        self.client.close().await
    }

    async fn renew(&self) {
        self.client.renew(|session| self.take_over(session)).await;
    }

    /// Moves everything to another session; returns the one before it.
    fn take_over(&self, session: &Session) -> Result<Session> {
        let mut subscriptions = lock(&self.subscriptions);
        let all = subscriptions.iter().map(|it| (it.again)(session));
        let all = all.collect::<Result<Vec<_>>>()?;
        for (subscription, subscribers) in subscriptions.iter_mut().zip(all) {
            subscription.subscribers = subscribers;
        }
        Ok(self.client.replace(session.clone()))
    }

    /// Lets `nowhere` take this session's place, as if the connection had ended while it began.
    #[cfg(test)]
    pub(crate) async fn strand(&self, nowhere: Session) {
        self.client.replace(nowhere).close().await.expect("it was open");
    }

    /// Looks as if after a long time.
    #[cfg(test)]
    pub(crate) async fn look_long_after(&self) {
        self.client.wait_long();
        self.renew().await;
    }
}

/// Looks whether anybody is at the other end of a session, until it is closed or nobody has it any more.
async fn look_after(session: Weak<LastingSession>) {
    let mut looks = interval(LOOK_EVERY);
    loop {
        looks.tick().await;
        match session.upgrade() {
            Some(session) if !session.now().is_closed() => session.renew().await,
            _ => return,
        }
    }
}
