//! The observer's end: reads presence, metrics, announcements and weights, and touches nothing.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use leadtime_proto::message::Announcement;
use leadtime_proto::receive::{self, ABOUT, HISTORY, METRICS};
use leadtime_proto::{DomainName, Incarnation, PolicyVersion, RunName};
use zenoh::sample::{Sample, SampleKind};

use crate::keys::{self, FROM, Key, Keys, Member, POINTS};
use crate::latest::{Events, Latest};
use crate::pubsub::{subscribe, watch};
use crate::queue::{Class, EventQueue};
use crate::redial::LastingSession;
use crate::told::ToldRefusals;
use crate::{ConnectSettings, Result, ask, discovery, weights, wire};

/// Places in the event queue for metrics.
const N_BULK: usize = 4_096;
/// How long a learner may take to say what its run is.
const ABOUT_TIMEOUT: Duration = Duration::from_secs(3);
/// How long it may take to read its history: a long one is a large file, and one question is answered at a time.
const HISTORY_TIMEOUT: Duration = Duration::from_secs(20);

/// What an observer sees.
#[derive(Debug)]
pub enum ObserverEvent {
    /// A member published its metrics.
    Metrics {
        /// The member that published them.
        member: Member,
        /// The start of the member that published them.
        incarnation: Incarnation,
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
    n_missed: Arc<AtomicU64>,
    told: Arc<ToldRefusals>,
    session: Arc<LastingSession>,
}

impl ObserverLink {
    /// Connects to a learner or a router. From now on a connection that has had nobody at its other end for ten seconds is
    /// replaced by another.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Unreachable`] if nobody answers within the settings' time-out.
    pub async fn open(settings: &ConnectSettings) -> Result<(Self, Events<ObserverEvent>)> {
        let session = LastingSession::open(settings).await?;
        let (events, latest, receiver) = Events::new(N_BULK);
        let (n_missed, told) = (Arc::default(), Arc::default());
        Ok((Self { events, latest, n_missed, told, session }, receiver))
    }

    /// Lists the runs that are there now.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Network`] if the network cannot be asked.
    pub async fn runs(&self) -> Result<BTreeSet<RunName>> {
        discovery::runs(&self.session.now()).await
    }

    /// Finds the run: the named one, or the only one present. Looks until the settings'
    /// time-out while no learner is there.
    ///
    /// # Errors
    ///
    /// [`crate::Error::RunNotFound`], [`crate::Error::SeveralRuns`] or [`crate::Error::NoLearner`].
    pub async fn find_run(
        &self,
        settings: &ConnectSettings,
        wanted: Option<RunName>,
    ) -> Result<RunName> {
        let current = || self.session.now();
        discovery::find(current, settings, wanted.as_ref(), Instant::now()).await
    }

    /// Follows a run from now on, whether it is there already or not.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Network`] if it cannot be subscribed to.
    pub fn follow(&self, run: &RunName) -> Result<()> {
        let (run, events) = (run.clone(), self.events.clone());
        let (latest, n_missed) = (Arc::clone(&self.latest), Arc::clone(&self.n_missed));
        let refusals = Arc::clone(&self.told);
        self.session.subscribe(move |session| {
            let (told, missed) = (events.clone(), Arc::clone(&n_missed));
            let refused = Arc::clone(&refusals);
            let metrics = subscribe(session, Keys::MetricsOf(&run), move |sample| {
                on_metrics(&told, &missed, &refused, &sample);
            })?;
            let (newest, refused) = (Arc::clone(&latest), Arc::clone(&refusals));
            let announcements = subscribe(session, Keys::AnnouncementsOf(&run), move |sample| {
                on_announcement(&newest, &refused, &sample);
            })?;
            let told = events.clone();
            let members = watch(session, Keys::MembersOf(&run), move |alive, kind| {
                let Some(keys::Alive { member, incarnation, .. }) = alive else { return };
                let event = match kind {
                    SampleKind::Put => ObserverEvent::Joined(member, incarnation),
                    SampleKind::Delete => ObserverEvent::Left(member, incarnation),
                };
                drop(told.offer(event, Class::Presence));
            })?;
            Ok(vec![metrics, announcements, members])
        })
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
        let (key, timeout) = (Key::Weights(run, domain), ask::PULL_TIMEOUT);
        ask::pull(&self.session.now(), key, version, sha256, timeout).await
    }

    /// Asks a run's learner what the run is. Returns the learner's start and its answer, JSON.
    ///
    /// # Errors
    ///
    /// [`crate::Error::NoAnswer`] if the learner is not there,
    /// [`crate::Error::BadAnswer`] if it is of another release.
    pub async fn ask_about(&self, run: &RunName) -> Result<(Incarnation, Vec<u8>)> {
        let (key, no_parameters) = (Key::About(run), String::new());
        ask::ask_bytes(&self.session.now(), key, no_parameters, ABOUT, ABOUT_TIMEOUT).await
    }

    /// Asks a run's learner for its updates from a number on, thinned to so many points. Returns the learner's start and
    /// its answer, JSON compressed with gzip.
    ///
    /// # Errors
    ///
    /// As [`ObserverLink::ask_about`]; [`crate::Error::Rejected`] if the learner cannot read its history.
    pub async fn ask_history(
        &self,
        run: &RunName,
        from: u64,
        n_points: usize,
    ) -> Result<(Incarnation, Vec<u8>)> {
        let parameters = format!("{FROM}={from};{POINTS}={n_points}");
        let key = Key::History(run);
        ask::ask_bytes(&self.session.now(), key, parameters, HISTORY, HISTORY_TIMEOUT).await
    }

    /// Returns how many messages there was no room for so far.
    pub fn n_missed(&self) -> u64 {
        self.n_missed.load(Ordering::Relaxed)
    }

    /// Measures how long a short question to a run's learner and its answer take.
    ///
    /// # Errors
    ///
    /// [`crate::Error::NoAnswer`] if nobody answers, or an access list is in the way.
    pub async fn round_trip(&self, run: &RunName) -> Result<Duration> {
        ask::round_trip(&self.session.now(), run).await
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        self.session.close().await
    }
}

fn on_metrics(
    events: &EventQueue<ObserverEvent>,
    missed: &AtomicU64,
    refused: &ToldRefusals,
    sample: &Sample,
) {
    let Some(member) = keys::parse_metrics(sample.key_expr()) else { return };
    let json = sample.payload().to_bytes();
    let checked = wire::inspect(sample.attachment(), Some(sample.payload()), METRICS)
        .and_then(|header| receive::verify(&header, &json).map(|()| header.incarnation));
    match checked {
        Ok(incarnation) => {
            let event = ObserverEvent::Metrics { member, incarnation, json: json.into_owned() };
            if events.offer(event, Class::Bulk).is_some() {
                missed.fetch_add(1, Ordering::Relaxed);
            }
        }
        Err(refusal) => refused.tell("metrics", &refusal),
    }
}

fn on_announcement(latest: &Latest<ObserverEvent>, refused: &ToldRefusals, sample: &Sample) {
    let Some(domain) = keys::parse_announcement(sample.key_expr()) else { return };
    match weights::read_announcement(sample) {
        Ok(announcement) => {
            let key = newest_of(&domain, &announcement);
            latest.put(&key, ObserverEvent::Announcement { domain, announcement });
        }
        Err(refusal) => refused.tell("announcement", &refusal),
    }
}

/// Names what a newer announcement takes the place of: the same learner's, so that no stranger's takes that of ours.
fn newest_of(domain: &DomainName, announcement: &Announcement) -> String {
    format!("{domain}/{}", announcement.learner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::*;

    #[test]
    fn a_strangers_announcement_takes_the_place_of_no_learners() {
        let of = |learner, versions| newest_of(&domain(), &Announcement { learner, versions });
        let newer = vec![(PolicyVersion(1), [0; 32])];
        assert_eq!(of(Incarnation(1), Vec::new()), of(Incarnation(1), newer));
        assert_ne!(of(Incarnation(1), Vec::new()), of(Incarnation(2), Vec::new()));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_observer_whose_connection_leads_nowhere_goes_on_with_another() {
        let (site, elsewhere) = (Site::new(), Site::new());
        let (learner, _events) = site.learner().await;
        let (observer, seen) = ObserverLink::open(&site.connect()).await.unwrap();
        observer.follow(&run("one")).unwrap();
        let joined = |event: ObserverEvent| {
            matches!(event, ObserverEvent::Joined(Member::Learner, LEARNER)).then_some(())
        };
        until(&seen, joined).await;

        observer.session.strand(elsewhere.raw("peer").await).await;
        observer.session.look_long_after().await;
        until(&seen, joined).await;
        assert_eq!(observer.find_run(&site.connect(), None).await.unwrap(), run("one"));
        learner.publish_metrics(b"{}").unwrap();
        let metrics = until(&seen, |event| match event {
            ObserverEvent::Metrics { json, .. } => Some(json),
            _ => None,
        });
        assert_eq!(metrics.await, b"{}");

        observer.close().await.unwrap();
        observer.session.look_long_after().await;
        assert!(observer.session.now().is_closed(), "nothing takes the place of what was closed");
    }
}
