//! The solver: projected Gauss–Seidel over the legs' stops and motors and the contacts with the ground.
//!
//! Rows, right-hand sides and the order of solution are rapier's, for one articulated body on fixed ground. A sweep
//! that changes no speed would be repeated by all that follow it, so it is the last one.

use rapier2d::dynamics::SpringCoefficients;
use rapier2d::math::Vector;

use super::super::constants::LEG_TORQUE;
use super::articulation::{Dynamics, N_SPEEDS, Speeds, add_scaled, dot};
use super::ground::{BodyPlace, ContactPoint, Impulses, Manifold, points};
use super::model::{LanderModel, MOTOR_GAIN, TIME_STEP};

/// Contacts with fixed ground are stiffer than others: natural frequency in Hz, damping ratio.
const CONTACT_SOFTNESS: SpringCoefficients<f32> =
    SpringCoefficients { natural_frequency: 60.0, damping_ratio: 10.0 };
/// A penetration is undone no faster than this, in m/s.
const MAX_CORRECTION: f32 = 3.0;
const INV_TIME_STEP: f32 = 1.0 / TIME_STEP;

/// A stop or a motor of one leg; it acts on the leg's coordinate alone.
struct JointRow {
    coordinate: usize,
    response: Speeds,
    inverse: f32,
    softness: f32,
    bounds: [f32; 2],
    /// Right-hand side with and without the correction of the place.
    biased: f32,
    free: f32,
    impulse: f32,
}

/// One direction at a contact point.
struct ContactRow {
    jacobian: Speeds,
    response: Speeds,
    inverse: f32,
    /// Right-hand side with and without the correction of the place.
    biased: f32,
    free: f32,
    impulse: f32,
}

/// A contact point's rows, and where its impulses are kept: body, manifold, point.
struct PointRows {
    place: [usize; 3],
    normal: ContactRow,
    tangent: ContactRow,
}

/// The points of one manifold: their normals are solved before their tangents.
struct Patch {
    friction: f32,
    points: std::ops::Range<usize>,
}

/// What a sweep does about errors of the place.
#[derive(Clone, Copy)]
pub(super) enum Places {
    Corrected,
    Left,
}

impl Places {
    fn right_side(self, biased: f32, free: f32) -> f32 {
        match self {
            Self::Corrected => biased,
            Self::Left => free,
        }
    }
}

/// The rows of a frame; their memory is kept from frame to frame.
#[derive(Default)]
pub(super) struct Rows {
    joints: Vec<JointRow>,
    points: Vec<PointRows>,
    patches: Vec<Patch>,
}

impl Rows {
    pub(super) fn clear(&mut self) {
        self.joints.clear();
        self.points.clear();
        self.patches.clear();
    }

    /// Adds the stop of a leg, if the leg is beyond it, and its motor.
    pub(super) fn add_leg(
        &mut self,
        model: &LanderModel,
        dynamics: &Dynamics,
        k: usize,
        angle: f32,
        speed: f32,
    ) {
        let coordinate = 3 + k;
        let mut unit = [0.0; N_SPEEDS];
        unit[coordinate] = 1.0;
        let response = dynamics.response(unit);
        let own = response[coordinate];
        let row = |softness: f32, bounds: [f32; 2], biased: f32, free: f32| {
            let inverse = inverse_of(own + softness);
            JointRow { coordinate, response, inverse, softness, bounds, biased, free, impulse: 0.0 }
        };
        let [lower, upper] = model.leg_limits[k];
        if angle < lower || upper < angle {
            let stop = SpringCoefficients::<f32>::joint_defaults();
            let bounds = if angle < lower { [-f32::MAX, 0.0] } else { [0.0, f32::MAX] };
            let beyond = (angle - upper).max(0.0) - (lower - angle).max(0.0);
            let biased = beyond * stop.erp_inv_dt(TIME_STEP);
            self.joints.push(row(own * stop.cfm_coeff(TIME_STEP), bounds, biased, 0.0));
        }
        let most = LEG_TORQUE as f32 * TIME_STEP;
        let [least, fastest] = [lower, upper].map(|stop| (stop - angle) * INV_TIME_STEP);
        let speed = within(speed, least, fastest);
        self.joints.push(row(inverse_of(TIME_STEP * MOTOR_GAIN), [-most, most], -speed, -speed));
    }

    /// Adds the points of a body's manifold, starting with their impulses of the last frame.
    pub(super) fn add_manifold(
        &mut self,
        model: &LanderModel,
        dynamics: &Dynamics,
        place: &BodyPlace,
        i: usize,
        manifold: &Manifold,
    ) {
        let (first, body) = (self.points.len(), place.body);
        points(manifold, place, |point| {
            let impulses = manifold.points[point.index].data;
            let [normal, tangent] =
                contact_rows(dynamics, body, -manifold.local_n1, &point, impulses);
            self.points.push(PointRows { place: [body, i, point.index], normal, tangent });
        });
        let points = first..self.points.len();
        if !points.is_empty() {
            self.patches.push(Patch { friction: model.frictions[body], points });
        }
    }

    /// Applies the impulses with which the frame starts.
    pub(super) fn start(&self, speeds: &mut Speeds) {
        for patch in &self.patches {
            let points = &self.points[patch.points.clone()];
            for row in points.iter().map(|point| &point.normal) {
                add_scaled(speeds, row.impulse, &row.response);
            }
            for row in points.iter().map(|point| &point.tangent) {
                add_scaled(speeds, row.impulse, &row.response);
            }
        }
    }

    /// Sweeps over all rows up to `n` times.
    pub(super) fn sweep(&mut self, speeds: &mut Speeds, n: usize, places: Places) {
        // What softness leaves of a contact's impulse.
        let kept = match places {
            Places::Corrected => CONTACT_SOFTNESS.cfm_factor(TIME_STEP),
            Places::Left => 1.0,
        };
        for _ in 0..n {
            let mut moved = false;
            for row in &mut self.joints {
                moved |= row.solve(speeds, places);
            }
            for patch in &self.patches {
                let points = &mut self.points[patch.points.clone()];
                for point in &mut *points {
                    moved |= point.normal.solve_normal(speeds, places, kept);
                }
                for point in points {
                    let limit = patch.friction * point.normal.impulse;
                    moved |= point.tangent.solve_tangent(speeds, places, limit);
                }
            }
            if !moved {
                break;
            }
        }
    }

    /// Keeps the impulses for the next frame.
    pub(super) fn keep(&self, manifolds: &mut [Vec<Manifold>; 3]) {
        for point in &self.points {
            let [body, i, index] = point.place;
            let kept = &mut manifolds[body][i].points[index].data;
            // A sum with zero has no sign of zero, as in rapier's snapshots.
            kept.normal = point.normal.impulse + 0.0;
            kept.tangent = point.tangent.impulse + 0.0;
        }
    }
}

impl JointRow {
    /// Solves the row, and returns whether a speed has changed.
    fn solve(&mut self, speeds: &mut Speeds, places: Places) -> bool {
        let error = places.right_side(self.biased, self.free) + speeds[self.coordinate];
        let [least, most] = self.bounds;
        let impulse = self.impulse + self.inverse * (error - self.softness * self.impulse);
        let impulse = within(impulse, least, most);
        let change = impulse - self.impulse;
        self.impulse = impulse;
        add_scaled(speeds, -change, &self.response);
        change != 0.0
    }
}

impl ContactRow {
    fn error(&self, speeds: &Speeds, places: Places) -> f32 {
        dot(&self.jacobian, speeds) + places.right_side(self.biased, self.free)
    }

    fn solve_normal(&mut self, speeds: &mut Speeds, places: Places, kept: f32) -> bool {
        let error = self.error(speeds, places);
        self.change_to(speeds, kept * (self.impulse - self.inverse * error).max(0.0))
    }

    fn solve_tangent(&mut self, speeds: &mut Speeds, places: Places, limit: f32) -> bool {
        let impulse = self.impulse - self.inverse * self.error(speeds, places);
        self.change_to(speeds, within(impulse, -limit, limit))
    }

    fn change_to(&mut self, speeds: &mut Speeds, impulse: f32) -> bool {
        let change = impulse - self.impulse;
        self.impulse = impulse;
        add_scaled(speeds, change, &self.response);
        change != 0.0
    }
}

/// Sets up the rows along a contact's normal and along the ground; `direction` points into the ground.
fn contact_rows(
    dynamics: &Dynamics,
    body: usize,
    direction: Vector,
    point: &ContactPoint,
    impulses: Impulses,
) -> [ContactRow; 2] {
    let along = direction.perp();
    let row = |force: Vector, biased: f32, free: f32, impulse: f32| {
        let jacobian = dynamics.jacobian(body, force, point.arm.perp_dot(force));
        let response = dynamics.response(jacobian);
        let inverse = inverse_of(dot(&jacobian, &response));
        ContactRow { jacobian, response, inverse, biased, free, impulse }
    };
    let free = point.gap.max(0.0) * INV_TIME_STEP;
    let correction =
        (CONTACT_SOFTNESS.erp_inv_dt(TIME_STEP) * point.gap).clamp(-MAX_CORRECTION, 0.0);
    let slide = point.offset.dot(along) * INV_TIME_STEP;
    [
        row(-direction, free + correction, free, impulses.normal),
        row(-along, slide, 0.0, impulses.tangent),
    ]
}

/// Bounds a number; unlike the standard library's, without a panic where a bound is none.
fn within(value: f32, least: f32, most: f32) -> f32 {
    if value < least {
        least
    } else if value > most {
        most
    } else {
        value
    }
}

/// Returns the inverse of a number, or zero if it is next to zero.
fn inverse_of(value: f32) -> f32 {
    if value.abs() <= 1.0e-20 { 0.0 } else { 1.0 / value }
}
