//! What the notifier environment needs of a world.
//!
//! A domain is a world with a listener in it who follows a plan of their own. It knows nothing of words, delays,
//! interruptions or notifiers: those are the [`human`](crate::human) model's and the notifier environment's. It
//! receives, step by step, the reaction (if any) that the listener carries out, and every fully delivered message.
//!
//! | | lander | highway | steakhouse |
//! |---|---|---|---|
//! | unaided listener | trained pilot | IDM + MOBIL | tiered cook on beliefs |
//! | reaction acts | every frame | once (lane) or every step (speed) | every step |
//! | reaction may be refused | leg on the ground, low | impossible lane change | - |
//! | world ends reaction | - | - | blocked move |
//! | plan invalid after it | no | no | yes |
//! | full delivery discloses | - | - | true station states |
//! | observation | fixed vector | entities with presence flags | fixed vector |

use crate::description::{Quantity, RewardTerm};
use crate::environment::{End, Entities, EpisodeSeed, SnapshotError};
use crate::fact::Fact;
use crate::message::{Message, ReactionStatus, ReactionStep};
use crate::scene::Scene;

/// The result of one step of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Advance {
    /// The domain's reward for the step, without the cost of messages.
    pub reward: f64,
    /// How the reaction went, if one was asked for.
    pub reaction: Option<ReactionStatus>,
    /// The end of the episode, if the world ended it (time limits included).
    pub end: Option<End>,
}

/// The effect of a fully delivered message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Delivery {
    /// A reaction that ran before is off: the listener re-plans with what they now know.
    pub cancels_reaction: bool,
}

/// A world with a listener in it.
///
/// # When what is called
///
/// | | calls, in this order |
/// |---|---|
/// | start of an episode | `reset`, `observe` |
/// | each step, of one word | `reaction_over` if a reaction was cut short, `started` if a message starts, `advance`, `reaction_over` and `deliver` where they are due, `observe`; then `metrics` and `success` |
/// | for the mask, a script, a picture, a sentence | `script`, `observe_for_scripts`, `observe_facts` and `scene`: at any moment, in any number, and perhaps never; they must change nothing |
/// | when a rollout is sent | `snapshot`, which must change nothing either |
/// | when a process has died | `restore`, into a world that may be in the middle of another episode; no `reset` and no `observe` before the next `advance` |
///
/// # Ranges
///
/// *Observations* are best within about -1 to 1 and must be finite: the networks see them as they are, unless
/// `policy.normalize_observations` is set. All `obs_dim` places are written by every call.
///
/// *Rewards* must be finite. Their scale decides with `learner.reward_scale` how fast a policy learns (a discounted return of
/// 1 to 10 in size is what the settings were tried with), and a message costs `notifier.initiation_cost` of them, 1 unless the
/// world says otherwise.
///
/// # The same bits again
///
/// What happens depends on the seed of `reset`, on the reactions and on nothing else, and a snapshot holds all of it. Keep
/// everything that changes in an episode in one struct that is written and read as a whole; what is forgotten shows only when a
/// process is killed. [`check_environment`](crate::env_check::check_environment) (`leadtime check`) finds it.
///
/// # Example
///
/// A walker who is to stop after a number of steps that only the notifier sees.
///
/// ```
/// use leadtime_numerics::Purpose;
/// use leadtime_sims::env_check::check_environment;
/// use leadtime_sims::environment::{read_snapshot, write_snapshot};
/// use leadtime_sims::human::HumanSettings;
/// use leadtime_sims::notifier::NotifierSettings;
/// use leadtime_sims::{
///     Advance, Domain, End, EpisodeSeed, NotifierEnv, ReactionStatus, ReactionStep, Scene, SnapshotError,
/// };
/// use serde::{Deserialize, Serialize};
///
/// #[derive(Default, Serialize, Deserialize)]
/// struct Walk {
///     n_steps: u32,
///     edge: u32,
///     stopped: bool,
/// }
///
/// #[derive(Default)]
/// struct Cliff {
///     walk: Walk,
/// }
///
/// impl Domain for Cliff {
///     fn topics(&self) -> &[&'static str] {
///         &["stop"]
///     }
///
///     fn obs_dim(&self) -> usize {
///         1
///     }
///
///     fn reset(&mut self, seed: EpisodeSeed) {
///         let edge = 10 + seed.stream(Purpose::World).below(10) as u32;
///         self.walk = Walk { edge, ..Walk::default() };
///     }
///
///     fn observe(&self, out: &mut [f32]) {
///         out[0] = (self.walk.edge - self.walk.n_steps) as f32 / 20.0;
///     }
///
///     fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
///         self.walk.stopped |= reaction.is_some();
///         self.walk.n_steps += 1;
///         let at_edge = self.walk.n_steps == self.walk.edge;
///         let reward = match (self.walk.stopped, at_edge) {
///             // The nearer to the edge, the better.
///             (true, _) => f64::from(self.walk.n_steps) / f64::from(self.walk.edge),
///             (false, true) => -1.0,
///             (false, false) => 0.0,
///         };
///         let end = (self.walk.stopped || at_edge).then_some(End::Terminated);
///         Advance { reward, reaction: reaction.map(|_| ReactionStatus::Followed), end }
///     }
///
///     fn success(&self) -> bool {
///         self.walk.stopped
///     }
///
///     fn metric_names(&self) -> &'static [&'static str] {
///         &["steps_left"]
///     }
///
///     fn metrics(&self, out: &mut [f32]) {
///         out[0] = (self.walk.edge - self.walk.n_steps) as f32;
///     }
///
///     fn snapshot(&self, out: &mut Vec<u8>) {
///         write_snapshot(&self.walk, out);
///     }
///
///     fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
///         self.walk = read_snapshot(snapshot)?;
///         Ok(())
///     }
///
///     fn scene(&self) -> Scene {
///         Scene::default()
///     }
/// }
///
/// let notifier = NotifierSettings { initiation_cost: 0.02, ..NotifierSettings::default() };
/// let build = || Ok(Box::new(NotifierEnv::new(Cliff::default(), &HumanSettings::default(), &notifier)?) as _);
/// let report = check_environment(build)?;
/// assert!(report.defects.is_empty() && report.rewards.notice().is_none());
/// # Ok::<(), leadtime_sims::TaskError>(())
/// ```
pub trait Domain: Send {
    /// Names the topics, in the order of their ids.
    fn topics(&self) -> &[&'static str];

    /// Returns whether a topic asks for an action. One that does not only informs: it leaves no reaction behind, and
    /// works when it is [delivered](Domain::deliver).
    fn asks_for_action(&self, _topic: usize) -> bool {
        true
    }

    /// Returns the length of the domain's own observation.
    fn obs_dim(&self) -> usize;

    /// Says what each number of the domain's own observation is. Shape `[obs_dim]`.
    fn quantities(&self) -> Vec<Quantity> {
        Quantity::unnamed(self.obs_dim())
    }

    /// Lists the parts of the domain's reward, for people.
    fn reward_terms(&self) -> Vec<RewardTerm> {
        Vec::new()
    }

    /// Says how the observation consists of entities, if it does.
    fn entities(&self) -> Option<Entities> {
        None
    }

    /// Starts an episode; nothing of the previous one may remain.
    fn reset(&mut self, seed: EpisodeSeed);

    /// Writes the domain's observation, every place of it: after `reset` and after every `advance`. Shape `[obs_dim]`.
    fn observe(&self, out: &mut [f32]);

    /// Advances the world by one step (one word): the listener reacts, or acts by their own plan.
    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance;

    /// Returns which danger the listener faces now, counted from 0: what one of the notifier's reasons would be about.
    /// A reason that the listener was given for a danger is not paid again
    /// ([`Human::acted`](crate::human::Human::acted)).
    fn danger(&self) -> usize {
        0
    }

    /// Called when a reaction is over (run out, replaced or cancelled): a plan made before it may be invalid.
    fn reaction_over(&mut self) {}

    /// Called when a message has started: a scripted notifier may wait for its effect.
    fn started(&mut self, _message: Message) {}

    /// Called when a message was heard to its end; returns its effect.
    fn deliver(&mut self, _message: Message) -> Delivery {
        Delivery::default()
    }

    /// Returns the message that the domain's scripted notifier would start now, if any.
    fn heuristic(&self) -> Option<Message> {
        None
    }

    /// Names the scripted notifiers that the world's own notifier is compared with: `unaided` says nothing, `heuristic`
    /// is [`Domain::heuristic`].
    fn scripts(&self) -> &'static [&'static str] {
        &["unaided", "heuristic"]
    }

    /// Returns the message that one of them would start now, if any.
    fn script(&self, name: &str) -> Option<Message> {
        (name == "heuristic").then(|| self.heuristic()).flatten()
    }

    /// Says what a script may look at besides the observation, such as the time to the next merge: numbers that a
    /// person who writes rules would want, and a network would not need.
    fn script_quantities(&self) -> Vec<Quantity> {
        Vec::new()
    }

    /// Writes them, at any moment of an episode. Shape `[script_quantities().len()]`.
    fn observe_for_scripts(&self, _out: &mut [f32]) {}

    /// Lists the facts that the world can state, for sentences that must be true: at most 64. A world that lists none
    /// lets the listener hear only sentences that presuppose nothing.
    fn facts(&self) -> Vec<Fact> {
        Vec::new()
    }

    /// Writes which of them hold, at any moment of an episode; what is not written does not hold. Shape
    /// `[facts().len()]`.
    ///
    /// It decides about words only: no observation, reward or end depends on it.
    fn observe_facts(&self, _holds: &mut [bool]) {}

    /// Returns whether the episode so far counts as a success; meaningful at its end.
    fn success(&self) -> bool;

    /// Returns whether the episode goes on although it can no longer become a success: a planner need not look at the
    /// rest.
    fn is_lost(&self) -> bool {
        false
    }

    /// Names the domain's own metrics, after `success`: each once, and none as a number that evaluations compute
    /// ([`COMPUTED`](leadtime_proto::spec::COMPUTED)).
    fn metric_names(&self) -> &'static [&'static str];

    /// Writes the domain's own metrics of the episode so far.
    fn metrics(&self, out: &mut [f32]);

    /// Returns how much a snapshot may grow beyond twice its size at the start of an episode, in bytes; as
    /// [`Environment::snapshot_margin`](crate::Environment::snapshot_margin).
    fn snapshot_margin(&self) -> usize {
        256
    }

    /// Appends everything the future depends on.
    fn snapshot(&self, out: &mut Vec<u8>);

    /// Continues from a snapshot, bit for bit.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the bytes are no snapshot of such a domain.
    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError>;

    /// Describes the present moment for a picture; the notifier environment adds what is said and done.
    ///
    /// Training never asks for it; `play`, `smoke` and transcripts do, once per step.
    fn scene(&self) -> Scene;
}
