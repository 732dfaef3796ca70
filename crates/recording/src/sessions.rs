//! From messages to sessions: what each took in, in order, with what was said in response.
//!
//! ```text
//! obs      ─┐
//! say      ─┼─ by the lines of `taken` ─▶  stretches: inputs without a gap, from a beginning on
//! session  ─┘
//! ```
//!
//! A **stretch** begins where nothing that came before matters: with the session, or with an episode. Where a line or an
//! observation is missing, it ends, and the next one begins with the next episode.

use std::collections::{BTreeMap, VecDeque};

use leadtime_link::live::LiveTopic;
use leadtime_serve::{HeardSay, SayEvent, SessionNote, StepClock, TakenInput, TakenLine};
use serde_json::Value;

use crate::message::{SentObservation, said_event, sent_observation};
use crate::read::{RecordedClient, RecordedMessage};
use crate::topic::RecordedTopic;

/// Something that the notifier took in, with what it said in response.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedInput {
    /// What was taken in.
    pub input: TakenInput,
    /// The notifier's time, in nanoseconds.
    pub now: u64,
    /// The step of the episode that it led to, from 0.
    pub step: u32,
    /// When the recorder heard of it, in nanoseconds since 1970.
    pub at: u64,
    /// The observation, if it is one.
    pub observation: Option<SentObservation>,
    /// The events that were recorded.
    pub events: Vec<HeardSay>,
    /// How many there were; `None` where that is not known.
    pub n_said: Option<u64>,
}

/// Inputs without a gap, from a beginning on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stretch {
    /// It begins with the session, not with a later episode.
    pub is_beginning: bool,
    /// What was taken in, in order.
    pub inputs: Vec<RecordedInput>,
}

impl Stretch {
    /// Returns what comes up to its last observation: what a notifier does once no client is there any more is left
    /// out.
    #[must_use]
    pub fn up_to_last_observation(mut self) -> Self {
        let n = self.inputs.iter().rposition(|input| input.observation.is_some());
        self.inputs.truncate(n.map_or(0, |n| n + 1));
        self
    }
}

/// What a notifier did, as it reported it.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedStatus {
    /// When it arrived, in nanoseconds since 1970.
    pub at: u64,
    /// The state: `silent`, `speaking` and so on.
    pub state: String,
    /// Why nothing was said.
    pub why: String,
}

/// A session as it was recorded, in one start of the notifier: one that was started again and went on with it has another one.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSession {
    /// The notifier and the client: `notifier/car-1`.
    pub client: String,
    /// Name of the session, as the notifier's answer gave it.
    pub id: String,
    /// The start of the notifier; empty where the recording does not state it.
    pub start: String,
    /// What it is; `None` if the recorder could not learn it.
    pub note: Option<SessionNote>,
    /// What can be replayed.
    pub stretches: Vec<Stretch>,
    /// Every observation that was taken in, and how many of them belong to no stretch.
    pub n_observations: usize,
    /// Observations that belong to no stretch.
    pub n_apart: usize,
    /// Every event, with when it arrived, in nanoseconds since 1970.
    pub events: Vec<(u64, HeardSay)>,
    /// What the notifier reported of itself.
    pub statuses: Vec<RecordedStatus>,
    /// Why something cannot be replayed, each reason once, with how often.
    pub gaps: BTreeMap<Gap, usize>,
}

/// Why something cannot be replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Gap {
    /// The recorder came in the middle of an episode.
    CameLate,
    /// The notifier was started again and went on with the session.
    Restarted,
    /// A line of what was taken in is missing.
    LineMissing,
    /// An observation that was taken in is missing.
    ObservationMissing,
}

impl Gap {
    /// Says it in a sentence's part.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::CameLate => "the recording begins in the middle of an episode",
            Self::Restarted => "the notifier was started again, and what came before is not told",
            Self::LineMissing => "messages about what was taken in are missing",
            Self::ObservationMissing => "an observation is missing",
        }
    }
}

impl RecordedSession {
    /// Returns when steps were taken; `None` if it is not known.
    pub fn clock(&self) -> Option<StepClock> {
        let note = self.note.as_ref()?;
        serde_json::from_value(note.answer["clock"].clone()).ok()
    }

    /// Returns how long a step took, in seconds.
    pub fn seconds_per_step(&self) -> f64 {
        let said = self.note.as_ref().and_then(|note| note.answer["seconds_per_step"].as_f64());
        said.filter(|seconds| *seconds > 0.0).unwrap_or(0.3)
    }
}

/// Finds the sessions of a client, in order.
pub fn sessions(client: &RecordedClient) -> Vec<RecordedSession> {
    let observations = Observations::new(&client.messages);
    let mut making = Making { client, observations, sessions: Vec::new(), run: None };
    let mut said = VecDeque::new();
    let mut statuses = Vec::new();
    let mut notes: Vec<SessionNote> = Vec::new();
    for message in &client.messages {
        match message.topic {
            RecordedTopic::Live(LiveTopic::Say) => {
                said.extend(said_event(&message.json).map(|event| (message.at, event)));
            }
            RecordedTopic::Live(LiveTopic::Taken) => {
                if let Ok(line) = serde_json::from_slice::<TakenLine<'_>>(&message.json) {
                    making.take(message.at, &line, &mut said);
                }
            }
            RecordedTopic::Live(LiveTopic::Status) => {
                let n_sessions = making.sessions.len();
                statuses.extend(status(message).map(|(id, status)| (n_sessions, id, status)));
            }
            RecordedTopic::Session => notes.extend(serde_json::from_slice(&message.json).ok()),
            RecordedTopic::Live(LiveTopic::Observations | LiveTopic::Heard)
            | RecordedTopic::Metrics => {}
        }
    }
    let mut found = making.sessions;
    // What was said after the last line belongs to the last session; what it responded to is not recorded.
    if let Some(last) = found.last_mut() {
        last.events.extend(said);
    }
    for (n_begun, id, status) in statuses {
        // The first status of a session comes before its first line.
        let is_its = |session: &RecordedSession| session.id == id;
        let place = found[..n_begun].iter().rposition(is_its);
        if let Some(place) = place.or_else(|| found.iter().position(is_its)) {
            found[place].statuses.push(status);
        }
    }
    for session in &mut found {
        let is_its = |note: &&SessionNote| {
            let is_start = session.start.is_empty() || session.start == note.start;
            note.session == session.id && is_start
        };
        session.note = notes.iter().find(is_its).cloned();
    }
    found
}

fn status(message: &RecordedMessage) -> Option<(String, RecordedStatus)> {
    let json: Value = serde_json::from_slice(&message.json).ok()?;
    let text = |key: &str| json[key].as_str().map(str::to_owned);
    let (state, why) = (text("state")?, text("why").unwrap_or_default());
    Some((text("session")?, RecordedStatus { at: message.at, state, why }))
}

/// A client's observations, of which each is taken once and in order.
struct Observations {
    all: Vec<Option<SentObservation>>,
    by_number: BTreeMap<u64, Vec<usize>>,
    /// Those before this one have had their turn.
    next: usize,
}

impl Observations {
    fn new(messages: &[RecordedMessage]) -> Self {
        let topic = RecordedTopic::Live(LiveTopic::Observations);
        let sent = messages.iter().filter(|message| message.topic == topic);
        let mut all = Vec::new();
        let mut by_number: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
        for observation in sent.filter_map(|message| sent_observation(&message.json)) {
            by_number.entry(observation.seq).or_default().push(all.len());
            all.push(Some(observation));
        }
        Self { all, by_number, next: 0 }
    }

    fn take(&mut self, seq: u64) -> Option<SentObservation> {
        let places = self.by_number.get(&seq)?;
        let place = *places.iter().find(|place| **place >= self.next)?;
        self.next = place + 1;
        self.all[place].take()
    }
}

impl RecordedSession {
    /// Takes the events that come before a line: all that there were, or as many as are left of them.
    fn hear(
        &mut self,
        line: &TakenLine<'_>,
        n_said: Option<u64>,
        said: &mut VecDeque<(u64, HeardSay)>,
    ) -> Vec<HeardSay> {
        let mut events = Vec::new();
        while n_said.is_none_or(|n| (events.len() as u64) < n)
            && said.front().is_some_and(|(_, event)| is_by(event, line))
        {
            let Some((at, event)) = said.pop_front() else { break };
            self.events.push((at, event.clone()));
            events.push(event);
        }
        events
    }
}

/// Returns whether an event was said by the time that a line tells of.
fn is_by(event: &HeardSay, line: &TakenLine<'_>) -> bool {
    // What is cut by a new episode was said in a later step of the one before.
    let is_of_step = event.step <= line.step || event.event == SayEvent::Cut;
    event.seq < line.seq || event.seq == line.seq && is_of_step
}

/// Where the lines of a session are.
struct LineRun {
    /// The last line's number, and how much had been said by then.
    n: u64,
    said: u64,
    /// The episode of the last observation, if it is known.
    episode: Option<u64>,
    /// Inputs are taken into a stretch.
    is_in_stretch: bool,
    /// The recorder was there before the last line: it should have every further observation.
    has_begun: bool,
}

struct Making<'a> {
    client: &'a RecordedClient,
    observations: Observations,
    sessions: Vec<RecordedSession>,
    run: Option<LineRun>,
}

impl Making<'_> {
    fn take(&mut self, at: u64, line: &TakenLine<'_>, said: &mut VecDeque<(u64, HeardSay)>) {
        let is_other = |it: &RecordedSession| it.id != line.session || it.start != line.start;
        if self.sessions.last().is_none_or(is_other) {
            self.begin(line, said);
        }
        let goes_on = self.sessions.iter().rev().skip(1).any(|it| it.id == line.session);
        let Some(session) = self.sessions.last_mut() else { return };
        let is_beginning = line.is_beginning();
        let follows = self.run.as_ref().is_some_and(|run| run.n + 1 == line.n);
        if !follows {
            let is_first = self.run.is_none();
            if is_beginning {
                session.stretches.push(Stretch { is_beginning: true, inputs: Vec::new() });
            } else {
                let at_first = if goes_on { Gap::Restarted } else { Gap::CameLate };
                let gap = if is_first { at_first } else { Gap::LineMissing };
                *session.gaps.entry(gap).or_default() += 1;
            }
            let is_in_stretch = is_beginning;
            // Before the first line nothing had been said.
            // The observations of a session that goes on come from a client that was heard before.
            let has_begun = is_in_stretch || goes_on || !is_first;
            let (n, said, episode) = (line.n, 0, None);
            self.run = Some(LineRun { n, said, episode, is_in_stretch, has_begun });
        }
        let Some(run) = &mut self.run else { return };
        let n_said = (follows || is_beginning).then(|| line.said.saturating_sub(run.said));
        (run.n, run.said) = (line.n, line.said);
        let events = session.hear(line, n_said, said);
        let mut input = RecordedInput {
            input: line.input,
            now: line.now,
            step: line.step,
            at,
            observation: None,
            events,
            n_said,
        };
        if let TakenInput::Observation { .. } = line.input {
            session.n_observations += 1;
            let Some(observation) = self.observations.take(line.seq) else {
                // Where the recorder came late, the first lines are about what was sent before.
                if run.has_begun {
                    *session.gaps.entry(Gap::ObservationMissing).or_default() += 1;
                }
                session.n_apart += 1;
                (run.is_in_stretch, run.episode) = (false, None);
                return;
            };
            let is_new = run.episode.is_some_and(|episode| episode != observation.episode);
            (run.episode, run.has_begun) = (Some(observation.episode), true);
            input.observation = Some(observation);
            if !run.is_in_stretch && is_new {
                run.is_in_stretch = true;
                session.stretches.push(Stretch::default());
                // What was cut was said in the episode before.
                let is_later =
                    |event: &HeardSay| event.seq == line.seq && event.event != SayEvent::Cut;
                input.events.retain(is_later);
                input.n_said = None;
            }
            session.n_apart += usize::from(!run.is_in_stretch);
        }
        if run.is_in_stretch
            && let Some(stretch) = session.stretches.last_mut()
        {
            stretch.inputs.push(input);
        }
    }

    /// Begins a session with its first line.
    fn begin(&mut self, line: &TakenLine<'_>, said: &mut VecDeque<(u64, HeardSay)>) {
        self.run = None;
        // What is said about later observations was said in the session before.
        while said.front().is_some_and(|(_, event)| !is_by(event, line)) {
            let event = said.pop_front();
            if let Some(before) = self.sessions.last_mut() {
                before.events.extend(event);
            }
        }
        self.sessions.push(RecordedSession {
            client: self.client.name.clone(),
            id: line.session.clone().into_owned(),
            start: line.start.clone().into_owned(),
            note: None,
            stretches: Vec::new(),
            n_observations: 0,
            n_apart: 0,
            events: Vec::new(),
            statuses: Vec::new(),
            gaps: BTreeMap::new(),
        });
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// A client of whom observations and lines were recorded: the number, the episode, the line's number.
    fn client(taken: &[(u64, u64, u64)], without: &[u64]) -> RecordedClient {
        let message = |topic, json: Value| RecordedMessage {
            topic,
            at: 7,
            json: json.to_string().into_bytes(),
        };
        let mut messages = Vec::new();
        for (seq, episode, n) in taken {
            let say = |event: &str, step: u64| json!({"seq": seq, "step": step, "episode": episode, "event": event, "last": true});
            messages.push(message(RecordedTopic::Live(LiveTopic::Say), say("cut", 3)));
            messages.push(message(RecordedTopic::Live(LiveTopic::Say), say("silent", 0)));
            let line = json!({
                "session": "s", "n": n, "now": 10 * seq, "said": 2 * n, "what": "observation", "seq": seq, "step": 3, "at": 10 * seq
            });
            messages.push(message(RecordedTopic::Live(LiveTopic::Taken), line));
            // What the client sent may arrive after what it led to.
            if !without.contains(seq) {
                let sent = json!({"seq": seq, "t": 0.0, "obs": [0.5], "episode": episode});
                messages.push(message(RecordedTopic::Live(LiveTopic::Observations), sent));
            }
        }
        RecordedClient { name: "n/c".to_owned(), messages }
    }

    fn numbers(session: &RecordedSession) -> Vec<Vec<u64>> {
        let of = |stretch: &Stretch| {
            let sent = stretch.inputs.iter().filter_map(|input| input.observation.as_ref());
            sent.map(|observation| observation.seq).collect()
        };
        session.stretches.iter().map(of).collect()
    }

    #[test]
    fn a_whole_session_is_one_stretch() {
        let found = sessions(&client(&[(1, 0, 1), (2, 0, 2), (3, 1, 3)], &[]));
        assert_eq!(found.len(), 1);
        assert_eq!(numbers(&found[0]), [vec![1, 2, 3]]);
        assert!(found[0].stretches[0].is_beginning && found[0].gaps.is_empty());
        assert_eq!((found[0].n_observations, found[0].n_apart), (3, 0));
        let inputs = &found[0].stretches[0].inputs;
        assert!(inputs.iter().all(|it| it.n_said == Some(2) && it.events.len() == 2));
    }

    /// Lets the messages about observations from `seq` on be of another start of the notifier.
    fn restarted(mut client: RecordedClient, from: u64) -> RecordedClient {
        for message in &mut client.messages {
            let mut json: Value = serde_json::from_slice(&message.json).unwrap();
            if message.topic == RecordedTopic::Live(LiveTopic::Taken) {
                json["start"] = if json["seq"].as_u64() < Some(from) { "a" } else { "b" }.into();
            }
            message.json = json.to_string().into_bytes();
        }
        client
    }

    #[test]
    fn two_starts_of_a_notifier_are_never_one_stretch() {
        // The second one counts from 2 again, or goes on by chance where the first one ended.
        for n in [2, 4] {
            let taken = [(1, 0, 1), (2, 0, 2), (3, 0, 3), (4, 0, n), (5, 0, n + 1), (6, 1, n + 2)];
            let found = sessions(&restarted(client(&taken, &[]), 4));
            assert_eq!(found.len(), 2);
            assert_eq!(numbers(&found[0]), [vec![1, 2, 3]]);
            assert_eq!(numbers(&found[1]), [vec![6]]);
            assert!(found[0].gaps.is_empty(), "{:?}", found[0].gaps);
            assert_eq!(found[1].gaps, BTreeMap::from([(Gap::Restarted, 1)]));
            assert_eq!((&*found[0].start, &*found[1].start, found[1].n_apart), ("a", "b", 2));
        }
    }

    #[test]
    fn a_session_without_its_beginning_is_replayed_from_the_next_episode_on() {
        let late = &sessions(&client(&[(5, 0, 5), (6, 1, 6), (7, 1, 7)], &[]))[0];
        assert_eq!(numbers(late), [vec![6, 7]]);
        assert_eq!((late.gaps[&Gap::CameLate], late.n_apart), (1, 1));
        let first = &late.stretches[0].inputs[0];
        assert_eq!(
            (first.n_said, first.events.len()),
            (None, 1),
            "the cut is of the episode before"
        );
        let torn = &sessions(&client(&[(1, 0, 1), (3, 0, 3), (4, 1, 4)], &[]))[0];
        assert_eq!(numbers(torn), [vec![1], vec![4]]);
        assert_eq!(torn.gaps[&Gap::LineMissing], 1);
        let taken = [(1, 0, 1), (2, 0, 2), (3, 0, 3), (4, 1, 4)];
        let missing = &sessions(&client(&taken, &[2]))[0];
        assert_eq!(numbers(missing), [vec![1], vec![4]]);
        assert_eq!((missing.gaps[&Gap::ObservationMissing], missing.n_apart), (1, 2));
        let taken: Vec<_> = (1..=9).map(|n| (n, 0, n)).collect();
        let missing = &sessions(&client(&taken, &[4, 5, 6, 8]))[0];
        assert_eq!((missing.gaps[&Gap::ObservationMissing], missing.n_apart), (4, 6));
        // The same number in the next session is another observation.
        let mut twice = client(&[(1, 0, 1), (2, 0, 2)], &[]);
        let again: Vec<_> = twice
            .messages
            .iter()
            .map(|message| {
                let text =
                    String::from_utf8(message.json.clone()).unwrap().replace("\"s\"", "\"t\"");
                RecordedMessage {
                    json: text.replace("0.5", "0.25").into_bytes(),
                    ..message.clone()
                }
            })
            .collect();
        twice.messages.extend(again);
        let found = sessions(&twice);
        let value = |i: usize| {
            let input: &RecordedInput = &found[i].stretches[0].inputs[1];
            input.observation.as_ref().unwrap().values[0]
        };
        assert_eq!((found.len(), value(0), value(1)), (2, 0.5, 0.25));
    }
}
