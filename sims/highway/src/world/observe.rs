//! What is seen of the traffic around a car: a row of numbers per body, the own car first.
//!
//! | column | own row | other rows |
//! |---|---|---|
//! | presence | 1 | 1; an empty row is all zero |
//! | x, y | in the world | relative to the own car |
//! | vx, vy | in the world | relative to the own car |
//! | cos, sin of the heading (if asked for) | in the world | in the world |
//!
//! x is divided by 200 m, y by 4 m per lane of the carriageway, velocities by 80 m/s; all are cut to [-1, 1]. The own x, which is a
//! place on the road and no distance, may have a unit of its own: in the original's it is 1 from 200 m on.
//!
//! # Source
//!
//! highway-env 1.12.1, `envs/common/observation.py`, `KinematicObservation`.

use leadtime_sims::Quantity;
use leadtime_sims::check::{SettingError, require_within};
use serde::{Deserialize, Serialize};

use super::constants::LENGTH;
use super::traffic::Traffic;
use super::vehicle::Vehicle;

/// What is seen farther away than this is not seen, in metres; also the unit of x.
const RANGE: f64 = 200.0;
/// The unit of velocities, in m/s.
const SPEED_RANGE: f64 = 80.0;
/// The most rows that can be asked for.
const MAX_ROWS: usize = 32;

/// Which bodies are observed, and with what.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObservationSettings {
    /// Bodies, the own car included (1 to 32). Default 10; the original's is 5.
    pub rows: usize,
    /// Whether a row ends with cos and sin of the heading. Default true; not in the original's default.
    pub headings: bool,
    /// Whether cars more than 10 m behind are seen. Default false, as in the original.
    pub see_behind: bool,
    /// What the own car's x is divided by, in metres (1 to 1000000). Default 200, as in the original.
    pub own_x_unit: f64,
}

impl Default for ObservationSettings {
    fn default() -> Self {
        Self { rows: 10, headings: true, see_behind: false, own_x_unit: RANGE }
    }
}

impl ObservationSettings {
    pub(crate) fn check(&self) -> Result<(), SettingError> {
        require_within("world.observation.rows", self.rows, 1..=MAX_ROWS, "rows")?;
        require_within("world.observation.own_x_unit", self.own_x_unit, 1.0..=1e6, "m")
    }

    /// Returns the numbers per row: 5 or 7.
    pub fn n_columns(&self) -> usize {
        if self.headings { 7 } else { 5 }
    }

    /// Returns the length of an observation.
    pub fn dim(&self) -> usize {
        self.rows * self.n_columns()
    }
}

pub(crate) fn quantities(settings: &ObservationSettings, n_lanes: usize) -> Vec<Quantity> {
    let across = 4 * n_lanes;
    let row = |row: usize| {
        let (who, of, unit) = match row {
            0 => ("ego".to_owned(), "", settings.own_x_unit),
            _ => (format!("car{row}"), ", minus the own car's", RANGE),
        };
        let bounded = |column: &str, meaning: String| {
            Quantity::new(format!("{who}.{column}"), meaning, [-1.0, 1.0])
        };
        let mut columns = vec![
            Quantity::flag(format!("{who}.there"), "whether there is a car; else all is 0"),
            bounded("x", format!("place along the road{of}, in {unit} m")),
            bounded("y", format!("place to the right{of}, in {across} m")),
            bounded("vx", format!("velocity along{of}, in {SPEED_RANGE} m/s")),
            bounded("vy", format!("velocity to the right{of}, in {SPEED_RANGE} m/s")),
        ];
        if settings.headings {
            columns.push(bounded("cos", "cosine of the heading".to_owned()));
            columns.push(bounded("sin", "sine of the heading".to_owned()));
        }
        columns
    };
    (0..settings.rows).flat_map(row).collect()
}

/// The bodies that fill the rows after the own one: the nearest along the lane, of equals the first.
struct Nearest {
    bodies: [(f64, usize); MAX_ROWS],
    n_bodies: usize,
    capacity: usize,
}

impl Nearest {
    fn insert(&mut self, distance: f64, body: usize) {
        let kept = &self.bodies[..self.n_bodies];
        let at = kept.iter().position(|&(other, _)| distance < other).unwrap_or(self.n_bodies);
        if at >= self.capacity {
            return;
        }
        self.n_bodies = (self.n_bodies + 1).min(self.capacity);
        self.bodies[at..self.n_bodies].rotate_right(1);
        self.bodies[at] = (distance, body);
    }
}

impl Traffic {
    /// Writes what is seen from a car on a carriageway of `n_lanes` lanes.
    ///
    /// # Shapes
    ///
    /// `out`: `[rows, columns]`.
    pub fn observe(
        &self,
        me: usize,
        n_lanes: usize,
        settings: &ObservationSettings,
        out: &mut [f32],
    ) {
        out.fill(0.0);
        let nearest = self.nearest(me, settings);
        let own = &self.vehicles[me];
        let mut units = [settings.own_x_unit, 4.0 * n_lanes as f64, SPEED_RANGE, SPEED_RANGE];
        let bodies = nearest.bodies[..nearest.n_bodies].iter().map(|&(_, body)| body);
        let rows = out.chunks_exact_mut(settings.n_columns());
        let mut origin = ([0.0; 2], [0.0; 2]);
        for (row, body) in rows.zip(std::iter::once(me).chain(bodies)) {
            let ([x, y], [vx, vy]) = (self.place_of(body), self.velocity_of(body));
            let ([x0, y0], [vx0, vy0]) = origin;
            let values = [x - x0, y - y0, vx - vx0, vy - vy0];
            // The first row is the own car's.
            origin = (own.position, own.velocity());
            row[0] = 1.0;
            for (out, (value, unit)) in row[1..5].iter_mut().zip(values.into_iter().zip(units)) {
                *out = (value / unit).clamp(-1.0, 1.0) as f32;
            }
            units[0] = RANGE;
            if settings.headings {
                let direction = self.vehicles.get(body).map_or([1.0, 0.0], Vehicle::direction);
                row[5..].copy_from_slice(&direction.map(|value| value as f32));
            }
        }
    }

    pub(super) fn velocity_of(&self, body: usize) -> [f64; 2] {
        self.vehicles.get(body).map_or([0.0; 2], Vehicle::velocity)
    }

    fn nearest(&self, me: usize, settings: &ObservationSettings) -> Nearest {
        let capacity = settings.rows - 1;
        let mut nearest = Nearest { bodies: [(0.0, 0); MAX_ROWS], n_bodies: 0, capacity };
        let own = &self.vehicles[me];
        for body in (0..self.vehicles.len() + self.road.obstacles.len()).filter(|&b| b != me) {
            let [x, y] = self.place_of(body);
            let [dx, dy] = [x - own.position[0], y - own.position[1]];
            if libm::sqrt(dx * dx + dy * dy) >= RANGE {
                continue;
            }
            let ahead = self.gap(me, body, own.lane);
            let looks_back = settings.see_behind && body < self.vehicles.len();
            if looks_back || ahead > -2.0 * LENGTH {
                nearest.insert(ahead.abs(), body);
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::world::{Blindness, Lookup, RoadSettings};

    fn observe(places: &[[f64; 2]], settings: &ObservationSettings) -> Vec<f32> {
        let road = RoadSettings::merge().build(Lookup::Segment).unwrap();
        let mut traffic = Traffic::new(Arc::new(road), Blindness::Never);
        for &place in places {
            traffic.vehicles.push(Vehicle::new(&traffic.road.network, place, 0.0, 20.0));
        }
        let mut out = vec![f32::NAN; settings.dim()];
        traffic.observe(0, 2, settings, &mut out);
        out
    }

    #[test]
    fn the_nearest_are_listed_nearest_first() {
        let cars = [[100.0, 4.0], [140.0, 0.0], [80.0, 0.0], [95.0, 4.0]];
        let settings =
            ObservationSettings { rows: 4, headings: false, ..ObservationSettings::default() };
        let seen = observe(&cars, &settings);
        assert_eq!(seen[..5], [1.0, 0.5, 0.5, 0.25, 0.0]);
        // 5 m behind is seen, 20 m behind is not; the obstacle is out of range.
        assert_eq!(seen[5..10], [1.0, -0.025, 0.0, 0.0, 0.0]);
        assert_eq!(seen[10..15], [1.0, 0.2, -0.5, 0.0, 0.0]);
        assert_eq!(seen[15..], [0.0; 5]);
        let behind = ObservationSettings { see_behind: true, rows: 3, ..settings };
        assert_eq!(observe(&cars, &behind)[10..], [1.0, -0.1, -0.5, 0.0, 0.0]);
    }

    #[test]
    fn an_obstacle_stands_still_and_heads_east() {
        let settings = ObservationSettings { rows: 2, ..ObservationSettings::default() };
        let seen = observe(&[[300.0, 4.0]], &settings);
        assert_eq!(seen[0..7], [1.0, 1.0, 0.5, 0.25, 0.0, 1.0, 0.0]);
        assert_eq!(seen[7..], [1.0, 0.05, 0.5, -0.25, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn the_own_place_may_have_a_unit_in_which_it_fits() {
        let settings =
            ObservationSettings { rows: 2, own_x_unit: 400.0, ..ObservationSettings::default() };
        let seen = observe(&[[300.0, 4.0]], &settings);
        assert_eq!(seen[0..7], [1.0, 0.75, 0.5, 0.25, 0.0, 1.0, 0.0]);
        // A distance keeps the original's.
        assert_eq!(seen[7..], [1.0, 0.05, 0.5, -0.25, 0.0, 1.0, 0.0]);
        let own = &quantities(&settings, 2)[1];
        assert_eq!(own.meaning, "place along the road, in 400 m");
    }
}
