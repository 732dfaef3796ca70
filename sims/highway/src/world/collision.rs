//! Collisions: rectangles now, and along the coming frame's relative movement.
//!
//! # Source
//!
//! Separating axes, as in highway-env 1.12.1, `vehicle/objects.py` and `utils.py`.

use super::constants::{LENGTH, OBSTACLE, WIDTH};
use super::traffic::Traffic;
use super::vehicle::Vehicle;

/// A rectangle that moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// The centre, in metres.
    pub position: [f64; 2],
    /// (cos, sin) of the heading.
    pub direction: [f64; 2],
    /// Length and width, in metres.
    pub size: [f64; 2],
    /// In m/s, along the heading.
    pub speed: f64,
}

/// What two bodies do to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The two bodies overlap now.
    pub touches: bool,
    /// If they will touch: by how much the first must move so that they do not.
    pub translation: Option<[f64; 2]>,
}

const NO_CONTACT: Contact = Contact { touches: false, translation: None };

impl Footprint {
    /// Returns a car's body.
    pub fn of(vehicle: &Vehicle) -> Self {
        let (position, direction) = (vehicle.position, vehicle.direction());
        Self { position, direction, size: [LENGTH, WIDTH], speed: vehicle.speed }
    }

    /// Returns an obstacle's body.
    pub fn obstacle(position: [f64; 2]) -> Self {
        Self { position, direction: [1.0, 0.0], size: [OBSTACLE; 2], speed: 0.0 }
    }

    pub(crate) fn corners(&self) -> [[f64; 2]; 4] {
        let ([x, y], [cosine, sine]) = (self.position, self.direction);
        let [length, width] = [self.size[0] / 2.0, self.size[1] / 2.0];
        [[-length, -width], [-length, width], [length, width], [length, -width]]
            .map(|[s, r]| [x + cosine * s - sine * r, y + sine * s + cosine * r])
    }

    fn diagonal(&self) -> f64 {
        libm::sqrt(self.size[0] * self.size[0] + self.size[1] * self.size[1])
    }

    fn velocity(&self) -> [f64; 2] {
        [self.speed * self.direction[0], self.speed * self.direction[1]]
    }
}

/// Computes the contact of two bodies within a frame of `dt` seconds.
pub fn contact(a: &Footprint, b: &Footprint, dt: f64) -> Contact {
    let [dx, dy] = [b.position[0] - a.position[0], b.position[1] - a.position[1]];
    let reach = f64::midpoint(a.diagonal(), b.diagonal()) + a.speed * dt;
    // A car that rolls backwards fast has a negative reach.
    if reach < 0.0 || dx * dx + dy * dy > reach * reach {
        return NO_CONTACT;
    }
    let (corners_a, corners_b) = (a.corners(), b.corners());
    let (velocity_a, velocity_b) = (a.velocity(), b.velocity());
    let moved = [(velocity_a[0] - velocity_b[0]) * dt, (velocity_a[1] - velocity_b[1]) * dt];
    let between = [0, 1].map(|axis| mean(&corners_a, axis) - mean(&corners_b, axis));
    let (mut touches, mut will_touch) = (true, true);
    let (mut smallest, mut translation) = (f64::INFINITY, [0.0; 2]);
    for corners in [&corners_a, &corners_b] {
        for edge in 0..4 {
            let normal = normal(corners[edge], corners[(edge + 1) % 4]);
            let (mut own, other) = (interval(&corners_a, normal), interval(&corners_b, normal));
            touches &= gap(own, other) <= 0.0;
            let shift = dot(normal, moved);
            own[usize::from(shift >= 0.0)] += shift;
            let gap = gap(own, other);
            will_touch &= gap <= 0.0;
            if !touches && !will_touch {
                return NO_CONTACT;
            }
            if gap.abs() < smallest {
                smallest = gap.abs();
                let sign = if dot(between, normal) > 0.0 { smallest } else { -smallest };
                translation = [sign * normal[0], sign * normal[1]];
            }
        }
    }
    Contact { touches, translation: will_touch.then_some(translation) }
}

fn mean(corners: &[[f64; 2]; 4], axis: usize) -> f64 {
    corners.iter().map(|corner| corner[axis]).sum::<f64>() / 4.0
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn normal(p: [f64; 2], q: [f64; 2]) -> [f64; 2] {
    let [x, y] = [p[1] - q[1], q[0] - p[0]];
    let length = libm::sqrt(x * x + y * y);
    [x / length, y / length]
}

/// Projects corners on an axis: `[least, greatest]`.
fn interval(corners: &[[f64; 2]; 4], axis: [f64; 2]) -> [f64; 2] {
    let places = corners.map(|corner| dot(corner, axis));
    let low = places.into_iter().fold(f64::INFINITY, f64::min);
    let high = places.into_iter().fold(f64::NEG_INFINITY, f64::max);
    [low, high]
}

/// Returns the gap between two intervals; negative where they overlap.
fn gap(a: [f64; 2], b: [f64; 2]) -> f64 {
    if a[0] < b[0] { b[0] - a[1] } else { a[0] - b[1] }
}

impl Traffic {
    /// Checks all pairs of cars, and all cars against all obstacles.
    pub(super) fn collide(&mut self, dt: f64) {
        let n_vehicles = self.vehicles.len();
        for i in 0..n_vehicles {
            let body = Footprint::of(&self.vehicles[i]);
            for j in i + 1..n_vehicles {
                let contact = contact(&body, &Footprint::of(&self.vehicles[j]), dt);
                if let Some([x, y]) = contact.translation {
                    self.vehicles[i].impact = Some([x / 2.0, y / 2.0]);
                    self.vehicles[j].impact = Some([-x / 2.0, -y / 2.0]);
                }
                self.vehicles[i].crashed |= contact.touches;
                self.vehicles[j].crashed |= contact.touches;
            }
            for &obstacle in &self.road.obstacles {
                let contact = contact(&body, &Footprint::obstacle(obstacle), dt);
                if contact.translation.is_some() {
                    self.vehicles[i].impact = contact.translation;
                }
                self.vehicles[i].crashed |= contact.touches;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1.0 / 15.0;

    fn car(x: f64, y: f64, speed: f64) -> Footprint {
        Footprint { position: [x, y], direction: [1.0, 0.0], size: [LENGTH, WIDTH], speed }
    }

    #[test]
    fn touching_now_and_touching_soon_differ() {
        assert_eq!(contact(&car(0.0, 0.0, 20.0), &car(7.5, 0.0, 10.0), DT), NO_CONTACT);
        let soon = contact(&car(0.0, 0.0, 20.0), &car(5.5, 0.0, 10.0), DT);
        assert!(!soon.touches);
        let [x, y] = soon.translation.unwrap();
        assert!((x + 1.0 / 6.0).abs() < 1e-12 && y == 0.0, "{x} {y}");
        assert!(contact(&car(0.0, 0.0, 20.0), &car(4.9, 0.0, 10.0), DT).touches);
        // Side by side without a gap counts as touching.
        assert!(contact(&car(0.0, 0.0, 0.0), &car(0.0, 2.0, 0.0), DT).touches);
        assert!(!contact(&car(0.0, 0.0, 0.0), &car(0.0, 2.01, 0.0), DT).touches);
    }

    #[test]
    fn obstacles_are_small_and_stand_still() {
        let obstacle = Footprint::obstacle([10.0, 0.0]);
        assert!(!contact(&car(6.4, 0.0, 0.0), &obstacle, DT).touches);
        assert!(contact(&car(6.6, 0.0, 0.0), &obstacle, DT).touches);
        assert!(contact(&car(6.4, 0.0, 10.0), &obstacle, DT).translation.is_some());
    }
}
