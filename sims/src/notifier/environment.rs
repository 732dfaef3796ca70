//! The environment that joins a domain, a listener and a notifier.

use leadtime_numerics::Purpose;
use leadtime_proto::limits::may_hold;
use leadtime_proto::{EnvSpec, Mask};
use serde::{Deserialize, Serialize};

use super::session::Session;
use super::settings::NotifierSettings;
use crate::check::{SettingError, require};
use crate::description::{Description, ObservationLayout, Quantity, RewardTerm};
use crate::environment::{
    End, EntityHistory, Environment, EpisodeSeed, Insight, SnapshotError, StepOutcome,
    read_snapshot, write_snapshot,
};
use crate::error::TaskError;
use crate::fact::Fact;
use crate::human::{
    BlockedInitiation, Human, HumanSettings, HumanState, Initiation, ReactionReward, ReasonTable,
    SpeechAct, SpokenMessage,
};
use crate::scene::{Listener, Scene, Word};
use crate::scriptable::{STEP, Scriptable};
use crate::{Domain, Message};

/// The notifier's own metrics; `success` first, and the domain's follow.
const METRICS: [&str; 17] = [
    "success",
    "notifications",
    "notifications_per_step",
    "ignored_initiations",
    "comprehended",
    "delivered",
    "followed",
    "followed_of_initiated",
    "followed_of_comprehended",
    "unheeded",
    "long_notifications",
    "preempted",
    "overwritten",
    "continued",
    "mean_k",
    "mean_l",
    "first_notification",
];

/// No episode of a notifier is longer.
const MAX_STEPS: u32 = 1 << 30;

/// What the last step left behind that no other part remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct StepMemory {
    n_steps: u32,
    /// One-based step in which the episode's first message started; 0 before it.
    first_start: u32,
    started: bool,
    reacting: Option<usize>,
}

/// Everything that the future of a [`NotifierEnv`] depends on.
#[derive(Serialize, Deserialize)]
struct NotifierSnapshot {
    domain: Vec<u8>,
    human: HumanState,
    history: Vec<f32>,
    last: StepMemory,
}

/// What a step of a [`NotifierEnv`] is worth.
pub(super) struct StepRewards {
    pub(super) world: f64,
    reaction: f64,
    cost: f64,
    pub(super) end: Option<End>,
}

impl StepRewards {
    /// Returns what the notifier gets.
    pub(super) fn notifier(&self) -> f64 {
        self.world + self.reaction - self.cost
    }
}

/// The notifier problem of a domain, as an [`Environment`].
///
/// # Shapes
///
/// The observation is `[n * (D + A)]`, the last n pairs of the domain's observation (D) and the own action (A = 1 +
/// topics + 2 * words, and 1 more with `can_stop`), oldest first. With `observe_utterance` 1 + topics numbers about
/// the running utterance follow: the share of its words that was spoken, and its topic one-hot. Nothing in it says
/// what the listener has understood or is about to do.
#[derive(Debug)]
pub struct NotifierEnv<D> {
    spec: EnvSpec,
    domain: D,
    human: Human,
    /// What it would be without the world and the listener.
    session: Session,
    initiation_cost: f64,
    blocked: BlockedInitiation,
    last: StepMemory,
    /// The last step was the first of a reaction; the future does not depend on it.
    reaction_began: bool,
    /// What was spoken in the last step, as its word has left it; the future does not depend on it.
    word: Option<SpokenMessage>,
}

impl<D: Domain> NotifierEnv<D> {
    /// Joins a domain with a listener and a notifier.
    ///
    /// # Errors
    ///
    /// [`TaskError`] if a setting or the action space is impossible.
    pub fn new(
        domain: D,
        human: &HumanSettings,
        notifier: &NotifierSettings,
    ) -> Result<Self, TaskError> {
        human.check()?;
        let session = Session::new(domain.obs_dim(), domain.topics(), human, notifier)?;
        let reasons = reasons(human, notifier, domain.topics())?;
        let metrics = METRICS.iter().chain(domain.metric_names()).map(|&name| name.to_owned());
        let (obs_dim, actions) = (session.row_dim(), session.actions().spec());
        let spec = EnvSpec { obs_dim, actions, metrics: metrics.collect() };
        spec.check()?;
        check_follow_through(&domain, human, &reasons, &session.actions().messages())?;
        let informs = |topic: &usize| !domain.asks_for_action(*topic);
        let informative = (0..domain.topics().len()).filter(informs).collect();
        Ok(Self {
            spec,
            human: Human::new(human, informative, reasons),
            domain,
            session,
            initiation_cost: notifier.initiation_cost,
            blocked: human.blocked_initiation,
            last: StepMemory::default(),
            reaction_began: false,
            word: None,
        })
    }

    /// Returns the world that the listener acts in.
    pub fn domain(&self) -> &D {
        &self.domain
    }

    /// Returns the simulated listener with everything they have heard.
    pub fn human(&self) -> &Human {
        &self.human
    }

    /// Takes one step with a speech act instead of a policy's choices, and returns what became of it.
    ///
    /// A scripted notifier may use messages that no choice of the policy's stands for.
    pub fn step_with(
        &mut self,
        act: SpeechAct,
        observation: &mut [f32],
    ) -> (StepOutcome, Initiation) {
        self.human.begin_step();
        self.report_reaction_over();
        let initiation = self.human.apply(act);
        self.report_reaction_over();
        let paid = self.finish_step(act, initiation, observation);
        (StepOutcome { reward: paid.notifier() as f32, end: paid.end }, initiation)
    }

    /// Lets somebody else decide what the listener does, from the next episode on.
    pub(super) fn hand_over(&mut self) {
        self.human.hand_over();
    }

    /// Takes one step in which the listener does what somebody else has decided; after [`NotifierEnv::hand_over`].
    pub(super) fn step_together(
        &mut self,
        act: SpeechAct,
        topic: Option<usize>,
        observation: &mut [f32],
    ) -> (StepRewards, Initiation) {
        let initiation = self.human.apply(act);
        self.human.decide(topic);
        self.report_reaction_over();
        (self.finish_step(act, initiation, observation), initiation)
    }

    pub(super) fn session_ref(&self) -> &Session {
        &self.session
    }

    /// Carries out what the listener does, advances the world and hears a word.
    fn finish_step(
        &mut self,
        act: SpeechAct,
        initiation: Initiation,
        observation: &mut [f32],
    ) -> StepRewards {
        let started = self.session.carry_out(act, initiation);
        if let Some(message) = started {
            self.domain.started(message);
        }
        let reaction = self.human.reaction();
        let danger = self.domain.danger();
        let advance = self.domain.advance(reaction);
        let n_followed = self.human.tally().followed;
        let reaction_reward = self.human.acted(advance.reaction, danger);
        self.reaction_began = self.human.tally().followed > n_followed;
        self.report_reaction_over();
        self.hear_word();
        let n_steps = self.last.n_steps + 1;
        let is_first = started.is_some() && self.last.first_start == 0;
        self.last = StepMemory {
            n_steps,
            first_start: if is_first { n_steps } else { self.last.first_start },
            started: started.is_some(),
            reacting: reaction.map(|reaction| reaction.topic),
        };
        let domain = &self.domain;
        self.session.observe(|out| domain.observe(out));
        self.session.write_row(observation);
        let cost = self.cost(initiation);
        StepRewards { world: advance.reward, reaction: reaction_reward, cost, end: advance.end }
    }

    fn report_reaction_over(&mut self) {
        if self.human.take_reaction_over() {
            self.domain.reaction_over();
        }
    }

    fn hear_word(&mut self) {
        // Before it is heard: an utterance that ends with it is gone then, and after a stop nothing is left to hear.
        self.word = self.human.next_word();
        let delivered = self.human.hear_word();
        self.session.hear_word();
        debug_assert_eq!(self.session.speech(), self.human.spoken(), "both count the same words");
        self.report_reaction_over();
        if delivered.is_some_and(|message| self.domain.deliver(message).cancels_reaction) {
            self.human.end_running();
            self.report_reaction_over();
        }
    }

    fn cost(&self, initiation: Initiation) -> f64 {
        let charges_blocked = self.blocked == BlockedInitiation::IgnoreCharged;
        match initiation {
            Initiation::Started => self.initiation_cost,
            Initiation::Blocked if charges_blocked => self.initiation_cost,
            _ => 0.0,
        }
    }

    fn word(&self) -> Option<Word> {
        self.word.map(|SpokenMessage { message, heard, .. }| Word {
            topic: message.topic,
            comprehension: message.comprehension,
            conveyance: message.conveyance,
            needed: self.human.words_needed(message),
            heard,
            started: self.last.started,
        })
    }
}

/// Reads which messages state a reason; a listener to whom reasons are worth something needs to know.
fn reasons(
    human: &HumanSettings,
    notifier: &NotifierSettings,
    topics: &[&str],
) -> Result<ReasonTable, SettingError> {
    match &notifier.reasons {
        Some(reasons) => ReasonTable::new(reasons, topics),
        None if human.reason_weight > 0.0 => Err(SettingError {
            key: "notifier.reasons",
            given: "left out".to_owned(),
            allowed: "a table of what states a reason, because `human.reason_weight` is above 0; `leadtime taxonomy \
                      export DOMAIN --format cells` prints it"
                .into(),
        }),
        None => Ok(ReasonTable::default()),
    }
}

/// Refuses a listener whom no message moves: every one would be paid for in vain, and a policy would learn silence. Also where
/// somebody else plays them, and it would not count: settings for two are those of a run, in which a policy may have to speak alone.
fn check_follow_through<D: Domain>(
    domain: &D,
    human: &HumanSettings,
    reasons: &ReasonTable,
    messages: &[Message],
) -> Result<(), SettingError> {
    let mut asking = messages.iter().filter(|said| domain.asks_for_action(said.topic)).peekable();
    let fits = asking.peek().is_none()
        || asking.any(|&said| human.reaction_steps(said, reasons.share(said)) > 0);
    let given = "0 steps for every message that asks for an action";
    let allowed = "a rule by which some message is followed for a step or more, such as { fixed = 3 }; `human.informativeness` \
                   and its weight say what the others count, of the k and l that `notifier` allows";
    require(fits, "human.follow_through", given, allowed)
}

/// Divides, and calls nothing divided by nothing 0: a metric must be a number.
fn share(part: u32, whole: u32) -> f32 {
    if whole == 0 { 0.0 } else { part as f32 / whole as f32 }
}

impl<D: Domain> Environment for NotifierEnv<D> {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn describe(&self) -> Description {
        let topics = self.domain.topics();
        let mut frame = self.domain.quantities();
        frame.extend(self.session.actions().quantities(topics));
        let rest = self.session.utterance_quantities(topics);
        let mut rewards = self.domain.reward_terms();
        let reaction = match self.human.reaction_reward() {
            ReactionReward::Off => None,
            ReactionReward::Once => Some("I - 2, once per message that is followed"),
            ReactionReward::PerStep => Some("I - 2, in every step that follows a message"),
        };
        rewards.extend(reaction.map(|when| RewardTerm::new(when, 1.0, "human.reaction_reward")));
        let charged = match self.blocked {
            BlockedInitiation::IgnoreCharged => "a message started, or that may not start",
            _ => "a message that is started",
        };
        rewards.push(RewardTerm::new(charged, -self.initiation_cost, "notifier.initiation_cost"));
        let n_frames = self.session.history().n_pairs();
        let observation = ObservationLayout { n_frames, frame, rest };
        Description { observation, actions: self.session.actions().heads(topics), rewards }
    }

    fn entity_history(&self) -> Option<EntityHistory> {
        let n_frames = self.session.history().n_pairs();
        let action_dim = self.session.actions().encoded_dim();
        let entities = self.domain.entities()?;
        Some(EntityHistory { n_frames, entities, action_dim })
    }

    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
        self.domain.reset(seed);
        self.human.reset(seed.stream(Purpose::Human));
        self.last = StepMemory::default();
        (self.reaction_began, self.word) = (false, None);
        let domain = &self.domain;
        self.session.begin(|out| domain.observe(out));
        self.session.write_row(observation);
    }

    fn mask(&self) -> Mask {
        self.session.mask()
    }

    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome {
        self.step_with(self.session.speech_act(action), observation).0
    }

    fn metrics(&self, out: &mut [f32]) {
        let tally = self.human.tally();
        let (notifier, domain) = out.split_at_mut(METRICS.len());
        notifier.copy_from_slice(&[
            f32::from(u8::from(self.domain.success())),
            tally.started as f32,
            share(tally.started, self.last.n_steps),
            tally.ignored as f32,
            tally.comprehended as f32,
            tally.delivered as f32,
            tally.followed as f32,
            share(tally.followed, tally.started),
            share(tally.followed, tally.comprehended),
            tally.unheeded as f32,
            tally.long as f32,
            tally.preempted as f32,
            tally.overwritten as f32,
            tally.continued as f32,
            share(tally.sum_k, tally.started),
            share(tally.sum_l, tally.started),
            self.last.first_start as f32,
        ]);
        self.domain.metrics(domain);
    }

    fn snapshot_margin(&self) -> usize {
        self.domain.snapshot_margin()
    }

    fn write_state(&self, out: &mut Vec<u8>) {
        let mut domain = Vec::new();
        self.domain.snapshot(&mut domain);
        let human = self.human.state().clone();
        let history = self.session.history().row().to_vec();
        write_snapshot(&NotifierSnapshot { domain, human, history, last: self.last }, out);
    }

    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        let snapshot: NotifierSnapshot = read_snapshot(state)?;
        let n_topics = self.domain.topics().len();
        let StepMemory { n_steps, first_start, reacting, .. } = snapshot.last;
        let known = reacting.is_none_or(|topic| topic < n_topics);
        if !snapshot.human.fits(n_topics) || !known {
            return Err(SnapshotError::Mismatch { what: "topics or words" });
        }
        let counts_on = n_steps < MAX_STEPS && first_start <= n_steps;
        let shown = snapshot.history.iter().copied().all(may_hold);
        let speech = snapshot.human.speech();
        if !counts_on || !shown || !self.session.resume(&snapshot.history, speech) {
            return Err(SnapshotError::Mismatch { what: "history" });
        }
        self.domain.restore(&snapshot.domain)?;
        self.human.restore(snapshot.human);
        self.last = snapshot.last;
        (self.reaction_began, self.word) = (false, None);
        self.session.write_row(observation);
        Ok(())
    }

    fn baselines(&self) -> &'static [&'static str] {
        self.domain.scripts()
    }

    fn baseline_action(&self, name: &str, action: &mut [u8]) -> bool {
        let known = self.domain.scripts().contains(&name);
        if known {
            // What a scripted notifier starts now, if the listener lets it.
            let message = self.human.may_start().then(|| self.domain.script(name)).flatten();
            self.session.actions().write(message, action);
        }
        known
    }

    fn scriptable(&self) -> Option<&dyn Scriptable> {
        Some(self)
    }

    fn session(&self) -> Option<Session> {
        Some(self.session.clone())
    }

    fn insight(&self) -> Option<Insight> {
        Some(Insight {
            reaction_delay: self.human.reaction_delay(),
            comprehended: self.human.tally().comprehended,
            reaction_began: self.reaction_began,
            word: self.word(),
        })
    }

    fn facts(&self) -> Vec<Fact> {
        self.domain.facts()
    }

    fn facts_that_hold(&self) -> Vec<&'static str> {
        let facts = self.domain.facts();
        let mut holds = vec![false; facts.len()];
        self.domain.observe_facts(&mut holds);
        let told = facts.iter().zip(holds).filter(|(_, holds)| *holds);
        told.map(|(fact, _)| fact.name).collect()
    }

    fn scene(&self) -> Option<Scene> {
        let listener = Listener {
            topics: self.domain.topics().to_vec(),
            word: self.word(),
            pending: self.human.pending().map(|message| message.topic),
            reacting: self.last.reacting,
        };
        Some(Scene { listener, facts: self.facts_that_hold(), ..self.domain.scene() })
    }
}

impl<D: Domain> Scriptable for NotifierEnv<D> {
    fn topics(&self) -> &[&'static str] {
        self.domain.topics()
    }

    fn messages(&self) -> Vec<Message> {
        self.session.actions().messages()
    }

    fn may_start(&self) -> bool {
        self.human.may_start()
    }

    fn is_lost(&self) -> bool {
        self.domain.is_lost()
    }

    fn write_action(&self, message: Option<Message>, action: &mut [u8]) {
        self.session.actions().write(message, action);
    }

    fn write_act(&self, act: SpeechAct, action: &mut [u8]) {
        self.session.actions().write_act(act, action);
    }

    fn quantities(&self) -> Vec<Quantity> {
        let mut all = self.domain.quantities();
        all.extend(self.domain.script_quantities());
        let unbounded = [0.0, f32::INFINITY];
        all.push(Quantity::new(STEP, "steps of the episode so far", unbounded));
        all
    }

    fn n_observed(&self) -> usize {
        self.domain.obs_dim()
    }

    fn n_remembered(&self) -> usize {
        if self.session.history().n_pairs() > 1 { self.n_observed() } else { 0 }
    }

    fn write_quantities(&self, now: &mut [f32], before: &mut [f32]) {
        let (n_observed, step) = (self.domain.obs_dim(), now.len() - 1);
        let (last, previous) = self.session.history().last_two();
        now[..n_observed].copy_from_slice(last);
        self.domain.observe_for_scripts(&mut now[n_observed..step]);
        now[step] = self.last.n_steps as f32;
        before.copy_from_slice(now);
        before[..n_observed].copy_from_slice(previous);
    }
}

#[cfg(test)]
#[path = "environment_tests.rs"]
mod tests;
