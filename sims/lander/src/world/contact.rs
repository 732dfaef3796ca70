//! The contact world: hull, legs and ground in rapier2d, as Box2D would treat them.
//!
//! The straightforward set-up (impulse joints, default settings) lands nothing: a leg is 68 times lighter than the
//! hull and stands between it and the ground. What works, and why each setting is there:
//!
//! * the legs are a **multibody** (reduced coordinates), so their joints hold without iterations;
//! * many velocity iterations near the ground, few elsewhere;
//! * one substep, because every substep would add its own share of gravity;
//! * a short prediction distance, because a longer one brakes the lander before it touches;
//! * the motors' target speed falls to zero at the stops, where a constant one would set up a limit cycle;
//! * no damping, and pushes as forces over one frame, because velocities written to a multibody's bodies do not
//!   reach the solver; for the same reason velocities are read from its generalised coordinates.
//!
//! A world is entered by cloning one template that has already been stepped once, so what happened before the
//! entry leaves no trace in it.

use leadtime_proto::codec;
use leadtime_proto::limits::MAX_SNAPSHOT_BYTES;
use leadtime_sims::environment::SnapshotError;
use rapier2d::dynamics::SoftBodySet;
use rapier2d::prelude::*;
use serde::{Deserialize, Serialize};

use super::body::{Body, spin_velocity};
use super::constants::{DT, GRAVITY, HULL, HULL_COM, LEG_SIGN, LEG_SPEED, Vec2};
use super::engines::Load;
use super::flight::Flight;
use super::terrain::{N_POINTS, Terrain};

/// Velocity iterations, then stabilisation iterations.
const FAR_ITERATIONS: (usize, usize) = (2, 1);
const NEAR_ITERATIONS: (usize, usize) = (20, 4);
/// Where the motors' speed reaches zero: Box2D lets a leg park a little beyond its stop.
const LEG_PARK: f64 = 0.346;
/// Time constant with which a leg settles there.
const LEG_SETTLE: f64 = 0.04;
/// Gain of the velocity motor; the torque limit is what matters.
pub(super) const MOTOR_GAIN: f32 = 1.0e4;

/// Everything of the physics engine that the future depends on.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(super) struct Sets {
    pub(super) islands: IslandManager,
    pub(super) broad_phase: BroadPhaseBvh,
    pub(super) narrow_phase: NarrowPhase,
    pub(super) bodies: RigidBodySet,
    pub(super) colliders: ColliderSet,
    pub(super) impulse_joints: ImpulseJointSet,
    pub(super) multibody_joints: MultibodyJointSet,
    pub(super) ccd: CCDSolver,
}

/// The names of things in the sets; the same in every clone of the template.
#[derive(Clone, Copy)]
pub(super) struct Names {
    pub(super) ground: ColliderHandle,
    pub(super) bodies: [RigidBodyHandle; 3],
    pub(super) multibody: MultibodyJointHandle,
}

/// A rapier2d world with one lander in it.
pub(super) struct ContactWorld {
    pub(super) sets: Sets,
    names: Names,
    pipeline: PhysicsPipeline,
    soft_bodies: SoftBodySet,
    parameters: IntegrationParameters,
}

impl ContactWorld {
    /// Puts the engine's working memory around its state.
    pub(super) fn around(sets: Sets, names: Names) -> Self {
        Self {
            sets,
            names,
            pipeline: PhysicsPipeline::new(),
            soft_bodies: SoftBodySet::new(),
            parameters: IntegrationParameters {
                dt: DT as f32,
                min_ccd_dt: DT as f32 / 100.0,
                num_solver_iterations: 1,
                max_ccd_substeps: 1,
                contact_recycling: false,
                warmstart_joints: true,
                friction_in_bias_pass: true,
                static_contact_softness: SpringCoefficients::new(60.0, 10.0),
                normalized_prediction_distance: 0.002,
                ..IntegrationParameters::default()
            },
        }
    }

    /// Reads a world back, with fresh working memory; an error if the bytes are no such state, or lack the lander.
    pub(super) fn decode(bytes: &[u8], names: Names) -> Result<Self, SnapshotError> {
        let sets: Sets = codec::decode(bytes, MAX_SNAPSHOT_BYTES)?;
        let multibody = sets.multibody_joints.get(names.multibody);
        let complete = names.bodies.iter().all(|&body| sets.bodies.contains(body))
            && sets.colliders.contains(names.ground)
            && multibody.is_some_and(|(lander, _)| lander.num_links() == 3 && lander.ndofs() == 5);
        let missing = SnapshotError::Mismatch { what: "lander bodies" };
        complete.then(|| Self::around(sets, names)).ok_or(missing)
    }

    pub(super) fn encode(&self) -> Vec<u8> {
        codec::encode(&self.sets).expect("the engine's sets are plain data")
    }

    /// Starts afresh, from the template's sets, with a lander taken over from free flight.
    pub(super) fn enter(&mut self, template: &Sets, flight: &Flight, terrain: &Terrain) {
        self.sets.clone_from(template);
        let ground = &mut self.sets.colliders[self.names.ground];
        ground.set_shape(ground_shape(&terrain.heights));
        self.place(flight);
    }

    /// Sets poses and velocities; the multibody's coordinates by displacement, its only way in.
    pub(super) fn place(&mut self, flight: &Flight) {
        let bodies = flight.bodies();
        for (&handle, body) in self.names.bodies.iter().zip(&bodies) {
            let rigid_body = &mut self.sets.bodies[handle];
            rigid_body.set_position(pose(body), false);
            rigid_body.set_linvel(vector(body.velocity), false);
            rigid_body.set_angvel(body.spin as f32, false);
        }
        let Body { velocity, spin, .. } = bodies[HULL];
        let (angles, rates) = (flight.leg_angles, flight.leg_rates);
        let multibody = self.multibody_mut();
        multibody.damping_mut().fill(0.0);
        // Its links are the hull and the legs in their order, and so are its five coordinates.
        let speeds = [velocity.x, velocity.y, spin, rates[0], rates[1]].map(|speed| speed as f32);
        multibody.generalized_velocity_mut().copy_from_slice(&speeds);
        for (link, angle) in multibody.links_mut().zip([flight.angle, angles[0], angles[1]]) {
            let turn = angle as f32 - link.joint().coords()[2];
            // A leg's hinge has no other freedom.
            let first = if link.is_root() { 0 } else { 2 };
            link.joint.apply_displacement(&[0.0, 0.0, turn][first..]);
        }
    }

    /// Advances by one frame; `near`: contacts with the ground are possible.
    pub(super) fn step(&mut self, load: &Load, near: bool) {
        push(&mut self.sets.bodies[self.names.bodies[HULL]], load);
        self.drive_legs();
        let iterations = if near { NEAR_ITERATIONS } else { FAR_ITERATIONS };
        self.parameters.num_internal_pgs_iterations = iterations.0;
        self.parameters.num_internal_stabilization_iterations = iterations.1;
        let sets = &mut self.sets;
        self.pipeline.step(
            Vector::new(0.0, -GRAVITY as f32),
            &self.parameters,
            &mut sets.islands,
            &mut sets.broad_phase,
            &mut sets.narrow_phase,
            &mut sets.bodies,
            &mut sets.colliders,
            &mut sets.impulse_joints,
            &mut sets.multibody_joints,
            &mut self.soft_bodies,
            &mut sets.ccd,
            &(),
            &(),
        );
    }

    /// Sets the motors' speeds: full speed towards the stop, gently to rest at it.
    fn drive_legs(&mut self) {
        for (link, sign) in self.multibody_mut().links_mut().skip(1).zip(LEG_SIGN) {
            let above_park = -sign * f64::from(link.joint().coords()[2]) - LEG_PARK;
            let speed = sign * (above_park / LEG_SETTLE).min(LEG_SPEED);
            link.joint.data.set_motor_velocity(JointAxis::AngX, speed as f32, MOTOR_GAIN);
        }
    }

    pub(super) fn bodies(&self) -> [Body; 3] {
        let (multibody, _) =
            self.sets.multibody_joints.get(self.names.multibody).expect("the lander is there");
        let speeds = multibody.generalized_velocity();
        let mut bodies = self.names.bodies.map(|handle| {
            let pose = self.sets.bodies[handle].position();
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

    fn multibody_mut(&mut self) -> &mut Multibody {
        let handle = self.names.multibody;
        self.sets.multibody_joints.get_mut_internal(handle).expect("the lander is there").0
    }
}

/// Returns the ground's shape; a height field is the quickest of the equivalent ones.
pub(super) fn ground_shape(heights: &[f64; N_POINTS]) -> SharedShape {
    SharedShape::heightfield(heights.iter().map(|&y| y as f32).collect(), Vector::new(20.0, 1.0))
}

/// Applies a frame's load as forces; they are gone after the frame.
fn push(hull: &mut RigidBody, load: &Load) {
    hull.reset_forces(false);
    hull.reset_torques(false);
    if let Some(gust) = load.wind {
        hull.add_force(Vector::new(gust.force as f32, 0.0), false);
        hull.add_torque(gust.torque as f32, false);
    }
    if let Some(push) = load.engine {
        hull.add_force_at_point(vector(push.impulse / DT), vector(push.point), false);
    }
}

pub(super) fn vector(v: Vec2) -> Vector {
    Vector::new(v.x as f32, v.y as f32)
}

fn pose(body: &Body) -> Pose {
    let rotation = Rotation::from_cos_sin_unchecked(body.cos as f32, body.sin as f32);
    Pose::from_parts(vector(body.center), rotation)
}
