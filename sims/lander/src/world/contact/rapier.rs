//! The same world stepped by rapier itself: what the contact world must equal, bit for bit.

use rapier2d::dynamics::SoftBodySet;
use rapier2d::prelude::*;

use super::super::body::Body;
use super::super::constants::{GRAVITY, HULL, LEG_TORQUE, Vec2};
use super::super::engines::Load;
use super::super::flight::Flight;
use super::super::start;
use super::super::terrain::{N_POINTS, Terrain};
use super::model::{
    GROUND_SCALE, MOTOR_GAIN, PREDICTION, Parts, TIME_STEP, assemble, hinge, leg_anchor,
    leg_limits, vector,
};
use super::world::{FAR_ITERATIONS, NEAR_ITERATIONS, bodies_of, motor_speeds, pose, push};

#[derive(Clone, Default)]
struct Sets {
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    bodies: RigidBodySet,
    colliders: ColliderSet,
    impulse_joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    ccd: CCDSolver,
}

/// A world of rapier with one lander in it.
pub(in super::super) struct Twin {
    sets: Sets,
    template: Sets,
    handles: [RigidBodyHandle; 3],
    ground: ColliderHandle,
    multibody: MultibodyJointHandle,
    pipeline: PhysicsPipeline,
    soft_bodies: SoftBodySet,
    parameters: IntegrationParameters,
}

impl Twin {
    pub(in super::super) fn new() -> Self {
        let Parts { bodies, colliders, handles } = assemble();
        let (ground, _) = colliders.iter().next().expect("the ground comes first");
        let mut multibody_joints = MultibodyJointSet::new();
        let [multibody, _] = std::array::from_fn(|k| {
            multibody_joints
                .insert(handles[HULL], handles[k + 1], leg_joint(k), false)
                .expect("two bodies without a joint between them")
        });
        let sets = Sets { bodies, colliders, multibody_joints, ..Sets::default() };
        let mut twin = Self {
            sets,
            template: Sets::default(),
            handles,
            ground,
            multibody,
            pipeline: PhysicsPipeline::new(),
            soft_bodies: SoftBodySet::new(),
            parameters: IntegrationParameters {
                dt: TIME_STEP,
                min_ccd_dt: TIME_STEP / 100.0,
                num_solver_iterations: 1,
                max_ccd_substeps: 1,
                contact_recycling: false,
                warmstart_joints: true,
                friction_in_bias_pass: true,
                static_contact_softness: SpringCoefficients::new(60.0, 10.0),
                normalized_prediction_distance: PREDICTION,
                ..IntegrationParameters::default()
            },
        };
        let (bodies, angle) = start::after_hidden_frame(Vec2::zeros(), 0.0);
        twin.place(&Flight::take_over(&bodies, angle));
        twin.step(&Load::default(), false);
        twin.template = twin.sets.clone();
        twin
    }

    pub(in super::super) fn enter(&mut self, flight: &Flight, terrain: &Terrain) {
        self.sets.clone_from(&self.template);
        let heights: [f64; N_POINTS] = terrain.heights;
        let shape = SharedShape::heightfield(heights.map(|y| y as f32).to_vec(), GROUND_SCALE);
        self.sets.colliders[self.ground].set_shape(shape);
        self.place(flight);
    }

    /// Sets poses and velocities; the multibody's coordinates by displacement, its only way in.
    fn place(&mut self, flight: &Flight) {
        let bodies = flight.bodies();
        for (&handle, body) in self.handles.iter().zip(&bodies) {
            let rigid_body = &mut self.sets.bodies[handle];
            rigid_body.set_position(pose(body), false);
            rigid_body.set_linvel(vector(body.velocity), false);
            rigid_body.set_angvel(body.spin as f32, false);
        }
        let Body { velocity, spin, .. } = bodies[HULL];
        let (angles, rates) = (flight.leg_angles, flight.leg_rates);
        let multibody = self.multibody_mut();
        multibody.damping_mut().fill(0.0);
        let speeds = [velocity.x, velocity.y, spin, rates[0], rates[1]].map(|speed| speed as f32);
        multibody.generalized_velocity_mut().copy_from_slice(&speeds);
        for (link, angle) in multibody.links_mut().zip([flight.angle, angles[0], angles[1]]) {
            let turn = angle as f32 - link.joint().coords()[2];
            // A leg's hinge has no other freedom.
            let first = if link.is_root() { 0 } else { 2 };
            link.joint.apply_displacement(&[0.0, 0.0, turn][first..]);
        }
    }

    pub(in super::super) fn step(&mut self, load: &Load, near: bool) {
        let hull = &mut self.sets.bodies[self.handles[HULL]];
        let (force, torque) = push(load, hull.center_of_mass());
        hull.reset_forces(false);
        hull.reset_torques(false);
        hull.add_force(force, false);
        hull.add_torque(torque, false);
        let mut angles = [0.0; 3];
        for (angle, link) in angles.iter_mut().zip(self.multibody_mut().links()) {
            *angle = link.joint().coords()[2];
        }
        let speeds = motor_speeds(&angles);
        for (link, speed) in self.multibody_mut().links_mut().skip(1).zip(speeds) {
            link.joint.data.set_motor_velocity(JointAxis::AngX, speed, MOTOR_GAIN);
        }
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

    pub(in super::super) fn bodies(&self) -> [Body; 3] {
        let poses = self.handles.map(|handle| *self.sets.bodies[handle].position());
        let (multibody, _) =
            self.sets.multibody_joints.get(self.multibody).expect("the lander is there");
        let speeds = multibody.generalized_velocity();
        bodies_of(&poses, &std::array::from_fn(|i| speeds[i]))
    }

    fn multibody_mut(&mut self) -> &mut Multibody {
        let joints = &mut self.sets.multibody_joints;
        joints.get_mut_internal(self.multibody).expect("the lander is there").0
    }
}

fn leg_joint(k: usize) -> RevoluteJointBuilder {
    RevoluteJointBuilder::new()
        .local_anchor1(hinge())
        .local_anchor2(leg_anchor(k))
        .contacts_enabled(false)
        .limits(leg_limits(k))
        .motor_model(MotorModel::ForceBased)
        .motor_velocity(0.0, MOTOR_GAIN)
        .motor_max_force(LEG_TORQUE as f32)
}
