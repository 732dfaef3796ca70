//! Flights over maps: many of each notifier side by side, and one over several maps.
//!
//! Only for piloting: how a flight ended is told in its words (a zone, the pad).

use std::ops::Range;

use leadtime_sims::piloting::ENTERED;
use leadtime_sims::{Scene, Shape, Tone};

use super::legend::{Entry, Legend, Sample};
use super::record::Playthrough;
use super::tiles::{TileStyle, Tiles};
use super::world::{World, areas};
use crate::draw::{Canvas, Ink, Paint, TextStyle};

const MARGIN: f64 = 16.0;
/// Title and a legend of one line above, two lines above every panel.
const TILES: TileStyle =
    TileStyle { width: 900.0, margin: MARGIN, gap: 16.0, top: 66.0, caption: 40.0 };
const LEGEND_Y: f64 = 50.0;
/// Panels side by side, at most.
const COLUMNS: usize = 3;

/// One map with flights over it.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightPanel {
    /// What it is: the map, or who speaks.
    pub title: String,
    /// The flights, in the order of their episodes.
    pub flights: Vec<Playthrough>,
}

/// How a flight ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlightEnd {
    /// On the pad, without having been in a zone.
    Safe,
    /// Anywhere, after having been in a zone.
    Entered,
    /// By a crash, beside the pad, out of view or out of time, and in no zone.
    Lost,
}

impl FlightEnd {
    /// Lists all, in the order of a legend.
    pub const ALL: [Self; 3] = [Self::Safe, Self::Entered, Self::Lost];

    /// Tells how a flight ended.
    pub fn of(flight: &Playthrough) -> Self {
        let entered = flight.scenes.last().is_some_and(|scene| scene.outcome == ENTERED);
        match (entered, flight.success) {
            (true, _) => Self::Entered,
            (false, Some(true)) => Self::Safe,
            (false, _) => Self::Lost,
        }
    }

    /// Returns the words of a legend.
    pub fn label(self) -> &'static str {
        match self {
            Self::Safe => "landed on the pad, in no zone",
            Self::Entered => "entered a zone",
            Self::Lost => "crashed, off the pad, out of view or of time",
        }
    }

    fn short(self) -> &'static str {
        match self {
            Self::Safe => "safe",
            Self::Entered => "in a zone",
            Self::Lost => "lost",
        }
    }

    fn paint(self) -> Paint {
        let paint = Paint::stroke(self.ink(), 1.6);
        if self == Self::Lost { paint.dashed(4.0, 3.0) } else { paint }
    }

    fn ink(self) -> Ink {
        match self {
            Self::Safe => Ink::Blue,
            Self::Entered => Ink::Vermilion,
            Self::Lost => Ink::Text,
        }
    }
}

/// Draws a panel per notifier with the ways of all its flights, coloured by how they ended. `id` must be unique on the
/// page.
pub fn trajectories(id: &str, title: &str, panels: &[FlightPanel]) -> String {
    let entries = FlightEnd::ALL
        .map(|end| Entry { sample: Sample::Ended(end.paint(), end.ink()), label: end.label() });
    let sheet = Sheet::new(panels, &entries);
    let mut canvas = sheet.begin(id, title);
    for (panel, world) in sheet.places() {
        let last: Vec<&Scene> = panel.flights.iter().filter_map(|f| f.scenes.last()).collect();
        world.draw_places(&mut canvas, &last);
        // Those that went wrong are few, and above the others.
        for end in FlightEnd::ALL {
            let flights = panel.flights.iter().filter(|flight| FlightEnd::of(flight) == end);
            flights.for_each(|flight| draw_way(&mut canvas, &world, &flight.scenes, end));
        }
        draw_caption(&mut canvas, &world, &panel.title, &counted(&panel.flights));
    }
    canvas.finish(title)
}

/// Draws maps side by side on one scale, and on each the way of its first flight, marked where it is inside a zone. `id`
/// must be unique on the page.
pub fn maps(id: &str, title: &str, panels: &[FlightPanel]) -> String {
    let entries = [(false, "flight, nobody speaks"), (true, "the same, inside a zone")]
        .map(|(inside, label)| Entry { sample: Sample::Stroke(zoned(inside)), label });
    let sheet = Sheet::new(panels, &entries);
    let mut canvas = sheet.begin(id, title);
    for (panel, world) in sheet.places() {
        let Some(flight) = panel.flights.first() else { continue };
        let Some(last) = flight.scenes.last() else { continue };
        world.draw_place(&mut canvas, last);
        world.draw_ghosts(&mut canvas, &flight.scenes);
        world.draw_body(&mut canvas, last, 1.0);
        canvas.clipped(world.area, |canvas| draw_zoned_way(canvas, &world, &flight.scenes));
        let n_inside = flight.scenes.iter().filter(|scene| is_inside(scene)).count();
        let steps = format!("{n_inside} of {} steps inside a zone", flight.n_steps());
        draw_caption(&mut canvas, &world, &panel.title, &steps);
    }
    canvas.finish(title)
}

/// Panels and where they stand.
struct Sheet<'a> {
    panels: &'a [FlightPanel],
    /// Everything that any flight shows: all maps have one scale.
    seen: Vec<Scene>,
    legend: Legend,
    tiles: Tiles,
}

impl<'a> Sheet<'a> {
    /// Places the panels under a legend of the ways' entries, and of what stands on the maps.
    fn new(panels: &'a [FlightPanel], ways: &[Entry]) -> Self {
        let flights = panels.iter().flat_map(|panel| &panel.flights);
        let seen: Vec<Scene> = flights.filter_map(|flight| flight.scenes.last().cloned()).collect();
        let entries: Vec<Entry> = ways.iter().copied().chain(areas(&seen)).collect();
        let legend = Legend::new(&entries, TILES.width - 2.0 * MARGIN);
        let style = TileStyle { top: TILES.top + legend.extra_height(), ..TILES };
        let tiles = Tiles::new(style, panels.len().clamp(1, COLUMNS), &seen);
        Self { panels, seen, legend, tiles }
    }

    fn places(&self) -> impl Iterator<Item = (&'a FlightPanel, World)> {
        self.panels.iter().enumerate().map(|(i, panel)| {
            let [x, y] = self.tiles.corner(i);
            (panel, World::new([x, y + TILES.caption], self.tiles.width, &self.seen))
        })
    }

    fn begin(&self, id: &str, title: &str) -> Canvas {
        let mut canvas = Canvas::new(id, TILES.width, self.tiles.bottom(self.panels.len().max(1)));
        canvas.text([MARGIN, 26.0], title, TextStyle::new(17.0, Ink::Text).bold());
        self.legend.draw(&mut canvas, [MARGIN, LEGEND_Y]);
        canvas
    }
}

fn draw_caption(canvas: &mut Canvas, world: &World, title: &str, line: &str) {
    let (x, y) = (world.area.x, world.area.y);
    canvas.text([x, y - 23.0], title, TextStyle::new(13.5, Ink::Text).bold());
    canvas.text([x, y - 8.0], line, TextStyle::new(11.5, Ink::Muted));
}

/// Counts how flights ended: `13 safe, 6 in a zone, 1 lost`.
fn counted(flights: &[Playthrough]) -> String {
    let count = |end: FlightEnd| flights.iter().filter(|f| FlightEnd::of(f) == end).count();
    let parts = FlightEnd::ALL.map(|end| format!("{} {}", count(end), end.short()));
    parts.join(", ")
}

fn draw_way(canvas: &mut Canvas, world: &World, scenes: &[Scene], end: FlightEnd) {
    let way: Vec<[f64; 2]> = scenes.iter().map(|scene| world.at(scene.position)).collect();
    canvas.clipped(world.area, |canvas| {
        canvas.line(&way, end.paint().opacity(0.75));
        if let Some(&last) = way.last() {
            canvas.circle(last, 3.0, Paint::fill(end.ink()));
        }
    });
}

fn draw_zoned_way(canvas: &mut Canvas, world: &World, scenes: &[Scene]) {
    let draw = |canvas: &mut Canvas, part: Range<usize>, paint: Paint| {
        let way = scenes[part].iter().map(|scene| world.at(scene.position));
        canvas.line(&way.collect::<Vec<_>>(), paint);
    };
    let mut start = 0;
    for run in scenes.chunk_by(|a, b| is_inside(a) == is_inside(b)) {
        let end = start + run.len();
        // With the first moment after it, so that no gap is left.
        draw(canvas, start..(end + 1).min(scenes.len()), zoned(is_inside(&run[0])));
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

    fn flight(outcome: &str, success: bool) -> Playthrough {
        let mut flight = synthetic::playthrough();
        flight.success = Some(success);
        if let Some(last) = flight.scenes.last_mut() {
            outcome.clone_into(&mut last.outcome);
        }
        flight
    }

    fn panels(n: usize) -> Vec<FlightPanel> {
        let flights = vec![
            flight("landed", true),
            flight("landed", true),
            flight(ENTERED, false),
            flight("crashed", false),
        ];
        vec![FlightPanel { title: "a <b>".to_owned(), flights }; n]
    }

    #[test]
    fn flights_are_counted_by_how_they_ended() {
        let ends: Vec<FlightEnd> = panels(1)[0].flights.iter().map(FlightEnd::of).collect();
        let expected = [FlightEnd::Safe, FlightEnd::Safe, FlightEnd::Entered, FlightEnd::Lost];
        assert_eq!(ends, expected);
        let svg = trajectories("t", "t & t", &panels(5));
        assert!(svg.contains("2 safe, 1 in a zone, 1 lost") && svg.contains("a &lt;b&gt;"));
        let pixels = Rasterizer::new().pixels(&svg, 1.0).unwrap();
        assert!(pixels.width == 900 && (500..700).contains(&pixels.height), "{}", pixels.height);
    }

    #[test]
    fn maps_tell_how_long_the_flight_is_inside_a_zone() {
        let svg = maps("m", "maps", &panels(2));
        let inside = panels(1)[0].flights[0].scenes.iter().filter(|scene| is_inside(scene)).count();
        assert!(inside > 0 && svg.contains(&format!("{inside} of 109 steps inside a zone")));
        Rasterizer::new().png(&svg, 1.0).unwrap();
    }

    #[test]
    fn what_is_empty_can_be_drawn() {
        let nobody = [FlightPanel { title: "nobody".to_owned(), flights: Vec::new() }];
        for panels in [&nobody[..], &[]] {
            for svg in [trajectories("t", "t", panels), maps("m", "m", panels)] {
                assert!(!svg.contains("NaN"));
                Rasterizer::new().png(&svg, 1.0).unwrap();
            }
        }
    }
}
