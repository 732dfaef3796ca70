//! What was said when, read off a session's events.

use std::collections::BTreeMap;

use leadtime_serve::{HeardSay, SayEvent, StepClock};

use crate::replay::StartedMessage;
use crate::sessions::RecordedSession;

/// An utterance with its times, in seconds from the beginning.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedUtterance {
    /// What was said, as a message.
    pub message: StartedMessage,
    /// When its first word began.
    pub start: f64,
    /// When enough had been heard to understand it; `None` if that never came.
    pub understood: Option<f64>,
    /// When it ended or was cut; `None` if the recording ends before.
    pub end: Option<f64>,
    /// It was cut before its last word had ended.
    pub is_cut: bool,
    /// Words that were heard.
    pub n_heard: u32,
}

/// A state of the notifier, from a time on, in seconds from the beginning.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedState {
    /// When the state began.
    pub start: f64,
    /// `silent`, `speaking` and so on.
    pub state: String,
    /// Why nothing was said.
    pub why: String,
}

/// What happened in a session, in order, in seconds from the beginning.
///
/// Where every observation was a step, time is counted in steps: how fast a simulator went says nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionCourse {
    /// What was said, in order.
    pub utterances: Vec<RecordedUtterance>,
    /// The states; empty where time is counted in steps.
    pub states: Vec<RecordedState>,
    /// When each episode was first seen.
    pub episodes: Vec<(f64, u64)>,
    /// What was observed, as far as it can be replayed.
    pub observations: Vec<(f64, Vec<f32>)>,
    /// When the last thing happened.
    pub end: f64,
}

impl SessionCourse {
    /// Puts a session in order.
    pub fn of(session: &RecordedSession) -> Self {
        let is_stepped = session.clock() == Some(StepClock::Observation);
        let clock = CourseClock::new(session, is_stepped);
        let mut course = Self::default();
        let inputs = || session.stretches.iter().flat_map(|stretch| &stretch.inputs);
        let sent = inputs().filter_map(|input| input.observation.as_ref());
        let episodes: BTreeMap<u64, u64> = sent.map(|sent| (sent.seq, sent.episode)).collect();
        for (at, event) in &session.events {
            // A raw event does not state its episode: it is that of the observation that it is about.
            let known = episodes.range(..=event.seq).next_back().map(|(_, episode)| *episode);
            let episode = known.filter(|_| event.topic_id.is_some()).unwrap_or(event.episode);
            course.take(clock.of(event.seq, *at), episode, event);
        }
        for (input, sent) in inputs().filter_map(|input| Some((input, input.observation.as_ref()?)))
        {
            let time = clock.of(sent.seq, input.at);
            if course.episodes.last().is_none_or(|(_, episode)| *episode != sent.episode) {
                course.episodes.push((time, sent.episode));
            }
            course.observations.push((time, sent.values.clone()));
            course.end = course.end.max(time);
        }
        if !is_stepped {
            for status in &session.statuses {
                let (start, state) = (clock.of(0, status.at), status.state.clone());
                if course.states.last().is_none_or(|last| last.state != state) {
                    let why = status.why.clone();
                    course.states.push(RecordedState { start, state, why });
                }
                course.end = course.end.max(start);
            }
        }
        course
    }

    fn take(&mut self, time: f64, episode: u64, event: &HeardSay) {
        self.end = self.end.max(time);
        let running = self.utterances.last_mut().filter(|it| it.end.is_none());
        match (event.event, running) {
            (SayEvent::Start, _) => self.utterances.push(RecordedUtterance {
                message: StartedMessage::of(event, episode),
                start: time,
                understood: None,
                end: None,
                is_cut: false,
                n_heard: 0,
            }),
            (what @ (SayEvent::Word | SayEvent::End | SayEvent::Cut), Some(utterance)) => {
                utterance.n_heard = event.heard;
                if event.heard >= event.k && utterance.understood.is_none() {
                    utterance.understood = Some(time);
                }
                if matches!(what, SayEvent::End | SayEvent::Cut) {
                    (utterance.end, utterance.is_cut) = (Some(time), what == SayEvent::Cut);
                }
            }
            (SayEvent::Silent | SayEvent::Word | SayEvent::End | SayEvent::Cut, _) => {}
        }
    }
}

/// Returns the time, in seconds from the beginning.
struct CourseClock {
    first_at: u64,
    first_seq: u64,
    /// How long an observation counts; `None` where the recorder's clock does.
    seconds_per_step: Option<f64>,
}

impl CourseClock {
    fn new(session: &RecordedSession, is_stepped: bool) -> Self {
        let inputs = || session.stretches.iter().flat_map(|stretch| &stretch.inputs);
        let of_events = session.events.iter().map(|(at, _)| *at);
        let of_statuses = session.statuses.iter().map(|status| status.at);
        let first_at = of_events.chain(of_statuses).chain(inputs().map(|input| input.at)).min();
        let sent = inputs().filter_map(|input| Some(input.observation.as_ref()?.seq));
        let first_seq = session.events.iter().map(|(_, event)| event.seq).chain(sent).min();
        let seconds_per_step = is_stepped.then(|| session.seconds_per_step());
        let (first_at, first_seq) = (first_at.unwrap_or(0), first_seq.unwrap_or(0));
        Self { first_at, first_seq, seconds_per_step }
    }

    fn of(&self, seq: u64, at: u64) -> f64 {
        match self.seconds_per_step {
            Some(seconds) => seq.saturating_sub(self.first_seq) as f64 * seconds,
            None => at.saturating_sub(self.first_at) as f64 * 1e-9,
        }
    }
}

#[cfg(test)]
mod tests {
    use leadtime_link::live::ArrivalEncoding;
    use leadtime_serve::TakenInput;

    use super::*;
    use crate::message::SentObservation;
    use crate::sessions::{RecordedInput, Stretch};

    /// An observation of an episode.
    fn observed(seq: u64, episode: u64) -> RecordedInput {
        let encoding = ArrivalEncoding::Binary;
        let (values, payload, beside) = (Vec::new(), Vec::new(), None);
        let sent = SentObservation { seq, episode, values, encoding, payload, beside };
        let (input, observation) =
            (TakenInput::Observation { at: 0, is_other_clock: false }, Some(sent));
        let (events, n_said) = (Vec::new(), None);
        RecordedInput { input, now: 0, step: 0, at: 0, observation, events, n_said }
    }

    /// The start of a message, which states episode 7 unless it is raw.
    fn started(seq: u64, topic_id: Option<u8>) -> (u64, HeardSay) {
        let json = format!(r#"{{"seq":{seq},"step":0,"event":"start","utterance":1,"episode":7}}"#);
        let event = HeardSay::read(json.as_bytes()).unwrap();
        let episode = if topic_id.is_some() { 0 } else { event.episode };
        (seq, HeardSay { topic_id, episode, ..event })
    }

    #[test]
    fn a_raw_message_is_of_the_episode_of_its_observation() {
        let inputs = vec![observed(1, 0), observed(3, 5), observed(6, 6)];
        let session = RecordedSession {
            client: "n/c".to_owned(),
            id: "s".to_owned(),
            start: String::new(),
            note: None,
            stretches: vec![Stretch { is_beginning: true, inputs }],
            n_observations: 3,
            n_apart: 0,
            events: vec![
                started(1, Some(2)),
                started(3, Some(2)),
                started(4, Some(2)),
                started(6, Some(2)),
                started(6, None),
            ],
            statuses: Vec::new(),
            gaps: BTreeMap::new(),
        };
        let course = SessionCourse::of(&session);
        let episodes = course.utterances.iter().map(|it| it.message.episode);
        assert_eq!(episodes.collect::<Vec<_>>(), [0, 5, 5, 6, 7]);
    }
}
