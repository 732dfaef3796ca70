//! A lane: a straight base line, about which the centre line may swing as a sine.
//!
//! The frame is seen from above: x forwards, y to the **right** of a car driving along +x, a positive heading turns
//! towards +y. Local coordinates are (s, r): s along the base line, r across it from the centre line to the right.

use serde::{Deserialize, Serialize};

use super::constants::LENGTH;

/// How the centre line swings about the base line: offset(s) = amplitude · sin(pulsation · s + phase).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wave {
    /// In metres, to the right.
    pub amplitude: f64,
    /// In radians per metre.
    pub pulsation: f64,
    /// Phase of the wave, in radians.
    pub phase: f64,
}

/// A lane as a person writes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LaneSettings {
    /// The node where it begins.
    pub from: String,
    /// The node where it ends. Lanes of the same two nodes lie side by side.
    pub to: String,
    /// Where its base line begins, `[x, y]` in metres.
    pub start: [f64; 2],
    /// Where its base line ends.
    pub end: [f64; 2],
    /// In metres (1 to 20). Default 4.
    #[serde(default = "default_width")]
    pub width: f64,
    /// In m/s (1 to 40): what IDM drivers keep to. Default 20.
    #[serde(default = "default_speed_limit")]
    pub speed_limit: f64,
    /// Whether nobody may change into it: true for ramps. Default false.
    #[serde(default)]
    pub forbidden: bool,
    /// How its centre line swings about the base line. Default: not at all.
    #[serde(default)]
    pub wave: Option<Wave>,
}

fn default_width() -> f64 {
    4.0
}

fn default_speed_limit() -> f64 {
    20.0
}

impl LaneSettings {
    /// Lays a lane with the defaults between two nodes.
    pub fn new(from: &str, to: &str, start: [f64; 2], end: [f64; 2]) -> Self {
        let (width, speed_limit) = (default_width(), default_speed_limit());
        let (from, to) = (from.to_owned(), to.to_owned());
        Self { from, to, start, end, width, speed_limit, forbidden: false, wave: None }
    }
}

/// A lane whose length and direction are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Lane {
    start: [f64; 2],
    direction: [f64; 2],
    heading: f64,
    /// Length of the base line, in metres.
    pub length: f64,
    /// Width of the lane, in metres.
    pub width: f64,
    /// What IDM drivers keep to, in m/s.
    pub speed_limit: f64,
    /// Whether nobody may change into it.
    pub forbidden: bool,
    wave: Option<Wave>,
}

impl Lane {
    pub(super) fn new(settings: &LaneSettings) -> Self {
        let [dx, dy] = [settings.end[0] - settings.start[0], settings.end[1] - settings.start[1]];
        let length = libm::sqrt(dx * dx + dy * dy);
        Self {
            start: settings.start,
            direction: [dx / length, dy / length],
            heading: libm::atan2(dy, dx),
            length,
            width: settings.width,
            speed_limit: settings.speed_limit,
            forbidden: settings.forbidden,
            wave: settings.wave,
        }
    }

    /// Returns s of a point: how far along the base line it lies.
    pub fn along(&self, [x, y]: [f64; 2]) -> f64 {
        (x - self.start[0]) * self.direction[0] + (y - self.start[1]) * self.direction[1]
    }

    /// Returns (s, r) of a point.
    pub fn local(&self, point: [f64; 2]) -> [f64; 2] {
        let s = self.along(point);
        [s, self.across(point) - self.offset(s)]
    }

    /// Returns the point at (s, r).
    pub fn position(&self, s: f64, r: f64) -> [f64; 2] {
        let ([dx, dy], r) = (self.direction, r + self.offset(s));
        [self.start[0] + s * dx - r * dy, self.start[1] + s * dy + r * dx]
    }

    /// Returns where the centre line ends.
    pub fn end(&self) -> [f64; 2] {
        self.position(self.length, 0.0)
    }

    /// Returns the heading of the centre line at s.
    pub fn heading(&self, s: f64) -> f64 {
        let slope = self.wave.map_or(0.0, |Wave { amplitude, pulsation, phase }| {
            libm::atan(amplitude * pulsation * libm::cos(pulsation * s + phase))
        });
        self.heading + slope
    }

    /// Returns s of a point that lies on the lane, or at most `margin` metres next to it and a car's length beyond
    /// its ends.
    pub fn holds(&self, point: [f64; 2], margin: f64) -> Option<f64> {
        let s = self.along(point);
        // The ends first: most points are far off, and the centre line's swing is costly.
        if !(-LENGTH..self.length + LENGTH).contains(&s) {
            return None;
        }
        let r = self.across(point) - self.offset(s);
        (r.abs() <= self.width / 2.0 + margin).then_some(s)
    }

    /// Returns whether a car at a point may change into it.
    pub fn is_reachable_from(&self, point: [f64; 2]) -> bool {
        let [s, r] = self.local(point);
        let near = r.abs() <= 2.0 * self.width && (0.0..self.length + LENGTH).contains(&s);
        near && !self.forbidden
    }

    /// Returns whether a point lies within half a car's length of its end, or beyond.
    pub fn is_behind(&self, point: [f64; 2]) -> bool {
        self.along(point) > self.length - LENGTH / 2.0
    }

    /// Returns the distance of a point, measured across the base line and beyond its ends.
    pub fn distance(&self, point: [f64; 2]) -> f64 {
        let [s, r] = self.local(point);
        r.abs() + (s - self.length).max(0.0) + (-s).max(0.0)
    }

    /// Returns by how much a heading differs from the lane's at a point.
    pub fn misalignment(&self, point: [f64; 2], heading: f64) -> f64 {
        let difference = heading - self.heading(self.along(point));
        // Wrapping costs a division and most headings need none; in the inner half turn it changes nothing.
        if difference.abs() < 3.0 { difference.abs() } else { wrap(difference).abs() }
    }

    fn across(&self, [x, y]: [f64; 2]) -> f64 {
        (y - self.start[1]) * self.direction[0] - (x - self.start[0]) * self.direction[1]
    }

    fn offset(&self, s: f64) -> f64 {
        self.wave.map_or(0.0, |Wave { amplitude, pulsation, phase }| {
            amplitude * libm::sin(pulsation * s + phase)
        })
    }
}

/// Brings an angle into [-π, π).
pub(super) fn wrap(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;

    fn lane(end: [f64; 2], wave: Option<Wave>) -> Lane {
        Lane::new(&LaneSettings { wave, ..LaneSettings::new("a", "b", [10.0, 5.0], end) })
    }

    #[test]
    fn right_is_where_y_grows() {
        let east = lane([90.0, 5.0], None);
        assert_eq!(east.local([30.0, 7.0]), [20.0, 2.0]);
        let north = lane([10.0, 85.0], None);
        assert_eq!(north.local([8.0, 35.0]), [30.0, 2.0]);
        assert_eq!(north.position(30.0, 2.0), [8.0, 35.0]);
        assert_eq!(north.heading(3.0), FRAC_PI_2);
    }

    #[test]
    fn a_wave_swings_from_one_side_to_the_other() {
        let wave = Wave { amplitude: 3.25, pulsation: PI / 80.0, phase: FRAC_PI_2 };
        let lane = lane([90.0, 5.0], Some(wave));
        assert!((lane.position(0.0, 0.0)[1] - 8.25).abs() < 1e-12);
        assert!((lane.position(80.0, 1.0)[1] - 2.75).abs() < 1e-12);
        assert!((lane.local([50.0, 6.0])[1] - 1.0).abs() < 1e-12);
        assert!((lane.heading(40.0) + libm::atan(3.25 * PI / 80.0)).abs() < 1e-12);
    }

    #[test]
    fn a_lane_holds_what_is_beside_it_and_a_length_beyond() {
        let lane = lane([90.0, 5.0], None);
        assert_eq!(lane.holds([5.0, 8.0], 1.0), Some(-5.0));
        assert_eq!(lane.holds([4.9, 5.0], 1.0), None);
        assert_eq!(lane.holds([95.0, 5.0], 1.0), None);
        assert_eq!(lane.holds([20.0, 8.1], 1.0), None);
        assert!(lane.is_reachable_from([10.0, -3.0]) && !lane.is_reachable_from([9.9, -3.0]));
        assert!(lane.is_behind([87.6, 0.0]) && !lane.is_behind([87.5, 0.0]));
    }

    #[test]
    fn distance_counts_sides_ends_and_heading() {
        let lane = lane([90.0, 5.0], None);
        assert_eq!(lane.distance([93.0, 3.0]), 5.0);
        assert_eq!(lane.distance([8.0, 5.0]), 2.0);
        assert_eq!(lane.misalignment([8.0, 5.0], -0.25), 0.25);
        assert!((lane.misalignment([8.0, 5.0], 6.0) - (2.0 * PI - 6.0)).abs() < 1e-12);
    }
}
