//! The lander world as a picture's ingredients.

use leadtime_sims::scene::{Shape, Tone, View};

use super::constants::{HALF_WORLD, HEIGHT, HULL, PAD_X, REST_Y};
use super::lander::{Lander, LanderOutcome};

/// The part of the world that the original shows, in the units of observed positions.
pub const VIEW: View = View {
    min: [-PAD_X / HALF_WORLD[0], -REST_Y / HALF_WORLD[1]],
    max: [PAD_X / HALF_WORLD[0], (HEIGHT - REST_Y) / HALF_WORLD[1]],
};

/// Half the pad's width in the units of observed positions.
const PAD: f64 = 0.2;

impl Lander {
    /// Describes ground, pad and lander, back to front, in the units of observed positions.
    pub fn shapes(&self) -> Vec<Shape> {
        let ground = self.terrain_outline();
        let (pad_y, bottom) = (ground[5][1], VIEW.min[1]);
        let soil = [&ground[..], &[[VIEW.max[0], bottom], [VIEW.min[0], bottom]]].concat();
        let pad = vec![[-PAD, pad_y], [PAD, pad_y]];
        let mut shapes = vec![
            Shape::Polygon { points: soil, tone: Tone::Ground },
            Shape::Line { points: pad, tone: Tone::Goal },
        ];
        let body = |i| Shape::Polygon { points: self.outline(i), tone: Tone::Own };
        shapes.extend([1, 2, HULL].map(body));
        shapes
    }
}

/// Names how an episode stands, for a picture's caption.
pub fn caption(outcome: Option<LanderOutcome>) -> &'static str {
    match outcome {
        None => "",
        Some(LanderOutcome::Landed) => "landed",
        Some(LanderOutcome::Crashed) => "crashed",
        Some(LanderOutcome::Out) => "left the view",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::PhysicsSettings;

    #[test]
    fn a_new_lander_is_drawn_near_the_top_of_the_view() {
        let shapes = Lander::new(&PhysicsSettings::default()).shapes();
        let Some(Shape::Polygon { points, tone: Tone::Own }) = shapes.last() else {
            panic!("the hull comes last: {shapes:?}")
        };
        let height = points.iter().map(|point| point[1]).sum::<f64>() / points.len() as f64;
        assert!((1.2..VIEW.max[1] + 0.1).contains(&height), "{height}");
    }
}
