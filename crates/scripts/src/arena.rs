//! Where candidates are tried: the same episodes for all of them, spread over threads.

use std::ops::Range;

use leadtime_episodes::{EpisodeCounter, MakeEnvironment, episode_seed, in_threads};
use leadtime_numerics::Pcg64;
use leadtime_sims::{Environment, Message, TaskError};

use crate::bound::BoundScript;
use crate::error::Error;
use crate::script::Script;

/// An episode of the search that takes longer is given up.
const MAX_STEPS: u64 = 100_000;

/// What one episode gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tried {
    /// 1 for a success, 0 for none, and where the task knows none.
    pub(crate) success: f64,
    /// Sum of raw rewards.
    pub(crate) total_reward: f64,
    pub(crate) n_steps: u64,
}

/// Environments, one per thread, and the episodes that are played in them.
pub(crate) struct Arena<'a> {
    environments: Vec<Box<dyn Environment>>,
    seed: u64,
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Arena<'a> {
    pub(crate) fn new(
        make: &MakeEnvironment<'_>,
        seed: u64,
        n_threads: usize,
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<Self, Error> {
        let made = (0..n_threads.max(1)).map(|_| make());
        let environments = made.collect::<Result<Vec<_>, TaskError>>()?;
        Ok(Self { environments, seed, stop })
    }

    /// Returns one of the environments.
    pub(crate) fn environment(&mut self) -> &mut dyn Environment {
        self.environments[0].as_mut()
    }

    /// Plays episodes with a script and returns what each gave, in order.
    pub(crate) fn play(
        &mut self,
        script: &Script,
        episodes: Range<u64>,
    ) -> Result<Vec<Tried>, Error> {
        let bound = BoundScript::bind(script, self.environments[0].as_ref())?;
        let episodes = EpisodeCounter::new(episodes);
        let (seed, stop) = (self.seed, self.stop);
        let work = |environment: &mut dyn Environment| {
            let mut bound = bound.clone();
            let mut done = Vec::new();
            while let Some(index) = episodes.take() {
                if stop() {
                    return Err(Error::Interrupted);
                }
                done.push((index, try_once(environment, &mut bound, seed, index)?));
            }
            Ok(done)
        };
        let work = &work;
        let environments = self.environments.iter_mut();
        let jobs = environments.map(|environment| move || work(environment.as_mut()));
        in_threads("search", &episodes, jobs, Error::Thread)
    }

    /// Says things at random, and shows `look` the task's numbers in every step; returns what the episodes gave.
    ///
    /// No further episode begins after `n_steps` steps.
    pub(crate) fn babble(
        &mut self,
        chance: f64,
        episodes: Range<u64>,
        n_steps: u64,
        draws: &mut Pcg64,
        mut look: impl FnMut(&[f32], &[f32]),
    ) -> Result<Vec<Tried>, Error> {
        let seed = self.seed;
        let environment = self.environment();
        let task = environment.scriptable().ok_or(Error::NoMessages)?;
        let (messages, n) = (task.messages(), task.quantities().len());
        let (mut now, mut before) = (vec![0.0; n], vec![0.0; n]);
        let mut tried = Vec::new();
        for index in episodes {
            let any = |environment: &dyn Environment, action: &mut [u8]| {
                let Some(task) = environment.scriptable() else { return };
                task.write_quantities(&mut now, &mut before);
                look(&now, &before);
                let speaks = task.may_start() && draws.unit() < chance;
                let any: Option<Message> = speaks.then(|| messages[draws.below(messages.len())]);
                task.write_action(any, action);
            };
            tried.push(play_once(environment, seed, index, any)?);
            if tried.iter().map(|tried| tried.n_steps).sum::<u64>() >= n_steps {
                break;
            }
        }
        Ok(tried)
    }
}

fn try_once(
    environment: &mut dyn Environment,
    script: &mut BoundScript,
    seed: u64,
    index: u64,
) -> Result<Tried, Error> {
    let mut quiet = 0.0;
    let act = |environment: &dyn Environment, action: &mut [u8]| {
        script.act(environment, &mut quiet, action);
    };
    play_once(environment, seed, index, act)
}

/// Plays one whole episode.
fn play_once(
    environment: &mut dyn Environment,
    seed: u64,
    index: u64,
    mut act: impl FnMut(&dyn Environment, &mut [u8]),
) -> Result<Tried, Error> {
    let spec = environment.spec();
    let mut observation = vec![0.0; spec.obs_dim];
    let mut action = vec![0; spec.actions.heads.len()];
    environment.reset(episode_seed(seed, index), &mut observation);
    let (mut total_reward, mut n_steps) = (0.0, 0);
    loop {
        act(environment, &mut action);
        let outcome = environment.step(&action, &mut observation);
        total_reward += f64::from(outcome.reward);
        n_steps += 1;
        if outcome.end.is_some() {
            return Ok(Tried { success: success(environment), total_reward, n_steps });
        }
        if n_steps >= MAX_STEPS {
            return Err(Error::Endless { index, n_steps });
        }
    }
}

/// Returns the metric `success` of the episode so far; 0 where there is none.
pub(crate) fn success(environment: &dyn Environment) -> f64 {
    let names = &environment.spec().metrics;
    let mut metrics = vec![0.0; names.len()];
    environment.metrics(&mut metrics);
    let place = names.iter().position(|name| name == "success");
    place.map_or(0.0, |place| f64::from(metrics[place]))
}
