//! Playing many whole episodes, several at a time.
//!
//! Episode i does not depend on the episodes played at the same time: its world, listener and action draws come from
//! streams named by (seed, i). So neither the number of slots nor that of threads changes a result, and two players
//! meet the same worlds.

use std::iter::repeat_n;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::{fmt, io};

use leadtime_numerics::Purpose;
use leadtime_proto::EnvId;
use leadtime_sims::{End, Environment, EpisodeSeed, TaskError};

use crate::error::Error;
use crate::lockstep::{Lockstep, Observer};
use crate::player::Player;
use crate::slot::EnvSlot;

/// Makes one more environment of the task.
pub type MakeEnvironment<'a> = dyn Fn() -> Result<Box<dyn Environment>, TaskError> + Sync + 'a;

/// Which episodes are played, and how.
#[derive(Clone, Copy)]
pub struct PlaySettings<'a> {
    /// Index of the first episode.
    pub first: u64,
    /// Number of episodes, from `first` on.
    pub n_episodes: u64,
    /// Seed of the evaluation; part of every stream's name.
    pub seed: u64,
    /// Episodes played side by side in a thread, so that a network sees batches.
    pub n_slots: usize,
    /// Threads; the results do not depend on it.
    pub n_threads: usize,
    /// An episode that takes longer is reported as endless.
    pub max_steps: u64,
    /// Asked before every step whether to end the playing with [`Error::Interrupted`].
    pub stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

impl fmt::Debug for PlaySettings<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, n_episodes, seed, .. } = self;
        write!(f, "PlaySettings({n_episodes} episodes of seed {seed} from {first})")
    }
}

impl<'a> PlaySettings<'a> {
    /// Plans the first `n_episodes` of a seed on one thread.
    pub fn new(n_episodes: u64, seed: u64) -> Self {
        Self {
            first: 0,
            n_episodes,
            seed,
            n_slots: 16,
            n_threads: 1,
            max_steps: 100_000,
            stop: None,
        }
    }

    /// Spreads the work over threads.
    pub fn threads(self, n_threads: usize) -> Self {
        Self { n_threads, ..self }
    }

    /// Ends the playing early once the function returns true.
    pub fn stopped_by(self, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self { stop: Some(stop), ..self }
    }
}

/// Watches one whole episode.
pub trait EpisodeObserver: Observer {
    /// What it makes of the episode.
    type Output: Send;

    /// The episode has ended; the slot holds its final observation.
    fn finish(self, slot: &EnvSlot, end: End) -> Self::Output;
}

impl EpisodeObserver for () {
    type Output = ();

    fn finish(self, _slot: &EnvSlot, _end: End) {}
}

impl<A: EpisodeObserver, B: EpisodeObserver> EpisodeObserver for (A, B) {
    type Output = (A::Output, B::Output);

    fn finish(self, slot: &EnvSlot, end: End) -> Self::Output {
        (self.0.finish(slot, end), self.1.finish(slot, end))
    }
}

/// Names the streams of the `index`-th episode of an evaluation.
///
/// Every episode is the first one of an environment of its own, so that a task which varies by environment shows
/// all its variants.
pub fn episode_seed(seed: u64, index: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: seed, env_id: EnvId(index as u32), episode: index >> 32 }
}

/// Plays episodes, each under an observer of its own, and returns what the observers made of them, in order.
///
/// # Errors
///
/// [`Error::Task`] if an environment cannot be made, [`Error::PolicyShape`] or [`Error::UnknownBaseline`] if the
/// player cannot play it, [`Error::Endless`] if an episode does not end, [`Error::Outside`] if an environment in another
/// process has failed, [`Error::Interrupted`] if it was stopped.
pub fn play<O: EpisodeObserver>(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &PlaySettings<'_>,
    observe: impl Fn(u64) -> O + Sync,
) -> Result<Vec<O::Output>, Error> {
    player.check(make()?.as_ref())?;
    let episodes = EpisodeCounter::new(settings.first..settings.first + settings.n_episodes);
    let work = || Shift::new(player, settings, &episodes).run(make, &observe);
    let n_threads = settings.n_threads.min(settings.n_episodes as usize).max(1);
    in_threads("evaluate", &episodes, repeat_n(work, n_threads), Error::Thread)
}

/// Hands the indices of episodes to threads, each once.
#[derive(Debug)]
pub struct EpisodeCounter {
    next: AtomicU64,
    end: u64,
}

impl EpisodeCounter {
    /// Makes a counter that hands out these indices.
    pub fn new(episodes: Range<u64>) -> Self {
        Self { next: AtomicU64::new(episodes.start), end: episodes.end }
    }

    /// Takes the index of an episode that no thread plays yet; `None` if there are no more.
    pub fn take(&self) -> Option<u64> {
        let index = self.next.fetch_add(1, Ordering::Relaxed);
        (index < self.end).then_some(index)
    }

    /// Passes on how something went; after a failure no more indices are handed out.
    fn unless_failed<T, E>(&self, found: Result<T, E>) -> Result<T, E> {
        if found.is_err() {
            // Nobody gets what the other threads would still find, and nobody hears of the failure before they end.
            self.next.store(self.end, Ordering::Relaxed);
        }
        found
    }
}

/// What episodes gave, with their indices.
type Indexed<T> = Vec<(u64, T)>;

/// Does jobs side by side, the last one in this thread, and returns what all of them found, sorted by its index.
///
/// The jobs take their indices from `episodes`, which hands out no more once one of them has failed.
///
/// # Errors
///
/// That of a job, or of a thread that cannot be started.
pub fn in_threads<T, E, J>(
    name: &str,
    episodes: &EpisodeCounter,
    jobs: impl IntoIterator<Item = J>,
    not_started: impl Fn(io::Error) -> E,
) -> Result<Vec<T>, E>
where
    T: Send,
    E: Send,
    J: FnOnce() -> Result<Vec<(u64, T)>, E> + Send,
{
    let mut jobs: Vec<J> = jobs.into_iter().collect();
    let last = jobs.pop();
    let mut done = thread::scope(|scope| {
        let start = |(i, job): (usize, J)| {
            let thread = thread::Builder::new().name(format!("{name}-{i}"));
            let thread = thread.spawn_scoped(scope, move || episodes.unless_failed(job()));
            episodes.unless_failed(thread).map_err(&not_started)
        };
        let threads = jobs.into_iter().enumerate().map(start).collect::<Result<Vec<_>, E>>()?;
        let mut all = last.map_or_else(|| Ok(Vec::new()), |job| episodes.unless_failed(job()))?;
        for thread in threads {
            // A panic in a thread is a bug; it goes on in the caller.
            let part = thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            all.extend(part?);
        }
        Ok::<_, E>(all)
    })?;
    done.sort_unstable_by_key(|(index, _)| *index);
    Ok(done.into_iter().map(|(_, found)| found).collect())
}

/// One thread's part: episodes from a shared counter, until there are no more.
struct Shift<'a, O: EpisodeObserver> {
    settings: &'a PlaySettings<'a>,
    episodes: &'a EpisodeCounter,
    player: Player,
    lockstep: Lockstep,
    slots: Vec<EnvSlot>,
    /// One for each slot.
    observers: Vec<O>,
    /// The episode in each slot.
    indices: Vec<u64>,
    done: Indexed<O::Output>,
}

impl<'a, O: EpisodeObserver> Shift<'a, O> {
    fn new(player: &Player, settings: &'a PlaySettings<'a>, episodes: &'a EpisodeCounter) -> Self {
        Self {
            settings,
            episodes,
            player: player.clone(),
            lockstep: Lockstep::default(),
            slots: Vec::new(),
            observers: Vec::new(),
            indices: Vec::new(),
            done: Vec::new(),
        }
    }

    fn run(
        mut self,
        make: &MakeEnvironment<'_>,
        observe: &impl Fn(u64) -> O,
    ) -> Result<Indexed<O::Output>, Error> {
        while self.slots.len() < self.settings.n_slots.max(1) {
            let Some(index) = self.episodes.take() else { break };
            let seed = episode_seed(self.settings.seed, index);
            let mut slot = EnvSlot::new(make()?, self.player.recurrent_dim(), seed);
            slot.draw_from(seed.stream(Purpose::Act));
            let mut observer = observe(index);
            observer.on_reset(&slot);
            self.slots.push(slot);
            self.observers.push(observer);
            self.indices.push(index);
        }
        while !self.slots.is_empty() {
            if self.settings.stop.is_some_and(|stop| stop()) {
                return Err(Error::Interrupted);
            }
            self.lockstep.act(&mut self.player.decider(), &mut self.slots, &mut self.observers);
            self.lockstep.advance(&mut self.slots, &mut self.observers);
            self.check_failures()?;
            let n_ended = self.lockstep.ended().len();
            // From the back, so that removing a slot leaves the slots before it in place.
            for i in (0..n_ended).rev() {
                let (row, end) = self.lockstep.ended()[i];
                self.replace(row, end, observe);
            }
            self.check_lengths()?;
        }
        Ok(self.done)
    }

    /// Finishes the episode of a slot, which takes another one or goes.
    fn replace(&mut self, row: usize, end: End, observe: &impl Fn(u64) -> O) {
        let Some(index) = self.episodes.take() else {
            let slot = self.slots.remove(row);
            let output = self.observers.remove(row).finish(&slot, end);
            self.done.push((self.indices.remove(row), output));
            return;
        };
        let slot = &mut self.slots[row];
        let observer = std::mem::replace(&mut self.observers[row], observe(index));
        let output = observer.finish(slot, end);
        self.done.push((std::mem::replace(&mut self.indices[row], index), output));
        let seed = episode_seed(self.settings.seed, index);
        slot.begin(seed);
        slot.draw_from(seed.stream(Purpose::Act));
        self.observers[row].on_reset(slot);
    }

    /// Looks at the episodes that have ended: those of an environment that has failed end at once.
    fn check_failures(&self) -> Result<(), Error> {
        for (row, _) in self.lockstep.ended() {
            if let Some(reason) = self.slots[*row].env.failure() {
                return Err(Error::Outside { index: self.indices[*row], reason });
            }
        }
        Ok(())
    }

    fn check_lengths(&self) -> Result<(), Error> {
        let n_steps = self.settings.max_steps;
        match self.slots.iter().position(|slot| u64::from(slot.n_steps()) >= n_steps) {
            Some(row) => Err(Error::Endless { index: self.indices[row], n_steps }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Barrier};

    use leadtime_proto::{ActionSpec, EnvSpec};
    use leadtime_sims::{SnapshotError, StepOutcome};

    use super::*;

    /// Plays the first episode without an end and all others in one step, the second not before the first was given up.
    struct Uneven {
        spec: EnvSpec,
        is_endless: bool,
        n_begun: Arc<AtomicU64>,
        given_up: Option<Arc<Barrier>>,
    }

    impl Uneven {
        fn wait(&mut self) {
            if let Some(given_up) = self.given_up.take() {
                given_up.wait();
            }
        }
    }

    impl Environment for Uneven {
        fn spec(&self) -> &EnvSpec {
            &self.spec
        }

        fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
            observation.fill(0.0);
            self.n_begun.fetch_add(1, Ordering::Relaxed);
            self.is_endless = seed.env_id == EnvId(0);
            if !self.is_endless {
                self.wait();
            }
        }

        fn step(&mut self, _action: &[u8], observation: &mut [f32]) -> StepOutcome {
            observation.fill(0.0);
            StepOutcome { reward: 0.0, end: (!self.is_endless).then_some(End::Terminated) }
        }

        fn metrics(&self, _out: &mut [f32]) {}

        fn write_state(&self, _out: &mut Vec<u8>) {}

        fn read_state(&mut self, _: &[u8], _: &mut [f32]) -> Result<(), SnapshotError> {
            Ok(())
        }

        fn baselines(&self) -> &'static [&'static str] {
            &["unaided"]
        }

        fn baseline_action(&self, _name: &str, action: &mut [u8]) -> bool {
            action.fill(0);
            true
        }
    }

    impl Drop for Uneven {
        fn drop(&mut self) {
            if self.is_endless {
                self.wait();
            }
        }
    }

    #[test]
    fn a_failure_in_one_thread_keeps_the_others_from_what_is_left() {
        const N_EPISODES: u64 = 20_000_000;
        let (n_begun, given_up) = (Arc::new(AtomicU64::new(0)), Arc::new(Barrier::new(2)));
        let make = || -> Result<Box<dyn Environment>, TaskError> {
            let actions = ActionSpec::discrete("action", 2);
            let spec = EnvSpec { obs_dim: 1, actions, metrics: Vec::new() };
            let (n_begun, given_up) = (Arc::clone(&n_begun), Some(Arc::clone(&given_up)));
            Ok(Box::new(Uneven { spec, is_endless: false, n_begun, given_up }))
        };
        let settings = PlaySettings::new(N_EPISODES, 1).threads(2);
        let settings = PlaySettings { n_slots: 1, max_steps: 3, ..settings };
        let error = play(&make, &Player::baseline("unaided"), &settings, |_| ()).unwrap_err();
        assert!(matches!(error, Error::Endless { index: 0, n_steps: 3 }), "{error}");
        // The other thread may have begun some more before it hears of the failure.
        let n_begun = n_begun.load(Ordering::Relaxed);
        assert!(n_begun < N_EPISODES, "{n_begun} episodes were begun");
    }
}
