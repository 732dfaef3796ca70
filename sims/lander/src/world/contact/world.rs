//! The world as a whole: its state, and one frame from beginning to end.

use std::sync::LazyLock;

use leadtime_proto::codec;
use leadtime_proto::limits::MAX_SNAPSHOT_BYTES;
use leadtime_sims::environment::SnapshotError;
use rapier2d::math::{Pose, Rotation, Vector};
use rapier2d::parry::bounding_volume::Aabb;
use rapier2d::parry::shape::HeightField;
use serde::{Deserialize, Serialize};

use super::super::body::{Body, spin_velocity};
use super::super::constants::{DT, HULL, HULL_COM, LEG_SIGN, LEG_SPEED, Vec2};
use super::super::engines::Load;
use super::super::flight::Flight;
use super::super::start;
use super::super::terrain::{N_POINTS, Terrain};
use super::articulation::{LinkVelocity, Motion, Speeds};
use super::ground::{self, Manifold};
use super::model::{LanderModel, MODEL, vector};
use super::pairs::Pairs;
use super::solve::{Places, Rows};
use super::sweep;

/// Velocity iterations, then stabilisation iterations.
pub(super) const FAR_ITERATIONS: (usize, usize) = (2, 1);
pub(super) const NEAR_ITERATIONS: (usize, usize) = (20, 4);
/// Where the motors' speed reaches zero: Box2D lets a leg park a little beyond its stop.
const LEG_PARK: f64 = 0.346;
/// Time constant with which a leg settles there.
const LEG_SETTLE: f64 = 0.04;

/// Everything that the future depends on.
#[derive(Clone, Serialize, Deserialize)]
struct State {
    motion: Motion,
    manifolds: [Vec<Manifold>; 3],
    pairs: Pairs,
    /// The episode has it, too: it is made from there and not kept.
    #[serde(skip, default = "flat")]
    ground: HeightField,
    /// The lander was put where it is and has not been stepped since.
    placed: bool,
}

/// A world with one lander in it.
pub(in super::super) struct ContactWorld {
    state: State,
    rows: Rows,
}

/// The state that every contact world starts from: a lander in mid-air over flat ground, stepped once, so that what
/// the tree of pairs knows does not depend on what happened before an entry.
static TEMPLATE: LazyLock<State> = LazyLock::new(|| {
    let (bodies, angle) = start::after_hidden_frame(Vec2::zeros(), 0.0);
    let state = State {
        motion: Motion::default(),
        manifolds: Default::default(),
        pairs: Pairs::default(),
        ground: flat(),
        placed: true,
    };
    let mut world = ContactWorld { state, rows: Rows::default() };
    world.place(&Flight::take_over(&bodies, angle));
    world.step(&Load::default(), false);
    world.state
});

impl ContactWorld {
    pub(in super::super) fn new() -> Self {
        Self { state: TEMPLATE.clone(), rows: Rows::default() }
    }

    /// Reads a world back over its episode's ground; an error if the bytes are no such state.
    pub(in super::super) fn decode(bytes: &[u8], terrain: &Terrain) -> Result<Self, SnapshotError> {
        let mut state: State = codec::decode(bytes, MAX_SNAPSHOT_BYTES)?;
        state.ground = ground::shape(&terrain.heights);
        let mismatch = SnapshotError::Mismatch { what: "lander contacts" };
        state.is_complete().then(|| Self { state, rows: Rows::default() }).ok_or(mismatch)
    }

    pub(in super::super) fn encode(&self) -> Vec<u8> {
        codec::encode(&self.state).expect("the state is plain data")
    }

    /// Starts afresh with a lander taken over from free flight.
    pub(in super::super) fn enter(&mut self, flight: &Flight, terrain: &Terrain) {
        self.state.clone_from(&TEMPLATE);
        self.state.ground = ground::shape(&terrain.heights);
        self.place(flight);
    }

    fn place(&mut self, flight: &Flight) {
        let bodies = flight.bodies();
        let motion = &mut self.state.motion;
        let [left, right] = flight.leg_angles;
        let angles = [flight.angle, left, right].map(|angle| angle as f32);
        motion.place(bodies.each_ref().map(pose), angles);
        let Body { velocity, spin, .. } = bodies[HULL];
        let [left, right] = flight.leg_rates;
        motion.speeds = [velocity.x, velocity.y, spin, left, right].map(|speed| speed as f32);
        motion.velocities = bodies
            .map(|body| LinkVelocity { linear: vector(body.velocity), angular: body.spin as f32 });
        self.state.placed = true;
    }

    /// Advances by one frame; `near`: contacts with the ground are possible.
    pub(in super::super) fn step(&mut self, load: &Load, near: bool) {
        let model = &*MODEL;
        let State { motion, manifolds, pairs, ground, placed } = &mut self.state;
        let (force, torque) = push(load, motion.poses[HULL].translation);
        let motors = motor_speeds(&motion.angles);
        // Contacts are found where the last frame ended, before links that it stopped are back at the hull.
        let (seen, velocities) = (motion.poses, motion.velocities);
        motion.settle(model);
        let boxes = std::mem::take(placed).then(|| placed_boxes(model, ground, &seen));
        pairs.update(boxes.as_ref().map_or(&[], |boxes| boxes), |gone| manifolds[gone].clear());
        let dynamics = motion.begin(model, force, torque);
        self.rows.clear();
        for (k, motor) in motors.into_iter().enumerate() {
            self.rows.add_leg(model, &dynamics, k, motion.angles[k + 1], motor);
        }
        for &body in pairs.order() {
            ground::touch(model, ground, body, &seen[body], &mut manifolds[body]);
            let place = ground::BodyPlace {
                body,
                seen: seen[body],
                pose: motion.poses[body],
                velocity: velocities[body],
            };
            for (i, manifold) in manifolds[body].iter().enumerate() {
                self.rows.add_manifold(model, &dynamics, &place, i, manifold);
            }
        }
        let (iterations, stabilisations) = if near { NEAR_ITERATIONS } else { FAR_ITERATIONS };
        self.rows.start(&mut motion.speeds);
        self.rows.sweep(&mut motion.speeds, iterations, Places::Corrected);
        let next = motion.integrate(model);
        self.rows.sweep(&mut motion.speeds, stabilisations, Places::Left);
        self.rows.keep(manifolds);
        for (body, to) in next.iter().enumerate() {
            let pose = &mut motion.poses[body];
            *pose = sweep::stop(model, ground, body, pose, to);
            pairs.follow(body, ground::search_box(model.shape(body), pose));
        }
    }

    pub(in super::super) fn bodies(&self) -> [Body; 3] {
        bodies_of(&self.state.motion.poses, &self.state.motion.speeds)
    }
}

impl State {
    /// Returns whether every index leads somewhere and every number is one.
    fn is_complete(&self) -> bool {
        let mut points = self.manifolds.iter().flatten().flat_map(|manifold| &manifold.points);
        self.pairs.is_complete()
            && self.motion.is_finite()
            && points.all(|p| p.data.normal.is_finite() && p.data.tangent.is_finite())
    }
}

fn flat() -> HeightField {
    ground::shape(&[3.3; N_POINTS])
}

/// Returns the boxes of ground and bodies in the order of the tree's leaves.
fn placed_boxes(model: &LanderModel, ground: &HeightField, seen: &[Pose; 3]) -> [Aabb; 4] {
    let of = |body: usize| ground::search_box(model.shape(body), &seen[body]);
    [ground::search_box(ground, &ground::pose()), of(0), of(1), of(2)]
}

/// Returns a frame's load as force on the hull's centre and torque.
pub(super) fn push(load: &Load, center: Vector) -> (Vector, f32) {
    let (mut force, mut torque) = (Vector::ZERO, 0.0);
    if let Some(gust) = load.wind {
        force += Vector::new(gust.force as f32, 0.0);
        torque += gust.torque as f32;
    }
    if let Some(push) = load.engine {
        let thrust = vector(push.impulse / DT);
        force += thrust;
        torque += (vector(push.point) - center).perp_dot(thrust);
    }
    (force, torque)
}

/// Returns the motors' speeds: full speed towards the stop, gently to rest at it.
pub(super) fn motor_speeds(angles: &[f32; 3]) -> [f32; 2] {
    [0, 1].map(|k| {
        let sign = LEG_SIGN[k];
        let above_park = -sign * f64::from(angles[k + 1]) - LEG_PARK;
        (sign * (above_park / LEG_SETTLE).min(LEG_SPEED)) as f32
    })
}

pub(super) fn pose(body: &Body) -> Pose {
    let rotation = Rotation::from_cos_sin_unchecked(body.cos as f32, body.sin as f32);
    Pose::from_parts(vector(body.center), rotation)
}

/// Returns the bodies' states, in double precision, from poses and generalized velocities.
pub(super) fn bodies_of(poses: &[Pose; 3], speeds: &Speeds) -> [Body; 3] {
    let mut bodies = poses.map(|pose| {
        let center = Vec2::new(f64::from(pose.translation.x), f64::from(pose.translation.y));
        Body::at_rest(center, f64::from(pose.rotation.re), f64::from(pose.rotation.im))
    });
    bodies[HULL].velocity = Vec2::new(f64::from(speeds[0]), f64::from(speeds[1]));
    bodies[HULL].spin = f64::from(speeds[2]);
    let hull = bodies[HULL];
    let to_hinge = hull.turn(Vec2::new(0.0, -HULL_COM));
    for (k, leg) in bodies[1..].iter_mut().enumerate() {
        leg.spin = hull.spin + f64::from(speeds[3 + k]);
        let from_hinge = leg.center - hull.center - to_hinge;
        leg.velocity = hull.velocity
            + spin_velocity(hull.spin, to_hinge)
            + spin_velocity(leg.spin, from_hinge);
    }
    bodies
}
