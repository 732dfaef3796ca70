//! The kitchen and its cook, as a domain.

use std::sync::Arc;

use leadtime_numerics::{Pcg64, Purpose};
use leadtime_sims::check::{SettingError, require};
use leadtime_sims::environment::{End, EpisodeSeed, SnapshotError, read_snapshot, write_snapshot};
use leadtime_sims::human::{
    BlockedInitiation, FollowThrough, HumanSettings, Interrupt, ReactionDelay,
};
use leadtime_sims::notifier::{NotifierSettings, NotifierWorld, TaskSettings};
use leadtime_sims::scene::Scene;
use leadtime_sims::{
    Advance, Delivery, Domain, DomainEntry, Fact, Message, Quantity, ReactionStatus, ReactionStep,
    RewardTerm,
};
use serde::{Deserialize, Serialize};

use super::settings::{SteakhouseWorldSettings, TieRule};
use super::topics::{INFORM, TOPICS, direction, topic};
use super::{describe, draw, facts};
use crate::world::{
    Action, Direction, Floorplan, Kitchen, KitchenStart, KitchenState, StartFamily, StationPhase,
    Subtask, Ties, interactions_left, is_misled, is_redundant, random_pose,
};

/// The fewest station slots of an observation.
const MIN_SLOTS: usize = 6;
/// Numbers per station slot: phase one-hot, share of the work that is done, awareness.
const SLOT_DIM: usize = 5;
/// Numbers before the slots: x, y, direction one-hot, hand one-hot.
const BODY_DIM: usize = 2 + 4 + 7;
/// Numbers after the slots: time, and time to the deadline.
const CLOCK_DIM: usize = 2;

/// The longest reference run, in steps, as a multiple of the longest episode.
const REFERENCE_EPISODES: u32 = 2;

/// k and l of the scripted notifier's directions: acted upon after two words, and long enough to disclose by default.
const DIRECTION_WORDS: (u32, u32) = (2, 5);

/// The scripted notifier that informs at the start, in as few words as disclose, and says nothing more.
const INFORM_AT_START: &str = "inform_at_start";

/// What the cook did in the last step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LastStep {
    /// The action that was taken.
    pub action: Action,
    /// What for; `None` if it was asked for.
    pub subtask: Option<Subtask>,
    /// Whether it was part of work in vain.
    pub redundant: bool,
}

/// What happened in an episode so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct CookProgress {
    reference_steps: u32,
    redundant_steps: u32,
    pointless_pickups: u32,
    ineffective_actions: u32,
    blocked_moves: u32,
    disclosures: u32,
    /// Until when the scripted notifier lets what was said work.
    quiet_until: u32,
}

#[derive(Serialize, Deserialize)]
struct SteakhouseSnapshot {
    kitchen: KitchenState,
    generator: Pcg64,
    progress: CookProgress,
}

/// The task: a kitchen, and a cook who knows of its stations what they have seen or been told.
///
/// # Shapes
///
/// Observation, all of it in 0..=1: x, y, direction (north, south, east, west), hand (nothing, onion, meat, plate,
/// clean plate, steak, dish); per station slot (six, or as many as there are: grills, boards, sinks) empty, busy,
/// ready, share of the work done, and whether the cook's belief is right; time and time to the deadline, as shares of
/// the longest episode. A station in somebody else's use looks busy.
#[derive(Debug)]
pub struct SteakhouseDomain {
    settings: SteakhouseWorldSettings,
    /// The kitchen and its cook.
    pub kitchen: Kitchen,
    /// Where the reference run takes place.
    reference: Kitchen,
    /// Every episode starts like this, if it is given.
    given: Option<KitchenStart>,
    start: KitchenStart,
    generator: Pcg64,
    progress: CookProgress,
    /// What the cook did in the last step of the episode.
    pub last_step: Option<LastStep>,
}

impl SteakhouseDomain {
    /// Creates the task.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if a setting is out of range, or no dish can come out of the kitchen in time.
    ///
    /// # Panics
    ///
    /// Never: a checked kitchen has a start.
    pub fn new(settings: &SteakhouseWorldSettings) -> Result<Self, SettingError> {
        let grid = settings.check()?;
        let plan = Arc::new(Floorplan::new(grid, settings.field_of_view));
        let times = settings.times();
        let start = KitchenStart::new(&plan.grid).expect("a checked kitchen has a start");
        let mut reference = Kitchen::new(Arc::clone(&plan), times, 1);
        let needed = reference.reference_steps(&start, 10_000);
        let given = settings.max_steps;
        let allowed = format!("at least {needed} steps: a cook who knows everything needs them");
        require(needed <= given, "world.max_steps", given, allowed)?;
        let mut kitchen = Kitchen::new(plan, times, settings.see_delay);
        kitchen.begin(&start, settings.aware);
        Ok(Self {
            settings: settings.clone(),
            kitchen,
            reference,
            given: None,
            start,
            generator: Pcg64::seed_from_u64(0),
            progress: CookProgress::default(),
            last_step: None,
        })
    }

    /// Lets every episode start like this, whatever the settings say of starts.
    pub fn with_start(mut self, start: KitchenStart) -> Self {
        self.given = Some(start);
        self
    }

    /// Returns the steps to delivery of a cook who knows everything, from this episode's start.
    pub fn reference_steps(&self) -> u32 {
        self.progress.reference_steps
    }

    /// Returns the last step by which a delivery is in time.
    pub fn deadline(&self) -> u32 {
        self.progress.reference_steps + self.settings.deadline_slack
    }

    /// Returns whether the dish was served.
    pub fn is_delivered(&self) -> bool {
        self.kitchen.world.is_done()
    }

    fn draw_start(&mut self, generator: &mut Pcg64) {
        if let Some(start) = &self.given {
            self.start.clone_from(start);
            return;
        }
        let grid = &self.kitchen.plan.grid;
        let families = &self.settings.start_families;
        let family = families[generator.below(families.len())];
        family.fill(grid, self.settings.times(), generator, &mut self.start.contents);
        if self.settings.random_pose {
            self.start.pose = random_pose(grid, generator);
        }
        let [low, high] = self.settings.release_steps;
        self.start.release_at =
            (high > 0).then(|| generator.integers(i64::from(low), i64::from(high) + 1) as u32);
    }

    /// Chooses the cook's action: the direction asked for, or their own.
    fn choose(&mut self, asked: Option<Direction>) -> LastStep {
        if let Some(direction) = asked {
            return LastStep { action: Action::Go(direction), subtask: None, redundant: false };
        }
        let ties = match self.settings.ties {
            TieRule::Random => Ties::Random(&mut self.generator),
            TieRule::First => Ties::First,
        };
        let action = self.kitchen.decide(ties);
        let subtask = self.kitchen.mind.subtask.unwrap_or(Subtask::Wait);
        LastStep { action, subtask: Some(subtask), redundant: self.is_in_vain(subtask) }
    }

    fn is_in_vain(&self, subtask: Subtask) -> bool {
        let world = &self.kitchen.world;
        is_redundant(world, subtask) || is_misled(world, &self.kitchen.mind)
    }

    /// Counts what the step was good for.
    fn count(&mut self, step: LastStep, changed: bool) {
        let progress = &mut self.progress;
        progress.redundant_steps += u32::from(step.redundant);
        let fetched = step.action == Action::Interact && changed;
        let fetches = step.subtask.is_some_and(Subtask::fetches);
        progress.pointless_pickups += u32::from(step.redundant && fetches && fetched);
        progress.ineffective_actions += u32::from(step.action != Action::Stay && !changed);
        self.last_step = Some(step);
    }

    fn is_over(&self) -> bool {
        self.is_delivered() || self.kitchen.n_steps >= self.settings.max_steps
    }

    fn discloses(&self, message: Message) -> bool {
        let from = match direction(message.topic) {
            Some(_) => self.settings.direction_discloses_from,
            None => self.settings.inform_discloses_from,
        };
        message.conveyance >= from
    }

    /// Informs, in as few words as disclose.
    fn inform(&self) -> Message {
        let words = self.settings.inform_discloses_from;
        Message { topic: INFORM, comprehension: words, conveyance: words }
    }
}

impl Domain for SteakhouseDomain {
    fn topics(&self) -> &[&'static str] {
        TOPICS
    }

    fn asks_for_action(&self, topic: usize) -> bool {
        direction(topic).is_some()
    }

    fn obs_dim(&self) -> usize {
        let n_slots = self.kitchen.world.contents().len().max(MIN_SLOTS);
        BODY_DIM + n_slots * SLOT_DIM + CLOCK_DIM
    }

    fn quantities(&self) -> Vec<Quantity> {
        describe::quantities(self.kitchen.world.grid(), MIN_SLOTS)
    }

    fn reward_terms(&self) -> Vec<RewardTerm> {
        describe::reward_terms(&self.settings)
    }

    fn reset(&mut self, seed: EpisodeSeed) {
        self.draw_start(&mut seed.stream(Purpose::Task));
        self.generator = seed.stream(Purpose::World);
        let longest = self.settings.max_steps * REFERENCE_EPISODES;
        let reference_steps = self.reference.reference_steps(&self.start, longest);
        self.kitchen.begin(&self.start, self.settings.aware);
        self.progress = CookProgress { reference_steps, ..CookProgress::default() };
        self.last_step = None;
    }

    fn observe(&self, out: &mut [f32]) {
        let world = &self.kitchen.world;
        let (grid, cook) = (world.grid(), world.cook());
        let (body, rest) = out.split_at_mut(BODY_DIM);
        let (slots, clock) = rest.split_at_mut(rest.len() - CLOCK_DIM);
        body.fill(0.0);
        let [x, y] = grid.position(cook.pose.place);
        body[0] = x as f32 / (grid.width - 1) as f32;
        body[1] = y as f32 / (grid.height() - 1) as f32;
        body[2 + cook.pose.facing as usize] = 1.0;
        body[6 + cook.held.map_or(0, |item| 1 + item as usize)] = 1.0;
        slots.fill(0.0);
        for (slot, out) in slots.chunks_exact_mut(SLOT_DIM).enumerate().take(grid.slots.len()) {
            let content = world.contents()[slot];
            let limit = world.times.limit(grid.slots[slot].station);
            let phase = match content.phase(limit) {
                StationPhase::Empty => 0,
                StationPhase::Busy | StationPhase::Unavailable => 1,
                StationPhase::Ready => 2,
            };
            out[phase] = 1.0;
            out[3] = f32::from(content.work().unwrap_or(0)) / f32::from(limit);
            out[4] = f32::from(u8::from(self.kitchen.mind.belief.is_aware(slot, world)));
        }
        let (now, longest) = (self.kitchen.n_steps, self.settings.max_steps as f32);
        clock[0] = now as f32 / longest;
        clock[1] = (self.deadline().saturating_sub(now) as f32 / longest).min(1.0);
    }

    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
        let asked = reaction.and_then(|reaction| direction(reaction.topic));
        let before = interactions_left(&self.kitchen.world);
        let place = self.kitchen.world.cook().pose.place;
        let step = self.choose(asked);
        let outcome = self.kitchen.step(step.action, asked.is_none());
        self.count(step, outcome.changed);
        let is_blocked = asked.is_some() && self.kitchen.world.cook().pose.place == place;
        self.progress.blocked_moves += u32::from(is_blocked);
        let status = match (asked, is_blocked) {
            (None, _) => ReactionStatus::Refused,
            (Some(_), true) => ReactionStatus::Ended,
            (Some(_), false) => ReactionStatus::Followed,
        };
        let ending = match (self.is_delivered(), self.success()) {
            (true, true) => self.settings.delivery_reward,
            (true, false) => self.settings.late_reward,
            (false, _) => 0.0,
        };
        let done = f64::from(before) - f64::from(interactions_left(&self.kitchen.world));
        let settings = &self.settings;
        let in_vain = if step.redundant { settings.redundant_cost } else { 0.0 };
        Advance {
            reward: ending + settings.progress_reward * done - settings.step_cost - in_vain,
            reaction: reaction.map(|_| status),
            // Running out of time is a failure of the task and not a limit on our patience: a true end.
            end: self.is_over().then_some(End::Terminated),
        }
    }

    /// The first station of which the cook is not aware.
    fn danger(&self) -> usize {
        let world = &self.kitchen.world;
        let n_slots = world.contents().len();
        let aware = |slot: &usize| self.kitchen.mind.belief.is_aware(*slot, world);
        (0..n_slots).find(|slot| !aware(slot)).unwrap_or(n_slots)
    }

    fn reaction_over(&mut self) {
        self.kitchen.replan();
    }

    fn started(&mut self, message: Message) {
        self.progress.quiet_until = self.kitchen.n_steps + message.conveyance;
    }

    fn deliver(&mut self, message: Message) -> Delivery {
        let discloses = self.discloses(message);
        if discloses {
            self.kitchen.disclose();
            self.progress.disclosures += 1;
        }
        Delivery { cancels_reaction: discloses }
    }

    fn heuristic(&self) -> Option<Message> {
        let (world, mind) = (&self.kitchen.world, &self.kitchen.mind);
        let now = self.kitchen.n_steps;
        if now < self.progress.quiet_until || mind.belief.is_aware_of_all(world) {
            return None;
        }
        if now == 0 {
            return Some(self.inform());
        }
        if !self.is_in_vain(mind.leaning(world)) {
            return None;
        }
        let topic = topic(self.kitchen.informed_action());
        let (comprehension, conveyance) = DIRECTION_WORDS;
        let direction = Message { topic, comprehension, conveyance };
        Some(if topic == INFORM { self.inform() } else { direction })
    }

    fn scripts(&self) -> &'static [&'static str] {
        &["unaided", INFORM_AT_START, "heuristic"]
    }

    fn script(&self, name: &str) -> Option<Message> {
        match name {
            INFORM_AT_START => (self.kitchen.n_steps == 0).then(|| self.inform()),
            "heuristic" => self.heuristic(),
            _ => None,
        }
    }

    fn facts(&self) -> Vec<Fact> {
        facts::facts()
    }

    fn observe_facts(&self, holds: &mut [bool]) {
        facts::observe(&self.kitchen, holds);
    }

    fn success(&self) -> bool {
        self.is_delivered() && self.kitchen.n_steps <= self.deadline()
    }

    fn is_lost(&self) -> bool {
        !self.is_delivered() && self.kitchen.n_steps >= self.deadline()
    }

    fn metric_names(&self) -> &'static [&'static str] {
        &[
            "dish_delivered",
            "steps_to_deliver",
            "excess_steps",
            "redundant_steps",
            "pointless_pickups",
            "ineffective_actions",
            "blocked_moves",
            "disclosures",
        ]
    }

    fn metrics(&self, out: &mut [f32]) {
        let delivered = self.is_delivered();
        let steps = if delivered { self.kitchen.n_steps } else { self.settings.max_steps };
        let excess = f64::from(steps) - f64::from(self.progress.reference_steps);
        let (outcome, counts) = out.split_at_mut(3);
        outcome.copy_from_slice(&[f32::from(u8::from(delivered)), steps as f32, excess as f32]);
        counts.copy_from_slice(&self.progress.counts().map(|count| count as f32));
    }

    fn snapshot(&self, out: &mut Vec<u8>) {
        let (generator, progress) = (self.generator.clone(), self.progress);
        let kitchen = self.kitchen.state();
        write_snapshot(&SteakhouseSnapshot { kitchen, generator, progress }, out);
    }

    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let SteakhouseSnapshot { kitchen, generator, progress } = read_snapshot(snapshot)?;
        if !progress.fits(&self.settings) {
            return Err(SnapshotError::Mismatch { what: "progress" });
        }
        if kitchen.n_steps > self.settings.max_steps || !self.kitchen.restore(kitchen) {
            return Err(SnapshotError::Mismatch { what: "kitchen" });
        }
        (self.generator, self.progress, self.last_step) = (generator, progress, None);
        Ok(())
    }

    fn scene(&self) -> Scene {
        let outcome = match (self.is_over(), self.is_delivered(), self.success()) {
            (_, true, true) => "delivered in time",
            (_, true, false) => "delivered late",
            (true, false, _) => "out of time",
            (false, ..) => "",
        };
        draw::scene(&self.kitchen, self.settings.field_of_view, outcome)
    }
}

impl CookProgress {
    /// Returns whether an episode could have come to these numbers, with room to count on.
    fn fits(&self, settings: &SteakhouseWorldSettings) -> bool {
        self.counts().iter().all(|&count| count <= settings.max_steps)
            && self.reference_steps <= settings.max_steps * REFERENCE_EPISODES
            && self.quiet_until <= 1 << 30
    }

    /// Returns what grows by at most one per step, in the order of the metrics.
    fn counts(&self) -> [u32; 5] {
        [
            self.redundant_steps,
            self.pointless_pickups,
            self.ineffective_actions,
            self.blocked_moves,
            self.disclosures,
        ]
    }
}

/// Everything about the task.
pub type SteakhouseTaskSettings = TaskSettings<SteakhouseWorldSettings>;

impl NotifierWorld for SteakhouseWorldSettings {
    type Task = SteakhouseDomain;

    /// The follow-through is three steps.
    fn human() -> HumanSettings {
        HumanSettings { follow_through: FollowThrough::Fixed(3), ..HumanSettings::default() }
    }

    /// A message costs 0.2.
    fn notifier() -> NotifierSettings {
        NotifierSettings { initiation_cost: 0.2, ..NotifierSettings::default() }
    }

    fn domain(&self) -> Result<SteakhouseDomain, SettingError> {
        SteakhouseDomain::new(self)
    }
}

/// Describes the notifier task `steakhouse`.
pub fn entry() -> DomainEntry {
    DomainEntry::notifier::<SteakhouseWorldSettings>("steakhouse")
}

/// Returns the settings of the recorded episodes: a listener who reacts at once and whom nothing interrupts, three
/// words of `inform`, ties by the first, the start tile.
pub fn golden() -> SteakhouseTaskSettings {
    let mut settings = SteakhouseTaskSettings::default();
    settings.world.random_pose = false;
    settings.world.ties = TieRule::First;
    settings.world.inform_discloses_from = 3;
    settings.human.reaction_delay = ReactionDelay::Fixed(0);
    settings.human.interrupt = Interrupt::Finish;
    settings.human.blocked_initiation = BlockedInitiation::Mask;
    settings
}

/// Returns the settings of the paper's demonstration: those of the recorded episodes, with half-done work at every
/// station, and words that count from 0, so that the cook has acted on the second word by t = 2.
pub fn demonstration() -> SteakhouseTaskSettings {
    let mut settings = golden();
    settings.world.start_families = vec![StartFamily::AllPartial];
    settings.human.words_from = 0;
    settings
}

#[cfg(test)]
#[path = "domain_tests.rs"]
mod tests;
