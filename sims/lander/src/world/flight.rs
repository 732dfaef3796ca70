//! The free-flight integrator: hull and legs as one body whose legs follow their motors.
//!
//! In the air nothing but engines, wind and gravity acts, and the motors are never near their torque limit (the
//! strongest engine frame asks for 0.05 of the 0.8 N m s that they have). So the legs turn at prescribed rates
//! towards their lower stops, and linear and angular momentum of the whole determine the rest exactly: no solver,
//! no iteration, no drift. Compared with Box2D its median error is smaller than that of the contact world.
//!
//! # Notation
//!
//! Hull frame: origin at the hull's centre of mass. The hinge of both legs is the hull's origin, at (0, -`HULL_COM`).

use serde::{Deserialize, Serialize};

use super::body::{Body, cross, rotate, spin_velocity};
use super::constants::{
    DT, GRAVITY, HULL, HULL_COM, INERTIA, LEG_ANCHOR, LEG_LOWER, LEG_SIGN, LEG_SPEED, MASS,
    TOTAL_MASS, Vec2,
};
use super::engines::Load;

/// What a spinning lander adds to its legs' speed, per squared spin: Box2D's joint correction pulls them in a little.
/// Fitted (residual 1.3e-5 rad over 22 frames), because it decides in which frame a leg reaches its stop.
const LEG_CREEP: f64 = 8.0e-4;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Flight {
    /// Common centre of mass.
    center: Vec2,
    /// Velocity of the centre of mass.
    velocity: Vec2,
    /// Angular momentum about it.
    angular_momentum: f64,
    /// The hull's angle, never wrapped.
    pub(super) angle: f64,
    /// The hull's angular velocity.
    spin: f64,
    /// Angles of the legs relative to the hull.
    pub(super) leg_angles: [f64; 2],
    /// Rates of the legs relative to the hull.
    pub(super) leg_rates: [f64; 2],
    stance: Stance,
}

/// What follows from the legs' angles alone; they rest most of the time, so it is kept.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Stance {
    /// Cosine and sine of each leg's angle relative to the hull.
    turns: [(f64, f64); 2],
    /// From the hinge to each leg's centre, hull frame.
    arms: [Vec2; 2],
    /// Common centre of mass, hull frame.
    center: Vec2,
    /// Inertia of the whole about its centre of mass.
    inertia: f64,
    /// Angular momentum of the whole per unit rate of each leg.
    coupling: [f64; 2],
}

impl Stance {
    fn of(angles: [f64; 2]) -> Self {
        let turns = angles.map(|angle| {
            let (sin, cos) = libm::sincos(angle);
            (cos, sin)
        });
        let arms = [0, 1].map(|k| {
            let anchor = Vec2::new(LEG_SIGN[k] * LEG_ANCHOR[0], LEG_ANCHOR[1]);
            -rotate(turns[k].0, turns[k].1, anchor)
        });
        let hinge = Vec2::new(0.0, -HULL_COM);
        let center: Vec2 = (0..2).map(|k| (hinge + arms[k]) * (MASS[k + 1] / TOTAL_MASS)).sum();
        let mut inertia = INERTIA[HULL] + MASS[HULL] * center.norm_squared();
        let mut coupling = [0.0; 2];
        for k in 0..2 {
            let from_center = hinge + arms[k] - center;
            inertia += INERTIA[k + 1] + MASS[k + 1] * from_center.norm_squared();
            coupling[k] = INERTIA[k + 1] + MASS[k + 1] * from_center.dot(&arms[k]);
        }
        Self { turns, arms, center, inertia, coupling }
    }

    /// Returns the hull's spin that an angular momentum means while the legs turn at given rates.
    fn spin(&self, angular_momentum: f64, leg_rates: [f64; 2]) -> f64 {
        let legs = self.coupling[0] * leg_rates[0] + self.coupling[1] * leg_rates[1];
        (angular_momentum - legs) / self.inertia
    }
}

impl Flight {
    /// Takes over hull and legs with all their linear and angular momentum.
    ///
    /// `angle` is the hull's, unwrapped; its cosine and sine are those of the hull's body.
    pub(super) fn take_over(bodies: &[Body; 3], angle: f64) -> Self {
        let weighted = |value: fn(&Body) -> Vec2| {
            (0..3).map(|i| value(&bodies[i]) * (MASS[i] / TOTAL_MASS)).sum::<Vec2>()
        };
        let (center, velocity) = (weighted(|body| body.center), weighted(|body| body.velocity));
        let momentum = |i: usize| {
            let moment = cross(bodies[i].center - center, bodies[i].velocity - velocity);
            MASS[i] * moment + INERTIA[i] * bodies[i].spin
        };
        let angular_momentum = (0..3).map(momentum).sum();
        let hull = &bodies[HULL];
        let leg_angles = [1, 2].map(|i| bodies[i].angle_from(hull));
        let leg_rates = [1, 2].map(|i| bodies[i].spin - hull.spin);
        let stance = Stance::of(leg_angles);
        let spin = stance.spin(angular_momentum, leg_rates);
        Self { center, velocity, angular_momentum, angle, spin, leg_angles, leg_rates, stance }
    }

    /// Returns whether every number of it is one, and its stance is that of its legs.
    pub(super) fn is_possible(&self) -> bool {
        let Self { center, velocity, angular_momentum, angle, spin, leg_angles, leg_rates, stance } =
            *self;
        let vectors = [center, velocity].map(|v| [v.x, v.y]);
        let pairs = vectors.into_iter().chain([[angle, spin], leg_angles, leg_rates]);
        let mut numbers = pairs.flatten().chain([angular_momentum]);
        stance == Stance::of(leg_angles) && numbers.all(f64::is_finite)
    }

    /// Advances by one frame: momenta first, then positions with the new velocities, as Box2D does.
    pub(super) fn step(&mut self, hull: &Body, load: &Load) {
        if let Some(push) = load.engine {
            self.velocity += push.impulse / TOTAL_MASS;
            self.angular_momentum += cross(push.point - self.center, push.impulse);
        }
        if let Some(gust) = load.wind {
            let impulse = Vec2::new(gust.force * DT, 0.0);
            self.velocity += impulse / TOTAL_MASS;
            self.angular_momentum += cross(hull.center - self.center, impulse) + gust.torque * DT;
        }
        self.velocity.y -= GRAVITY * DT;
        let speed = LEG_SPEED + LEG_CREEP * self.spin * self.spin;
        for ((rate, angle), sign) in self.leg_rates.iter_mut().zip(self.leg_angles).zip(LEG_SIGN) {
            let above_stop = -sign * angle - LEG_LOWER;
            *rate = if above_stop > 0.0 { speed * sign } else { 0.0 };
        }
        self.spin = self.stance.spin(self.angular_momentum, self.leg_rates);
        self.angular_momentum -= self.joint_loss();
        self.center += self.velocity * DT;
        self.angle += self.spin * DT;
        if self.leg_rates != [0.0; 2] {
            for k in 0..2 {
                self.leg_angles[k] += self.leg_rates[k] * DT;
            }
            self.stance = Stance::of(self.leg_angles);
        }
    }

    /// Computes the angular momentum that Box2D's joints lose in a frame.
    ///
    /// It moves each body along its tangent and then pulls the bodies back onto their joints without touching
    /// their velocities, so the next frame finds each orbital velocity turned by -w dt against its radius: a
    /// factor cos(w dt) on the orbital part. It shows only in a tumbling lander.
    fn joint_loss(&self) -> f64 {
        let orbital = self.stance.inertia - INERTIA.iter().sum::<f64>();
        0.5 * orbital * self.spin * (self.spin * DT).powi(2)
    }

    pub(super) fn bodies(&self) -> [Body; 3] {
        let (sin, cos) = libm::sincos(self.angle);
        let world = |v: Vec2| rotate(cos, sin, v);
        let center = world(self.stance.center);
        let swing = [0, 1].map(|k| spin_velocity(self.leg_rates[k], world(self.stance.arms[k])));
        let legs_share = (swing[0] * MASS[1] + swing[1] * MASS[2]) / TOTAL_MASS;
        let hull = Body {
            center: self.center - center,
            cos,
            sin,
            velocity: self.velocity - spin_velocity(self.spin, center) - legs_share,
            spin: self.spin,
        };
        let leg = |k: usize| {
            let offset = world(Vec2::new(0.0, -HULL_COM) + self.stance.arms[k]);
            let (leg_cos, leg_sin) = self.stance.turns[k];
            Body {
                center: hull.center + offset,
                cos: cos * leg_cos - sin * leg_sin,
                sin: sin * leg_cos + cos * leg_sin,
                velocity: hull.velocity + spin_velocity(self.spin, offset) + swing[k],
                spin: self.spin + self.leg_rates[k],
            }
        };
        [hull, leg(0), leg(1)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::engines::{Gust, Push};
    use super::super::start;
    use super::*;

    fn start() -> Flight {
        let (bodies, angle) = start::after_hidden_frame(Vec2::new(300.0, -200.0), 0.0);
        Flight::take_over(&bodies, angle)
    }

    fn coast(flight: &mut Flight, n_frames: usize) {
        (0..n_frames).for_each(|_| flight.step(&flight.bodies()[HULL], &Load::default()));
    }

    #[test]
    fn taking_over_ones_own_bodies_changes_nothing() {
        let mut flight = start();
        for _ in 0..30 {
            coast(&mut flight, 1);
            let again = Flight::take_over(&flight.bodies(), flight.angle);
            assert!((again.center - flight.center).norm() < 1e-9);
            assert!((again.velocity - flight.velocity).norm() < 1e-9);
            assert!((again.leg_angles[0] - flight.leg_angles[0]).abs() < 1e-9);
            // The spin comes from the legs' place before the frame, so it lags by a few millionths.
            assert!((again.spin - flight.spin).abs() < 1e-3);
        }
    }

    #[test]
    fn without_a_load_the_lander_falls_and_loses_only_what_its_joints_lose() {
        let mut flight = start();
        let (momentum, fall) = (flight.angular_momentum, flight.velocity.y);
        coast(&mut flight, 50);
        let kept = flight.angular_momentum / momentum;
        assert!((0.9999..1.0).contains(&kept), "{kept}");
        assert!((flight.velocity.y - (fall - GRAVITY)).abs() < 1e-9);
    }

    #[test]
    fn legs_come_to_rest_at_their_lower_stops() {
        let mut flight = start();
        coast(&mut flight, 100);
        for (angle, sign) in flight.leg_angles.iter().zip(LEG_SIGN) {
            assert!((0.343..=0.351).contains(&(-sign * angle)), "{angle}");
        }
        assert_eq!(flight.leg_rates, [0.0; 2]);
    }

    #[test]
    fn a_push_through_the_centre_does_not_turn() {
        let mut flight = start();
        let before = flight.angular_momentum;
        let push = Push { impulse: Vec2::new(1.0, 2.0), point: flight.center };
        let gust = Gust { force: 0.0, torque: 1.0 };
        flight.step(&flight.bodies()[HULL], &Load { engine: Some(push), wind: Some(gust) });
        // The joints lose some 6e-8 of it in this frame.
        assert!((flight.angular_momentum - before - DT).abs() < 1e-6);
    }
}
