//! A session as a picture: lines of time, on each what was said, from when on it was understood, what the notifier did, and
//! what was observed.

use std::ops::Range;

use leadtime_eval::draw::{
    Anchor, Area, Canvas, Ink, Paint, Panel, Svg, TextStyle, Weight, text_width,
};

use crate::course::{RecordedUtterance, SessionCourse};
use crate::sessions::RecordedSession;

/// How long a line is, in seconds.
const LINE_SECONDS: f64 = 12.0;
/// The most lines of a picture.
const MAX_LINES: usize = 8;
/// How many lines a picture has that is not asked for more.
const USUAL_LINES: usize = 4;

const WIDTH: f64 = 1080.0;
const MARGIN: f64 = 24.0;
/// Room for the names of rows.
const LEFT: f64 = 92.0;
const HEAD: f64 = 76.0;
const LABEL_HEIGHT: f64 = 15.0;
const N_LABEL_ROWS: usize = 3;
const BAR_HEIGHT: f64 = 18.0;
const BAND_HEIGHT: f64 = 15.0;
const CURVE_HEIGHT: f64 = 54.0;
const AXIS_HEIGHT: f64 = 34.0;
const GAP: f64 = 7.0;
const LABEL_SIZE: f64 = 11.5;
/// How many of the observation's numbers are drawn.
const N_CURVES: usize = 2;
/// The shortest part of an utterance that is drawn, in pixels.
const THINNEST: f64 = 1.5;

/// Returns the part of a session that a picture shows, in seconds: as asked for, at most [`MAX_LINES`] lines.
fn shown(course: &SessionCourse, asked: Option<Range<u64>>) -> (f64, usize) {
    let (from, to, most) = match asked {
        Some(asked) => (asked.start as f64, asked.end as f64, MAX_LINES),
        None => (0.0, course.end.max(LINE_SECONDS), USUAL_LINES),
    };
    let n_lines = ((to - from) / LINE_SECONDS).ceil().clamp(1.0, most as f64);
    (from, n_lines as usize)
}

/// Draws a session, or these seconds of it; `None` if nothing happened in them.
pub fn picture(session: &RecordedSession, asked: Option<Range<u64>>) -> Option<Svg> {
    let course = SessionCourse::of(session);
    let (from, n_lines) = shown(&course, asked);
    let to = from + n_lines as f64 * LINE_SECONDS;
    let is_empty = course.observations.is_empty() && course.utterances.is_empty();
    if from > course.end || is_empty {
        return None;
    }
    let names = curve_names(session, &course);
    let curves_height = if names.is_empty() { 0.0 } else { CURVE_HEIGHT + GAP };
    let labels_height = N_LABEL_ROWS as f64 * LABEL_HEIGHT;
    let line_height =
        labels_height + BAR_HEIGHT + GAP + BAND_HEIGHT + GAP + curves_height + AXIS_HEIGHT;
    let height = HEAD + n_lines as f64 * line_height + MARGIN / 2.0;
    let mut canvas = Canvas::new("session", WIDTH, height);
    draw_head(&mut canvas, session, &course, from, to);
    for i in 0..n_lines {
        let start = from + i as f64 * LINE_SECONDS;
        let line = TimeLine {
            course: &course,
            span: [start, start + LINE_SECONDS],
            top: HEAD + i as f64 * line_height,
            names: &names,
            is_last: i + 1 == n_lines,
        };
        line.draw(&mut canvas);
    }
    let n = course.utterances.len();
    canvas.describe(&format!("What was said when in {:.0} s: {n} messages in all.", course.end));
    Some(canvas.finish(&format!("{}, session {}", session.client, session.id)))
}

/// Names the observation's first numbers that change: place, name, least and greatest.
fn curve_names(
    session: &RecordedSession,
    course: &SessionCourse,
) -> Vec<(usize, String, [f64; 2])> {
    let Some(note) = &session.note else { return Vec::new() };
    let all = note.answer["observation"].as_array().cloned().unwrap_or_default();
    let named = all.iter().enumerate().filter_map(|(i, number)| {
        let values = || course.observations.iter().filter_map(|(_, all)| all.get(i)).copied();
        let (low, high) =
            (values().fold(f32::INFINITY, f32::min), values().fold(f32::NEG_INFINITY, f32::max));
        let margin = 0.08 * f64::from(high - low);
        let bounds = [f64::from(low) - margin, f64::from(high) + margin];
        (high > low).then(|| Some((i, number["name"].as_str()?.to_owned(), bounds)))?
    });
    named.take(N_CURVES).collect()
}

fn draw_head(
    canvas: &mut Canvas,
    session: &RecordedSession,
    course: &SessionCourse,
    from: f64,
    to: f64,
) {
    let client = &session.client;
    let title = TextStyle::new(16.0, Ink::Text).bold();
    canvas.text([MARGIN, 30.0], &format!("{client}: what was said when"), title);
    let part = format!("{from:.0} to {:.0} s of {:.0} s", to.min(course.end), course.end);
    let style = TextStyle::new(12.0, Ink::Muted).anchored(Anchor::End);
    canvas.text([WIDTH - MARGIN, 30.0], &part, style);
    let mut x = MARGIN;
    let legend = [
        (Some(Ink::Orange), "until it is understood"),
        (Some(Ink::PaleOrange), "the rest of the words"),
        (None, "cut before"),
    ];
    for (ink, name) in legend {
        let area = Area::new(x, 45.0, 26.0, 12.0);
        canvas.rectangle(area, 2.0, Paint::fill(ink.unwrap_or(Ink::Orange)));
        if ink.is_none() {
            strike(canvas, &area);
        }
        canvas.text([x + 32.0, 55.0], name, TextStyle::new(12.0, Ink::Text));
        x += 32.0 + text_width(name, 12.0, Weight::Regular) + 22.0;
    }
}

fn strike(canvas: &mut Canvas, area: &Area) {
    let y = area.y + area.height / 2.0;
    let ends = [[area.x, y], [area.right(), y]];
    canvas.line(&ends, Paint::stroke(Ink::Orange.label(), 1.4));
}

struct TimeLine<'a> {
    course: &'a SessionCourse,
    /// From when to when, in seconds.
    span: [f64; 2],
    top: f64,
    names: &'a [(usize, String, [f64; 2])],
    is_last: bool,
}

impl TimeLine<'_> {
    fn draw(&self, canvas: &mut Canvas) {
        let width = WIDTH - MARGIN - LEFT;
        let bar = Area::new(LEFT, self.top + N_LABEL_ROWS as f64 * LABEL_HEIGHT, width, BAR_HEIGHT);
        let band = Area { y: bar.bottom() + GAP, height: BAND_HEIGHT, ..bar };
        let curves = Area { y: band.bottom() + GAP, height: CURVE_HEIGHT, ..bar };
        name_row(canvas, bar.y + 13.0, "says", Ink::Muted);
        canvas.rectangle(bar, 0.0, Paint::fill(Ink::Panel));
        self.draw_words(canvas, bar);
        if self.course.states.is_empty() {
            name_row(canvas, band.y + 11.5, "episode", Ink::Muted);
            self.draw_episodes(canvas, band);
        } else {
            name_row(canvas, band.y + 11.5, "state", Ink::Muted);
            self.draw_states(canvas, band);
        }
        let lowest = if self.names.is_empty() { band } else { curves };
        if !self.names.is_empty() {
            canvas.rectangle(curves, 0.0, Paint::fill(Ink::Panel));
            canvas.clipped(curves, |canvas| self.draw_curves(canvas, curves));
            for (i, (_, name, _)) in self.names.iter().enumerate() {
                name_row(canvas, curves.y + 22.0 + i as f64 * 18.0, name, curve_ink(i));
            }
        }
        let axis =
            Panel::new(Area { height: lowest.height + 3.0, ..lowest }, self.span, [0.0, 1.0]);
        axis.draw_x(canvas, 12, Some(if self.is_last { "seconds" } else { "" }));
    }

    fn x(&self, area: Area, time: f64) -> f64 {
        Panel::new(area, self.span, [0.0, 1.0]).x.at(time.clamp(self.span[0], self.span[1]))
    }

    /// Returns where a span of time is, if any of it is on this line.
    fn part(&self, row: Area, from: f64, to: f64) -> Option<Area> {
        let is_here = from < self.span[1] && to > self.span[0];
        let (left, right) = (self.x(row, from), self.x(row, to));
        is_here.then(|| Area { x: left, width: (right - left - 1.0).max(THINNEST), ..row })
    }

    fn draw_words(&self, canvas: &mut Canvas, row: Area) {
        // How far the labels of each row reach.
        let mut taken = [f64::MIN; N_LABEL_ROWS];
        let mut labels = Vec::new();
        for utterance in &self.course.utterances {
            let end = utterance.end.unwrap_or(self.course.end);
            let Some(whole) = self.part(row, utterance.start, end) else { continue };
            canvas.rectangle(whole, 2.0, Paint::fill(Ink::PaleOrange));
            let understood = utterance.understood.unwrap_or(end);
            if let Some(first) = self.part(row, utterance.start, understood) {
                canvas.rectangle(first, 2.0, Paint::fill(Ink::Orange));
            }
            if utterance.is_cut && utterance.understood.is_none() {
                strike(canvas, &whole);
            }
            if utterance.start >= self.span[0] {
                labels.extend(label(whole, utterance, &mut taken));
            }
        }
        for PlacedLabel { at: [_, y], foot, .. } in &labels {
            let line = [[foot[0], y + 3.0], *foot];
            canvas.line(&line, Paint::stroke(Ink::Grid, 1.0));
        }
        let style = TextStyle::new(LABEL_SIZE, Ink::Text).haloed(Ink::Paper);
        for label in &labels {
            canvas.text(label.at, label.text, style);
        }
    }

    fn draw_episodes(&self, canvas: &mut Canvas, row: Area) {
        let episodes = &self.course.episodes;
        for (i, (start, episode)) in episodes.iter().enumerate() {
            let end = episodes.get(i + 1).map_or(self.course.end, |(next, _)| *next);
            let Some(area) = self.part(row, *start, end) else { continue };
            let ink = if i % 2 == 0 { Ink::Sky } else { Ink::Blue };
            draw_band(canvas, area, ink, &episode.to_string());
        }
    }

    fn draw_states(&self, canvas: &mut Canvas, row: Area) {
        let states = &self.course.states;
        for (i, state) in states.iter().enumerate() {
            let end = states.get(i + 1).map_or(self.course.end, |next| next.start);
            let Some(area) = self.part(row, state.start, end) else { continue };
            let ink = match state.state.as_str() {
                "speaking" => Ink::Green,
                "stale" => Ink::Vermilion,
                "lost" | "closed" => Ink::Purple,
                _ => Ink::Neutral,
            };
            draw_band(canvas, area, ink, &state.state);
        }
    }

    fn draw_curves(&self, canvas: &mut Canvas, area: Area) {
        for (i, (place, _, [low, high])) in self.names.iter().enumerate() {
            let panel = Panel::new(area, self.span, [*low, *high]);
            let mut points: Vec<[f64; 2]> = Vec::new();
            let mut episode_ends = self.course.episodes.iter().map(|(start, _)| *start).peekable();
            for (time, values) in &self.course.observations {
                // A new episode is a new line.
                while episode_ends.next_if(|start| start <= time).is_some() {
                    canvas.line(&points, Paint::stroke(curve_ink(i), 1.5));
                    points.clear();
                }
                let Some(value) = values.get(*place) else { continue };
                if *time >= self.span[0] - 1.0 && *time <= self.span[1] + 1.0 {
                    points.push(panel.at([*time, f64::from(*value)]));
                }
            }
            canvas.line(&points, Paint::stroke(curve_ink(i), 1.5));
        }
    }
}

/// A sentence above its bar.
struct PlacedLabel<'a> {
    text: &'a str,
    at: [f64; 2],
    /// Where the line ends that leads to the bar.
    foot: [f64; 2],
}

/// Places a sentence above its bar, in the first row that has room; the topic, where none has.
fn label<'a>(
    bar: Area,
    utterance: &'a RecordedUtterance,
    taken: &mut [f64; N_LABEL_ROWS],
) -> Option<PlacedLabel<'a>> {
    let message = &utterance.message;
    let texts = [message.text.as_str(), message.topic.as_str()];
    for text in texts.into_iter().filter(|text| !text.is_empty()) {
        let width = text_width(text, LABEL_SIZE, Weight::Regular);
        let x = bar.x.min(WIDTH - MARGIN - width);
        let Some(row) = taken.iter().position(|reach| *reach + 8.0 <= x) else { continue };
        taken[row] = x + width;
        let at = [x, bar.y - 4.0 - row as f64 * LABEL_HEIGHT];
        return Some(PlacedLabel { text, at, foot: [bar.x + 0.5, bar.y] });
    }
    None
}

fn name_row(canvas: &mut Canvas, y: f64, name: &str, ink: Ink) {
    let style = TextStyle::new(11.5, ink).anchored(Anchor::End);
    canvas.text([LEFT - 8.0, y], name, style);
}

/// Draws a part of a row, with its name if there is room.
fn draw_band(canvas: &mut Canvas, area: Area, ink: Ink, name: &str) {
    const SIZE: f64 = 10.5;
    canvas.rectangle(area, 2.0, Paint::fill(ink));
    if text_width(name, SIZE, Weight::Regular) + 6.0 <= area.width {
        let style = TextStyle::new(SIZE, ink.label()).anchored(Anchor::Middle);
        canvas.text([area.x + area.width / 2.0, area.y + 11.2], name, style);
    }
}

fn curve_ink(i: usize) -> Ink {
    [Ink::Blue, Ink::Green][i % N_CURVES]
}
