//! Trajectories over maps: many of each notifier side by side, and one over several maps.
//!
//! Only for the lander: how a trajectory ended is read off its outcome (a zone, the pad).

use leadtime_lander::task::ENTERED;
use leadtime_sims::{Scene, Shape, Tone};

use super::legend::{Legend, LegendEntry, Mark};
use super::tiles::{TileStyle, Tiles};
use super::world_view::{WorldView, areas};
use crate::draw::{Canvas, Ink, Paint, Svg, TextStyle};
use crate::playthrough::Playthrough;

const MARGIN: f64 = 16.0;
/// Title and a legend of one line above, two lines above every panel.
const TILES: TileStyle =
    TileStyle { width: 900.0, margin: MARGIN, gap: 16.0, top: 66.0, caption: 40.0 };
const LEGEND_Y: f64 = 50.0;
/// Panels side by side, at most.
const COLUMNS: usize = 3;

/// One map with trajectories over it.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryPanel {
    /// What it is: the map, or who speaks.
    pub title: String,
    /// The trajectories, in the order of their episodes.
    pub trajectories: Vec<Playthrough>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TrajectoryEnd {
    /// On the pad, without having been in a zone.
    Safe,
    /// Anywhere, after having been in a zone.
    Entered,
    /// By a crash, off the pad, out of view or out of time, and in no zone.
    Lost,
}

impl TrajectoryEnd {
    /// Lists all, in the order of a legend.
    const ALL: [Self; 3] = [Self::Safe, Self::Entered, Self::Lost];

    fn of(trajectory: &Playthrough) -> Self {
        let entered = trajectory.scenes.last().is_some_and(|scene| scene.outcome == ENTERED);
        match (entered, trajectory.success) {
            (true, _) => Self::Entered,
            (false, Some(true)) => Self::Safe,
            (false, _) => Self::Lost,
        }
    }

    /// Returns its words in a legend and in a count, and its colour.
    fn style(self) -> (&'static str, &'static str, Ink) {
        match self {
            Self::Safe => ("landed on the pad, in no zone", "safe", Ink::Blue),
            Self::Entered => ("entered a zone", "in a zone", Ink::Vermilion),
            Self::Lost => ("crashed, off the pad, out of view or of time", "lost", Ink::Text),
        }
    }

    fn paint(self) -> Paint {
        let paint = Paint::stroke(self.style().2, 1.6);
        if self == Self::Lost { paint.dashed(4.0, 3.0) } else { paint }
    }
}

/// Draws a panel per notifier with all its trajectories, coloured by how they ended. `id` must be unique on the
/// page.
pub fn trajectories(id: &str, title: &str, panels: &[TrajectoryPanel]) -> Svg {
    let entries = TrajectoryEnd::ALL.map(|end| {
        let (label, _, ink) = end.style();
        LegendEntry { mark: Mark::Ended(end.paint(), ink), label }
    });
    let tiling = Tiling::new(panels, &entries);
    let mut canvas = tiling.begin(id, title);
    for (panel, world) in tiling.places() {
        let last: Vec<&Scene> = panel.trajectories.iter().filter_map(|f| f.scenes.last()).collect();
        world.draw_places(&mut canvas, &last);
        // Those that went wrong are few, and above the others.
        for end in TrajectoryEnd::ALL {
            for trajectory in ended(&panel.trajectories, end) {
                draw_trajectory(&mut canvas, &world, &trajectory.scenes, end);
            }
        }
        draw_caption(&mut canvas, &world, &panel.title, &counted(&panel.trajectories));
    }
    canvas.finish(title)
}

/// Draws maps side by side on one scale, and on each its first trajectory, marked where it is inside a zone. `id`
/// must be unique on the page.
pub fn maps(id: &str, title: &str, panels: &[TrajectoryPanel]) -> Svg {
    let entries = [(false, "trajectory, nobody speaks"), (true, "the same, inside a zone")]
        .map(|(inside, label)| LegendEntry { mark: Mark::Stroke(zoned(inside)), label });
    let tiling = Tiling::new(panels, &entries);
    let mut canvas = tiling.begin(id, title);
    for (panel, world) in tiling.places() {
        let Some(trajectory) = panel.trajectories.first() else { continue };
        let Some(last) = trajectory.scenes.last() else { continue };
        world.draw_place(&mut canvas, last);
        world.draw_ghosts(&mut canvas, &trajectory.scenes);
        world.draw_body(&mut canvas, last, 1.0);
        canvas.clipped(world.area, |canvas| draw_zoned(canvas, &world, &trajectory.scenes));
        let n_inside = trajectory.scenes.iter().filter(|scene| is_inside(scene)).count();
        let steps = format!("{n_inside} of {} steps inside a zone", trajectory.n_steps());
        draw_caption(&mut canvas, &world, &panel.title, &steps);
    }
    canvas.finish(title)
}

/// Panels and where they stand.
struct Tiling<'a> {
    panels: &'a [TrajectoryPanel],
    /// Everything that any trajectory shows: all maps have one scale.
    seen: Vec<Scene>,
    legend: Legend,
    tiles: Tiles,
}

impl<'a> Tiling<'a> {
    /// Places the panels under a legend of the trajectories' entries, and of what stands on the maps.
    fn new(panels: &'a [TrajectoryPanel], kinds: &[LegendEntry]) -> Self {
        let trajectories = panels.iter().flat_map(|panel| &panel.trajectories);
        let seen: Vec<Scene> = trajectories.filter_map(|t| t.scenes.last().cloned()).collect();
        let entries = kinds.iter().copied().chain(areas(&seen));
        let legend = Legend::new(entries, TILES.width - 2.0 * MARGIN);
        let style = TileStyle { top: TILES.top + legend.extra_height(), ..TILES };
        let tiles = Tiles::new(style, panels.len().clamp(1, COLUMNS), &seen);
        Self { panels, seen, legend, tiles }
    }

    fn places(&self) -> impl Iterator<Item = (&'a TrajectoryPanel, WorldView)> {
        self.panels.iter().enumerate().map(|(i, panel)| {
            let [x, y] = self.tiles.corner(i);
            (panel, WorldView::new([x, y + TILES.caption], self.tiles.width, &self.seen))
        })
    }

    fn begin(&self, id: &str, title: &str) -> Canvas {
        let mut canvas = Canvas::new(id, TILES.width, self.tiles.bottom(self.panels.len().max(1)));
        canvas.text([MARGIN, 26.0], title, TextStyle::new(17.0, Ink::Text).bold());
        self.legend.draw(&mut canvas, [MARGIN, LEGEND_Y]);
        canvas
    }
}

fn draw_caption(canvas: &mut Canvas, world: &WorldView, title: &str, line: &str) {
    let (x, y) = (world.area.x, world.area.y);
    canvas.text([x, y - 23.0], title, TextStyle::new(13.5, Ink::Text).bold());
    canvas.text([x, y - 8.0], line, TextStyle::new(11.5, Ink::Muted));
}

/// Returns the trajectories that ended in one way.
fn ended(all: &[Playthrough], end: TrajectoryEnd) -> impl Iterator<Item = &Playthrough> {
    all.iter().filter(move |trajectory| TrajectoryEnd::of(trajectory) == end)
}

/// Counts how trajectories ended: `13 safe, 6 in a zone, 1 lost`.
fn counted(all: &[Playthrough]) -> String {
    let part = |end: TrajectoryEnd| format!("{} {}", ended(all, end).count(), end.style().1);
    TrajectoryEnd::ALL.map(part).join(", ")
}

fn draw_trajectory(canvas: &mut Canvas, world: &WorldView, scenes: &[Scene], end: TrajectoryEnd) {
    let path: Vec<[f64; 2]> = scenes.iter().map(|scene| world.at(scene.position)).collect();
    canvas.clipped(world.area, |canvas| {
        canvas.line(&path, end.paint().opacity(0.75));
        if let Some(&last) = path.last() {
            canvas.circle(last, 3.0, Paint::fill(end.style().2));
        }
    });
}

fn draw_zoned(canvas: &mut Canvas, world: &WorldView, scenes: &[Scene]) {
    let path: Vec<[f64; 2]> = scenes.iter().map(|scene| world.at(scene.position)).collect();
    let mut start = 0;
    for run in scenes.chunk_by(|a, b| is_inside(a) == is_inside(b)) {
        let end = start + run.len();
        // With the first moment after it, so that no gap is left.
        canvas.line(&path[start..path.len().min(end + 1)], zoned(is_inside(&run[0])));
        start = end;
    }
}

fn zoned(inside: bool) -> Paint {
    if inside { Paint::stroke(Ink::Vermilion, 3.6) } else { Paint::stroke(Ink::Neutral, 2.2) }
}

fn is_inside(scene: &Scene) -> bool {
    let [x, y] = scene.position;
    scene.shapes.iter().any(|shape| match shape {
        Shape::Rectangle { min, max, tone: Tone::Danger } => {
            (min[0]..=max[0]).contains(&x) && (min[1]..=max[1]).contains(&y)
        }
        _ => false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Rasterizer;
    use crate::playthrough::synthetic;

    fn trajectory(outcome: &str, success: bool) -> Playthrough {
        let mut trajectory = synthetic::playthrough();
        trajectory.success = Some(success);
        outcome.clone_into(&mut trajectory.scenes.last_mut().unwrap().outcome);
        trajectory
    }

    fn panels(n: usize) -> Vec<TrajectoryPanel> {
        let ends = [("landed", true), ("landed", true), (ENTERED, false), ("crashed", false)];
        let trajectories = ends.map(|(outcome, success)| trajectory(outcome, success)).to_vec();
        vec![TrajectoryPanel { title: "a <b>".to_owned(), trajectories }; n]
    }

    #[test]
    fn trajectories_are_counted_by_how_they_ended() {
        let svg = trajectories("t", "t & t", &panels(5)).text;
        assert!(svg.contains("2 safe, 1 in a zone, 1 lost") && svg.contains("a &lt;b&gt;"));
        let pixels = Rasterizer::new().pixmap(&svg, 1.0).unwrap();
        let [width, height] = [pixels.width(), pixels.height()];
        assert!(width == 900 && (500..700).contains(&height), "{height}");
    }

    #[test]
    fn maps_show_how_long_the_trajectory_is_inside_a_zone() {
        let svg = maps("m", "maps", &panels(2)).text;
        let inside =
            panels(1)[0].trajectories[0].scenes.iter().filter(|scene| is_inside(scene)).count();
        assert!(inside > 0 && svg.contains(&format!("{inside} of 109 steps inside a zone")));
        Rasterizer::new().png(&svg, 1.0).unwrap();
    }

    #[test]
    fn empty_trajectories_can_be_drawn() {
        let nobody = [TrajectoryPanel { title: "nobody".to_owned(), trajectories: Vec::new() }];
        for panels in [&nobody[..], &[]] {
            for svg in [trajectories("t", "t", panels).text, maps("m", "m", panels).text] {
                assert!(!svg.contains("NaN"));
                Rasterizer::new().png(&svg, 1.0).unwrap();
            }
        }
    }
}
