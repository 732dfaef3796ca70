//! The world's part of a picture: shapes, path, markers.

use leadtime_sims::{Scene, Shape, Tone, View};

use super::labels::{self, Placer};
use super::legend::{LegendEntry, Mark};
use super::marker::{self, draw_marker};
use crate::draw::{Anchor, Area, Canvas, Ink, Paint, Scale, TextStyle};
use crate::playthrough::{Sentence, Spoken, Timeline, topic_name};

/// A world is drawn at most this much higher than wide ...
const MAX_RATIO: f64 = 2.0 / 3.0;
/// ... and at least this much: a long road is stretched.
const MIN_RATIO: f64 = 0.25;

/// Size of the world's own labels.
const LABEL_SIZE: f64 = 11.0;

/// How far apart the person's body is drawn on the trajectory, in pixels.
const GHOST_DISTANCE: f64 = 95.0;

/// Where the points of a world lie in a picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorldView {
    pub(super) area: Area,
    x: Scale,
    y: Scale,
    label_size: f64,
}

impl WorldView {
    /// Fits everything that the scenes show into a panel of the given corner and width.
    pub(super) fn new(corner: [f64; 2], width: f64, scenes: &[Scene]) -> Self {
        let view = union(scenes);
        let size = [view.max[0] - view.min[0], view.max[1] - view.min[1]];
        let ratio = if size[0] > 0.0 { size[1] / size[0] } else { MAX_RATIO };
        let area =
            Area::new(corner[0], corner[1], width, width * ratio.clamp(MIN_RATIO, MAX_RATIO));
        let x = Scale::new([view.min[0], view.max[0]], [area.x, area.right()]);
        let y = Scale::new([view.min[1], view.max[1]], [area.bottom(), area.y]);
        Self { area, x, y, label_size: LABEL_SIZE }
    }

    /// Draws the world's own labels in another size.
    pub(super) fn with_label_size(self, label_size: f64) -> Self {
        Self { label_size, ..self }
    }

    pub(super) fn at(&self, point: [f64; 2]) -> [f64; 2] {
        [self.x.at(point[0]), self.y.at(point[1])]
    }

    fn all(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        points.iter().map(|point| self.at(*point)).collect()
    }

    /// Draws the panel with everything in the scene but the person's body.
    pub(super) fn draw_place(&self, canvas: &mut Canvas, scene: &Scene) {
        canvas.rectangle(self.area, 6.0, Paint::fill(Ink::Panel));
        canvas.clipped(self.area, |canvas| {
            for shape in scene.shapes.iter().filter(|shape| tone(shape) != Some(Tone::Own)) {
                self.draw_shape(canvas, shape, 1.0);
            }
        });
    }

    /// Draws the panel with the places of several episodes: what they share once, and what differs from one to the other
    /// (the ground) as faint as they are many.
    pub(super) fn draw_places(&self, canvas: &mut Canvas, scenes: &[&Scene]) {
        canvas.rectangle(self.area, 6.0, Paint::fill(Ink::Panel));
        let place = |scene: &&Scene| -> Vec<Shape> {
            let shapes = scene.shapes.iter().filter(|shape| tone(shape) != Some(Tone::Own));
            shapes.cloned().collect()
        };
        let places: Vec<Vec<Shape>> = scenes.iter().map(place).collect();
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

    /// Draws the person's body, more or less visible.
    pub(super) fn draw_body(&self, canvas: &mut Canvas, scene: &Scene, opacity: f64) {
        canvas.clipped(self.area, |canvas| {
            for shape in scene.shapes.iter().filter(|shape| tone(shape) == Some(Tone::Own)) {
                self.draw_shape(canvas, shape, opacity);
            }
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
                self.draw_dots(canvas, &scene.others);
                last = Some([x, y]);
            }
        }
    }

    fn draw_dots(&self, canvas: &mut Canvas, places: &[[f64; 2]]) {
        canvas.clipped(self.area, |canvas| {
            for &place in places {
                canvas.circle(self.at(place), 2.6, Paint::fill(Ink::Muted));
            }
        });
    }

    /// Draws the trajectories of the others.
    pub(super) fn draw_others(&self, canvas: &mut Canvas, scenes: &[Scene]) {
        let n_others = scenes.last().map_or(0, |scene| scene.others.len());
        canvas.clipped(self.area, |canvas| {
            for i in 0..n_others {
                let path = scenes.iter().filter_map(|scene| scene.others.get(i));
                let path: Vec<[f64; 2]> = path.map(|place| self.at(*place)).collect();
                canvas.line(&path, Paint::stroke(Ink::Muted, 1.0).opacity(0.7));
            }
        });
    }

    /// Draws the trajectory, coloured by what the person did; `scenes` may be the first part of an episode.
    pub(super) fn draw_path(&self, canvas: &mut Canvas, scenes: &[Scene], timeline: &Timeline) {
        let steps = &timeline.activities[..scenes.len().saturating_sub(1)];
        canvas.clipped(self.area, |canvas| {
            let mut start = 0;
            for run in steps.chunk_by(|a, b| a == b) {
                let end = start + run.len();
                let points: Vec<[f64; 2]> =
                    scenes[start..=end].iter().map(|scene| self.at(scene.position)).collect();
                canvas.line(&points, marker::stroke(run[0]));
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
        let path = scenes.iter().map(|scene| self.at(scene.position)).collect();
        let mut placer = Placer::new(self.area, path);
        for utterance in &timeline.utterances {
            let [x, y] = self.at(scenes[utterance.start].position);
            placer.block(Area::new(x - 5.0, y - 5.0, 10.0, 10.0));
        }
        for text in self.texts(scenes) {
            placer.block(text);
        }
        let mut first = 0;
        for run in timeline.utterances.chunk_by(|a, b| a.topic == b.topic) {
            let marker = self.at(scenes[run[0].start].position);
            // A sentence needs more room than the topic that it says.
            let sentence = spoken.sentences.get(first).map(|sentence| said(sentence, run.len()));
            first += run.len();
            let named = named(&topic_name(&scenes[0], run[0].topic), run.len());
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
        let labels = scenes.last().into_iter().flat_map(|scene| &scene.shapes);
        let area = |shape: &Shape| match shape {
            Shape::Label { at, text } => {
                let [x, y] = self.at(*at);
                let width = 7.0 * text.chars().count() as f64;
                Some(Area::new(x - width / 2.0, y - 8.0, width, 14.0))
            }
            _ => None,
        };
        labels.filter_map(area).collect()
    }

    fn draw_shape(&self, canvas: &mut Canvas, shape: &Shape, opacity: f64) {
        match shape {
            Shape::Rectangle { min, max, tone } => {
                let ([x0, y0], [x1, y1]) = (self.at(*min), self.at(*max));
                let area = Area::new(x0.min(x1), y0.min(y1), (x1 - x0).abs(), (y1 - y0).abs());
                canvas.rectangle(area, 0.0, filled(*tone).opacity(opacity));
            }
            Shape::Line { points, tone } => {
                canvas.line(&self.all(points), lined(*tone).opacity(opacity));
            }
            Shape::Polygon { points, tone } => {
                canvas.polygon(&self.all(points), filled(*tone).opacity(opacity));
            }
            Shape::Label { at, text } => {
                let [x, y] = self.at(*at);
                let style = TextStyle::new(self.label_size, Ink::Text).anchored(Anchor::Middle);
                canvas.text([x, y + 0.36 * self.label_size], text, style);
            }
        }
    }
}

/// Names the topic of a message and of those that repeat it.
fn named(topic: &str, n: usize) -> String {
    if n > 1 { format!("{topic} \u{d7}{n}") } else { topic.to_owned() }
}

/// Quotes a sentence, and counts those that repeat its topic in other words.
fn said(sentence: &Sentence, n: usize) -> String {
    if n > 1 { format!("{sentence} and {} more", n - 1) } else { sentence.to_string() }
}

/// Connects a label with its marker, unless it is right next to it.
fn draw_leader(canvas: &mut Canvas, marker: [f64; 2], label: &Area) {
    let nearest =
        [marker[0].clamp(label.x, label.right()), marker[1].clamp(label.y, label.bottom())];
    let gap = [nearest[0] - marker[0], nearest[1] - marker[1]];
    let length = gap[0].hypot(gap[1]);
    if length > 14.0 {
        let from = [marker[0] + gap[0] / length * 6.0, marker[1] + gap[1] / length * 6.0];
        canvas.line(&[from, nearest], Paint::stroke(Ink::Axis, 0.9));
    }
}

/// Explains the areas that the scenes show.
pub(super) fn areas(scenes: &[Scene]) -> impl Iterator<Item = LegendEntry> {
    let meanings = [
        (Tone::Danger, "danger"),
        (Tone::Mistaken, "believed otherwise"),
        (Tone::Hint, "what the person sees"),
        (Tone::Goal, "goal"),
    ];
    let shown = |tone| scenes.iter().any(|scene| has_area(scene, tone));
    let shown = meanings.into_iter().filter(move |(tone, _)| shown(*tone));
    shown.map(|(tone, label)| LegendEntry { mark: Mark::Swatch(filled(tone)), label })
}

/// Tells whether a scene has an area of a meaning; a pad is a line, and counts as one.
fn has_area(scene: &Scene, wanted: Tone) -> bool {
    let is_line = |shape: &Shape| matches!(shape, Shape::Line { .. }) && wanted == Tone::Hint;
    scene.shapes.iter().any(|shape| tone(shape) == Some(wanted) && !is_line(shape))
}

fn tone(shape: &Shape) -> Option<Tone> {
    match shape {
        Shape::Rectangle { tone, .. } | Shape::Line { tone, .. } | Shape::Polygon { tone, .. } => {
            Some(*tone)
        }
        Shape::Label { .. } => None,
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
    let mut view = scenes.first().map_or(View { min: [0.0; 2], max: [1.0; 2] }, |s| s.view);
    for scene in scenes {
        for d in 0..2 {
            view.min[d] = view.min[d].min(scene.view.min[d]);
            view.max[d] = view.max[d].max(scene.view.max[d]);
        }
    }
    view
}
