//! Building the world that every contact world is a clone of.

use std::sync::LazyLock;

use rapier2d::prelude::*;

use super::body::Body;
use super::constants::{
    FRICTION, HULL, HULL_COM, HULL_CORNERS, INERTIA, LEG_ANCHOR, LEG_FRICTION, LEG_HALF, LEG_SIGN,
    LEG_SPEED, LEG_TORQUE, LEG_UPPER, MASS, Vec2,
};
use super::contact::{ContactWorld, MOTOR_GAIN, Names, Sets, ground_shape, vector};
use super::engines::Load;
use super::flight::Flight;
use super::start;
use super::terrain::N_POINTS;

/// Half of the gap that Box2D keeps between resting shapes.
const SKIN: f32 = 0.0075;
/// Box2D's friction grips a little less than the exact solution. Fitted on 2,500 windy and 2,000 calm episodes flown
/// with the same seeds in both worlds: without it 2.2 (± 0.6) per cent more of the windy ones land, with it 1.1.
const GRIP: f64 = 0.95;
/// The lower stop in the contact world: a little beyond the place where the motors rest.
const LEG_LOWER_STOP: f32 = 0.326;
const LANDER: Group = Group::GROUP_2;
const GROUND: Group = Group::GROUP_1;

/// The world that all others are cloned from.
pub(super) struct Template {
    pub(super) sets: Sets,
    pub(super) names: Names,
}

/// Kept for the life of the process; it is the same in every process.
pub(super) static TEMPLATE: LazyLock<Template> = LazyLock::new(build);

/// Builds the template: a lander in mid-air over flat ground, stepped once so that everything is registered.
fn build() -> Template {
    let (bodies, angle) = start::after_hidden_frame(Vec2::zeros(), 0.0);
    let (sets, names) = assemble(&bodies);
    let mut world = ContactWorld::around(sets, names);
    let flight = Flight::take_over(&bodies, angle);
    world.place(&flight);
    world.step(&Load::default(), false);
    Template { sets: world.sets, names }
}

fn assemble(poses: &[Body; 3]) -> (Sets, Names) {
    let mut sets = Sets::default();
    let ground = insert_ground(&mut sets);
    let bodies = std::array::from_fn(|i| insert_body(&mut sets, i, &poses[i]));
    let [first, _] = std::array::from_fn(|k| insert_leg_joint(&mut sets, &bodies, k));
    (sets, Names { ground, bodies, multibody: first })
}

fn collider(shape: SharedShape, friction: f64, own: Group, other: Group) -> ColliderBuilder {
    ColliderBuilder::new(shape)
        .density(0.0)
        .friction((GRIP * friction) as f32)
        .restitution(0.0)
        .contact_skin(SKIN)
        .collision_groups(InteractionGroups::new(own, other, InteractionTestMode::And))
        .friction_combine_rule(CoefficientCombineRule::GeometricMean)
}

fn insert_ground(sets: &mut Sets) -> ColliderHandle {
    let body = sets.bodies.insert(RigidBodyBuilder::fixed());
    let shape = collider(ground_shape(&[3.3; N_POINTS]), FRICTION, GROUND, LANDER)
        .translation(Vector::new(10.0, 0.0));
    sets.colliders.insert_with_parent(shape, body, &mut sets.bodies)
}

fn insert_body(sets: &mut Sets, i: usize, at: &Body) -> RigidBodyHandle {
    let mass = MassProperties::new(Vector::ZERO, MASS[i] as f32, INERTIA[i] as f32);
    let body = RigidBodyBuilder::dynamic()
        .additional_mass_properties(mass)
        .can_sleep(false)
        .translation(vector(at.center))
        .rotation(libm::atan2(at.sin, at.cos) as f32);
    let handle = sets.bodies.insert(body);
    let (shape, friction) = if i == HULL {
        let corners = HULL_CORNERS.map(|corner| vector(corner.into())).to_vec();
        let hull = SharedShape::convex_polyline_unmodified(corners).expect("the hull is convex");
        (hull, FRICTION)
    } else {
        (SharedShape::cuboid(LEG_HALF[0] as f32, LEG_HALF[1] as f32), LEG_FRICTION)
    };
    let shape = collider(shape, friction, LANDER, GROUND);
    sets.colliders.insert_with_parent(shape, handle, &mut sets.bodies);
    handle
}

fn insert_leg_joint(
    sets: &mut Sets,
    bodies: &[RigidBodyHandle; 3],
    k: usize,
) -> MultibodyJointHandle {
    let sign = LEG_SIGN[k];
    let upper = LEG_UPPER as f32;
    let limits = if k == 0 { [LEG_LOWER_STOP, upper] } else { [-upper, -LEG_LOWER_STOP] };
    let anchor = Vector::new((sign * LEG_ANCHOR[0]) as f32, LEG_ANCHOR[1] as f32);
    let joint = RevoluteJointBuilder::new()
        .local_anchor1(Vector::new(0.0, -HULL_COM as f32))
        .local_anchor2(anchor)
        .contacts_enabled(false)
        .limits(limits)
        .motor_model(MotorModel::ForceBased)
        .motor_velocity((sign * LEG_SPEED) as f32, MOTOR_GAIN)
        .motor_max_force(LEG_TORQUE as f32);
    sets.multibody_joints
        .insert(bodies[HULL], bodies[k + 1], joint, false)
        .expect("two bodies without a joint between them")
}
