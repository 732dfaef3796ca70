//! The world's part of a picture: shapes, path, markers.

use leadtime_sims::{Scene, Shape, Tone, View};

use super::labels::{self, Placer};
use super::legend::{LegendEntry, Mark};
use super::marker::{self, draw_marker};
use crate::draw::{Anchor, Area, Canvas, Ink, Paint, Panel, TextStyle, Weight, text_width};
use crate::playthrough::{Sentence, Spoken, Timeline, topic_name};

/// A world is drawn at most this much higher than wide ...
const MAX_RATIO: f64 = 2.0 / 3.0;
/// ... and at least this much: a long road is stretched.
const MIN_RATIO: f64 = 0.25;

/// Size of the world's own labels.
const LABEL_SIZE: f64 = 11.0;

/// How far apart the listener's body is drawn on the trajectory, in pixels.
const GHOST_DISTANCE: f64 = 95.0;

/// Where the points of a world lie in a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorldView {
    pub(super) area: Area,
    frame: Panel,
    /// Size of the world's own labels.
    pub(super) label_size: f64,
}

impl WorldView {
    /// Fits everything that the scenes show into a panel of the given corner and width.
    pub(super) fn new(corner: [f64; 2], width: f64, scenes: &[Scene]) -> Self {
        let view = union(scenes);
        let size = [view.max[0] - view.min[0], view.max[1] - view.min[1]];
        let ratio = if size[0] > 0.0 { size[1] / size[0] } else { MAX_RATIO };
        let area =
            Area::new(corner[0], corner[1], width, width * ratio.clamp(MIN_RATIO, MAX_RATIO));
        let [x, y] = [0, 1].map(|d| [view.min[d], view.max[d]]);
        Self { area, frame: Panel::new(area, x, y), label_size: LABEL_SIZE }
    }

    pub(super) fn at(&self, point: [f64; 2]) -> [f64; 2] {
        self.frame.at(point)
    }

    fn all(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        points.iter().map(|point| self.at(*point)).collect()
    }

    /// Draws the panel with everything in the scene but the listener's body.
    pub(super) fn draw_place(&self, canvas: &mut Canvas, scene: &Scene) {
        self.draw_places(canvas, &[scene]);
    }

    /// Draws the same for several episodes: what they share once, and what differs from one to the other (the ground) as
    /// faint as they are many.
    pub(super) fn draw_places<'a>(&self, canvas: &mut Canvas, scenes: &[&'a Scene]) {
        canvas.rectangle(self.area, 6.0, Paint::fill(Ink::Panel));
        let is_place = |shape: &&Shape| tone(shape) != Some(Tone::Own);
        let place = |scene: &&'a Scene| scene.shapes.iter().filter(is_place).collect();
        let places: Vec<Vec<&Shape>> = scenes.iter().map(place).collect();
        let Some(first) = places.first() else { return };
        let faint = (1.6 / places.len() as f64).min(1.0);
        canvas.clipped(self.area, |canvas| {
            for (i, shape) in first.iter().enumerate() {
                if places.iter().all(|place| place.get(i) == Some(shape)) {
                    self.draw_shape(canvas, shape, 1.0);
                    continue;
                }
                for shape in places.iter().filter_map(|place| place.get(i)) {
                    self.draw_shape(canvas, shape, faint);
                }
            }
        });
    }

    /// Draws the listener's body, more or less visible.
    pub(super) fn draw_body(&self, canvas: &mut Canvas, scene: &Scene, opacity: f64) {
        let body = scene.shapes.iter().filter(|shape| tone(shape) == Some(Tone::Own));
        canvas.clipped(self.area, |canvas| {
            body.for_each(|shape| self.draw_shape(canvas, shape, opacity));
        });
    }

    /// Draws the scene's labels once more, above everything else.
    pub(super) fn draw_texts(&self, canvas: &mut Canvas, scene: &Scene) {
        let labels = scene.shapes.iter().filter(|shape| matches!(shape, Shape::Label { .. }));
        canvas.clipped(self.area, |canvas| {
            labels.for_each(|label| self.draw_shape(canvas, label, 1.0));
        });
    }

    /// Draws faint bodies along the trajectory, and where the others were at those moments.
    pub(super) fn draw_ghosts(&self, canvas: &mut Canvas, scenes: &[Scene]) {
        let mut last: Option<[f64; 2]> = None;
        for scene in scenes {
            let [x, y] = self.at(scene.position);
            if last.is_none_or(|[x0, y0]| (x - x0).hypot(y - y0) >= GHOST_DISTANCE) {
                self.draw_body(canvas, scene, 0.22);
                canvas.clipped(self.area, |canvas| {
                    let dots = self.all(&scene.others).into_iter();
                    dots.for_each(|dot| canvas.circle(dot, 2.6, Paint::fill(Ink::Muted)));
                });
                last = Some([x, y]);
            }
        }
    }

    /// Draws the trajectories of the others.
    pub(super) fn draw_others(&self, canvas: &mut Canvas, scenes: &[Scene]) {
        let n_others = scenes.last().map_or(0, |scene| scene.others.len());
        canvas.clipped(self.area, |canvas| {
            for i in 0..n_others {
                let path = scenes.iter().filter_map(|scene| Some(self.at(*scene.others.get(i)?)));
                let paint = Paint::stroke(Ink::Muted, 1.0).opacity(0.7);
                canvas.line(&path.collect::<Vec<_>>(), paint);
            }
        });
    }

    /// Draws the trajectory, coloured by what the listener did; `scenes` may be the first part of an episode.
    pub(super) fn draw_path(&self, canvas: &mut Canvas, scenes: &[Scene], timeline: &Timeline) {
        let steps = &timeline.activities[..scenes.len().saturating_sub(1)];
        canvas.clipped(self.area, |canvas| {
            let mut start = 0;
            for run in steps.chunk_by(|a, b| a == b) {
                let end = start + run.len();
                let points = scenes[start..=end].iter().map(|scene| self.at(scene.position));
                canvas.line(&points.collect::<Vec<_>>(), marker::stroke(run[0]));
                start = end;
            }
        });
    }

    /// Marks where messages were started.
    pub(super) fn draw_starts(&self, canvas: &mut Canvas, scenes: &[Scene], timeline: &Timeline) {
        canvas.clipped(self.area, |canvas| {
            for utterance in timeline.utterances.iter().filter(|u| u.start + 1 < scenes.len()) {
                draw_marker(canvas, self.at(scenes[utterance.start].position));
            }
        });
    }

    /// Labels the messages at their markers, as many as fit; repetitions share a label.
    pub(super) fn draw_labels(&self, canvas: &mut Canvas, spoken: &Spoken) {
        let (scenes, timeline) = (&spoken.played.scenes, &spoken.timeline);
        let marks = timeline.utterances.iter().map(|utterance| {
            let [x, y] = self.at(scenes[utterance.start].position);
            Area::new(x - 5.0, y - 5.0, 10.0, 10.0)
        });
        let taken = marks.chain(self.texts(scenes)).collect();
        let path = scenes.iter().map(|scene| self.at(scene.position)).collect();
        let mut placer = Placer { bounds: self.area, taken, path };
        let mut first = 0;
        for run in timeline.utterances.chunk_by(|a, b| a.topic == b.topic) {
            let marker = self.at(scenes[run[0].start].position);
            // A sentence needs more room than the topic that it says.
            let sentence = spoken.sentences.get(first).map(|sentence| said(sentence, run.len()));
            first += run.len();
            let topic = topic_name(&scenes[0], run[0].topic);
            let named = if run.len() > 1 { format!("{topic} \u{d7}{}", run.len()) } else { topic };
            let mut texts = sentence.into_iter().chain([named]);
            let placed = texts.find_map(|text| Some((placer.place(marker, &text)?, text)));
            let Some((area, text)) = placed else { continue };
            draw_leader(canvas, marker, &area);
            let style =
                TextStyle::new(labels::SIZE, Ink::Text).anchored(Anchor::Middle).haloed(Ink::Panel);
            canvas.text([area.x + area.width / 2.0, area.bottom() - 3.2], &text, style);
        }
    }

    /// Returns where the scene's own labels stand.
    fn texts(&self, scenes: &[Scene]) -> Vec<Area> {
        let shapes = scenes.last().into_iter().flat_map(|scene| &scene.shapes);
        let area = |shape: &Shape| {
            let Shape::Label { at, text } = shape else { return None };
            let [x, y] = self.at(*at);
            let width = text_width(text, self.label_size, Weight::Regular) + 6.0;
            Some(Area::new(x - width / 2.0, y - 8.0, width, 16.0))
        };
        shapes.filter_map(area).collect()
    }

    /// Returns whether a shape with these corners may reach into the view; a long road is mostly elsewhere.
    fn is_seen(&self, corners: &[[f64; 2]]) -> bool {
        let range = |d: usize| {
            let along = corners.iter().map(|corner| corner[d]);
            along.fold([f64::MAX, f64::MIN], |[low, high], v| [low.min(v), high.max(v)])
        };
        let ([left, right], [top, bottom]) = (range(0), range(1));
        // Strokes reach a little further than their lines.
        let corners = Area::new(left - 4.0, top - 4.0, right - left + 8.0, bottom - top + 8.0);
        self.area.overlaps(&corners)
    }

    fn draw_shape(&self, canvas: &mut Canvas, shape: &Shape, opacity: f64) {
        match shape {
            Shape::Rectangle { min, max, tone } => {
                let ([x0, y0], [x1, y1]) = (self.at(*min), self.at(*max));
                let area = Area::new(x0.min(x1), y0.min(y1), (x1 - x0).abs(), (y1 - y0).abs());
                canvas.rectangle(area, 0.0, filled(*tone).opacity(opacity));
            }
            Shape::Line { points, tone } => {
                let points = self.all(points);
                if self.is_seen(&points) {
                    canvas.line(&points, lined(*tone).opacity(opacity));
                }
            }
            Shape::Polygon { points, tone } => {
                let points = self.all(points);
                if self.is_seen(&points) {
                    canvas.polygon(&points, filled(*tone).opacity(opacity));
                }
            }
            Shape::Label { at, text } => {
                let [x, y] = self.at(*at);
                // It stands on whatever the world has there.
                let style = TextStyle::new(self.label_size, Ink::Text).haloed(Ink::Panel);
                let style = style.anchored(Anchor::Middle);
                canvas.text([x, y + 0.36 * self.label_size], text, style);
            }
        }
    }
}

/// Quotes a sentence, and counts those that repeat its topic in other words.
fn said(sentence: &Sentence, n: usize) -> String {
    if n > 1 { format!("{sentence} and {} more", n - 1) } else { sentence.to_string() }
}

/// Connects a label with its marker, unless it is right next to it.
fn draw_leader(canvas: &mut Canvas, marker: [f64; 2], label: &Area) {
    let [x, y] = marker;
    let nearest = [x.clamp(label.x, label.right()), y.clamp(label.y, label.bottom())];
    let [dx, dy] = [nearest[0] - x, nearest[1] - y];
    let length = dx.hypot(dy);
    if length > 14.0 {
        let from = [x + dx / length * 6.0, y + dy / length * 6.0];
        canvas.line(&[from, nearest], Paint::stroke(Ink::Axis, 0.9));
    }
}

/// Explains the areas that the scenes show.
pub(super) fn areas(scenes: &[Scene]) -> impl Iterator<Item = LegendEntry> {
    let meanings = [
        (Tone::Danger, "danger"),
        (Tone::Mistaken, "believed otherwise"),
        (Tone::Hint, "what the listener sees"),
        (Tone::Goal, "goal"),
    ];
    let shown = |tone| scenes.iter().any(|scene| has_area(scene, tone));
    let shown = meanings.into_iter().filter(move |(tone, _)| shown(*tone));
    shown.map(|(tone, label)| LegendEntry { mark: Mark::Swatch(filled(tone)), label })
}

/// Returns whether a scene has an area of a meaning; a pad is a line, and counts as one.
fn has_area(scene: &Scene, wanted: Tone) -> bool {
    let is_line = |shape: &Shape| matches!(shape, Shape::Line { .. }) && wanted == Tone::Hint;
    scene.shapes.iter().any(|shape| tone(shape) == Some(wanted) && !is_line(shape))
}

fn tone(shape: &Shape) -> Option<Tone> {
    match shape {
        Shape::Label { .. } => None,
        Shape::Rectangle { tone, .. } | Shape::Line { tone, .. } | Shape::Polygon { tone, .. } => {
            Some(*tone)
        }
    }
}

fn filled(tone: Tone) -> Paint {
    match tone {
        Tone::Ground => Paint::fill(Ink::Ground),
        Tone::Goal => Paint::fill(Ink::Green).fill_opacity(0.3).outlined(Ink::Green, 1.2),
        Tone::Danger | Tone::Mistaken => {
            let paint = Paint::fill(Ink::Vermilion).fill_opacity(0.16);
            paint.outlined(Ink::Vermilion, 1.2).dashed(5.0, 4.0)
        }
        Tone::Own => Paint::fill(Ink::Text),
        Tone::Other => Paint::fill(Ink::Muted).fill_opacity(0.6),
        Tone::Hint => Paint::fill(Ink::Sky).fill_opacity(0.4),
    }
}

fn lined(tone: Tone) -> Paint {
    match tone {
        Tone::Ground => Paint::stroke(Ink::Ground, 2.5),
        Tone::Goal => Paint::stroke(Ink::Green, 5.0),
        Tone::Danger | Tone::Mistaken => Paint::stroke(Ink::Vermilion, 1.5).dashed(5.0, 4.0),
        Tone::Own => Paint::stroke(Ink::Text, 2.0),
        Tone::Other => Paint::stroke(Ink::Muted, 3.0),
        Tone::Hint => Paint::stroke(Ink::Grid, 1.0),
    }
}

/// Returns the smallest view that holds every scene's.
fn union(scenes: &[Scene]) -> View {
    let views = scenes.iter().map(|scene| scene.view);
    let both = |a: View, b: View| View {
        min: [0, 1].map(|d: usize| a.min[d].min(b.min[d])),
        max: [0, 1].map(|d: usize| a.max[d].max(b.max[d])),
    };
    views.reduce(both).unwrap_or(View { min: [0.0; 2], max: [1.0; 2] })
}
