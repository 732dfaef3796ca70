//! The strip under the world: the listener's gauge over time, and when messages were spoken, waited for and followed.

use leadtime_sims::Scene;

use super::marker::{self, draw_marker};
use crate::draw::{Anchor, Area, Canvas, Ink, Paint, Panel, TextStyle, Weight, text_width};
use crate::playthrough::{Activity, Spoken, Timeline, topic_name};

const CURVE_HEIGHT: f64 = 92.0;
const ROW_HEIGHT: f64 = 19.0;
const ROW_GAP: f64 = 6.0;
/// Room for the rows' names.
const LEFT: f64 = 74.0;

/// How high the strip is, with its axis.
pub(super) const HEIGHT: f64 = CURVE_HEIGHT + 3.0 * (ROW_HEIGHT + ROW_GAP) + 52.0;

/// Draws the strip of `n_steps` steps into the given corner and width; the episode may be shorter.
pub(super) fn draw(
    canvas: &mut Canvas,
    corner: [f64; 2],
    width: f64,
    spoken: &Spoken,
    n_steps: usize,
) {
    let (scenes, timeline) = (&spoken.played.scenes[..], &spoken.timeline);
    let n_steps = n_steps.max(1) as f64;
    let area = Area::new(corner[0] + LEFT, corner[1], width - LEFT, CURVE_HEIGHT);
    let values = || scenes.iter().map(|scene| scene.gauge.value);
    let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
    let margin = 0.06 * (high - low);
    let frame = Panel::new(area, [0.0, n_steps], [low - margin, high + margin]);
    frame.draw_y(canvas, 3, scenes[0].gauge.label);
    draw_curve(canvas, &frame, scenes, timeline);
    let rows_top = area.bottom() + ROW_GAP + 4.0;
    let row = |i: usize| {
        let y = rows_top + i as f64 * (ROW_HEIGHT + ROW_GAP);
        Area { y, height: ROW_HEIGHT, ..area }
    };
    for (i, name) in ["says", "waits", "follows"].into_iter().enumerate() {
        let row = row(i);
        canvas.rectangle(row, 0.0, Paint::fill(Ink::Panel));
        let style = TextStyle::new(11.5, Ink::Muted).anchored(Anchor::End);
        canvas.text([row.x - 8.0, row.y + 13.5], name, style);
    }
    draw_rows(canvas, &frame, row, spoken);
    let bottom = Area { height: ROW_HEIGHT + 4.0, ..row(2) };
    let axis = Panel::new(bottom, [0.0, n_steps], [0.0, 1.0]);
    axis.draw_x(canvas, 8, Some(&axis_label(&scenes[0], timeline)));
}

/// Names the axis, and the topics whose initials stand in narrow bars.
fn axis_label(scene: &Scene, timeline: &Timeline) -> String {
    let said = |topic: &usize| timeline.utterances.iter().any(|u| u.topic == *topic);
    let names = (0..scene.listener.topics.len()).filter(said).map(|topic| topic_name(scene, topic));
    let keys: Vec<String> = names.map(|name| format!("{} {name}", initials(&name))).collect();
    if keys.is_empty() {
        return "step".to_owned();
    }
    format!("step (one word each)   \u{b7}   {}", keys.join(", "))
}

fn initials(name: &str) -> String {
    name.split(' ').filter_map(|word| word.chars().next()).collect()
}

fn draw_curve(canvas: &mut Canvas, frame: &Panel, scenes: &[Scene], timeline: &Timeline) {
    let at = |i: usize| frame.at([i as f64, scenes[i].gauge.value]);
    let mut start = 0;
    for run in timeline.activities.chunk_by(|a, b| a == b) {
        let end = start + run.len();
        let points: Vec<[f64; 2]> = (start..=end).map(at).collect();
        let width = 0.8 * marker::stroke_width(run[0]);
        canvas.line(&points, Paint::stroke(marker::ink(run[0]), width));
        start = end;
    }
    for utterance in &timeline.utterances {
        draw_marker(canvas, at(utterance.start));
    }
}

fn draw_rows(canvas: &mut Canvas, frame: &Panel, row: impl Fn(usize) -> Area, spoken: &Spoken) {
    let (scenes, timeline) = (&spoken.played.scenes[..], &spoken.timeline);
    let bar = |i: usize, start: usize, end: usize| {
        let (from, to) = (frame.x.at(start as f64), frame.x.at(end as f64));
        Area::new(from, row(i).y, (to - from - 1.0).max(1.0), ROW_HEIGHT)
    };
    for (i, utterance) in timeline.utterances.iter().enumerate() {
        let understood = utterance.understood();
        let ink = marker::ink(Activity::Hearing);
        let words = bar(0, utterance.start, utterance.end);
        canvas.rectangle(words, 2.0, Paint::fill(Ink::PaleOrange));
        let clear_from = understood.unwrap_or(utterance.end);
        if clear_from > utterance.start {
            let unclear = bar(0, utterance.start, clear_from);
            canvas.rectangle(unclear, 2.0, Paint::fill(ink));
        }
        if understood.is_none() {
            // Cut off before it could be understood: struck through.
            let y = words.y + ROW_HEIGHT / 2.0;
            canvas.line(&[[words.x, y], [words.right(), y]], Paint::stroke(ink.label(), 1.4));
        }
        let sentence = spoken.sentences.get(i).map(ToString::to_string);
        let topic = topic_name(&scenes[0], utterance.topic);
        name_bar(canvas, &words, ink.label(), sentence.as_deref(), &topic);
    }
    for (row, spans, activity) in
        [(1, &timeline.waits, Activity::Waiting), (2, &timeline.reactions, Activity::Following)]
    {
        for span in spans {
            let area = bar(row, span.start, span.end);
            let ink = marker::ink(activity);
            canvas.rectangle(area, 2.0, Paint::fill(ink));
            name_bar(canvas, &area, ink.label(), None, &topic_name(&scenes[0], span.topic));
        }
    }
}

/// Writes a sentence into its bar if it fits, else its topic, else the topic's initials, else nothing.
fn name_bar(canvas: &mut Canvas, area: &Area, ink: Ink, sentence: Option<&str>, name: &str) {
    const SIZE: f64 = 10.5;
    let initials = initials(name);
    let fits = |text: &&str| text_width(text, SIZE, Weight::Regular) + 5.0 <= area.width;
    let texts = sentence.into_iter().chain([name, initials.as_str()]);
    let Some(text) = texts.into_iter().find(fits) else { return };
    let style = TextStyle::new(SIZE, ink).anchored(Anchor::Middle);
    canvas.text([area.x + area.width / 2.0, area.y + 13.3], text, style);
}

#[cfg(test)]
mod tests {
    use leadtime_sims::human::{Comprehension, HumanSettings, SpeechAct};

    use crate::playthrough::synthetic::{ascend, lander, playthrough};
    use crate::playthrough::{Playthrough, Spoken};

    #[test]
    fn what_was_not_understood_is_struck_through_and_nothing_else() {
        let is_struck = |change: fn(&mut HumanSettings)| {
            let acts = [ascend(3, 3), SpeechAct::Continue, SpeechAct::Stop];
            let scenes = lander(change, &acts);
            let svg = Spoken::from(Playthrough { scenes, ..playthrough() }).svg("p").text;
            svg.contains("stroke-width=\"1.4\"")
        };
        assert!(!is_struck(|_| {}), "it is heard to its end");
        assert!(is_struck(|human| human.can_stop = true));
        let sooner = |human: &mut HumanSettings| {
            (human.can_stop, human.comprehension) = (true, Comprehension::Immediate);
        };
        assert!(!is_struck(sooner));
    }
}
