//! A learner's status: fed by what its run reports, read on request.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use leadtime_learner::{Books, RunEvent, RunHealth, UpdateProgress};
use leadtime_proto::RefusalCause;
use tokio_util::sync::DropGuard;

use crate::health::{Liveness, Occasion};
use crate::machine;
use crate::names::{BOOK_ENTRIES, Metric, MetricPage};
use crate::numbers::PageNumbers;
use crate::server::{StatusServer, StatusSource};

/// The span that the share of waiting is about.
const WINDOW: Duration = Duration::from_mins(1);
/// Updates closer together than this share an entry, so that a window has few.
const ENTRY: Duration = Duration::from_secs(1);

/// What a learner's page needs to know of its run once.
#[derive(Debug)]
pub struct LearnerFacts {
    /// The name of the run.
    pub run: String,
    /// The directory of the run.
    pub directory: PathBuf,
    /// The configured time between checkpoints.
    pub checkpoint_interval: Duration,
    /// The file of the learner's certificate.
    pub certificate: Option<PathBuf>,
    /// Whether the learner listens with it, and so reads it only when it starts; it is read anew whenever a process dials.
    pub is_certificate_read_once: bool,
}

/// The writing end of a learner's status page, which is served for as long as this lives.
#[derive(Debug)]
pub struct LearnerStatus {
    shared: Arc<LearnerPage>,
    window: WaitWindow,
    before: CountsBefore,
    _served: DropGuard,
}

/// What the run had counted before this process, which its counters leave out: a checkpoint holds a little less than the
/// last scrape before, and Prometheus would take that for a counter that began anew and counted all of it.
#[derive(Debug, Default)]
struct CountsBefore {
    n_steps: u64,
    n_updates: u64,
    n_episodes: u64,
    books: Books,
}

#[derive(Debug)]
struct LearnerPage {
    facts: LearnerFacts,
    /// When the certificate ends that was read at the start; `None` where its file counts.
    certificate_end: Option<f64>,
    numbers: Arc<PageNumbers>,
    liveness: Arc<Liveness>,
    is_listening: AtomicBool,
    has_enough_actors: AtomicBool,
    is_paused: AtomicBool,
    n_actors: AtomicU64,
    last_checkpoint: Occasion,
    last_update: Occasion,
    /// Waiting within the window up to the last update, the window's length, and the time of the last training; in
    /// milliseconds.
    waited: AtomicU64,
    spanned: AtomicU64,
    trained: AtomicU64,
}

impl LearnerStatus {
    /// Begins to serve what the learner tells.
    pub fn serve(server: StatusServer, facts: LearnerFacts) -> Self {
        let liveness = Liveness::new();
        let start = liveness.start();
        let read_once = facts.certificate.as_deref().filter(|_| facts.is_certificate_read_once);
        let shared = Arc::new(LearnerPage {
            certificate_end: read_once.and_then(machine::certificate_end),
            numbers: PageNumbers::new(MetricPage::Learner),
            is_listening: AtomicBool::new(false),
            has_enough_actors: AtomicBool::new(false),
            is_paused: AtomicBool::new(false),
            n_actors: AtomicU64::new(0),
            last_checkpoint: Occasion::never(start),
            last_update: Occasion::never(start),
            waited: AtomicU64::new(0),
            spanned: AtomicU64::new(0),
            trained: AtomicU64::new(0),
            liveness,
            facts,
        });
        let served = server.serve(Arc::clone(&shared) as Arc<dyn StatusSource>);
        let (window, before) = (WaitWindow::new(start), CountsBefore::default());
        Self { shared, window, before, _served: served }
    }

    /// Takes in an update.
    pub fn update(&mut self, progress: &UpdateProgress) {
        let shared = &self.shared;
        let numbers = &shared.numbers;
        let UpdateProgress { update, episodes, phases, books, n_queued, .. } = progress;
        self.count(progress.n_steps, progress.n_updates, episodes.n_finished, books);
        for (&staleness, &n) in &update.staleness {
            numbers.observe_staleness(staleness, n);
        }
        numbers.set(Metric::SuccessRatio, episodes.success.unwrap_or(f64::NAN));
        numbers.set(Metric::Return, episodes.episode_return.unwrap_or(f64::NAN));
        numbers.set(Metric::Entropy, update.entropy);
        numbers.set(Metric::Kl, update.approx_kl);
        numbers.set(Metric::ExplainedVariance, update.explained_variance);
        numbers.set(Metric::LearningRate, update.learning_rate);
        let spent = [phases.wait, phases.train, phases.checkpoint, phases.weights];
        for (index, spent) in spent.into_iter().enumerate() {
            numbers.add(Metric::PhaseSeconds, index, spent.as_secs_f64());
        }
        let owed = books.published as f64 - books.rolled_back as f64;
        numbers.set(Metric::BooksImbalance, owed - books.accounted() as f64 - *n_queued as f64);
        self.window.add(Instant::now(), phases.wait);
        let millis = |duration: Duration| duration.as_millis() as u64;
        shared.waited.store(millis(self.window.waited()), Ordering::Relaxed);
        shared.spanned.store(millis(self.window.span()), Ordering::Relaxed);
        shared.trained.store(millis(phases.train), Ordering::Relaxed);
        shared.last_update.note();
    }

    /// Tells what the run has counted over all its starts, and what of it in this process.
    fn count(&self, n_steps: u64, n_updates: u64, n_episodes: u64, books: &Books) {
        self.tell_progress(n_steps, n_updates, n_episodes);
        let (numbers, before) = (&self.shared.numbers, &self.before);
        numbers.set(Metric::Steps, since(n_steps, before.n_steps));
        numbers.set(Metric::Updates, since(n_updates, before.n_updates));
        numbers.set(Metric::Episodes, since(n_episodes, before.n_episodes));
        let entries = entries_of(books).zip(entries_of(&before.books));
        numbers.set_all(Metric::Books, entries.map(|(now, then)| since(now, then)));
    }

    /// Tells how far the run is, over all its starts.
    fn tell_progress(&self, n_steps: u64, n_updates: u64, n_episodes: u64) {
        let numbers = &self.shared.numbers;
        numbers.set(Metric::RunSteps, n_steps as f64);
        numbers.set(Metric::RunUpdates, n_updates as f64);
        numbers.set(Metric::RunEpisodes, n_episodes as f64);
    }

    /// Takes in how the run stands.
    pub fn tick(&self, health: &RunHealth) {
        let LearnerPage { numbers, liveness, .. } = &*self.shared;
        liveness.tick();
        numbers.set(Metric::Actors, health.n_actors as f64);
        numbers.set(Metric::EnvironmentsWaiting, health.n_envs_waiting as f64);
        numbers.set(Metric::QueuedRollouts, health.n_queued as f64);
        numbers.set(Metric::QueuedBytes, health.queued_bytes as f64);
        numbers.set(Metric::Unsaved, health.unsaved.unwrap_or_default().as_secs_f64());
        // Not with the updates: a run whose actors are all refused makes none.
        let before = &self.before.books.refusals;
        let refused = |cause: &RefusalCause| {
            let [n_now, n_then] =
                [&health.refusals, before].map(|counts| counts.get(cause).copied().unwrap_or(0));
            since(n_now, n_then)
        };
        numbers.set_all(Metric::Refusals, RefusalCause::ALL.iter().map(refused));
        self.shared.n_actors.store(health.n_actors as u64, Ordering::Relaxed);
        self.shared.has_enough_actors.store(health.has_enough_actors, Ordering::Relaxed);
        self.shared.is_paused.store(health.is_paused, Ordering::Relaxed);
    }

    /// Takes in what happened.
    pub fn event(&mut self, event: &RunEvent) {
        match event {
            RunEvent::Resumed { n_steps, n_updates, n_episodes, books, .. } => {
                let (n_steps, n_updates, n_episodes) = (*n_steps, *n_updates, *n_episodes);
                self.tell_progress(n_steps, n_updates, n_episodes);
                let books = books.clone();
                self.before = CountsBefore { n_steps, n_updates, n_episodes, books };
            }
            RunEvent::Listening { .. } => self.shared.is_listening.store(true, Ordering::Relaxed),
            RunEvent::CheckpointWritten { .. } => self.shared.last_checkpoint.note(),
            _ => {}
        }
    }

    /// Counts something that could not be written.
    pub fn dropped(&self) {
        self.shared.numbers.add(Metric::LinesDropped, 0, 1.0);
    }
}

/// Returns what was counted since then.
fn since(now: u64, then: u64) -> f64 {
    now.saturating_sub(then) as f64
}

/// Returns the entries of the books, in the order of their label's values.
fn entries_of(books: &Books) -> impl Iterator<Item = u64> {
    let entries = BTreeMap::from(books.entries());
    BOOK_ENTRIES.iter().map(move |name| entries[name])
}

impl Drop for LearnerStatus {
    fn drop(&mut self) {
        self.shared.liveness.end();
    }
}

impl StatusSource for LearnerPage {
    fn metrics(&self) -> Result<String, std::fmt::Error> {
        let Self { numbers, facts, liveness, .. } = self;
        let set = |metric, value: Option<f64>| numbers.set(metric, value.unwrap_or(f64::NAN));
        let age = self.last_checkpoint.elapsed().unwrap_or_else(|| liveness.start().elapsed());
        numbers.set(Metric::CheckpointAge, age.as_secs_f64());
        numbers.set(Metric::CheckpointInterval, facts.checkpoint_interval.as_secs_f64());
        numbers.set(Metric::WaitRatio, self.wait_ratio());
        if numbers.get(Metric::LinesDropped, 0).is_nan() {
            numbers.set(Metric::LinesDropped, 0.0);
        }
        let disk = machine::disk_bytes(&facts.directory);
        set(Metric::DiskFree, disk.map(|(free, _)| free));
        set(Metric::DiskSize, disk.map(|(_, size)| size));
        set(Metric::Resident, machine::resident_bytes());
        let in_file = || machine::certificate_end(facts.certificate.as_deref()?);
        set(Metric::CertificateEnd, self.certificate_end.or_else(in_file));
        numbers.text(("run", &facts.run))
    }

    fn live(&self) -> Result<(), String> {
        self.liveness.check()
    }

    fn ready(&self) -> Result<(), String> {
        self.live()?;
        let load = |flag: &AtomicBool| flag.load(Ordering::Relaxed);
        let directory = &self.facts.directory;
        if self.liveness.is_ending() {
            Err("the run is over".to_owned())
        } else if !load(&self.is_listening) {
            Err("the learner does not listen yet".to_owned())
        } else if load(&self.is_paused) {
            Err(format!(
                "no checkpoint can be written: free some space on the disk of {}",
                directory.display()
            ))
        } else if !machine::is_writable(directory) {
            Err(format!("the run directory {} cannot be written", directory.display()))
        } else if !load(&self.has_enough_actors) {
            let n_actors = self.n_actors.load(Ordering::Relaxed);
            Err(format!("actors are missing: {n_actors} are here"))
        } else {
            Ok(())
        }
    }
}

impl LearnerPage {
    /// Returns the share of the window that was waited; since the last update, all that is longer than a training.
    fn wait_ratio(&self) -> f64 {
        let load = |millis: &AtomicU64| Duration::from_millis(millis.load(Ordering::Relaxed));
        let since = self.last_update.elapsed();
        let since = since.unwrap_or_else(|| self.liveness.start().elapsed()).min(WINDOW);
        let waiting = since.saturating_sub(load(&self.trained));
        // What the window still holds of the time before the last update.
        let spanned = load(&self.spanned);
        let left = spanned.min(WINDOW.saturating_sub(since));
        let share = if spanned.is_zero() { 0.0 } else { left.div_duration_f64(spanned) };
        let waited = load(&self.waited).mul_f64(share) + waiting;
        let all = left + since;
        if all.is_zero() { 0.0 } else { waited.div_duration_f64(all).min(1.0) }
    }
}

/// How long the trainer waited during the last minute.
#[derive(Debug)]
struct WaitWindow {
    /// When each entry began, and the waiting in it.
    entries: VecDeque<(Instant, Duration)>,
    end: Instant,
}

impl WaitWindow {
    fn new(now: Instant) -> Self {
        Self { entries: VecDeque::from([(now, Duration::ZERO)]), end: now }
    }

    /// Adds what was waited between the last call and this one.
    fn add(&mut self, now: Instant, waited: Duration) {
        match self.entries.back_mut() {
            Some((begun, sum)) if now.duration_since(*begun) < ENTRY => *sum += waited,
            _ => self.entries.push_back((self.end, waited)),
        }
        self.end = now;
        // The oldest entry goes when the others fill the window by themselves.
        while self.entries.get(1).is_some_and(|(begun, _)| now.duration_since(*begun) >= WINDOW) {
            self.entries.pop_front();
        }
    }

    fn waited(&self) -> Duration {
        self.entries.iter().map(|(_, waited)| *waited).sum::<Duration>().min(self.span())
    }

    fn span(&self) -> Duration {
        self.entries.front().map_or(Duration::ZERO, |(begun, _)| self.end.duration_since(*begun))
    }
}

#[cfg(test)]
mod tests {

    use leadtime_certs::{Authority, Role};

    use super::*;

    async fn served() -> LearnerStatus {
        served_with(None, false).await
    }

    async fn served_with(
        certificate: Option<PathBuf>,
        is_certificate_read_once: bool,
    ) -> LearnerStatus {
        let server = StatusServer::bind("127.0.0.1:0".parse().unwrap()).await.unwrap();
        let facts = LearnerFacts {
            run: "r".to_owned(),
            directory: PathBuf::from("."),
            checkpoint_interval: Duration::from_secs(30),
            certificate,
            is_certificate_read_once,
        };
        LearnerStatus::serve(server, facts)
    }

    #[tokio::test]
    async fn the_end_of_a_certificate_is_that_of_the_one_in_use() {
        let directory = tempfile::tempdir().unwrap();
        let now = "2026-01-01T00:00:00Z".parse().unwrap();
        Authority::create(directory.path(), "Test", now).unwrap();
        let mut authority = Authority::open(directory.path(), now).unwrap();
        for (name, days) in [("old", 30), ("new", 60)] {
            let lifetime = Duration::from_hours(24 * days);
            authority.issue(Role::Learner, &name.parse().unwrap(), &[], lifetime, now).unwrap();
        }
        let [old, new] = ["old.pem", "new.pem"].map(|name| directory.path().join(name));
        let ends = [&old, &new].map(|path| machine::certificate_end(path).unwrap());
        let listening = served_with(Some(old.clone()), true).await;
        let dialling = served_with(Some(old.clone()), false).await;
        std::fs::copy(new, old).unwrap();
        for (status, end) in [&listening, &dialling].into_iter().zip(ends) {
            status.shared.metrics().unwrap();
            assert_eq!(status.shared.numbers.get(Metric::CertificateEnd, 0), end);
        }
    }

    #[tokio::test]
    async fn what_cannot_be_saved_is_told_while_updates_wait_for_it_as_well() {
        let status = served().await;
        for (seconds, told) in [(None, 0.0), (Some(90), 90.0), (None, 0.0)] {
            let unsaved = seconds.map(Duration::from_secs);
            let is_paused = unsaved.is_some();
            status.tick(&RunHealth { unsaved, is_paused, ..RunHealth::default() });
            assert_eq!(status.shared.numbers.get(Metric::Unsaved, 0), told);
        }
    }

    fn resumed(books: Books) -> RunEvent {
        let (path, n_updates, n_steps, n_episodes) = (PathBuf::new(), 990, 9_900, 99);
        RunEvent::Resumed { path, n_updates, n_steps, n_episodes, books }
    }

    #[tokio::test]
    async fn a_learner_that_resumes_counts_from_its_start_and_tells_how_far_the_run_is() {
        let mut status = served().await;
        let told = |status: &LearnerStatus, metric| status.shared.numbers.get(metric, 0);
        let mut books = Books::default();
        books.published = 70;
        status.event(&resumed(books.clone()));
        assert_eq!(told(&status, Metric::RunUpdates), 990.0);
        assert!(told(&status, Metric::Updates).is_nan(), "it has made none");
        books.published += 3;
        status.count(9_910, 991, 101, &books);
        for (metric, value) in [
            (Metric::Steps, 10.0),
            (Metric::Updates, 1.0),
            (Metric::Episodes, 2.0),
            (Metric::Books, 3.0),
            (Metric::RunSteps, 9_910.0),
            (Metric::RunUpdates, 991.0),
            (Metric::RunEpisodes, 101.0),
        ] {
            assert_eq!(told(&status, metric), value, "{metric:?}");
        }
        books.duplicates += 2;
        status.count(9_910, 991, 101, &books);
        let duplicates = BOOK_ENTRIES.iter().position(|name| *name == "duplicates").unwrap();
        assert_eq!(status.shared.numbers.get(Metric::Books, duplicates), 2.0);
    }

    #[tokio::test]
    async fn refusals_are_told_without_an_update_and_not_again_after_a_resume() {
        let mut status = served().await;
        let mut books = Books::default();
        books.refuse_without_event(RefusalCause::Protocol, 499);
        status.event(&resumed(books));
        let health = |n| RunHealth {
            refusals: BTreeMap::from([(RefusalCause::Protocol, n)]),
            ..RunHealth::default()
        };
        for (n, told) in [(499, 0), (502, 3)] {
            status.tick(&health(n));
            let page = status.shared.metrics().unwrap();
            let line = format!("leadtime_refusals_total{{run=\"r\",cause=\"protocol\"}} {told}");
            assert!(page.lines().any(|it| it == line), "no `{line}` in\n{page}");
            assert!(!page.contains("leadtime_updates_total"), "{page}");
        }
    }

    #[test]
    fn the_share_of_waiting_is_that_of_the_last_minute() {
        let start = Instant::now();
        let mut window = WaitWindow::new(start);
        // Two minutes of nothing but waiting, then one and a half of updates that wait a quarter of the time.
        for second in 1..=120 {
            window.add(start + Duration::from_secs(second), Duration::from_secs(1));
        }
        assert!(window.waited() >= window.span().mul_f64(0.99));
        for quarter in 1..=360 {
            let now = start + Duration::from_mins(2) + quarter * Duration::from_millis(250);
            window.add(now, Duration::from_micros(62_500));
        }
        let share = window.waited().div_duration_f64(window.span());
        assert!((0.24..0.27).contains(&share), "{share}");
        assert!(window.entries.len() < 130, "{}", window.entries.len());
        assert!((60.0..63.0).contains(&window.span().as_secs_f64()), "{:?}", window.span());
    }
}
