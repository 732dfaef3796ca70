//! Following a run over the network: what an observer hears becomes what a page knows.

use std::io::Read as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

use flate2::read::GzDecoder;
use leadtime_link::keys::Member;
use leadtime_link::{ConnectSettings, Error as LinkError, Events, ObserverEvent, ObserverLink};
use leadtime_proto::message::Announcement;
use leadtime_proto::{DomainName, Incarnation, RunName};
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval, sleep};
use tokio_util::sync::CancellationToken;
use tracing::debug;

use crate::error::Error;
use crate::flight::{FlightPlan, FlightThread};
use crate::page::{EVENT_PAUSE, Page};
use crate::state::MAX_POINTS;

/// The largest history that is decompressed, in bytes.
const MAX_HISTORY: u64 = 32 << 20;
/// Pause before a question is asked again.
const PAUSE: Duration = Duration::from_millis(500);
/// The shortest time between two pulls of weights.
const PULL_PAUSE: Duration = Duration::from_secs(10);
/// Answers that wait to be taken in.
const QUEUED: usize = 16;

/// Makes what is played of a run's configuration, or says why nothing can be.
pub type PlanMaker = dyn Fn(&str) -> Result<FlightPlan, String> + Send + Sync;

/// A connection to the network of a run.
#[derive(Debug)]
pub struct Attachment {
    /// The run that is watched.
    pub run: RunName,
    link: Arc<ObserverLink>,
    events: Events<ObserverEvent>,
}

impl Attachment {
    /// Connects, and finds the run: the one that is named, or the only one that is there.
    ///
    /// # Errors
    ///
    /// [`Error::Link`] if the network cannot be reached or asked, if no learner is there in time, or if it is not clear
    /// which run is meant: with the runs that are there.
    pub async fn open(settings: &ConnectSettings, run: Option<RunName>) -> Result<Self, Error> {
        let (link, events) = ObserverLink::open(settings).await?;
        let run = link.find_run(settings, run).await?;
        link.follow(&run)?;
        Ok(Self { run, link: Arc::new(link), events })
    }

    /// Asks once what the run is and how it went, and listens for a moment to who is here.
    ///
    /// # Errors
    ///
    /// [`Error::LearnerGone`] if its learner has ended in the meantime, [`Error::Link`] if it is of another release, or if the
    /// network is not left in time; [`Error::Answer`] or [`Error::Compression`] if an answer cannot be read.
    pub async fn look_once(self, page: &Page, listen: Duration) -> Result<(), Error> {
        let gone = |error| match error {
            Error::Link(source @ LinkError::NoAnswer { .. }) => {
                Error::LearnerGone { run: self.run.clone(), source }
            }
            other => other,
        };
        let (incarnation, about) = ask_about(&self.link, &self.run).await.map_err(gone)?;
        page.with(|view, now| {
            view.learner_joined(&incarnation.hex(), now);
            view.about(about, now);
        });
        let deadline = tokio::time::Instant::now() + listen;
        while let Ok(Some(event)) = tokio::time::timeout_at(deadline, self.events.recv()).await {
            take_in(page, event);
        }
        // Last, so that its curves have no gaps. A page that has heard that the learner ended shows how.
        if !page.with(|view, now| view.is_over(now)) {
            let history = ask_history(&self.link, &self.run).await.map_err(gone)?;
            page.with(|view, now| view.history(&history, now));
        }
        self.link.close().await?;
        Ok(())
    }

    /// Follows the run until the token is cancelled.
    ///
    /// # Errors
    ///
    /// [`Error::Thread`] if no thread can be started for the playthrough.
    pub async fn follow(
        self,
        page: Arc<Page>,
        plan: Option<Arc<PlanMaker>>,
        stop: CancellationToken,
    ) -> Result<(), Error> {
        let play = match plan {
            Some(plan) => {
                let watcher: Arc<Page> = Arc::clone(&page);
                Some(Play {
                    plan,
                    flight: FlightThread::start(watcher)?,
                    offered: None,
                    pulled: None,
                    pulled_at: None,
                    is_pulling: false,
                })
            }
            None => None,
        };
        let (answers, answered) = mpsc::channel(QUEUED);
        let link = Arc::clone(&self.link);
        let follower = Follower {
            run: self.run,
            link: self.link,
            page,
            play,
            answers,
            is_asking: false,
            is_known: false,
        };
        follower.run(self.events, answered, stop).await;
        if let Err(error) = link.close().await {
            debug!(%error, "network not closed in time");
        }
        Ok(())
    }
}

async fn ask_about(link: &ObserverLink, run: &RunName) -> Result<(Incarnation, Value), Error> {
    let (incarnation, json) = link.ask_about(run).await?;
    let about = serde_json::from_slice(&json)
        .map_err(|source| Error::Answer { question: "`about`", source })?;
    Ok((incarnation, about))
}

async fn ask_history(link: &ObserverLink, run: &RunName) -> Result<Value, Error> {
    let (_, compressed) = link.ask_history(run, 0, MAX_POINTS).await?;
    let read = move || {
        let mut text = Vec::new();
        let mut decoder = GzDecoder::new(compressed.as_slice()).take(MAX_HISTORY);
        decoder.read_to_end(&mut text).map_err(Error::Compression)?;
        serde_json::from_slice(&text)
            .map_err(|source| Error::Answer { question: "`history`", source })
    };
    match tokio::task::spawn_blocking(read).await {
        Ok(read) => read,
        Err(_panicked) => Err(LinkError::Panicked("read a history").into()),
    }
}

/// Takes in what an observer hears, but for announcements. Returns whether a learner came that was not there.
fn take_in(page: &Page, event: ObserverEvent) -> bool {
    page.with(|view, now| match event {
        ObserverEvent::Metrics { member, incarnation, json } => {
            let Ok(told) = serde_json::from_slice::<Value>(&json) else { return false };
            let incarnation = incarnation.hex();
            match member {
                Member::Learner => view.learner_says(&incarnation, told, now),
                Member::Actor(id) => {
                    view.actor_says(id.as_str(), &incarnation, told, now);
                    false
                }
            }
        }
        ObserverEvent::Joined(Member::Learner, incarnation) => {
            view.learner_joined(&incarnation.hex(), now)
        }
        ObserverEvent::Joined(Member::Actor(id), incarnation) => {
            view.actor_joined(id.as_str(), &incarnation.hex(), now);
            false
        }
        ObserverEvent::Left(Member::Learner, incarnation) => {
            view.learner_left(&incarnation.hex(), now);
            false
        }
        ObserverEvent::Left(Member::Actor(id), incarnation) => {
            view.actor_left(id.as_str(), &incarnation.hex(), now);
            false
        }
        ObserverEvent::Announcement { .. } => false,
    })
}

/// What comes back from a task.
enum Answer {
    /// What the run is, and how it went; or that it is to be asked again.
    Asked(Option<(Value, Value)>),
    /// A version of the weights, if it could be pulled.
    Pulled(Option<(u64, Vec<u8>)>),
}

/// What it takes to show the policy at work.
struct Play {
    plan: Arc<PlanMaker>,
    flight: FlightThread,
    /// The newest announcement, whose last version may be pulled.
    offered: Option<(DomainName, Announcement)>,
    /// The version that plays.
    pulled: Option<u64>,
    pulled_at: Option<Instant>,
    is_pulling: bool,
}

impl Play {
    /// Takes in an announcement of the learner that is followed; others may be anybody's.
    fn offer(&mut self, learner: Option<&str>, domain: DomainName, announcement: Announcement) {
        if learner == Some(announcement.learner.hex().as_str()) {
            self.offered = Some((domain, announcement));
        }
    }
}

struct Follower {
    run: RunName,
    link: Arc<ObserverLink>,
    page: Arc<Page>,
    play: Option<Play>,
    answers: mpsc::Sender<Answer>,
    is_asking: bool,
    /// Whether the learner that is there now has been asked.
    is_known: bool,
}

impl Follower {
    async fn run(
        mut self,
        events: Events<ObserverEvent>,
        mut answered: mpsc::Receiver<Answer>,
        stop: CancellationToken,
    ) {
        let mut ticks = interval(EVENT_PAUSE);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                () = stop.cancelled() => return,
                event = events.recv() => match event {
                    Some(event) => self.event(event),
                    None => return,
                },
                Some(answer) = answered.recv() => self.answer(answer),
                _ = ticks.tick() => self.pull(),
            }
            let n_missed = self.link.n_missed();
            self.page.with(|view, _| view.missed(n_missed));
            self.page.flush(Instant::now());
        }
    }

    fn event(&mut self, event: ObserverEvent) {
        if let ObserverEvent::Announcement { domain, announcement } = event {
            let learner = self.page.with(|view, _| view.learner().map(str::to_owned));
            if let Some(play) = &mut self.play {
                play.offer(learner.as_deref(), domain, announcement);
                self.pull();
            }
            return;
        }
        if take_in(&self.page, event) {
            self.is_known = false;
        }
        self.ask();
    }

    /// Asks a learner that is new what its run is and how it went.
    fn ask(&mut self) {
        let is_there = self.page.with(|view, _| view.has_learner());
        if self.is_known || self.is_asking || !is_there {
            return;
        }
        self.is_asking = true;
        let (link, run, answers) = (Arc::clone(&self.link), self.run.clone(), self.answers.clone());
        tokio::spawn(async move {
            let asked = async {
                let (_, about) = ask_about(&link, &run).await?;
                Ok::<_, Error>((about, ask_history(&link, &run).await?))
            };
            let asked = asked.await;
            if let Err(error) = &asked {
                debug!(%error, "the learner has not answered");
                sleep(PAUSE).await;
            }
            drop(answers.send(Answer::Asked(asked.ok())).await);
        });
    }

    fn answer(&mut self, answer: Answer) {
        match answer {
            Answer::Asked(None) => {
                self.is_asking = false;
                self.ask();
            }
            Answer::Asked(Some((about, history))) => {
                (self.is_asking, self.is_known) = (false, true);
                let config = about["config"].as_str().map(str::to_owned);
                self.page.with(|view, now| {
                    view.about(about, now);
                    view.history(&history, now);
                });
                if let Some(play) = &mut self.play {
                    // A plan that is new plays nothing yet, and a learner that is new makes versions again.
                    play.pulled = None;
                    let config = config.ok_or("the learner tells no configuration".to_owned());
                    play.flight.plan(config.and_then(|config| (play.plan)(&config)));
                }
                self.pull();
            }
            Answer::Pulled(pulled) => {
                let Some(play) = &mut self.play else { return };
                play.is_pulling = false;
                if let Some((version, weights)) = pulled {
                    play.pulled = Some(version);
                    play.flight.policy(version, weights);
                }
            }
        }
    }

    /// Pulls the newest weights, if they are looked at and it is time.
    fn pull(&mut self) {
        let is_watched = self.page.n_watching() > 0;
        let Some(play) = self.play.as_mut().filter(|_| is_watched) else { return };
        let is_due = play.pulled_at.is_none_or(|at| at.elapsed() >= PULL_PAUSE);
        let Some((domain, announcement)) = &play.offered else { return };
        let Some(&(version, sha256)) = announcement.versions.last() else { return };
        if play.is_pulling || !is_due || play.pulled == Some(version.0) {
            return;
        }
        (play.is_pulling, play.pulled_at) = (true, Some(Instant::now()));
        let (link, run, domain) = (Arc::clone(&self.link), self.run.clone(), domain.clone());
        let answers = self.answers.clone();
        tokio::spawn(async move {
            let pulled = link.pull_weights(&run, &domain, version, sha256).await;
            if let Err(error) = &pulled {
                debug!(%error, "weights not pulled");
            }
            let pulled = pulled.ok().map(|weights| (version.0, weights));
            drop(answers.send(Answer::Pulled(pulled)).await);
        });
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::PolicyVersion;

    use super::*;

    #[test]
    fn only_the_learner_that_is_followed_offers_what_is_played() {
        let watcher: Arc<Page> = Page::new("r", || 0.0);
        let mut play = Play {
            plan: Arc::new(|_| Err("nothing is played".to_owned())),
            flight: FlightThread::start(watcher).unwrap(),
            offered: None,
            pulled: None,
            pulled_at: None,
            is_pulling: false,
        };
        let (own, stranger) = (Incarnation(1), Incarnation(2));
        let mut offer = |learner, version| {
            let versions = vec![(PolicyVersion(version), [0; 32])];
            let domain = DomainName::new("lander").unwrap();
            play.offer(Some(&own.hex()), domain, Announcement { learner, versions });
            play.offered.as_ref().map(|(_, offered)| offered.newest())
        };
        assert_eq!(offer(stranger, 99), None);
        assert_eq!(offer(own, 3), Some(PolicyVersion(3)));
        assert_eq!(offer(stranger, 99), Some(PolicyVersion(3)));
    }
}
