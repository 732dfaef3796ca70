//! The highway as a picture's ingredients: the whole road, seen where the ego is.
//!
//! Pictures have y upwards, roads have theirs to the right of the driver; so y is negated.

use leadtime_sims::scene::{Gauge, Scene, Shape, Tone, View};

use super::reaction::EGO;
use crate::world::constants::OBSTACLE;
use crate::world::{Footprint, Lane, Traffic};

/// How much road is shown behind and ahead of the ego, in metres.
const STRETCH: [f64; 2] = [60.0, 140.0];
/// How much around y = 0 is shown, to the right and to the left, in metres.
const SIDES: [f64; 2] = [18.0, 14.0];
/// Distance between the points of a curved edge, in metres.
const GRAIN: f64 = 5.0;

/// Describes the road around the ego.
pub(super) fn picture(traffic: &Traffic, goal: f64, outcome: &str) -> Scene {
    let [x, y] = traffic.vehicles[EGO].position;
    let view = View { min: [x - STRETCH[0], -SIDES[0]], max: [x + STRETCH[1], SIDES[1]] };
    let lanes = traffic.network().lanes();
    let mut shapes: Vec<Shape> = lanes.iter().map(surface).collect();
    shapes.extend(lanes.iter().flat_map(|lane| [-0.5, 0.5].map(|side| edge(lane, side))));
    let finish = vec![[goal, view.min[1]], [goal, view.max[1]]];
    shapes.push(Shape::Line { points: finish, tone: Tone::Goal });
    for &[x, y] in &traffic.road.obstacles {
        let half = OBSTACLE / 2.0;
        let (min, max) = ([x - half, -y - half], [x + half, -y + half]);
        shapes.push(Shape::Rectangle { min, max, tone: Tone::Danger });
    }
    // The ego comes last, on top.
    for (i, vehicle) in traffic.vehicles.iter().enumerate().rev() {
        let tone = if i == EGO { Tone::Own } else { Tone::Other };
        let points = Footprint::of(vehicle).corners().map(|[x, y]| [x, -y]).to_vec();
        shapes.push(Shape::Polygon { points, tone });
    }
    let others = traffic.vehicles[EGO + 1..].iter().map(|other| other.position);
    Scene {
        view,
        shapes,
        position: [x, -y],
        gauge: Gauge { label: "speed (m/s)", value: traffic.vehicles[EGO].speed },
        others: others.map(|[x, y]| [x, -y]).collect(),
        outcome: outcome.to_owned(),
        ..Scene::default()
    }
}

/// Returns the points of a line along a lane, `share` of its width to the right of its centre.
fn points(lane: &Lane, share: f64) -> Vec<[f64; 2]> {
    let n_points = (lane.length / GRAIN).ceil().max(1.0) as usize;
    let places = (0..=n_points).map(|i| lane.length * i as f64 / n_points as f64);
    places.map(|s| lane.position(s, share * lane.width)).map(|[x, y]| [x, -y]).collect()
}

fn surface(lane: &Lane) -> Shape {
    let mut outline = points(lane, -0.5);
    outline.extend(points(lane, 0.5).into_iter().rev());
    Shape::Polygon { points: outline, tone: Tone::Ground }
}

fn edge(lane: &Lane, share: f64) -> Shape {
    Shape::Line { points: points(lane, share), tone: Tone::Hint }
}
