//! The highway with a listener who trusts merging cars, as a domain.

use std::sync::Arc;

use leadtime_numerics::{Pcg64, Purpose};
use leadtime_sims::check::SettingError;
use leadtime_sims::environment::{End, EpisodeSeed, SnapshotError, read_snapshot, write_snapshot};
use leadtime_sims::human::{FollowThrough, HumanSettings};
use leadtime_sims::notifier::{NotifierSettings, NotifierWorld, TaskSettings};
use leadtime_sims::scene::Scene;
use leadtime_sims::{
    Advance, Domain, DomainEntry, Entities, Fact, Message, Quantity, ReactionStatus, ReactionStep,
    RewardTerm,
};
use serde::{Deserialize, Serialize};

use super::admit::{merging_car, populate};
use super::facts::{self, DriveMoment};
use super::heuristic::advise;
use super::overview;
use super::picture::picture;
use super::progress::{DriveOutcome, DriveProgress};
use super::reaction::{EGO, TOPICS, is_lane_change, react};
use super::settings::{HighwayWorldSettings, start_lanes};
use crate::world::{CarRole, Driver, RewardSettings, Traffic, Vehicle, quantities};

/// What a step pays once the ego has arrived.
const ARRIVED_REWARD: f64 = 1.0;

#[derive(Serialize, Deserialize)]
struct HighwaySnapshot {
    vehicles: Vec<Vehicle>,
    n_admitted: usize,
    generator: Pcg64,
    progress: DriveProgress,
}

/// The task: a highway, its traffic, and the listener who does not look at the ramps.
///
/// # Shapes
///
/// Observation: `[rows, columns]` of [`ObservationSettings`](crate::world::ObservationSettings), the ego first.
#[derive(Debug)]
pub struct HighwayDomain {
    settings: HighwayWorldSettings,
    /// The cars and their road; the ego is car 0.
    pub traffic: Traffic,
    /// Lanes abreast where the ego starts: the unit of observed y.
    n_lanes: usize,
    /// The last step in which an arrival is in time, if there is one.
    last_in_time: Option<u32>,
    /// Ramps whose car has appeared.
    n_admitted: usize,
    generator: Pcg64,
    progress: DriveProgress,
}

impl HighwayDomain {
    /// Creates the task.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if a setting is out of range or the road is malformed.
    pub fn new(settings: &HighwayWorldSettings) -> Result<Self, SettingError> {
        let road = Arc::new(settings.build()?);
        let n_lanes = start_lanes(&road).count();
        let n_vehicles = 1 + settings.traffic.cars.len() + road.ramps.len();
        let mut traffic = Traffic::new(road, settings.merging.blindness);
        // Adding cars allocates nothing.
        traffic.vehicles.reserve(n_vehicles);
        let mut generator = Pcg64::seed_from_u64(0);
        populate(&mut traffic, settings, &mut generator);
        Ok(Self {
            settings: settings.clone(),
            traffic,
            n_lanes,
            last_in_time: settings.last_step_in_time(),
            n_admitted: 0,
            generator,
            progress: DriveProgress::default(),
        })
    }

    /// Returns the number of the merge at which the ego crashed, if it did.
    pub fn crash_ramp(&self) -> Option<usize> {
        self.progress.crash_ramp
    }

    /// Returns whether the ego has passed the goal.
    pub fn has_arrived(&self) -> bool {
        self.progress.is(DriveOutcome::Arrived)
    }

    /// Returns whether the ego has passed the goal in time.
    pub fn is_in_time(&self) -> bool {
        self.has_arrived() && !self.is_late()
    }

    /// Returns whether the ego never braked too hard.
    pub fn is_comfortable(&self) -> bool {
        let bound = self.settings.hardest_braking;
        bound == 0.0 || self.progress.hardest_braking <= bound
    }

    /// Returns whether the drive is too long by now, or was when the ego arrived.
    fn is_late(&self) -> bool {
        self.last_in_time.is_some_and(|last| self.progress.n_driven > last)
    }

    fn ego(&self) -> &Vehicle {
        &self.traffic.vehicles[EGO]
    }

    /// Lets the next merging car appear, if its time has come.
    fn admit(&mut self) {
        let Some(ramp) = self.traffic.road.ramps.get(self.n_admitted) else { return };
        let merging = &self.settings.merging;
        if self.ego().position[0] > ramp.merge_x - merging.distance {
            let car = merging_car(&self.traffic, ramp, merging, &mut self.generator);
            self.traffic.vehicles.push(car);
            self.n_admitted += 1;
        }
    }

    fn run_frames(&mut self) {
        let dt = 1.0 / f64::from(self.settings.frame_rate);
        for _ in 0..self.settings.frames_per_step {
            self.admit();
            let before = self.ego().speed;
            self.traffic.step(dt);
            self.progress.record_frame(before, &self.traffic.vehicles[EGO], dt);
        }
    }

    /// Computes the reward of a step, and adds its pieces to the progress.
    fn pay(&mut self, changes_lanes: bool) -> f64 {
        let weights = &self.settings.reward;
        let terms = self.traffic.terms(EGO, changes_lanes, weights);
        for (sum, piece) in self.progress.pieces.iter_mut().zip(weights.pieces(&terms)) {
            *sum += piece;
        }
        weights.reward(&terms)
    }

    /// Charges a step of driving for what a success does not allow.
    fn charge(&mut self, was_comfortable: bool) -> f64 {
        let RewardSettings { late, hard_braking, .. } = self.settings.reward;
        let charged = [
            if self.is_late() { late } else { 0.0 },
            if was_comfortable && !self.is_comfortable() { hard_braking } else { 0.0 },
        ];
        for (sum, charge) in self.progress.penalties.iter_mut().zip(charged) {
            *sum += charge;
        }
        charged.iter().sum()
    }

    /// Notes how the episode stands, and returns whether it is over.
    fn finish(&mut self) -> Option<End> {
        let (x, crashed) = (self.ego().position[0], self.ego().crashed);
        let progress = &mut self.progress;
        progress.n_driven = progress.n_steps;
        if crashed {
            progress.outcome = Some(DriveOutcome::Crashed);
            let ramps = self.traffic.road.ramps.iter();
            let met = ramps.filter(|ramp| x > ramp.merge_x - self.settings.merging.distance);
            progress.crash_ramp = met.count().checked_sub(1);
            return Some(End::Terminated);
        }
        if x > self.settings.goal {
            progress.outcome = Some(DriveOutcome::Arrived);
            return (progress.n_steps >= self.settings.absorb_until).then_some(End::Terminated);
        }
        if progress.n_steps >= self.settings.max_steps {
            progress.outcome = Some(DriveOutcome::OutOfTime);
            return Some(End::Truncated);
        }
        None
    }

    fn fits(&self, snapshot: &HighwaySnapshot) -> bool {
        let road = &self.traffic.road;
        let n_vehicles = 1 + self.settings.traffic.cars.len() + snapshot.n_admitted;
        let n_frames = snapshot.progress.n_frames;
        let possible = |(i, vehicle): (usize, &Vehicle)| {
            (vehicle.role == CarRole::Ego) == (i == EGO)
                && matches!(vehicle.driver, Driver::Idm(_))
                && vehicle.is_proper(&road.network, n_frames)
        };
        snapshot.n_admitted <= road.ramps.len()
            && snapshot.vehicles.len() == n_vehicles
            && snapshot.vehicles.iter().enumerate().all(possible)
    }
}

impl Domain for HighwayDomain {
    fn topics(&self) -> &[&'static str] {
        TOPICS
    }

    fn obs_dim(&self) -> usize {
        self.settings.observation.dim()
    }

    fn quantities(&self) -> Vec<Quantity> {
        quantities(&self.settings.observation, self.n_lanes)
    }

    fn reward_terms(&self) -> Vec<RewardTerm> {
        let weights = &self.settings.reward;
        let mut terms = weights.terms();
        if let Some(last) = self.last_in_time {
            let late = format!("a step of driving after step {last}");
            terms.push(RewardTerm::new(late, weights.late, "world.reward.late"));
        }
        let braking = self.settings.hardest_braking;
        if braking > 0.0 {
            let hard = format!("braking harder than {braking} m/s², once");
            terms.push(RewardTerm::new(hard, weights.hard_braking, "world.reward.hard_braking"));
        }
        let after = "a step after the arrival, and nothing else";
        terms.push(RewardTerm::new(after, ARRIVED_REWARD, ""));
        terms
    }

    fn entities(&self) -> Option<Entities> {
        let observation = &self.settings.observation;
        Some(Entities { n_entities: observation.rows, n_features: observation.n_columns() })
    }

    fn reset(&mut self, seed: EpisodeSeed) {
        self.generator = seed.stream(Purpose::World);
        self.traffic.vehicles.clear();
        populate(&mut self.traffic, &self.settings, &mut self.generator);
        self.n_admitted = 0;
        self.progress = DriveProgress::begin(&self.traffic.vehicles);
    }

    fn observe(&self, out: &mut [f32]) {
        self.traffic.observe(EGO, self.n_lanes, &self.settings.observation, out);
    }

    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
        self.progress.n_steps += 1;
        if self.has_arrived() {
            // Nothing moves any more.
            let reaction = reaction.map(|_| ReactionStatus::Refused);
            let is_over = self.progress.n_steps >= self.settings.absorb_until;
            let end = is_over.then_some(End::Terminated);
            return Advance { reward: ARRIVED_REWARD, reaction, end };
        }
        let Self { traffic, settings, progress, .. } = self;
        let status = react(traffic, reaction, &settings.ego, &mut progress.refused);
        let changes_lanes = reaction.is_some_and(|it| it.first && is_lane_change(it.topic));
        progress.n_refused += u32::from(changes_lanes && progress.refused);
        let was_comfortable = self.is_comfortable();
        self.run_frames();
        let reward = self.pay(changes_lanes);
        let end = self.finish();
        Advance { reward: reward + self.charge(was_comfortable), reaction: status, end }
    }

    /// The number of ramps whose end the ego has passed: the next one is the danger that it faces.
    fn danger(&self) -> usize {
        let x = self.ego().position[0];
        self.traffic.road.ramps.iter().filter(|ramp| x >= ramp.end_x).count()
    }

    fn heuristic(&self) -> Option<Message> {
        let drives = !self.has_arrived();
        drives.then(|| advise(&self.traffic, &self.settings.heuristic)).flatten()
    }

    fn script_quantities(&self) -> Vec<Quantity> {
        overview::quantities()
    }

    fn observe_for_scripts(&self, out: &mut [f32]) {
        overview::observe(&self.traffic, out);
    }

    fn facts(&self) -> Vec<Fact> {
        facts::facts()
    }

    fn observe_facts(&self, holds: &mut [bool]) {
        let desired_speed = self.settings.ego.desired_speed;
        facts::observe(DriveMoment { traffic: &self.traffic, desired_speed }, holds);
    }

    fn success(&self) -> bool {
        self.is_in_time() && self.is_comfortable()
    }

    fn metric_names(&self) -> &'static [&'static str] {
        &[
            "crashed",
            "arrived",
            "timed_out",
            "overtaken",
            "refused_changes",
            "mean_speed",
            "hardest_braking",
            "jerk",
            "return_collision",
            "return_right_lane",
            "return_high_speed",
            "return_merging",
            "return_lane_change",
            "in_time",
            "comfortable",
            "drive_time",
            "return_late",
            "return_hard_braking",
        ]
    }

    fn metrics(&self, out: &mut [f32]) {
        let progress = &self.progress;
        let flags = [DriveOutcome::Crashed, DriveOutcome::Arrived, DriveOutcome::OutOfTime];
        let counts = [progress.overtaken(&self.traffic.vehicles), progress.n_refused];
        let amounts = [progress.mean_speed(), progress.hardest_braking, progress.jerk()];
        let flags = flags.into_iter().map(|outcome| f64::from(u8::from(progress.is(outcome))));
        let parts = [self.is_in_time(), self.is_comfortable()];
        let parts = parts.map(|part| f64::from(u8::from(part)));
        let seconds =
            f64::from(self.settings.frames_per_step) / f64::from(self.settings.frame_rate);
        let values = flags.chain(counts.map(f64::from)).chain(amounts).chain(progress.pieces);
        let values = values.chain(parts).chain([f64::from(progress.n_driven) * seconds]);
        let values = values.chain(progress.penalties);
        for (out, value) in out.iter_mut().zip(values) {
            *out = value as f32;
        }
    }

    fn snapshot(&self, out: &mut Vec<u8>) {
        let snapshot = HighwaySnapshot {
            vehicles: self.traffic.vehicles.clone(),
            n_admitted: self.n_admitted,
            generator: self.generator.clone(),
            progress: self.progress,
        };
        write_snapshot(&snapshot, out);
    }

    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let snapshot: HighwaySnapshot = read_snapshot(snapshot)?;
        if !self.fits(&snapshot) {
            return Err(SnapshotError::Mismatch { what: "cars" });
        }
        let n_ramps = self.traffic.road.ramps.len();
        if !snapshot.progress.is_plausible(self.settings.max_steps, n_ramps) {
            return Err(SnapshotError::Mismatch { what: "progress" });
        }
        let vehicles = &mut self.traffic.vehicles;
        vehicles.clear();
        vehicles.extend(snapshot.vehicles);
        for vehicle in vehicles {
            vehicle.face(vehicle.heading);
        }
        self.n_admitted = snapshot.n_admitted;
        self.generator = snapshot.generator;
        self.progress = snapshot.progress;
        Ok(())
    }

    fn scene(&self) -> Scene {
        let outcome = match self.progress.outcome {
            Some(DriveOutcome::Crashed) => "crashed",
            Some(DriveOutcome::Arrived) => "arrived",
            Some(DriveOutcome::OutOfTime) => "out of time",
            None => "",
        };
        picture(&self.traffic, self.settings.goal, outcome)
    }
}

/// Everything about the task.
pub type HighwayTaskSettings = TaskSettings<HighwayWorldSettings>;

impl NotifierWorld for HighwayWorldSettings {
    type Task = HighwayDomain;

    /// The follow-through is 2 l - 2.
    fn human() -> HumanSettings {
        let follow_through = FollowThrough::TwiceLengthMinusTwo;
        HumanSettings { follow_through, ..HumanSettings::default() }
    }

    /// A message costs 0.3.
    fn notifier() -> NotifierSettings {
        NotifierSettings { initiation_cost: 0.3, ..NotifierSettings::default() }
    }

    fn domain(&self) -> Result<HighwayDomain, SettingError> {
        HighwayDomain::new(self)
    }
}

/// Describes the notifier task `highway`.
pub fn entry() -> DomainEntry {
    // A policy is evaluated to the arrival: what is counted per step is counted while driving.
    DomainEntry::notifier::<HighwayWorldSettings>("highway").evaluated_with("absorb_until = 0")
}

#[cfg(test)]
#[path = "domain_tests.rs"]
mod tests;
