//! Scenes as JSON for a canvas: shapes in world units, what stands still apart from what moves.
//!
//! ```text
//! ["poly", "own", [x, y, ...]]   ["line", "ground", [x, y, ...]]   ["rect", "danger", [x0, y0, x1, y1]]
//! ["text", "", [x, y], "steak"]
//! ```

use leadtime_sims::{Scene, Shape, View};
use serde_json::{Value, json};

/// Points per width of the view: finer than that nothing is seen.
const FINENESS: f64 = 4_000.0;

/// Rounds coordinates to what can be seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SceneGrid(f64);

impl SceneGrid {
    /// Chooses the grid for a view.
    pub(crate) fn of(view: &View) -> Self {
        let width = (view.max[0] - view.min[0]).max(view.max[1] - view.min[1]).max(1e-6);
        Self(10_f64.powf((FINENESS / width).log10().ceil()))
    }

    fn round(self, value: f64) -> f64 {
        (value * self.0).round() / self.0
    }

    fn flat<'a>(self, points: impl IntoIterator<Item = &'a [f64; 2]>) -> Vec<f64> {
        points.into_iter().flatten().map(|value| self.round(*value)).collect()
    }

    pub(crate) fn point(self, point: [f64; 2]) -> Value {
        json!(point.map(|value| self.round(value)))
    }

    pub(crate) fn view(self, view: &View) -> Value {
        json!(self.flat([&view.min, &view.max]))
    }

    pub(crate) fn shape(self, shape: &Shape) -> Value {
        match shape {
            Shape::Rectangle { min, max, tone } => json!(["rect", tone, self.flat([min, max])]),
            Shape::Line { points, tone } => json!(["line", tone, self.flat(points)]),
            Shape::Polygon { points, tone } => json!(["poly", tone, self.flat(points)]),
            Shape::Label { at, text } => json!(["text", "", self.flat([at]), text]),
        }
    }
}

/// Returns which shapes of the first scene stand still through all of them.
pub(crate) fn still(scenes: &[Scene]) -> Vec<&Shape> {
    let Some((first, others)) = scenes.split_first() else { return Vec::new() };
    let stays = |shape: &&Shape| others.iter().all(|scene| scene.shapes.contains(shape));
    first.shapes.iter().filter(stays).collect()
}

#[cfg(test)]
mod tests {
    use leadtime_sims::Tone;

    use super::*;

    fn square(x: f64, tone: Tone) -> Shape {
        Shape::Rectangle { min: [x, 0.0], max: [x + 1.0, 1.0], tone }
    }

    #[test]
    fn what_stands_still_is_told_apart_from_what_moves() {
        let scene = |x: f64| Scene {
            shapes: vec![square(0.0, Tone::Danger), square(x, Tone::Own)],
            ..Scene::default()
        };
        let scenes = [scene(1.0), scene(2.0)];
        assert_eq!(still(&scenes), [&square(0.0, Tone::Danger)]);
        assert!(still(&[]).is_empty());
    }

    #[test]
    fn shapes_are_short_texts() {
        let grid = SceneGrid::of(&View { min: [0.0, 0.0], max: [100.0, 50.0] });
        let line = Shape::Line { points: vec![[0.123_456, 1.0], [2.0, 3.0]], tone: Tone::Hint };
        assert_eq!(grid.shape(&line).to_string(), r#"["line","hint",[0.12,1.0,2.0,3.0]]"#);
        let label = Shape::Label { at: [1.0, 2.0], text: "steak".to_owned() };
        assert_eq!(grid.shape(&label).to_string(), r#"["text","",[1.0,2.0],"steak"]"#);
    }
}
