//! The observer's end: reads presence, metrics, announcements and weights, and touches nothing.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use leadtime_proto::message::Announcement;
use leadtime_proto::receive::{self, ANNOUNCEMENT, METRICS};
use leadtime_proto::{DomainName, Incarnation, PolicyVersion, RunName};
use tracing::warn;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::Session;

use crate::keys::{self, Keys, Member};
use crate::latest::{Events, Latest};
use crate::lock::lock;
use crate::pubsub::{subscribe, watch};
use crate::queue::{Class, EventQueue};
use crate::{ConnectSettings, Result, ask, discovery, session, wire};

/// Places in the event queue for metrics.
const N_BULK: usize = 4_096;

/// What an observer sees.
#[derive(Debug)]
pub enum ObserverEvent {
    /// A member's metrics.
    Metrics {
        /// The member that published them.
        member: Member,
        /// As the member wrote them.
        json: Vec<u8>,
    },
    /// A version of the weights is there.
    Announcement {
        /// The domain whose policy it is.
        domain: DomainName,
        /// The versions that are kept, with their digests.
        announcement: Announcement,
    },
    /// This start of a member is there (may be told more than once).
    Joined(Member, Incarnation),
    /// This start of a member is gone.
    Left(Member, Incarnation),
}

/// An observer's place on the network.
#[derive(Debug)]
pub struct ObserverLink {
    events: EventQueue<ObserverEvent>,
    latest: Arc<Latest<ObserverEvent>>,
    followed: Mutex<Vec<Subscriber<()>>>,
    /// Last, because fields are dropped in this order: what was declared on it goes while it is there.
    session: Session,
}

impl ObserverLink {
    /// Connects to a learner or a router.
    ///
    /// # Errors
    ///
    /// [`Error::Unreachable`](crate::Error::Unreachable) if nobody answers within the settings' time-out.
    pub async fn open(settings: &ConnectSettings) -> Result<(Self, Events<ObserverEvent>)> {
        let session = session::connect(settings).await?;
        let (events, latest, receiver) = Events::new(N_BULK);
        Ok((Self { session, events, latest, followed: Mutex::default() }, receiver))
    }

    /// Lists the runs that are there now.
    ///
    /// # Errors
    ///
    /// [`Error::Network`](crate::Error::Network) if the network cannot be asked.
    pub async fn runs(&self) -> Result<BTreeSet<RunName>> {
        discovery::runs(&self.session).await
    }

    /// Follows a run from now on, whether it is there already or not.
    ///
    /// # Errors
    ///
    /// [`Error::Network`](crate::Error::Network) if it cannot be subscribed to.
    pub fn follow(&self, run: &RunName) -> Result<()> {
        let (events, latest) = (self.events.clone(), Arc::clone(&self.latest));
        let metrics = subscribe(&self.session, Keys::MetricsOf(run), move |sample| {
            on_metrics(&events, &sample);
        })?;
        let announcements = subscribe(&self.session, Keys::AnnouncementsOf(run), move |sample| {
            on_announcement(&latest, &sample);
        })?;
        let events = self.events.clone();
        let members = watch(&self.session, Keys::MembersOf(run), move |alive, kind| {
            let Some(keys::Alive { member, incarnation, .. }) = alive else { return };
            let event = match kind {
                SampleKind::Put => ObserverEvent::Joined(member, incarnation),
                SampleKind::Delete => ObserverEvent::Left(member, incarnation),
            };
            drop(events.offer(event, Class::Presence));
        })?;
        lock(&self.followed).extend([metrics, announcements, members]);
        Ok(())
    }

    /// Pulls a version of the weights that was announced.
    ///
    /// # Errors
    ///
    /// As [`crate::ActorLink::pull_weights`].
    pub async fn pull_weights(
        &self,
        run: &RunName,
        domain: &DomainName,
        version: PolicyVersion,
        sha256: [u8; 32],
    ) -> Result<Vec<u8>> {
        ask::pull(&self.session, run, domain, Incarnation(0), version, sha256).await
    }

    /// Measures how long a short question to a run's learner and its answer take.
    ///
    /// # Errors
    ///
    /// [`Error::NoAnswer`](crate::Error::NoAnswer) if nobody answers, or an access list is in the way.
    pub async fn round_trip(&self, run: &RunName) -> Result<Duration> {
        ask::round_trip(&self.session, run).await
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`](crate::Error::Close) if it takes too long.
    pub async fn close(&self) -> Result<()> {
        session::close(&self.session).await
    }
}

fn on_metrics(events: &EventQueue<ObserverEvent>, sample: &Sample) {
    let Some(member) = keys::parse_metrics(sample.key_expr()) else { return };
    let json = sample.payload().to_bytes();
    let checked = wire::inspect(sample.attachment(), Some(sample.payload()), METRICS)
        .and_then(|header| receive::verify(&header, &json));
    match checked {
        Ok(()) => {
            let event = ObserverEvent::Metrics { member, json: json.into_owned() };
            drop(events.offer(event, Class::Bulk));
        }
        Err(refusal) => warn!(%refusal, "metrics refused"),
    }
}

fn on_announcement(latest: &Latest<ObserverEvent>, sample: &Sample) {
    let Some(domain) = keys::parse_announcement(sample.key_expr()) else { return };
    match wire::unseal(sample.attachment(), Some(sample.payload()), ANNOUNCEMENT) {
        Ok(announcement) => {
            let key = domain.to_string();
            latest.put(&key, ObserverEvent::Announcement { domain, announcement });
        }
        Err(refusal) => warn!(%refusal, "announcement refused"),
    }
}
