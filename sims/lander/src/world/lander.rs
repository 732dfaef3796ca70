//! One lander world: terrain, lander, weather, and the order of everything in a frame.
//!
//! # Invariants
//!
//! * Random draws come in Gymnasium's order, so a generator seeded as Gymnasium's makes the same episode: twelve
//!   heights, two start forces, the wind's two starts (if windy), then two dispersion draws in every frame, the
//!   hidden first one included.
//! * A frame depends on the snapshot and on the engine alone: nothing of earlier episodes is left.

use std::fmt;

use leadtime_numerics::Pcg64;
use leadtime_sims::environment::SnapshotError;
use serde::{Deserialize, Serialize};

use super::body::Body;
use super::constants::{HULL, Vec2};
use super::contact::ContactWorld;
use super::engines::{Engine, Load, WindClock, draw_dispersion};
use super::flight::Flight;
use super::observe;
use super::settings::{Physics, PhysicsSettings};
use super::sleep::Sleep;
use super::start;
use super::terrain::{N_POINTS, Terrain};
use super::touch::Touch;

/// Frames without nearness or touch before the free-flight integrator takes over again.
const CLEAR_FRAMES: u32 = 3;

/// How an episode of the lander ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LanderOutcome {
    /// It came to rest (on the pad or elsewhere) without its hull ever touching the ground.
    Landed,
    /// Its hull touched the ground.
    Crashed,
    /// It left the view sideways.
    Out,
}

/// What one frame gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// The observation after it.
    pub observation: [f32; 8],
    /// The reward of the original: difference of potentials minus fuel; ±100 at the end.
    pub reward: f64,
    /// How the episode ended, if this frame was its last; the world must be reset then.
    pub outcome: Option<LanderOutcome>,
}

/// Which physics moves the lander at the moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum Integrator {
    /// Exact free flight, clear of the ground.
    Flight(Flight),
    /// The contact world, for so many frames clear of the ground.
    Contact { clear_frames: u32 },
}

/// Everything of an episode but the contact world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct LanderEpisode {
    rng: Pcg64,
    terrain: Terrain,
    wind: Option<WindClock>,
    integrator: Integrator,
    bodies: [Body; 3],
    angle: f64,
    touch: Touch,
    sleep: Sleep,
    shaping: f64,
    observation: [f32; 8],
}

/// How much a snapshot may grow beyond twice its size in the air, in bytes: contacts with the ground take some four
/// kilobytes.
pub(crate) const SNAPSHOT_MARGIN: usize = 8 << 10;

/// A lander world in the middle of an episode, ready to be stored or sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LanderSnapshot {
    physics: Physics,
    episode: LanderEpisode,
    /// The physics engine's state, only while it is what moves the lander.
    contact: Option<Vec<u8>>,
}

/// The world of `LunarLander-v3` on rapier2d.
///
/// # Example
///
/// ```
/// use leadtime_numerics::Pcg64;
/// use leadtime_lander::pilot::heuristic;
/// use leadtime_lander::world::{Lander, PhysicsSettings};
///
/// let mut lander = Lander::new(&PhysicsSettings::default());
/// let mut observation = lander.reset(Pcg64::seed_from_u64(0));
/// let outcome = (0..1000).find_map(|_| {
///     let frame = lander.step(heuristic(&observation));
///     observation = frame.observation;
///     frame.outcome
/// });
/// assert_eq!(outcome, Some(leadtime_lander::world::LanderOutcome::Landed));
/// ```
pub struct Lander {
    settings: PhysicsSettings,
    episode: LanderEpisode,
    /// Kept between episodes for its memory only.
    contact: Option<Box<ContactWorld>>,
}

impl fmt::Debug for Lander {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Lander")
            .field("settings", &self.settings)
            .field("episode", &self.episode)
            .finish_non_exhaustive()
    }
}

impl Lander {
    /// Makes a world; it stands at the start of the episode of seed 0.
    pub fn new(settings: &PhysicsSettings) -> Self {
        let mut contact = None;
        let episode = LanderEpisode::start(settings, Pcg64::seed_from_u64(0), &mut contact);
        Self { settings: settings.clone(), episode, contact }
    }

    /// Sets, from the next episode, whether the wind blows, and the largest start force (in newtons, acting for one
    /// frame in each direction).
    pub fn set_start(&mut self, wind: bool, impulse: f64) {
        (self.settings.wind, self.settings.start_impulse) = (wind, impulse);
    }

    /// Starts an episode and returns its first observation.
    ///
    /// With `Pcg64::seed_from_u64(seed)` this is Gymnasium's `reset(seed=seed)`: the same ground, the same push,
    /// the same wind, and the same dispersion in every frame to come.
    pub fn reset(&mut self, rng: Pcg64) -> [f32; 8] {
        self.episode = LanderEpisode::start(&self.settings, rng, &mut self.contact);
        self.episode.observation
    }

    /// Advances by one frame, 0.02 s.
    pub fn step(&mut self, engine: Engine) -> Frame {
        let load = self.episode.load(&self.settings, engine);
        self.shift();
        self.episode.advance(&load, self.contact.as_deref_mut());
        self.episode.score(engine)
    }

    /// Changes the integrator where the distance to the ground asks for it.
    fn shift(&mut self) {
        let episode = &mut self.episode;
        let clear = !episode.touch.near && !episode.touch.any();
        match &mut episode.integrator {
            Integrator::Flight(_) if episode.touch.near => episode.enter_contact(&mut self.contact),
            Integrator::Contact { clear_frames } if self.settings.physics == Physics::Hybrid => {
                *clear_frames = if clear { *clear_frames + 1 } else { 0 };
                if *clear_frames > CLEAR_FRAMES {
                    let flight = Flight::take_over(&episode.bodies, episode.angle);
                    episode.integrator = Integrator::Flight(flight);
                }
            }
            Integrator::Flight(_) | Integrator::Contact { .. } => {}
        }
    }

    /// Returns the current observation: x, y, vx, vy, angle, angular velocity, leg flags (right leg first).
    pub fn observation(&self) -> &[f32; 8] {
        &self.episode.observation
    }

    /// Returns the hull's origin in metres; the world is 20 wide and the pad lies at (10, 3.3).
    pub fn position(&self) -> [f64; 2] {
        self.episode.bodies[HULL].origin().into()
    }

    /// Returns the hull's angle in radians, unwrapped; positive is counter-clockwise.
    pub fn angle(&self) -> f64 {
        self.episode.angle
    }

    /// Returns the leg flags as the original computes them, right leg first.
    pub fn leg_contacts(&self) -> [bool; 2] {
        self.episode.touch.legs
    }

    /// Returns the ground as a line, in the units of observed positions.
    pub(super) fn terrain_outline(&self) -> Vec<[f64; 2]> {
        let point = |i| observe::to_observation_units(self.episode.terrain.point(i)).into();
        (0..N_POINTS).map(point).collect()
    }

    /// Returns a body's corners, in the units of observed positions.
    pub(super) fn outline(&self, i: usize) -> Vec<[f64; 2]> {
        let outline = self.episode.bodies[i].outline(i == HULL);
        outline.corners().iter().map(|&c| observe::to_observation_units(c).into()).collect()
    }

    /// Returns whether the contact world moves the lander at the moment.
    pub fn is_in_contact(&self) -> bool {
        matches!(self.episode.integrator, Integrator::Contact { .. })
    }

    /// Captures everything that the rest of the episode depends on.
    ///
    /// In free flight that is half a kilobyte; the contact world adds its own state.
    pub fn snapshot(&self) -> LanderSnapshot {
        let contact = self.contact.as_ref().filter(|_| self.is_in_contact());
        LanderSnapshot {
            physics: self.settings.physics,
            episode: self.episode.clone(),
            contact: contact.map(|world| world.encode()),
        }
    }

    /// Continues from a snapshot, bit for bit; settings of later episodes stay as they are.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the snapshot is of another physics, its contacts cannot be read, or no flight comes to what
    /// it holds; nothing has changed then.
    pub fn restore(&mut self, snapshot: &LanderSnapshot) -> Result<(), SnapshotError> {
        if snapshot.physics != self.settings.physics {
            return Err(SnapshotError::Mismatch { what: "lander physics" });
        }
        if !snapshot.episode.is_plausible() {
            return Err(SnapshotError::Mismatch { what: "lander flight" });
        }
        match (&snapshot.contact, snapshot.episode.integrator) {
            (Some(bytes), Integrator::Contact { .. }) => {
                let world = ContactWorld::decode(bytes, &snapshot.episode.terrain)?;
                self.contact = Some(Box::new(world));
            }
            (None, Integrator::Flight(_)) => {}
            _ => return Err(SnapshotError::Mismatch { what: "lander integrator" }),
        }
        self.episode = snapshot.episode.clone();
        Ok(())
    }
}

impl LanderEpisode {
    fn start(
        settings: &PhysicsSettings,
        mut rng: Pcg64,
        contact: &mut Option<Box<ContactWorld>>,
    ) -> Self {
        let terrain = Terrain::draw(&mut rng);
        let reach = settings.start_impulse;
        let mut force = Vec2::new(rng.uniform(-reach, reach), rng.uniform(-reach, reach));
        let mut wind = settings.wind.then(|| WindClock::draw(&mut rng));
        let gust = wind.as_mut().map(|clock| clock.blow(settings)).unwrap_or_default();
        force.x += gust.force;
        draw_dispersion(&mut rng);
        let (bodies, angle) = start::after_hidden_frame(force, gust.torque);
        let state = observe::state(&bodies, angle, [false; 2]);
        let mut episode = Self {
            rng,
            terrain,
            wind,
            integrator: Integrator::Flight(Flight::take_over(&bodies, angle)),
            bodies,
            angle,
            touch: Touch::default(),
            sleep: Sleep::default(),
            shaping: observe::shaping(&state),
            observation: state.map(|value| value as f32),
        };
        if settings.physics == Physics::Rapier {
            episode.enter_contact(contact);
        }
        episode
    }

    /// Returns whether a flight can have come to this and can go on: it shows what it is, and every number is one.
    fn is_plausible(&self) -> bool {
        let state = observe::state(&self.bodies, self.angle, self.touch.legs);
        let moves = match &self.integrator {
            Integrator::Flight(flight) => flight.is_possible(),
            Integrator::Contact { clear_frames } => *clear_frames <= CLEAR_FRAMES,
        };
        moves
            && self.is_within_reach(&state)
            && self.observation == state.map(|value| value as f32)
            && self.shaping == observe::shaping(&state)
            && self.terrain.is_possible()
            && self.sleep.is_finite()
    }

    /// Returns whether a flight can come to a state of the bodies.
    fn is_within_reach(&self, state: &[f64; 8]) -> bool {
        observe::is_possible(state) && self.bodies.iter().all(Body::is_finite)
    }

    /// Hands the lander over to the contact world.
    fn enter_contact(&mut self, contact: &mut Option<Box<ContactWorld>>) {
        let Integrator::Flight(flight) = &self.integrator else { return };
        let world = contact.get_or_insert_with(|| Box::new(ContactWorld::new()));
        world.enter(flight, &self.terrain);
        self.integrator = Integrator::Contact { clear_frames: 0 };
    }

    /// Gathers what pushes the lander in the coming frame; draws the frame's random numbers.
    fn load(&mut self, settings: &PhysicsSettings, engine: Engine) -> Load {
        let flying = self.touch.legs == [false; 2];
        let wind = self.wind.as_mut().filter(|_| flying).map(|clock| clock.blow(settings));
        let dispersion = draw_dispersion(&mut self.rng);
        Load { engine: engine.push(&self.bodies[HULL], dispersion), wind }
    }

    /// Moves the lander, and finds out what it touches.
    fn advance(&mut self, load: &Load, contact: Option<&mut ContactWorld>) {
        match (&mut self.integrator, contact) {
            (Integrator::Flight(flight), _) => {
                flight.step(&self.bodies[HULL], load);
                self.bodies = flight.bodies();
                self.angle = flight.angle;
            }
            (Integrator::Contact { .. }, Some(world)) => {
                world.step(load, self.touch.near);
                let before = std::mem::replace(&mut self.bodies, world.bodies())[HULL];
                self.angle += self.bodies[HULL].angle_from(&before);
            }
            (Integrator::Contact { .. }, None) => unreachable!("the contact world has its world"),
        }
        self.touch.update(&self.bodies, &self.terrain);
    }

    /// Computes observation, reward and end of the frame.
    fn score(&mut self, engine: Engine) -> Frame {
        let asleep = self.sleep.update(&self.bodies);
        let state = observe::state(&self.bodies, self.angle, self.touch.legs);
        if !self.is_within_reach(&state) {
            // Only an ascent of twenty minutes comes here, or a snapshot that somebody made up: a spin that no frame can follow
            // grows until it is no number. What was seen last stays: a rollout with such numbers is refused.
            let (observation, outcome) = (self.observation, Some(LanderOutcome::Out));
            return Frame { observation, reward: -100.0, outcome };
        }
        let shaping = observe::shaping(&state);
        let difference = shaping - self.shaping - engine.fuel();
        self.shaping = shaping;
        self.observation = state.map(|value| value as f32);
        let (outcome, reward) = if asleep {
            (Some(LanderOutcome::Landed), 100.0)
        } else if self.touch.hull {
            (Some(LanderOutcome::Crashed), -100.0)
        } else if state[0].abs() >= 1.0 {
            (Some(LanderOutcome::Out), -100.0)
        } else {
            (None, difference)
        };
        Frame { observation: self.observation, reward, outcome }
    }
}

#[cfg(test)]
mod tests {
    use super::super::contact::rapier::Twin;
    use super::*;
    use crate::pilot::heuristic;

    /// A lander whose contact frames rapier computes, too.
    struct Pair {
        lander: Lander,
        twin: Twin,
    }

    impl Pair {
        /// Steps both, and returns whether they were compared.
        fn step(&mut self, engine: Engine) -> (Frame, bool) {
            let Self { lander, twin } = self;
            let load = lander.episode.load(&lander.settings, engine);
            let before = lander.episode.integrator;
            lander.shift();
            let compared = lander.is_in_contact();
            if let (true, Integrator::Flight(flight)) = (compared, &before) {
                twin.enter(flight, &lander.episode.terrain);
            }
            if compared {
                twin.step(&load, lander.episode.touch.near);
            }
            lander.episode.advance(&load, lander.contact.as_deref_mut());
            if compared {
                assert_eq!(lander.episode.bodies, twin.bodies());
            }
            (lander.episode.score(engine), compared)
        }
    }

    #[test]
    fn contacts_that_are_no_numbers_are_not_restored() {
        let settings = PhysicsSettings { physics: Physics::Rapier, ..PhysicsSettings::default() };
        let mut lander = Lander::new(&settings);
        lander.step(Engine::Main);
        let mut snapshot = lander.snapshot();
        let contact = snapshot.contact.as_mut().unwrap();
        // The state begins with a number of the hull's pose; here it is NaN.
        contact[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        let error = lander.restore(&snapshot).unwrap_err();
        assert!(matches!(error, SnapshotError::Mismatch { .. }), "{error}");
    }

    #[test]
    fn a_flight_that_cannot_have_been_is_not_restored() {
        let mut lander = Lander::new(&PhysicsSettings::default());
        lander.step(Engine::Main);
        let flown = lander.snapshot();
        let changes: [fn(&mut LanderEpisode); 9] = [
            |it| it.bodies[HULL].center.y = f64::NAN,
            |it| it.bodies[1].velocity.x = f64::INFINITY,
            // It is elsewhere than it shows.
            |it| it.bodies[HULL].center.x += 1.0,
            // It shows where it is, which is far beyond any flight.
            |it| {
                it.bodies[HULL].center.y = 1e12;
                let state = observe::state(&it.bodies, it.angle, it.touch.legs);
                it.observation = state.map(|value| value as f32);
                it.shaping = observe::shaping(&state);
            },
            |it| it.observation[7] = f32::NAN,
            |it| it.shaping = 1e12,
            |it| it.terrain.heights[0] = f64::NAN,
            |it| it.terrain.top = 1e9,
            |it| {
                if let Integrator::Flight(flight) = &mut it.integrator {
                    flight.leg_rates[0] = f64::NAN;
                }
            },
        ];
        for (i, change) in changes.into_iter().enumerate() {
            let mut snapshot = flown.clone();
            change(&mut snapshot.episode);
            let error = lander.restore(&snapshot).unwrap_err();
            let is_it = matches!(error, SnapshotError::Mismatch { what: "lander flight" });
            assert!(is_it, "change {i}: {error}");
            assert_eq!(lander.snapshot(), flown, "change {i}");
        }
        lander.restore(&flown).unwrap();
    }

    #[test]
    fn a_spin_that_no_frame_can_follow_ends_the_flight_and_is_not_seen() {
        let mut lander = Lander::new(&PhysicsSettings::default());
        let mut snapshot = lander.snapshot();
        let episode = &mut snapshot.episode;
        episode.bodies.iter_mut().for_each(|body| body.spin = 1e5);
        episode.integrator = Integrator::Flight(Flight::take_over(&episode.bodies, episode.angle));
        let state = observe::state(&episode.bodies, episode.angle, episode.touch.legs);
        episode.observation = state.map(|value| value as f32);
        episode.shaping = observe::shaping(&state);
        lander.restore(&snapshot).unwrap();
        let last = (0..10).map(|_| lander.step(Engine::Idle)).find(|it| it.outcome.is_some());
        let last = last.expect("it flies apart within a few frames");
        assert_eq!((last.outcome, last.reward), (Some(LanderOutcome::Out), -100.0));
        assert!(last.observation.iter().all(|value| value.abs() <= 1e6), "{last:?}");
        assert_eq!(lander.observation(), &last.observation);
    }

    #[test]
    fn the_contact_world_is_rapiers_bit_for_bit() {
        let mut rng = Pcg64::seed_from_u64(7);
        let settings = PhysicsSettings::default();
        let mut pair = Pair { lander: Lander::new(&settings), twin: Twin::new() };
        let mut compared = 0;
        for seed in 0..500_u64 {
            pair.lander.set_start(seed.is_multiple_of(3), settings.start_impulse);
            let mut observation = pair.lander.reset(Pcg64::seed_from_u64(seed));
            for _ in 0..1000 {
                // Landings, crashes, bounces on a busy engine, and tumbling.
                let chance = rng.next_u64();
                let engine = match seed % 4 {
                    0 => Engine::ALL[(chance >> 62) as usize],
                    2 if chance.is_multiple_of(3) => Engine::ALL[(chance >> 62) as usize],
                    3 if chance.is_multiple_of(2) => Engine::Main,
                    _ => heuristic(&observation),
                };
                let (frame, both) = pair.step(engine);
                compared += usize::from(both);
                observation = frame.observation;
                if frame.outcome.is_some() {
                    break;
                }
            }
        }
        assert!(compared > 40_000, "{compared} frames");
    }
}
