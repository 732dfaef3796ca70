//! The lander with danger zones, as a domain.

use leadtime_numerics::Purpose;
use leadtime_sims::ReactionStatus::{Followed, Refused};
use leadtime_sims::check::SettingError;
use leadtime_sims::environment::{End, EpisodeSeed, SnapshotError, read_snapshot, write_snapshot};
use leadtime_sims::notifier::{NotifierWorld, TaskSettings};
use leadtime_sims::scene::{Gauge, Scene, Shape, Tone};
use leadtime_sims::{Advance, Domain, Fact, Message, Quantity, ReactionStep, RewardTerm};
use serde::{Deserialize, Serialize};

use super::describe;
use super::facts::{self, FlightMoment};
use super::maneuver::{Maneuver, TOPICS, listens, maneuver, raw};
use super::safe_path::direct;
use super::settings::{
    EntryPenalty, LanderWorldSettings, NearCharge, NearPenalty, PilotKind, ReactionKind,
};
use super::zone::Zone;
use crate::pilot::{Flyer, Pilot, engines_off};
use crate::world::{Engine, Lander, LanderOutcome, LanderSnapshot, SNAPSHOT_MARGIN, VIEW, caption};

/// The outcome of a scene in which the lander has been in a danger zone, however it went on.
pub const ENTERED: &str = "entered a danger zone";

/// Half the pad's width.
const PAD: f64 = 0.2;

/// What happened in an episode so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct LanderProgress {
    n_steps: u32,
    outcome: Option<LanderOutcome>,
    timed_out: bool,
    entered: bool,
    /// One-based index of the first step in a zone; 0 before it.
    entered_at: u32,
    zone_steps: u32,
    fuel: f64,
}

/// What the frames of one step came to.
#[derive(Clone, Copy, Debug, Default)]
struct Frames {
    fuel: f64,
    followed: bool,
    /// How many of them were in a zone.
    n_inside: u32,
    /// What being near zones costs.
    near_cost: f64,
}

impl Frames {
    fn is_inside(&self) -> bool {
        self.n_inside > 0
    }
}

#[derive(Serialize, Deserialize)]
struct LanderTaskSnapshot {
    zones: Vec<Zone>,
    progress: LanderProgress,
    lander: LanderSnapshot,
}

/// The task: a lander, its pilot, and the zones that the pilot does not see.
///
/// # Shapes
///
/// Observation: the lander's 8 values; if zones differ between episodes, 4 more per zone (x0, x1, y0, y1); with
/// `observe_time`, 1 more: the share of the steps that is left.
#[derive(Debug)]
pub struct LanderDomain {
    settings: LanderWorldSettings,
    /// Who has the controls while no reaction runs.
    flyer: Flyer<'static>,
    lander: Lander,
    zones: Vec<Zone>,
    progress: LanderProgress,
}

impl LanderDomain {
    /// Creates the task; the error names a setting that is out of range.
    pub(crate) fn new(settings: &LanderWorldSettings) -> Result<Self, SettingError> {
        settings.check()?;
        let flyer = match settings.pilot {
            PilotKind::Embedded => Flyer::Network { pilot: Pilot::embedded(), rests: false },
            PilotKind::Heuristic => Flyer::Heuristic,
        };
        Ok(Self {
            lander: Lander::new(&settings.lander()),
            flyer,
            zones: settings.zones.clone(),
            progress: LanderProgress::default(),
            settings: settings.clone(),
        })
    }

    fn place(&self) -> [f64; 2] {
        let [x, y, ..] = self.lander.observation().map(f64::from);
        [x, y]
    }

    fn n_observed_zones(&self) -> usize {
        if self.settings.has_jitter() { self.zones.len() } else { 0 }
    }

    /// Chooses the pilot's engine for one frame, and returns whether it follows the reaction.
    fn engine(&self, reaction: Option<ReactionStep>) -> (Engine, bool) {
        let observation = self.lander.observation();
        if let Some(reaction) = reaction
            && listens(observation)
        {
            let asked = Maneuver::of(reaction.topic);
            let engine = match self.settings.reaction {
                ReactionKind::Maneuver => maneuver(asked, observation),
                ReactionKind::Raw => raw(asked),
            };
            return (engine, true);
        }
        if self.settings.engines_off && engines_off(observation) {
            return (Engine::Idle, false);
        }
        (self.flyer.engine(observation), false)
    }

    /// Flies the frames of one step, fewer if the episode ends.
    fn fly(&mut self, reaction: Option<ReactionStep>) -> Frames {
        let mut frames = Frames::default();
        for _ in 0..self.settings.frames_per_step {
            let (engine, follows) = self.engine(reaction);
            frames.followed |= follows;
            frames.fuel += match engine {
                Engine::Idle => 0.0,
                Engine::Main => self.settings.main_fuel,
                Engine::Left | Engine::Right => self.settings.side_fuel,
            };
            self.progress.outcome = self.lander.step(engine).outcome;
            let place = self.place();
            frames.n_inside += u32::from(self.zones.iter().any(|zone| zone.contains(place)));
            if self.settings.near_charged == NearCharge::PerFrame {
                frames.near_cost += self.near_cost();
            }
            let ends_here = frames.is_inside() && self.settings.zone_ends_episode;
            if ends_here || self.progress.outcome.is_some() {
                break;
            }
        }
        if self.settings.near_charged == NearCharge::PerStep {
            frames.near_cost = self.near_cost();
        }
        frames
    }

    /// Returns whether these are the zones, moved as far as they may be.
    fn has_zones(&self, zones: &[Zone]) -> bool {
        let LanderWorldSettings { zones: originals, zone_jitter, .. } = &self.settings;
        let mut pairs = zones.iter().zip(originals);
        zones.len() == originals.len()
            && pairs.all(|(zone, original)| zone.is_moved(original, *zone_jitter))
    }

    /// Returns whether an episode can have come to these numbers.
    fn has_come_to(&self, progress: &LanderProgress) -> bool {
        let LanderProgress { n_steps, entered_at, zone_steps, fuel, .. } = *progress;
        let settings = &self.settings;
        let per_step =
            f64::from(settings.frames_per_step) * settings.main_fuel.max(settings.side_fuel);
        // A sum of so many frames is a little more or less.
        let most_fuel = f64::from(n_steps) * per_step * (1.0 + 1e-6);
        entered_at.max(zone_steps) <= n_steps
            && n_steps <= settings.max_steps
            && (0.0..=most_fuel).contains(&fuel)
    }

    fn is_on_pad(&self) -> bool {
        self.place()[0].abs() <= PAD
    }

    fn counts_as_landed(&self) -> bool {
        let there = !self.settings.on_pad || self.is_on_pad();
        self.progress.outcome == Some(LanderOutcome::Landed) && there
    }

    /// Computes what being near zones costs at this place.
    fn near_cost(&self) -> f64 {
        let (place, near) = (self.place(), self.settings.near_distance);
        let depth = |distance: f64| (near - distance).max(0.0);
        let zones = self.zones.iter();
        let sum: f64 = match self.settings.near_penalty {
            NearPenalty::Off => 0.0,
            NearPenalty::Depth => zones.map(|zone| depth(zone.distance(place))).sum(),
            NearPenalty::Sides => {
                zones.flat_map(|zone| zone.side_distances(place)).map(depth).sum()
            }
            NearPenalty::Literal => {
                zones.map(|zone| zone.distance(place)).filter(|&distance| distance < near).sum()
            }
        };
        self.settings.near_weight * sum
    }

    /// Computes what the zones cost in a step that is not part of the progress yet.
    fn zone_cost(&self, frames: &Frames) -> f64 {
        let settings = &self.settings;
        let entry = match (frames.n_inside, settings.zone_ends_episode, settings.entry_charged) {
            (0, ..) => 0.0,
            (_, true, _) => settings.zone_end_penalty,
            (_, false, EntryPenalty::Once) if self.progress.entered => 0.0,
            (_, false, EntryPenalty::Once | EntryPenalty::PerStep) => settings.entry_penalty,
            (n, false, EntryPenalty::PerFrame) => f64::from(n) * settings.entry_penalty,
        };
        entry + frames.near_cost
    }

    /// Computes the reward of how the episode ended, and whether it did.
    fn finish(&mut self, inside: bool) -> (f64, Option<End>) {
        if inside && self.settings.zone_ends_episode {
            return (0.0, Some(End::Terminated));
        }
        let reward = match self.progress.outcome {
            Some(LanderOutcome::Landed) if self.counts_as_landed() => self.settings.landing_reward,
            Some(LanderOutcome::Landed) => 0.0,
            Some(LanderOutcome::Crashed | LanderOutcome::Out) => -self.settings.crash_penalty,
            None if self.progress.n_steps >= self.settings.max_steps => {
                self.progress.timed_out = true;
                -self.settings.timeout_penalty
            }
            None => return (0.0, None),
        };
        // Running out of time is a failure of the task and not a limit on our patience: a true end.
        (reward, Some(End::Terminated))
    }
}

impl Domain for LanderDomain {
    fn topics(&self) -> &[&'static str] {
        TOPICS
    }

    fn obs_dim(&self) -> usize {
        8 + 4 * self.n_observed_zones() + usize::from(self.settings.observe_time)
    }

    fn quantities(&self) -> Vec<Quantity> {
        describe::quantities(&self.settings)
    }

    fn reward_terms(&self) -> Vec<RewardTerm> {
        describe::reward_terms(&self.settings)
    }

    fn reset(&mut self, seed: EpisodeSeed) {
        self.progress = LanderProgress::default();
        self.zones.clone_from(&self.settings.zones);
        if self.settings.has_jitter() {
            let mut generator = seed.stream(Purpose::Task);
            let [reach_x, reach_y] = self.settings.zone_jitter;
            for zone in &mut self.zones {
                let dx = generator.uniform(-reach_x, reach_x);
                *zone = zone.moved(dx, generator.uniform(-reach_y, reach_y));
            }
        }
        self.lander.reset(seed.stream(Purpose::World));
    }

    fn observe(&self, out: &mut [f32]) {
        let (lander, rest) = out.split_at_mut(8);
        lander.copy_from_slice(self.lander.observation());
        let (zones, time_left) = rest.split_at_mut(4 * self.n_observed_zones());
        for (sides, zone) in zones.chunks_exact_mut(4).zip(&self.zones) {
            sides.copy_from_slice(&[zone.x0, zone.x1, zone.y0, zone.y1].map(|side| side as f32));
        }
        if let [time_left] = time_left {
            let used = f64::from(self.progress.n_steps) / f64::from(self.settings.max_steps);
            *time_left = (1.0 - used) as f32;
        }
    }

    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
        let frames = self.fly(reaction);
        let zone_cost = self.zone_cost(&frames);
        let is_inside = frames.is_inside();
        self.progress.n_steps += 1;
        if is_inside && !self.progress.entered {
            self.progress.entered_at = self.progress.n_steps;
        }
        self.progress.entered |= is_inside;
        self.progress.zone_steps += u32::from(is_inside);
        self.progress.fuel += frames.fuel;
        let (ending, end) = self.finish(is_inside);
        let status = if frames.followed { Followed } else { Refused };
        let reward = ending - frames.fuel - zone_cost;
        Advance { reward, reaction: reaction.map(|_| status), end }
    }

    /// The index of the zone that is nearest to the lander.
    fn danger(&self) -> usize {
        let distance = |zone: &Zone| zone.distance(self.place());
        let zones = self.zones.iter().enumerate();
        let nearest = zones.min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)));
        nearest.map_or(0, |(i, _)| i)
    }

    fn heuristic(&self) -> Option<Message> {
        let place = self.place();
        let is_near = |zone: &Zone| zone.distance(place) < self.settings.heuristic_distance;
        let speaks = self.zones.iter().any(is_near);
        speaks.then(|| direct(place, &self.settings.safe_path)).flatten()
    }

    fn facts(&self) -> Vec<Fact> {
        facts::facts()
    }

    fn observe_facts(&self, holds: &mut [bool]) {
        let [x, y, vx, vy, ..] = self.lander.observation().map(f64::from);
        facts::observe(
            &FlightMoment { place: [x, y], velocity: [vx, vy], zones: &self.zones },
            holds,
        );
    }

    fn success(&self) -> bool {
        self.counts_as_landed() && !self.progress.entered
    }

    fn is_lost(&self) -> bool {
        self.progress.entered
    }

    fn metric_names(&self) -> &'static [&'static str] {
        &[
            "enter_danger",
            "landed",
            "landed_on_pad",
            "crashed",
            "out",
            "timed_out",
            "danger_from",
            "danger_steps",
            "fuel",
        ]
    }

    fn metrics(&self, out: &mut [f32]) {
        let progress = &self.progress;
        let ended = |outcome| progress.outcome == Some(outcome);
        let flag = |holds: bool| f32::from(u8::from(holds));
        out.copy_from_slice(&[
            flag(progress.entered),
            flag(ended(LanderOutcome::Landed)),
            flag(ended(LanderOutcome::Landed) && self.is_on_pad()),
            flag(ended(LanderOutcome::Crashed)),
            flag(ended(LanderOutcome::Out)),
            flag(progress.timed_out),
            progress.entered_at as f32,
            progress.zone_steps as f32,
            progress.fuel as f32,
        ]);
    }

    fn snapshot_margin(&self) -> usize {
        SNAPSHOT_MARGIN
    }

    fn snapshot(&self, out: &mut Vec<u8>) {
        let (zones, lander) = (self.zones.clone(), self.lander.snapshot());
        write_snapshot(&LanderTaskSnapshot { zones, progress: self.progress, lander }, out);
    }

    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let snapshot: LanderTaskSnapshot = read_snapshot(snapshot)?;
        if !self.has_zones(&snapshot.zones) {
            return Err(SnapshotError::Mismatch { what: "danger zones" });
        }
        if !self.has_come_to(&snapshot.progress) {
            return Err(SnapshotError::Mismatch { what: "progress" });
        }
        self.lander.restore(&snapshot.lander)?;
        self.zones = snapshot.zones;
        self.progress = snapshot.progress;
        Ok(())
    }

    fn scene(&self) -> Scene {
        let zones = self.zones.iter().map(|zone| Shape::Rectangle {
            min: [zone.x0, zone.y0],
            max: [zone.x1, zone.y1],
            tone: Tone::Danger,
        });
        let progress = &self.progress;
        let outcome = match (progress.entered, progress.timed_out) {
            (true, _) => ENTERED,
            (false, true) => "out of time",
            (false, false) => caption(progress.outcome),
        };
        Scene {
            view: VIEW,
            shapes: zones.chain(self.lander.shapes()).collect(),
            position: self.place(),
            gauge: Gauge { label: "height", value: self.place()[1] },
            outcome: outcome.to_owned(),
            ..Scene::default()
        }
    }
}

/// Everything about the task.
pub type LanderTaskSettings = TaskSettings<LanderWorldSettings>;

impl NotifierWorld for LanderWorldSettings {
    type Task = LanderDomain;

    fn domain(&self) -> Result<LanderDomain, SettingError> {
        LanderDomain::new(self)
    }
}

#[cfg(test)]
#[path = "domain_tests.rs"]
mod tests;
