//! Hull and legs as one articulated body in five coordinates: the hull's place and angle, and the legs' angles.
//!
//! Reduced coordinates after rapier's multibody: a joint holds because no coordinate leads out of it. Every sum is in
//! rapier's order and in single precision, and terms that are always zero are left out, so the bits are the same.
//!
//! # Notation
//!
//! `s02`: from the parent's centre to the joint; `s23`: from the joint to the link's centre. A column of a link's
//! Jacobian is the link's velocity (x, y, spin) per unit speed of one coordinate.

use nalgebra::{Const, LU, SMatrix, SVector};
use rapier2d::math::{Pose, Rotation, Vector, rotation_from_angle};
use serde::{Deserialize, Serialize};

use super::model::{FALL, LanderModel, TIME_STEP};

/// Coordinates: the hull's x, y and angle, then the angles of the legs.
pub(super) const N_SPEEDS: usize = 5;
/// A value per coordinate.
pub(super) type Speeds = [f32; N_SPEEDS];
type MassMatrix = SMatrix<f32, N_SPEEDS, N_SPEEDS>;
type Factors = LU<f32, Const<N_SPEEDS>, Const<N_SPEEDS>>;

/// Velocity of a link at its centre.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct LinkVelocity {
    pub(super) linear: Vector,
    pub(super) angular: f32,
}

impl LinkVelocity {
    pub(super) fn at(&self, arm: Vector) -> Vector {
        self.linear + spin(self.angular, arm)
    }
}

/// Where the links are and how they move.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Motion {
    /// Poses of hull and legs; where a sweep stopped a link, its own.
    pub(super) poses: [Pose; 3],
    pub(super) speeds: Speeds,
    /// Angles of the hull and of the legs, as the coordinates' sum of steps has them.
    pub(super) angles: [f32; 3],
    /// Rotations by the legs' angles.
    leg_turns: [Rotation; 2],
    /// Velocities of the links before the last solution.
    pub(super) velocities: [LinkVelocity; 3],
}

impl Default for Motion {
    fn default() -> Self {
        Self {
            poses: [Pose::IDENTITY; 3],
            speeds: [0.0; N_SPEEDS],
            angles: [0.0; 3],
            leg_turns: [Rotation::IDENTITY; 2],
            velocities: [LinkVelocity::default(); 3],
        }
    }
}

/// The turn of a vector by a spin: the velocity that it gives to a point at `arm`.
fn spin(angular: f32, arm: Vector) -> Vector {
    arm.perp() * angular
}

/// The sum of products in the order of the coordinates.
pub(super) fn dot(a: &Speeds, b: &Speeds) -> f32 {
    let mut sum = a[0] * b[0];
    for i in 1..N_SPEEDS {
        sum += a[i] * b[i];
    }
    sum
}

pub(super) fn add_scaled(a: &mut Speeds, factor: f32, b: &Speeds) {
    for i in 0..N_SPEEDS {
        a[i] += factor * b[i];
    }
}

/// What of a leg's place its dynamics need.
#[derive(Clone, Copy)]
struct Arms {
    s02: Vector,
    s23: Vector,
}

/// One column of a link's Jacobian, and the coordinate that it is for.
#[derive(Clone, Copy)]
struct Column {
    coordinate: usize,
    linear: Vector,
    angular: f32,
}

impl Column {
    fn dot(&self, linear: Vector, angular: f32) -> f32 {
        self.linear.x * linear.x + self.linear.y * linear.y + self.angular * angular
    }
}

/// The columns that are not zero: of the hull its own three, of a leg these and its own.
type Columns = ([Column; 4], usize);

/// The dynamics of one frame: masses factored, free speeds known.
pub(super) struct Dynamics {
    columns: [Columns; 3],
    factors: Factors,
}

impl Motion {
    pub(super) fn is_finite(&self) -> bool {
        let turns = self.leg_turns.iter().flat_map(|turn| [turn.re, turn.im]);
        let velocities = self.velocities.iter().flat_map(|v| [v.linear.x, v.linear.y, v.angular]);
        let numbers = turns.chain(velocities).chain(self.speeds).chain(self.angles);
        self.poses.iter().all(Pose::is_finite) && numbers.into_iter().all(f32::is_finite)
    }

    /// Puts the links where `poses` are; the legs' coordinates are led there by displacements.
    pub(super) fn place(&mut self, poses: [Pose; 3], angles: [f32; 3]) {
        self.poses = poses;
        for (angle, goal) in self.angles.iter_mut().zip(angles) {
            *angle += goal - *angle;
        }
        self.turn_legs();
    }

    fn turn_legs(&mut self) {
        for (turn, &angle) in self.leg_turns.iter_mut().zip(&self.angles[1..]) {
            *turn = rotation_from_angle(angle);
        }
    }

    /// Places the legs at the hull.
    fn chain(&self, model: &LanderModel, hull: Pose) -> [Pose; 3] {
        let leg = |k: usize| {
            let at_hinge = Pose::from_rotation(self.leg_turns[k]) * model.leg_frames[k];
            hull * (model.hinge * at_hinge)
        };
        [hull, leg(0), leg(1)]
    }

    /// Moves the coordinates by a frame and returns where the links are then.
    pub(super) fn integrate(&mut self, model: &LanderModel) -> [Pose; 3] {
        let center = self.poses[0].translation;
        let speeds = &self.speeds;
        let center =
            Vector::new(center.x + speeds[0] * TIME_STEP, center.y + speeds[1] * TIME_STEP);
        for (angle, speed) in self.angles.iter_mut().zip(&speeds[2..]) {
            *angle += speed * TIME_STEP;
        }
        self.turn_legs();
        self.chain(model, Pose::from_parts(center, rotation_from_angle(self.angles[0])))
    }

    /// Puts the legs back to the hull before a frame; a sweep may have stopped it.
    pub(super) fn settle(&mut self, model: &LanderModel) {
        self.poses = self.chain(model, self.poses[0]);
    }

    fn arms(&self, model: &LanderModel, k: usize) -> Arms {
        let leg = &self.poses[k + 1];
        let hinge = *leg * model.leg_anchors[k];
        Arms { s02: hinge - self.poses[0].translation, s23: leg.translation - hinge }
    }

    fn update_velocities(&mut self, arms: &[Arms; 2]) {
        let [x, y, angular, ..] = self.speeds;
        let hull = LinkVelocity { linear: Vector::new(x, y), angular };
        self.velocities[0] = hull;
        for (k, arms) in arms.iter().enumerate() {
            let rate = self.speeds[3 + k];
            let shift = self.poses[k + 1].translation - self.poses[0].translation;
            let linear = hull.linear + spin(hull.angular, shift) + spin(rate, arms.s23);
            self.velocities[k + 1] = LinkVelocity { linear, angular: hull.angular + rate };
        }
    }

    /// Computes the frame's dynamics, and adds what gravity and a load on the hull do to the speeds.
    pub(super) fn begin(&mut self, model: &LanderModel, force: Vector, torque: f32) -> Dynamics {
        let arms = [self.arms(model, 0), self.arms(model, 1)];
        self.update_velocities(&arms);
        let columns = [hull_columns(), leg_columns(0, &arms[0]), leg_columns(1, &arms[1])];
        let (mass, moving_mass) = self.masses(model, &arms, &columns);
        let factors = LU::new(mass);
        let (forces, applied) = self.forces(model, &arms, &columns, force, torque);
        let mut accelerations = SVector::from(forces);
        LU::new(moving_mass).solve_mut(&mut accelerations);
        let mut accelerations: Speeds = accelerations.into();
        let fastest = self.speeds.iter().fold(0.0_f32, |most, speed| most.max(speed.abs()));
        if TIME_STEP * fastest >= 1.0e-3
            && !is_passive(&mass, &self.speeds, &accelerations, &forces, &applied)
        {
            let mut plain = SVector::from(forces);
            factors.solve_mut(&mut plain);
            accelerations = plain.into();
        }
        for (speed, acceleration) in self.speeds.iter_mut().zip(accelerations) {
            *speed += TIME_STEP * acceleration;
        }
        Dynamics { columns, factors }
    }

    /// Computes the mass matrix, and the one that contains what the turning of the links does within a frame.
    fn masses(
        &self,
        model: &LanderModel,
        arms: &[Arms; 2],
        columns: &[Columns; 3],
    ) -> (MassMatrix, MassMatrix) {
        let (mut mass, mut moving) = (MassMatrix::zeros(), MassMatrix::zeros());
        for (link, (columns, n)) in columns.iter().enumerate() {
            let columns = &columns[..*n];
            let (m, inertia) = (model.masses[link], model.inertias[link]);
            for b in columns {
                let momentum = b.linear * m;
                for a in columns {
                    let share = a.dot(momentum, inertia * b.angular);
                    mass[(a.coordinate, b.coordinate)] += share;
                    moving[(a.coordinate, b.coordinate)] += share;
                }
            }
            if link > 0 {
                self.add_turning(model, link, &arms[link - 1], columns, &mut moving);
            }
        }
        (mass, moving)
    }

    /// Adds what the turning of a leg and of the hull below it does within a frame.
    fn add_turning(
        &self,
        model: &LanderModel,
        link: usize,
        arms: &Arms,
        columns: &[Column],
        moving: &mut MassMatrix,
    ) {
        let (hull, leg) = (self.velocities[0].angular, self.velocities[link].angular);
        let [of_hull, own] = turning(hull, leg, arms).map(|v| v * (model.masses[link] * TIME_STEP));
        for (j, momentum) in [(2, of_hull), (columns[3].coordinate, own)] {
            for a in columns {
                let share = a.linear.x * momentum.x + a.linear.y * momentum.y;
                moving[(a.coordinate, j)] += share;
            }
        }
    }

    /// Computes generalized forces, all of them and those that are applied from outside.
    fn forces(
        &self,
        model: &LanderModel,
        arms: &[Arms; 2],
        columns: &[Columns; 3],
        force: Vector,
        torque: f32,
    ) -> (Speeds, Speeds) {
        let (mut all, mut applied) = ([0.0; N_SPEEDS], [0.0; N_SPEEDS]);
        for (link, (columns, n)) in columns.iter().enumerate() {
            let (user, torque) = if link == 0 { (force, torque) } else { (Vector::ZERO, 0.0) };
            let outer = user + FALL * model.masses[link];
            let inner = if link == 0 {
                outer
            } else {
                let (hull, leg) = (self.velocities[0].angular, self.velocities[link].angular);
                let Arms { s02, s23 } = arms[link - 1];
                let towards = spin(hull, spin(hull, s02)) + spin(leg, spin(leg, s23));
                outer - model.masses[link] * towards
            };
            for a in &columns[..*n] {
                all[a.coordinate] += a.dot(inner, torque);
                applied[a.coordinate] += a.dot(outer, torque);
            }
        }
        (all, applied)
    }
}

impl Dynamics {
    /// Returns the Jacobian of a force on a link: what it does to each coordinate.
    pub(super) fn jacobian(&self, link: usize, force: Vector, torque: f32) -> Speeds {
        let (columns, n) = &self.columns[link];
        let mut jacobian = [0.0; N_SPEEDS];
        for a in &columns[..*n] {
            jacobian[a.coordinate] = a.dot(force, torque);
        }
        jacobian
    }

    /// Returns the speeds that an impulse along a Jacobian gives.
    pub(super) fn response(&self, jacobian: Speeds) -> Speeds {
        let mut response = SVector::from(jacobian);
        self.factors.solve_mut(&mut response);
        response.into()
    }
}

fn hull_columns() -> Columns {
    let column = |coordinate, linear, angular| Column { coordinate, linear, angular };
    let [x, y] = [column(0, Vector::new(1.0, 0.0), 0.0), column(1, Vector::new(0.0, 1.0), 0.0)];
    ([x, y, column(2, Vector::ZERO, 1.0), column(2, Vector::ZERO, 0.0)], 3)
}

fn leg_columns(k: usize, arms: &Arms) -> Columns {
    let ([x, y, ..], _) = hull_columns();
    let own = arms.s23.perp();
    let of_hull = own + arms.s02.perp();
    let column = |coordinate, linear| Column { coordinate, linear, angular: 1.0 };
    ([x, y, column(2, of_hull), column(3 + k, own)], 4)
}

/// The velocities that the columns of the hull's angle and of the leg's own gain by the turning of the links.
fn turning(hull: f32, leg: f32, arms: &Arms) -> [Vector; 2] {
    let Arms { s02, s23 } = *arms;
    let inwards = |angular: f32, arm: Vector| -(arm * angular);
    let own = inwards(leg, s23) + inwards(leg, s23);
    let of_hull = inwards(leg, s02) + inwards(hull, s02);
    [of_hull + inwards(leg, s23) + inwards(leg, s23), own]
}

/// Returns whether accelerations add no more energy than the work of the applied forces, but for a small margin.
fn is_passive(
    mass: &MassMatrix,
    speeds: &Speeds,
    accelerations: &Speeds,
    forces: &Speeds,
    applied: &Speeds,
) -> bool {
    if accelerations.iter().any(|a| !a.is_finite()) {
        return false;
    }
    let times = |x: &Speeds| -> Speeds {
        let mut product = [0.0; N_SPEEDS];
        for (j, factor) in x.iter().enumerate() {
            for (i, value) in product.iter_mut().enumerate() {
                *value += mass[(i, j)] * factor;
            }
        }
        product
    };
    let half_square = 0.5 * TIME_STEP * TIME_STEP;
    let momentum = times(accelerations);
    let gained = TIME_STEP * dot(speeds, &momentum) + half_square * dot(accelerations, &momentum);
    let work = TIME_STEP * dot(speeds, forces) + half_square * dot(accelerations, applied);
    let kinetic = 0.5 * dot(speeds, &times(speeds));
    gained - work - (1.0e-2 * kinetic + 1.0e-8) <= 0.0
}
