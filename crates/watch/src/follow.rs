//! Following a run over the network: what an observer hears becomes what a page knows.

use std::io::Read as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

use flate2::read::GzDecoder;
use leadtime_link::keys::Member;
use leadtime_link::{ConnectSettings, Error as LinkError, Events, ObserverEvent, ObserverLink};
use leadtime_proto::message::Announcement;
use leadtime_proto::{DomainName, Incarnation, PolicyVersion, RunName};
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval, sleep};
use tokio_util::sync::CancellationToken;
use tracing::debug;

use crate::error::Error;
use crate::flight::{FlightPlan, FlightThread};
use crate::page::{Page, TICK};
use crate::state::MAX_POINTS;

/// The largest history that is decompressed, in bytes.
const MAX_HISTORY: u64 = 32 << 20;
/// Pause before a question is asked again.
const PAUSE: Duration = Duration::from_millis(500);
/// The shortest time between two pulls of weights.
const PULL_PAUSE: Duration = Duration::from_secs(10);
/// The same after one that failed: a quick learner may have made newer versions meanwhile, and keep this one no longer.
const RETRY_PAUSE: Duration = Duration::from_millis(200);
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
        let play = plan.map(|plan| Play::start(plan, Arc::clone(&page))).transpose()?;
        let (answers, answered) = mpsc::channel(QUEUED);
        let link = Arc::clone(&self.link);
        let follower = Follower {
            run: self.run,
            link: self.link,
            page,
            play,
            answers,
            question: Question::default(),
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
                    view.actor_says(id.as_str(), &incarnation, &told, now);
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
    /// What the run is: a playthrough needs no more, and the history takes longer.
    Described(Value),
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
    /// When weights may be pulled again.
    next_pull: Option<Instant>,
    is_pulling: bool,
}

impl Play {
    fn start(plan: Arc<PlanMaker>, page: Arc<Page>) -> Result<Self, Error> {
        let flight = FlightThread::start(page)?;
        Ok(Self { plan, flight, offered: None, pulled: None, next_pull: None, is_pulling: false })
    }

    /// Takes in an announcement of the learner that is followed; others may be anybody's.
    fn offer(&mut self, learner: Option<&str>, domain: DomainName, announcement: Announcement) {
        if learner == Some(announcement.learner.hex().as_str()) {
            self.offered = Some((domain, announcement));
        }
    }

    /// Begins to pull the newest version of the learner that is followed now, if it is another one than what plays, and if it
    /// is time.
    fn begin_pull(
        &mut self,
        learner: Option<&str>,
        now: Instant,
    ) -> Option<(DomainName, PolicyVersion, [u8; 32])> {
        let is_due = self.next_pull.is_none_or(|at| now >= at);
        let (domain, announcement) = self.offered.as_ref()?;
        let is_own = learner == Some(announcement.learner.hex().as_str());
        let &(version, sha256) = announcement.versions.last().filter(|_| is_own)?;
        if self.is_pulling || !is_due || self.pulled == Some(version.0) {
            return None;
        }
        (self.is_pulling, self.next_pull) = (true, Some(now + PULL_PAUSE));
        Some((domain.clone(), version, sha256))
    }

    /// Takes in a version that was pulled, if it was.
    fn end_pull(&mut self, pulled: Option<(u64, Vec<u8>)>, now: Instant) {
        self.is_pulling = false;
        match pulled {
            Some((version, weights)) => {
                self.pulled = Some(version);
                self.flight.policy(version, weights);
            }
            None => self.next_pull = Some(now + RETRY_PAUSE),
        }
    }
}

/// What a learner is asked: what its run is, and how it went.
#[derive(Debug, Default)]
struct Question {
    /// Whether somebody is being asked.
    is_asked: bool,
    /// Whether the learner that is followed was asked, and nothing went wrong with that.
    is_known: bool,
}

impl Question {
    /// Returns whether it is to be asked now.
    fn begin(&mut self) -> bool {
        let is_due = !self.is_asked && !self.is_known;
        if is_due {
            *self = Self { is_asked: true, is_known: true };
        }
        is_due
    }

    /// Another learner is followed: it has to be asked, also if the one before it still is.
    fn renew(&mut self) {
        self.is_known = false;
    }

    /// Takes in that it was answered, or was not. Returns whether the answer counts: it is not that of the learner before.
    fn end(&mut self, is_answered: bool) -> bool {
        self.is_asked = false;
        self.is_known &= is_answered;
        self.is_known
    }
}

struct Follower {
    run: RunName,
    link: Arc<ObserverLink>,
    page: Arc<Page>,
    play: Option<Play>,
    answers: mpsc::Sender<Answer>,
    question: Question,
}

impl Follower {
    async fn run(
        mut self,
        events: Events<ObserverEvent>,
        mut answered: mpsc::Receiver<Answer>,
        stop: CancellationToken,
    ) {
        let mut ticks = interval(TICK);
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
            self.question.renew();
        }
        self.ask();
    }

    /// Asks a learner that is new what its run is and how it went.
    fn ask(&mut self) {
        if !self.page.with(|view, _| view.has_learner()) || !self.question.begin() {
            return;
        }
        let (link, run, answers) = (Arc::clone(&self.link), self.run.clone(), self.answers.clone());
        tokio::spawn(async move {
            let about = async {
                let (_, about) = ask_about(&link, &run).await?;
                drop(answers.send(Answer::Described(about.clone())).await);
                Ok(about)
            };
            let asked = tokio::try_join!(about, ask_history(&link, &run));
            if let Err(error) = &asked {
                debug!(%error, "the learner has not answered");
                sleep(PAUSE).await;
            }
            drop(answers.send(Answer::Asked(asked.ok())).await);
        });
    }

    fn answer(&mut self, answer: Answer) {
        match answer {
            Answer::Asked(asked) => {
                let is_answered = self.question.end(asked.is_some());
                let Some((about, history)) = asked.filter(|_| is_answered) else {
                    return self.ask();
                };
                self.page.with(|view, now| {
                    view.about(about, now);
                    view.history(&history, now);
                });
            }
            Answer::Described(about) => {
                if !self.question.is_known {
                    return;
                }
                let config = about["config"].as_str().map(str::to_owned);
                if let Some(play) = &mut self.play {
                    // A plan that is new plays nothing yet, and a learner that is new makes versions again.
                    play.pulled = None;
                    let config = config.ok_or("the learner tells no configuration".to_owned());
                    play.flight.plan(config.and_then(|config| (play.plan)(&config)));
                }
                self.pull();
            }
            Answer::Pulled(pulled) => {
                if let Some(play) = &mut self.play {
                    play.end_pull(pulled, Instant::now());
                }
            }
        }
    }

    /// Pulls the newest weights, if they are looked at and it is time.
    fn pull(&mut self) {
        let is_watched = self.page.n_watching() > 0;
        let Some(play) = self.play.as_mut().filter(|_| is_watched) else { return };
        let begun = self.page.with(|view, _| play.begin_pull(view.learner(), Instant::now()));
        let Some((domain, version, sha256)) = begun else { return };
        let (link, run) = (Arc::clone(&self.link), self.run.clone());
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
    use leadtime_link::{Archive, LearnerLink, ListenSettings, StartKey};

    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn what_is_played_is_known_before_a_long_history_is_read() {
        let place = tempfile::tempdir().unwrap();
        let endpoint = format!("unixsock-stream/{}", place.path().join("l").display());
        let endpoint: leadtime_link::Endpoint = endpoint.parse().unwrap();
        let run = RunName::new("r").unwrap();
        let settings = ListenSettings::new(vec![endpoint.clone()]);
        let start = StartKey::numbered(1);
        let opened = LearnerLink::open(&run, "lander", &start, &settings).await;
        let (mut learner, _events) = opened.unwrap();
        let (read, reading) = flume::bounded::<()>(1);
        let history = move |_: u64, _: usize| -> Result<Vec<u8>, String> {
            reading.recv().ok();
            Err("it was read in vain".to_owned())
        };
        let about = br#"{"config": "of this run"}"#.to_vec();
        learner.answer_observers(Archive { about, history: Arc::new(history) }).unwrap();

        let settings = ConnectSettings::new(vec![endpoint]);
        let attachment = Attachment::open(&settings, Some(run)).await.unwrap();
        let (planned, plans) = flume::unbounded();
        let plan = move |config: &str| {
            drop(planned.send(config.to_owned()));
            Err("nothing is played".to_owned())
        };
        let (page, stop) = (Page::new("r", || 0.0), CancellationToken::new());
        let following = attachment.follow(page, Some(Arc::new(plan)), stop.clone());
        let following = tokio::spawn(following);
        let planned = tokio::time::timeout(Duration::from_secs(20), plans.recv_async()).await;
        assert_eq!(planned.expect("the history is still being read").unwrap(), "of this run");
        drop(read);
        stop.cancel();
        following.await.unwrap().unwrap();
        learner.close().await.unwrap();
    }

    #[test]
    fn a_learner_that_comes_while_another_is_asked_is_asked_as_well() {
        let mut question = Question::default();
        assert!(question.begin() && !question.begin());
        question.renew();
        assert!(!question.begin(), "one question at a time");
        assert!(!question.end(true), "this is how the run of the one before it went");
        assert!(question.begin() && !question.end(false), "no answer");
        assert!(question.begin() && question.end(true) && !question.begin());
    }

    fn play() -> Play {
        let watcher: Arc<Page> = Page::new("r", || 0.0);
        let plan: Arc<PlanMaker> = Arc::new(|_| Err("nothing is played".to_owned()));
        Play::start(plan, watcher).unwrap()
    }

    #[test]
    fn a_pull_that_failed_is_tried_again_soon() {
        let (mut play, start) = (play(), Instant::now());
        let (learner, domain) = (Incarnation(1), DomainName::new("lander").unwrap());
        let offer = |play: &mut Play, version| {
            let versions = vec![(PolicyVersion(version), [0; 32])];
            let news = Announcement { learner, versions };
            play.offer(Some(&learner.hex()), domain.clone(), news);
        };
        offer(&mut play, 1);
        let own = Some(learner.hex());
        let version = |pull: Option<(_, PolicyVersion, _)>| pull.map(|(_, version, _)| version.0);
        assert_eq!(version(play.begin_pull(own.as_deref(), start)), Some(1));
        offer(&mut play, 9);
        assert_eq!(version(play.begin_pull(own.as_deref(), start)), None, "one at a time");
        // The learner has it no longer.
        play.end_pull(None, start);
        assert_eq!(version(play.begin_pull(own.as_deref(), start)), None);
        let again = start + RETRY_PAUSE;
        assert_eq!(version(play.begin_pull(own.as_deref(), again)), Some(9));
        play.end_pull(Some((9, Vec::new())), again);
        offer(&mut play, 10);
        assert_eq!(version(play.begin_pull(own.as_deref(), again + RETRY_PAUSE)), None, "it plays");
        assert_eq!(version(play.begin_pull(own.as_deref(), again + PULL_PAUSE)), Some(10));
    }

    #[test]
    fn only_the_learner_that_is_followed_offers_what_is_played() {
        let mut play = play();
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
        let mut begun = |learner: Incarnation| {
            play.begin_pull(Some(&learner.hex()), Instant::now()).map(|it| it.1)
        };
        assert_eq!((begun(stranger), begun(own)), (None, Some(PolicyVersion(3))));
    }
}
