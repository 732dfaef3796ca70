//! A clairvoyant notifier: it tries messages on the episode itself, and says what works.
//!
//! At the start of an episode it lets each of its *bases* (scripts, and silence) play on to the end in the environment, which
//! it then restores. If one succeeds, it does as that one. Otherwise it takes the most promising failure, in turn with the
//! oldest one, goes back from its end, says something else at each moment where a message may start, and lets the base play on
//! from there; what comes of that is a new failure to mend, or a success. An attempt ends where it is lost: a zone entered, a
//! deadline missed. The oracle ends with the first successes, or after [`MAX_STEPS`] tried steps with the failure of the
//! highest return.
//!
//! It sees what no notifier can: the listener, their delays, and every random draw to come. Its success is therefore a mark
//! that a policy may not reach. It is a search with a limit, and so no proof of what is impossible.
//!
//! ```text
//! base   ────s────s────s────✗          the end of a failure
//!                      └─m──s────✗     go back, say m, let the base play on
//!                 └─m'─s────s────s─✓   farther back: done
//! ```
//!
//! # Invariants
//!
//! * In an episode in which a base succeeds, the oracle succeeds.
//! * The slot's environment is as it was before: planning changes no bit of the episode.

use std::error::Error as StdError;
use std::rc::Rc;

use leadtime_episodes::{EnvSlot, Error as PlayError, Scripted};
use leadtime_sims::{Environment, EpisodeSeed, Message, Scriptable};

use crate::arena::success;
use crate::bound::BoundScript;
use crate::error::Error;
use crate::script::Script;

/// Steps that may be tried for one episode.
const MAX_STEPS: u64 = 60_000;
/// Moments of a failure that are tried before another failure gets its turn.
const MOMENTS: usize = 3;
/// An episode of which no end is seen is given up after so many steps.
const MAX_LENGTH: usize = 10_000;

/// What plays on after the oracle's messages.
#[derive(Clone, Debug, PartialEq)]
pub enum OracleBase {
    /// One of the task's own scripts, by name.
    Named(String),
    /// A script as data.
    Script(Script),
}

/// A player that plans each episode on the episode itself.
#[derive(Clone, Debug)]
pub struct Oracle {
    bases: Vec<OracleBase>,
    /// The actions of the episodes that are being played.
    plans: Vec<EpisodePlan>,
}

#[derive(Clone, Debug)]
struct EpisodePlan {
    seed: EpisodeSeed,
    /// The step of its first action.
    begun: usize,
    actions: Vec<Vec<u8>>,
}

impl Oracle {
    /// Makes an oracle that mends what these do; silence is always one of them.
    pub fn new(bases: Vec<OracleBase>) -> Self {
        Self { bases, plans: Vec::new() }
    }

    /// Finds what to do from here to the episode's end.
    fn plan(&self, environment: &mut dyn Environment, observation: &mut [f32]) -> Vec<Vec<u8>> {
        let mut state = Vec::new();
        environment.write_state(&mut state);
        let mut planner = Planner::new(&self.bases, environment, observation);
        planner.play_bases(&Opening { step: 0, total_reward: 0.0, state: state.as_slice().into() });
        planner.mend();
        let best = planner.best();
        // What was written can be read.
        let restored = environment.read_state(&state, observation);
        debug_assert!(restored.is_ok(), "an environment reads its own state");
        best
    }
}

impl Scripted for Oracle {
    fn check(&self, environment: &dyn Environment) -> Result<(), Box<dyn StdError + Send + Sync>> {
        environment.scriptable().ok_or(Error::NoMessages)?;
        for base in &self.bases {
            match base {
                OracleBase::Named(name) => {
                    let known = environment.baselines();
                    if !known.contains(&name.as_str()) {
                        return Err(PlayError::UnknownBaseline { name: name.clone(), known }.into());
                    }
                }
                OracleBase::Script(script) => drop(BoundScript::bind(script, environment)?),
            }
        }
        Ok(())
    }

    fn choose(&mut self, slot: &mut EnvSlot, choices: &mut [u8]) {
        let (seed, n_steps) = (slot.seed(), slot.n_steps() as usize);
        if n_steps == 0 {
            self.plans.retain(|plan| plan.seed != seed);
        }
        if !self.plans.iter().any(|plan| plan.seed == seed) {
            let (environment, observation) = slot.env_mut();
            let actions = self.plan(environment, observation);
            self.plans.push(EpisodePlan { seed, begun: n_steps, actions });
        }
        choices.fill(0);
        let Some(plan) = self.plans.iter_mut().find(|plan| plan.seed == seed) else { return };
        // A plan ends with the episode, or where that is lost: then it keeps silent.
        match plan.actions.get(n_steps - plan.begun) {
            Some(action) => choices.copy_from_slice(action),
            None => plan.actions = Vec::new(),
        }
    }

    fn copy(&self) -> Box<dyn Scripted> {
        Box::new(Self::new(self.bases.clone()))
    }
}

/// A base that can act.
#[derive(Clone, Debug)]
enum Acting {
    Silent,
    Named(String),
    Script(BoundScript),
}

impl Acting {
    fn act(&mut self, environment: &dyn Environment, quiet: &mut f32, action: &mut [u8]) {
        match self {
            Self::Silent => action.fill(0),
            Self::Named(name) => {
                if !environment.baseline_action(name, action) {
                    action.fill(0);
                }
            }
            Self::Script(script) => script.act(environment, quiet, action),
        }
    }
}

/// A moment in which a message might start, and may be another one.
#[derive(Clone, Debug)]
struct Opening {
    /// The step that comes next.
    step: usize,
    /// Sum of the rewards before it.
    total_reward: f64,
    state: Rc<[u8]>,
}

/// An episode that was tried to its end, or until it was lost.
#[derive(Clone, Debug)]
struct Attempt {
    /// Index of the base that played on.
    base: usize,
    /// Where it left the attempt that it varies.
    begun: Opening,
    /// Its first action there was not the base's.
    is_varied: bool,
    actions: Vec<Vec<u8>>,
    success: f64,
    total_reward: f64,
    /// Moments that have not been tried yet; the last one comes first. `None` until the attempt's turn comes.
    moments: Option<Vec<Opening>>,
}

impl Attempt {
    /// Returns whether there is something left to vary.
    fn is_open(&self) -> bool {
        self.moments.as_ref().is_none_or(|moments| !moments.is_empty())
    }
}

/// Tries actions in an environment.
struct Planner<'a> {
    environment: &'a mut dyn Environment,
    observation: &'a mut [f32],
    bases: Vec<Acting>,
    /// What may be said instead.
    options: Vec<Message>,
    n_heads: usize,
    attempts: Vec<Attempt>,
    n_steps: u64,
}

impl<'a> Planner<'a> {
    fn new(
        bases: &[OracleBase],
        environment: &'a mut dyn Environment,
        observation: &'a mut [f32],
    ) -> Self {
        let bind = |base: &OracleBase| match base {
            OracleBase::Named(name) => Some(Acting::Named(name.clone())),
            OracleBase::Script(script) => {
                BoundScript::bind(script, environment).ok().map(Acting::Script)
            }
        };
        let bases = bases.iter().filter_map(bind).chain([Acting::Silent]).collect();
        let options = environment.scriptable().map(|task| shortest(&task.messages()));
        let options = options.unwrap_or_default();
        let n_heads = environment.spec().actions.heads.len();
        Self { environment, observation, bases, options, n_heads, attempts: Vec::new(), n_steps: 0 }
    }

    fn play_bases(&mut self, begun: &Opening) {
        for base in 0..self.bases.len() {
            self.attempt(base, begun, &[], None);
        }
    }

    /// Mends failures until one attempt succeeds, or the steps are used up.
    fn mend(&mut self) {
        let mut is_patient = false;
        while self.n_steps < MAX_STEPS && !self.attempts.iter().any(|it| it.success > 0.0) {
            let mut open = self.attempts.iter().enumerate().filter(|(_, it)| it.is_open());
            let by_return = |(_, a): &(usize, &Attempt), (_, b): &(usize, &Attempt)| {
                a.total_reward.total_cmp(&b.total_reward)
            };
            // In turn with the oldest one: where the return misleads, everything small is tried all the same.
            let promising = if is_patient { open.next() } else { open.max_by(by_return) };
            let Some((promising, _)) = promising else { return };
            is_patient = !is_patient;
            let mut moments = match self.attempts[promising].moments.take() {
                Some(moments) => moments,
                None => self.moments_of(promising),
            };
            let turn = moments.split_off(moments.len().saturating_sub(MOMENTS));
            self.attempts[promising].moments = Some(moments);
            for moment in turn.iter().rev() {
                self.vary(promising, moment);
            }
        }
    }

    /// Plays an attempt once more, and keeps the moments in which a message may start, after its own variation.
    fn moments_of(&mut self, of: usize) -> Vec<Opening> {
        let Attempt { begun, actions, .. } = self.attempts[of].clone();
        let mut moments = Vec::new();
        if self.environment.read_state(&begun.state, self.observation).is_err() {
            return moments;
        }
        let mut total_reward = begun.total_reward;
        let is_varied = self.attempts[of].is_varied;
        for (step, action) in actions.iter().enumerate().skip(begun.step) {
            let may_start = self.environment.scriptable().is_some_and(Scriptable::may_start);
            if may_start && (step > begun.step || !is_varied) {
                let mut state = Vec::new();
                self.environment.write_state(&mut state);
                moments.push(Opening { step, total_reward, state: state.into() });
            }
            total_reward += f64::from(self.environment.step(action, self.observation).reward);
            self.n_steps += 1;
        }
        moments
    }

    /// Says everything else at a moment of an attempt, silence included.
    fn vary(&mut self, of: usize, moment: &Opening) {
        let (base, actions) = (self.attempts[of].base, self.attempts[of].actions.clone());
        let messages = self.options.clone().into_iter().map(Some).chain([None]);
        for message in messages {
            let mut action = vec![0; self.n_heads];
            if let Some(task) = self.environment.scriptable() {
                task.write_action(message, &mut action);
            }
            if action != actions[moment.step] {
                self.attempt(base, moment, &actions[..moment.step], Some(action));
            }
        }
    }

    /// Goes to a moment, acts, and lets a base play on to the end.
    fn attempt(
        &mut self,
        base: usize,
        begun: &Opening,
        before: &[Vec<u8>],
        first: Option<Vec<u8>>,
    ) {
        if self.environment.read_state(&begun.state, self.observation).is_err() {
            return;
        }
        let is_varied = first.is_some();
        let (mut actions, mut next) = (before.to_vec(), first);
        let (mut total_reward, mut quiet) = (begun.total_reward, 0.0);
        loop {
            let action = next.take().unwrap_or_else(|| {
                let mut action = vec![0; self.n_heads];
                self.bases[base].act(self.environment, &mut quiet, &mut action);
                action
            });
            let outcome = self.environment.step(&action, self.observation);
            actions.push(action);
            total_reward += f64::from(outcome.reward);
            self.n_steps += 1;
            let is_lost = self.environment.scriptable().is_some_and(Scriptable::is_lost);
            if outcome.end.is_some() || is_lost || actions.len() >= MAX_LENGTH {
                break;
            }
        }
        let (begun, success) = (begun.clone(), success(self.environment));
        let attempt =
            Attempt { base, begun, is_varied, actions, success, total_reward, moments: None };
        self.attempts.push(attempt);
    }

    /// Returns the actions of the best attempt: by success, then by return, then the earlier one.
    fn best(self) -> Vec<Vec<u8>> {
        let key = |it: &Attempt| (it.success, it.total_reward);
        let mut best: Option<Attempt> = None;
        for attempt in self.attempts {
            if best.as_ref().is_none_or(|best| key(&attempt) > key(best)) {
                best = Some(attempt);
            }
        }
        best.map(|best| best.actions).unwrap_or_default()
    }
}

/// Keeps of the messages with one topic and length the one that is understood first: a later k only delays, and a later start
/// does that too.
fn shortest(messages: &[Message]) -> Vec<Message> {
    let mut kept: Vec<Message> = Vec::new();
    for &message in messages {
        let same =
            |it: &&mut Message| (it.topic, it.conveyance) == (message.topic, message.conveyance);
        match kept.iter_mut().find(same) {
            Some(known) => known.comprehension = known.comprehension.min(message.comprehension),
            None => kept.push(message),
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use leadtime_episodes::Player;

    use super::*;
    use crate::bound::ScriptPlayer;
    use crate::test_support::{played, share};

    /// It is right for some edges only.
    const TIMED: &str = "[[rules]]\nsay = { topic = \"stop\", k = 2, l = 2 }\nwhen = [{ of = \"walked\", above = 9.0 }]";

    fn timed() -> Script {
        Script::read(TIMED).unwrap()
    }

    fn oracle(bases: Vec<OracleBase>) -> Player {
        Player::scripted("oracle", Box::new(Oracle::new(bases)))
    }

    #[test]
    fn an_oracle_mends_what_fails_and_leaves_what_succeeds_as_it_is() {
        let base = played(&Player::scripted("base", Box::new(ScriptPlayer::new(timed()))), 60, 5);
        let mended = played(&oracle(vec![OracleBase::Script(timed())]), 60, 5);
        assert!((0.2..0.8).contains(&share(&base)), "{}", share(&base));
        assert_eq!(share(&mended), 1.0);
        for (base, mended) in base.iter().zip(&mended).filter(|(base, _)| base[0] > 0.0) {
            // Planning has changed nothing, so the same actions give the same episode, its random delays included.
            assert_eq!(base, mended);
        }
    }

    #[test]
    fn an_oracle_without_a_base_starts_from_silence() {
        assert_eq!(share(&played(&oracle(vec![]), 30, 5)), 1.0);
        let named = OracleBase::Named("unaided".to_owned());
        assert_eq!(share(&played(&oracle(vec![named]), 30, 5)), 1.0);
    }

    #[test]
    fn an_oracle_refuses_what_the_task_does_not_have() {
        let environment = crate::test_support::cliff().unwrap();
        let oracle = Oracle::new(vec![OracleBase::Named("heuristic".to_owned())]);
        let error = oracle.check(environment.as_ref()).unwrap_err().to_string();
        assert!(error.contains("no scripted player `heuristic`"), "{error}");
    }
}
