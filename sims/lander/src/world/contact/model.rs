//! What the contact world is made of: shapes, masses, joints, and the numbers of its solver.
//!
//! The straightforward set-up (impulse joints, default settings) lands nothing: a leg is 68 times lighter than the
//! hull and stands between it and the ground. What works, and why each setting is there:
//!
//! * the legs are a **multibody** (reduced coordinates), so their joints hold without iterations;
//! * many velocity iterations near the ground, few elsewhere;
//! * one substep, because every substep would add its own share of gravity;
//! * a short prediction distance, because a longer one brakes the lander before it touches;
//! * the motors' target speed falls to zero at the stops, where a constant one would set up a limit cycle;
//! * no damping, and pushes as forces over one frame.

use std::sync::LazyLock;

use rapier2d::parry::shape::{ConvexPolygon, Cuboid, Shape};
use rapier2d::prelude::*;

use super::super::constants::{
    DT, FRICTION, GRAVITY, HULL, HULL_COM, HULL_CORNERS, INERTIA, LEG_ANCHOR, LEG_FRICTION,
    LEG_HALF, LEG_SIGN, LEG_UPPER, MASS, Vec2,
};
use super::super::terrain::N_POINTS;

/// Duration of a frame, in seconds.
pub(super) const TIME_STEP: f32 = DT as f32;
/// Acceleration by gravity, in m/s².
pub(super) const FALL: Vector = Vector::new(0.0, -GRAVITY as f32);
/// Half of the gap that Box2D keeps between resting shapes, in metres.
pub(super) const SKIN: f32 = 0.0075;
/// How far ahead contacts are seen, in metres.
pub(super) const PREDICTION: f32 = 0.002;
/// The two together: the gap at which a contact is looked for.
pub(super) const REACH: f32 = PREDICTION + (SKIN + SKIN);
/// The ground's middle, in metres; it is 20 wide.
pub(super) const GROUND_CENTER: Vector = Vector::new(10.0, 0.0);
/// The ground's extent and the unit of its heights, in metres.
pub(super) const GROUND_SCALE: Vector = Vector::new(20.0, 1.0);
/// Gain of the velocity motor; the torque limit is what matters.
pub(super) const MOTOR_GAIN: f32 = 1.0e4;
/// The lower stop in the contact world: a little beyond the place where the motors rest.
const LEG_LOWER_STOP: f32 = 0.326;
/// Box2D's friction grips a little less than the exact solution. Fitted on 2,500 windy and 2,000 calm episodes flown
/// with the same seeds in both worlds: without it 2.2 (± 0.6) per cent more of the windy ones land, with it 1.1.
const GRIP: f64 = 0.95;
const LANDER: Group = Group::GROUP_2;
const GROUND: Group = Group::GROUP_1;

/// The lander as the solver needs it. Masses are rapier's, because a mass and the inverse of its inverse differ in
/// the last bit.
pub(super) struct LanderModel {
    pub(super) hull: ConvexPolygon,
    pub(super) leg: Cuboid,
    pub(super) masses: [f32; 3],
    pub(super) inertias: [f32; 3],
    /// The hinge of both legs in the hull's frame.
    pub(super) hinge: Pose,
    /// The hinge in each leg's frame, and the inverse of that frame.
    pub(super) leg_anchors: [Vector; 2],
    pub(super) leg_frames: [Pose; 2],
    /// Smallest and largest angle of each leg.
    pub(super) leg_limits: [[f32; 2]; 2],
    /// Friction of each body with the ground.
    pub(super) frictions: [f32; 3],
    /// Smallest extent of each body, in metres.
    pub(super) thicknesses: [f32; 3],
    /// Middle of each body's area, in its frame.
    pub(super) middles: [Vector; 3],
    /// Distance of each body's farthest point from its centre, in metres.
    pub(super) extents: [f32; 3],
}

/// Built once per process; the same in every process.
pub(super) static MODEL: LazyLock<LanderModel> = LazyLock::new(|| {
    let Parts { mut bodies, colliders, handles } = assemble();
    for handle in handles {
        bodies[handle].recompute_mass_properties_from_colliders(&colliders);
    }
    let mass = |i: usize| bodies[handles[i]].mass_properties();
    let leg_anchors = [0, 1].map(leg_anchor);
    let shape = |i: usize| colliders[bodies[handles[i]].colliders()[0]].shape();
    LanderModel {
        hull: hull(),
        leg: leg(),
        masses: [0, 1, 2].map(|i| mass(i).effective_mass().x),
        inertias: [0, 1, 2].map(|i| mass(i).effective_angular_inertia()),
        hinge: Pose::from_translation(hinge()),
        leg_anchors,
        leg_frames: leg_anchors.map(|anchor| Pose::from_translation(anchor).inverse()),
        leg_limits: [0, 1].map(leg_limits),
        frictions: [0, 1, 2].map(|i| (grip(FRICTION) * grip(friction(i))).sqrt()),
        thicknesses: [0, 1, 2].map(|i| shape(i).ccd_thickness()),
        middles: [0, 1, 2].map(|i| shape(i).mass_properties(1.0).local_com),
        extents: [0, 1, 2].map(|i| mass(i).max_extent()),
    }
});

impl LanderModel {
    pub(super) fn shape(&self, body: usize) -> &dyn Shape {
        if body == HULL { &self.hull } else { &self.leg }
    }
}

/// The lander and its ground in rapier, not yet joined.
pub(super) struct Parts {
    pub(super) bodies: RigidBodySet,
    pub(super) colliders: ColliderSet,
    /// Hull and legs.
    pub(super) handles: [RigidBodyHandle; 3],
}

/// Makes the parts; the first collider is the ground's.
pub(super) fn assemble() -> Parts {
    let (mut bodies, mut colliders) = (RigidBodySet::new(), ColliderSet::new());
    let earth = bodies.insert(RigidBodyBuilder::fixed());
    let flat = SharedShape::heightfield(vec![3.3; N_POINTS], GROUND_SCALE);
    let ground = collider(flat, FRICTION, GROUND, LANDER).translation(GROUND_CENTER);
    colliders.insert_with_parent(ground, earth, &mut bodies);
    let handles = std::array::from_fn(|i| insert_body(&mut bodies, &mut colliders, i));
    Parts { bodies, colliders, handles }
}

fn insert_body(
    bodies: &mut RigidBodySet,
    colliders: &mut ColliderSet,
    i: usize,
) -> RigidBodyHandle {
    let mass = MassProperties::new(Vector::ZERO, MASS[i] as f32, INERTIA[i] as f32);
    let body = RigidBodyBuilder::dynamic().additional_mass_properties(mass).can_sleep(false);
    let handle = bodies.insert(body);
    let shape = if i == HULL { SharedShape::new(hull()) } else { SharedShape::new(leg()) };
    colliders.insert_with_parent(collider(shape, friction(i), LANDER, GROUND), handle, bodies);
    handle
}

fn collider(shape: SharedShape, friction: f64, own: Group, other: Group) -> ColliderBuilder {
    ColliderBuilder::new(shape)
        .density(0.0)
        .friction(grip(friction))
        .restitution(0.0)
        .contact_skin(SKIN)
        .collision_groups(InteractionGroups::new(own, other, InteractionTestMode::And))
        .friction_combine_rule(CoefficientCombineRule::GeometricMean)
}

fn hull() -> ConvexPolygon {
    let corners = HULL_CORNERS.map(|corner| vector(corner.into())).to_vec();
    ConvexPolygon::from_convex_polyline_unmodified(corners).expect("the hull is convex")
}

fn leg() -> Cuboid {
    Cuboid::new(Vector::new(LEG_HALF[0] as f32, LEG_HALF[1] as f32))
}

pub(super) fn hinge() -> Vector {
    Vector::new(0.0, -HULL_COM as f32)
}

pub(super) fn leg_anchor(k: usize) -> Vector {
    Vector::new((LEG_SIGN[k] * LEG_ANCHOR[0]) as f32, LEG_ANCHOR[1] as f32)
}

pub(super) fn leg_limits(k: usize) -> [f32; 2] {
    let upper = LEG_UPPER as f32;
    if k == 0 { [LEG_LOWER_STOP, upper] } else { [-upper, -LEG_LOWER_STOP] }
}

fn friction(i: usize) -> f64 {
    if i == HULL { FRICTION } else { LEG_FRICTION }
}

fn grip(friction: f64) -> f32 {
    (GRIP * friction) as f32
}

pub(super) fn vector(v: Vec2) -> Vector {
    Vector::new(v.x as f32, v.y as f32)
}
