//! The strip under the world: the person's gauge over time, and what was said, understood and done about it.

use leadtime_sims::Scene;

use super::record::Playthrough;
use super::story::{Doing, Story};
use super::world::{draw_marker, topic_name};
use crate::draw::{Anchor, Area, Canvas, Ink, Paint, Panel, TextStyle, Weight, text_width};

const CURVE_HEIGHT: f64 = 92.0;
const LANE_HEIGHT: f64 = 19.0;
const LANE_GAP: f64 = 6.0;
/// Room for the lanes' names.
const LEFT: f64 = 74.0;

/// How high the strip is, with its axis.
pub(super) const HEIGHT: f64 = CURVE_HEIGHT + 3.0 * (LANE_HEIGHT + LANE_GAP) + 52.0;

/// Draws the strip of `n_steps` steps into the given corner and width; the episode may be shorter.
pub(super) fn draw(
    canvas: &mut Canvas,
    corner: [f64; 2],
    width: f64,
    played: &Playthrough,
    story: &Story,
    n_steps: usize,
) {
    let scenes = &played.scenes[..];
    let n_steps = n_steps.max(1) as f64;
    let area = Area::new(corner[0] + LEFT, corner[1], width - LEFT, CURVE_HEIGHT);
    let values = || scenes.iter().map(|scene| scene.gauge.value);
    let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
    let margin = 0.06 * (high - low);
    let frame = Panel::new(area, [0.0, n_steps], [low - margin, high + margin]);
    frame.draw_y(canvas, 3, scenes[0].gauge.label);
    draw_curve(canvas, &frame, scenes, story);
    let lanes_top = area.bottom() + LANE_GAP + 4.0;
    let lane = |i: usize| {
        let y = lanes_top + i as f64 * (LANE_HEIGHT + LANE_GAP);
        Area::new(area.x, y, area.width, LANE_HEIGHT)
    };
    for (i, name) in ["says", "waits", "follows"].into_iter().enumerate() {
        let lane = lane(i);
        canvas.rectangle(lane, 0.0, Paint::fill(Ink::Panel));
        let style = TextStyle::new(11.5, Ink::Muted).anchored(Anchor::End);
        canvas.text([lane.x - 8.0, lane.y + 13.5], name, style);
    }
    draw_lanes(canvas, &frame, lane, played, story);
    let bottom = Area::new(area.x, lane(2).y, area.width, LANE_HEIGHT + 4.0);
    let axis = Panel::new(bottom, [0.0, n_steps], [0.0, 1.0]);
    axis.draw_x(canvas, 8, Some(&axis_label(&scenes[0], story)));
}

/// Names the axis, and the topics whose initials stand in narrow bars.
fn axis_label(scene: &Scene, story: &Story) -> String {
    let said = |topic: &usize| story.utterances.iter().any(|u| u.topic == *topic);
    let topics = (0..scene.listener.topics.len()).filter(said);
    let keys = topics.map(|topic| topic_name(scene, topic));
    let keys: Vec<String> = keys.map(|name| format!("{} {name}", initials(&name))).collect();
    if keys.is_empty() {
        return "step".to_owned();
    }
    format!("step (one word each)   \u{b7}   {}", keys.join(", "))
}

fn initials(name: &str) -> String {
    name.split(' ').filter_map(|word| word.chars().next()).collect()
}

fn draw_curve(canvas: &mut Canvas, frame: &Panel, scenes: &[Scene], story: &Story) {
    let at = |i: usize| frame.at([i as f64, scenes[i].gauge.value]);
    let mut start = 0;
    for run in story.doing.chunk_by(|a, b| a == b) {
        let end = start + run.len();
        let points: Vec<[f64; 2]> = (start..=end).map(at).collect();
        canvas.line(&points, Paint::stroke(run[0].ink(), run[0].width() * 0.8));
        start = end;
    }
    for utterance in &story.utterances {
        draw_marker(canvas, at(utterance.start));
    }
}

fn draw_lanes(
    canvas: &mut Canvas,
    frame: &Panel,
    lane: impl Fn(usize) -> Area,
    played: &Playthrough,
    story: &Story,
) {
    let scenes = &played.scenes[..];
    let bar = |row: usize, start: usize, end: usize| {
        let (from, to) = (frame.x.at(start as f64), frame.x.at(end as f64));
        Area::new(from, lane(row).y, (to - from - 1.0).max(1.0), LANE_HEIGHT)
    };
    for (i, utterance) in story.utterances.iter().enumerate() {
        let understood = utterance.start + utterance.comprehension;
        let paint = Paint::fill(Doing::Hearing.ink());
        let words = bar(0, utterance.start, utterance.end);
        canvas.rectangle(words, 2.0, paint.fill_opacity(0.35));
        let unclear = bar(0, utterance.start, understood.min(utterance.end));
        canvas.rectangle(unclear, 2.0, paint);
        if understood > utterance.end {
            // Cut off before it could be understood: struck through.
            let y = words.y + LANE_HEIGHT / 2.0;
            canvas.line(&[[words.x, y], [words.right(), y]], Paint::stroke(Ink::Text, 1.4));
        }
        let sentence = played.sentences.get(i).map(ToString::to_string);
        name_bar(canvas, &words, sentence.as_deref(), &topic_name(&scenes[0], utterance.topic));
    }
    for (row, spans, doing) in
        [(1, &story.waits, Doing::Waiting), (2, &story.reactions, Doing::Following)]
    {
        for span in spans {
            let area = bar(row, span.start, span.end);
            canvas.rectangle(area, 2.0, Paint::fill(doing.ink()).fill_opacity(0.85));
            name_bar(canvas, &area, None, &topic_name(&scenes[0], span.topic));
        }
    }
}

/// Writes a sentence into its bar if it fits, else its topic, else the topic's initials, else nothing.
fn name_bar(canvas: &mut Canvas, area: &Area, sentence: Option<&str>, name: &str) {
    const SIZE: f64 = 10.5;
    let initials = initials(name);
    let fits = |text: &&str| text_width(text, SIZE, Weight::Regular) + 5.0 <= area.width;
    let texts = sentence.into_iter().chain([name, initials.as_str()]);
    let Some(text) = texts.into_iter().find(fits) else { return };
    let style = TextStyle::new(SIZE, Ink::Text).anchored(Anchor::Middle);
    canvas.text([area.x + area.width / 2.0, area.y + 13.3], text, style);
}
