//! A session as text: what was said when, and what the notifier did.

use std::fmt::Write as _;
use std::ops::Range;

use crate::course::{RecordedUtterance, SessionCourse};
use crate::sessions::RecordedSession;

/// Why nothing can go wrong where text is written into text.
const WRITTEN: &str = "a string takes what is written";

/// Writes what was said when, a line each, with the notifier's states in between: all of it, or these seconds, half open.
///
/// # Panics
///
/// Never: a string takes what is written.
pub fn transcript(session: &RecordedSession, asked: Option<&Range<u64>>) -> String {
    let mut text = format!("{}, session {}\n", session.client, session.id);
    if let Some(note) = &session.note {
        let say = |key: &str| note.answer[key].to_string();
        let (domain, clock, seed) = (say("domain"), say("clock"), say("seed"));
        let (domain, clock) = (domain.trim_matches('"'), clock.trim_matches('"'));
        let (path, sha256) = (&note.policy.path, &note.policy.sha256);
        writeln!(text, "{domain}, clock {clock}, seed {seed}\n{path}, SHA-256 {sha256}")
            .expect(WRITTEN);
    }
    for gap in session.gaps.keys() {
        writeln!(text, "{}", gap.as_str()).expect(WRITTEN);
    }
    text.push_str("\n     time  episode  step\n");
    let course = SessionCourse::of(session);
    let mut lines: Vec<(f64, String)> = Vec::new();
    for utterance in &course.utterances {
        let (episode, step) = (utterance.message.episode, utterance.message.step);
        lines.push((utterance.start, format!("{episode:>7} {step:>5}  {}", said(utterance))));
    }
    for state in course.states.iter().filter(|it| it.state != "speaking" && it.state != "silent") {
        lines.push((state.start, format!("{:>15}{}: {}", "", state.state, state.why)));
    }
    lines.sort_by(|(one, _), (other, _)| one.total_cmp(other));
    let is_shown = |time: f64| {
        asked.is_none_or(|asked| (asked.start as f64..asked.end as f64).contains(&time))
    };
    for (time, line) in lines.into_iter().filter(|(time, _)| is_shown(*time)) {
        writeln!(text, "{time:8.2}s  {line}").expect(WRITTEN);
    }
    text
}

fn said(utterance: &RecordedUtterance) -> String {
    let message = &utterance.message;
    let (topic, k, l) = (&message.topic, message.k, message.l);
    let text = if message.text.is_empty() { topic } else { &message.text };
    match (utterance.is_cut, utterance.understood) {
        (true, None) => format!("{text}  ({topic}, cut after {} of {l} words)", utterance.n_heard),
        (true, Some(_)) => {
            let n = utterance.n_heard;
            format!("{text}  ({topic}, understood after {k}, cut after {n} of {l} words)")
        }
        (false, _) => format!("{text}  ({topic}, understood after {k} of {l} words)"),
    }
}
