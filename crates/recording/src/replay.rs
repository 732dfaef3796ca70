//! Replaying a session: the same observations again, and whether the same is said.

use leadtime_serve::{
    HeardSay, LiveDecider, LiveSession, ObservationBytes, SayEvent, SayTo, SessionNote,
    SessionPlan, StepClock, TakenInput, WorkingPolicy,
};

use crate::error::Error;
use crate::sessions::{RecordedInput, Stretch};

/// What observations are fed to.
pub trait ReplayTarget {
    /// Feeds one input; returns what is said in response.
    ///
    /// # Errors
    ///
    /// [`Error::Client`] if a notifier does not answer in time, or is gone.
    fn feed(&mut self, input: &RecordedInput) -> Result<Vec<HeardSay>, Error>;
}

/// A session of a policy at hand.
#[derive(Debug)]
pub struct SessionAtHand {
    session: LiveSession,
    decider: LiveDecider,
    /// Reports of what was heard are about utterances of this policy.
    is_same: bool,
    /// By how much the numbers of utterances differ; known once something was said.
    ahead: Option<u32>,
}

impl SessionAtHand {
    /// Opens the recorded session again, for a stretch of it. `is_same` says that it is the policy of the recording.
    ///
    /// # Errors
    ///
    /// [`Error::Session`] if the policy was made for another task.
    pub fn open(
        note: &SessionNote,
        policy: &WorkingPolicy,
        stretch: &Stretch,
        is_same: bool,
    ) -> Result<Self, Error> {
        let seed = note.answer["seed"].as_u64().unwrap_or(0);
        let question = note.question.to_string();
        let plan = SessionPlan::read(question.as_bytes(), policy, seed)?;
        let decider = policy.decider();
        let now = stretch.inputs.first().map_or(0, |input| input.now);
        let session = LiveSession::new(note.session.clone(), plan, policy, &decider, now);
        let ahead = stretch.is_beginning.then_some(0);
        Ok(Self { session, decider, is_same, ahead })
    }
}

/// Keeps what is said.
#[derive(Debug, Default)]
struct KeptEvents(Vec<HeardSay>);

impl SayTo for KeptEvents {
    fn say(&mut self, bytes: &[u8]) {
        self.0.extend(HeardSay::read(bytes));
    }

    fn status(&mut self, _bytes: &[u8]) {}
}

impl ReplayTarget for SessionAtHand {
    fn feed(&mut self, input: &RecordedInput) -> Result<Vec<HeardSay>, Error> {
        let Self { session, decider, is_same, ahead } = self;
        let (now, mut out) = (input.now, KeptEvents::default());
        match (input.input, &input.observation) {
            (TakenInput::Observation { at, is_other_clock }, Some(sent)) => {
                session.note_clock(is_other_clock);
                let (encoding, beside) = (&sent.encoding, sent.beside.as_deref());
                let bytes = ObservationBytes { encoding, payload: &sent.payload, beside };
                session.arrive(now, at, bytes, decider, &mut out);
            }
            (TakenInput::Heard { mut report }, _) if *is_same => {
                report.utterance = report.utterance.wrapping_sub(ahead.unwrap_or(0));
                // Plain data: it cannot fail.
                let report = serde_json::to_vec(&report).unwrap_or_default();
                session.hear(now, &report, decider, &mut out);
            }
            (TakenInput::Presence { is_here }, _) => session.note_presence(is_here),
            (TakenInput::Tick, _) => session.tick(now, decider, &mut out),
            _ => {}
        }
        if ahead.is_none() {
            let number =
                |events: &[HeardSay]| Some(events.iter().find(|it| it.utterance > 0)?.utterance);
            let numbers = number(&input.events).zip(number(&out.0));
            *ahead = numbers.map(|(recorded, own)| recorded.wrapping_sub(own));
        }
        Ok(out.0)
    }
}

/// A message: an utterance as it was started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StartedMessage {
    /// The episode that the client counts it to.
    pub episode: u64,
    /// The step of the episode, from 0.
    pub step: u32,
    /// The topic; its number where the client gets raw events.
    pub topic: String,
    /// Comprehension time k, in words.
    pub k: u32,
    /// Conveyance time l, in words.
    pub l: u32,
    /// The sentence; empty without words.
    pub text: String,
}

impl StartedMessage {
    /// Reads it off an event; a raw one does not state the episode.
    pub fn of(event: &HeardSay, episode: u64) -> Self {
        let topic = match event.topic_id {
            Some(id) => format!("topic {id}"),
            None => event.topic.clone(),
        };
        let HeardSay { step, k, l, text, .. } = event.clone();
        Self { episode, step, topic, k, l, text }
    }
}

/// What is said in a session, counted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MessageTally {
    /// Messages that were started.
    pub n_messages: u64,
    /// Messages that were cut.
    pub n_cut: u64,
    /// Sums of k and of l.
    pub sum_k: u64,
    /// The sum of l.
    pub sum_l: u64,
}

impl MessageTally {
    fn count(&mut self, events: &[HeardSay]) {
        for event in events {
            match event.event {
                SayEvent::Start => {
                    self.n_messages += 1;
                    self.sum_k += u64::from(event.k);
                    self.sum_l += u64::from(event.l);
                }
                SayEvent::Cut => self.n_cut += 1,
                SayEvent::Silent | SayEvent::Word | SayEvent::End => {}
            }
        }
    }

    /// Adds the counts of another session.
    pub fn add(&mut self, other: &Self) {
        self.n_messages += other.n_messages;
        self.n_cut += other.n_cut;
        self.sum_k += other.sum_k;
        self.sum_l += other.sum_l;
    }

    /// Returns the mean of k, in words; `None` without messages.
    pub fn mean_k(&self) -> Option<f64> {
        (self.n_messages > 0).then(|| self.sum_k as f64 / self.n_messages as f64)
    }

    /// Returns the mean of l, in words; `None` without messages.
    pub fn mean_l(&self) -> Option<f64> {
        (self.n_messages > 0).then(|| self.sum_l as f64 / self.n_messages as f64)
    }
}

/// Where what is said differs for the first time.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayDifference {
    /// The number of the newest observation.
    pub seq: u64,
    /// The episode that the client counts it to.
    pub episode: u64,
    /// What was said in the recording.
    pub recorded: Vec<HeardSay>,
    /// What is said now.
    pub replayed: Vec<HeardSay>,
}

/// What came out of a replay.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReplayOutcome {
    /// Observations that were fed.
    pub n_observations: u64,
    /// Events that were compared.
    pub n_events: u64,
    /// Events that the recording lacks, though they were said.
    pub n_lost: u64,
    /// Counts of what was said in the recording.
    pub recorded: MessageTally,
    /// What is said now.
    pub replayed: MessageTally,
    /// Messages as recorded and as replayed, step by step: one of a pair is missing where only one of them spoke.
    pub pairs: Vec<[Option<StartedMessage>; 2]>,
    /// Where the two differ first.
    pub difference: Option<ReplayDifference>,
}

impl ReplayOutcome {
    /// Adds what came out of a further stretch or session.
    pub fn add(&mut self, other: Self) {
        self.n_observations += other.n_observations;
        self.n_events += other.n_events;
        self.n_lost += other.n_lost;
        self.recorded.add(&other.recorded);
        self.replayed.add(&other.replayed);
        self.pairs.extend(other.pairs);
        self.difference = self.difference.take().or(other.difference);
    }
}

/// Feeds a stretch; `before` gets each input before it is fed, and ends the replay with `false`.
///
/// # Errors
///
/// [`Error::Client`] if the notifier that the stretch is fed to does not answer; what came before is lost.
pub fn replay(
    stretch: &Stretch,
    target: &mut impl ReplayTarget,
    mut before: impl FnMut(&RecordedInput) -> bool,
) -> Result<ReplayOutcome, Error> {
    let mut outcome = ReplayOutcome::default();
    let (mut seq, mut episode) = (0, 0);
    for input in &stretch.inputs {
        if !before(input) {
            break;
        }
        let said = target.feed(input)?;
        if let Some(observation) = &input.observation {
            (seq, episode) = (observation.seq, observation.episode);
            outcome.n_observations += 1;
        }
        outcome.recorded.count(&input.events);
        outcome.replayed.count(&said);
        let started = |events: &[HeardSay]| -> Vec<StartedMessage> {
            let starts = events.iter().filter(|event| event.event == SayEvent::Start);
            starts.map(|event| StartedMessage::of(event, episode)).collect()
        };
        let (mut ones, mut others) =
            (started(&input.events).into_iter(), started(&said).into_iter());
        loop {
            let pair = [ones.next(), others.next()];
            if pair == [None, None] {
                break;
            }
            outcome.pairs.push(pair);
        }
        let n_lost = lost(input, &said);
        outcome.n_events += said.len() as u64 - n_lost.unwrap_or(0);
        match n_lost {
            Some(n_lost) => outcome.n_lost += n_lost,
            None if outcome.difference.is_none() => {
                let (recorded, replayed) = (input.events.clone(), said);
                let difference = ReplayDifference { seq, episode, recorded, replayed };
                outcome.difference = Some(difference);
            }
            None => {}
        }
    }
    Ok(outcome)
}

/// Counts how many events of an input the recording lacks; `None` if what it has differs from what is said.
fn lost(input: &RecordedInput, said: &[HeardSay]) -> Option<u64> {
    let mut rest = said.iter();
    let is_part = input.events.iter().all(|event| rest.any(|other| is_same(event, other)));
    let n_lost = said.len().saturating_sub(input.events.len()) as u64;
    // How many there were is known but for the first input of a later episode.
    let n_said = input.n_said.unwrap_or(said.len() as u64);
    let is_complete = n_said == said.len() as u64;
    (is_part && is_complete).then_some(n_lost)
}

/// Returns whether two events say the same. Numbers of utterances count on over restarts and stretches.
fn is_same(one: &HeardSay, other: &HeardSay) -> bool {
    let (utterance, age) = (one.utterance, one.age);
    *one == HeardSay { utterance, age, ..other.clone() }
}

/// Returns whether a session can be replayed over the network, where a notifier has a clock of its own. Of each stretch
/// only what comes [up to its last observation](Stretch::up_to_last_observation) can be.
///
/// # Errors
///
/// [`Error::NotOverNetwork`] if steps were taken by the notifier's clock, or an episode began anew after a pause: then
/// time decides, and the replay has another one.
pub fn check_for_network(clock: StepClock, stretches: &[Stretch]) -> Result<(), Error> {
    if clock != StepClock::Observation {
        let why = "its steps were taken by the notifier's clock: replay it without --connect";
        return Err(Error::NotOverNetwork(why));
    }
    if stretches.iter().any(has_pause) {
        let why = "after a long pause an episode began anew: replay it without --connect";
        return Err(Error::NotOverNetwork(why));
    }
    let inputs = || stretches.iter().flat_map(|stretch| &stretch.inputs);
    let is_timed = |input: &RecordedInput| match input.input {
        TakenInput::Observation { .. } | TakenInput::Presence { .. } => false,
        TakenInput::Heard { .. } => true,
        TakenInput::Tick => !input.events.is_empty(),
    };
    if inputs().any(is_timed) {
        let why =
            "it depends on when something was heard, or nothing came: replay it without --connect";
        return Err(Error::NotOverNetwork(why));
    }
    Ok(())
}

/// Returns whether an episode began anew though its client said nothing of it: the past of one that was lost for long
/// is forgotten.
fn has_pause(stretch: &Stretch) -> bool {
    let mut episode = None;
    let mut sent =
        stretch.inputs.iter().filter_map(|it| it.observation.as_ref().zip(Some(it.step)));
    sent.any(|(sent, step)| episode.replace(sent.episode) == Some(sent.episode) && step == 0)
}

#[cfg(test)]
mod tests {
    use leadtime_link::live::ArrivalEncoding;

    use super::*;
    use crate::message::SentObservation;

    fn event(step: u32, event: &str) -> HeardSay {
        let text = format!("{{\"seq\":4,\"step\":{step},\"event\":\"{event}\",\"utterance\":9}}");
        HeardSay::read(text.as_bytes()).unwrap()
    }

    fn input(events: &[HeardSay], n_said: Option<u64>) -> RecordedInput {
        let (input, events) = (TakenInput::Tick, events.to_vec());
        RecordedInput { input, now: 0, step: 0, at: 0, observation: None, events, n_said }
    }

    #[test]
    fn lost_messages_are_not_differences_and_changed_ones_are() {
        let (end, start) = (event(3, "end"), event(3, "start"));
        let renumbered = HeardSay { utterance: 1, age: 0.5, ..start.clone() };
        let said = [end.clone(), renumbered];
        let whole = input(&[end.clone(), start.clone()], Some(2));
        assert_eq!(lost(&whole, &said), Some(0));
        assert_eq!(lost(&input(std::slice::from_ref(&start), Some(2)), &said), Some(1));
        assert_eq!(lost(&input(std::slice::from_ref(&start), None), &said), Some(1));
        assert_eq!(
            lost(&input(std::slice::from_ref(&start), Some(1)), &said),
            None,
            "one too many"
        );
        assert_eq!(lost(&whole, &said[..1]), None);
        let swapped = input(&[start.clone(), end], Some(2));
        assert_eq!(lost(&swapped, &said), None);
        let other = HeardSay { text: "Climb.".to_owned(), ..start };
        assert_eq!(lost(&input(&[other], Some(2)), &said), None);
    }

    /// Says two events in response to everything.
    struct Talkative([HeardSay; 2]);

    impl ReplayTarget for Talkative {
        fn feed(&mut self, _input: &RecordedInput) -> Result<Vec<HeardSay>, Error> {
            Ok(self.0.to_vec())
        }
    }

    #[test]
    fn an_event_that_the_recording_lacks_is_not_one_that_was_compared() {
        let said = [event(3, "end"), event(3, "start")];
        let mut target = Talkative(said.clone());
        let mut counts = |inputs: &[RecordedInput]| {
            let stretch = Stretch { is_beginning: true, inputs: inputs.to_vec() };
            let outcome = replay(&stretch, &mut target, |_| true).unwrap();
            (outcome.n_events, outcome.n_lost, outcome.difference.is_some())
        };
        let (all, nothing) = (input(&said, Some(2)), input(&[], Some(2)));
        assert_eq!(counts(std::slice::from_ref(&all)), (2, 0, false));
        assert_eq!(counts(std::slice::from_ref(&nothing)), (0, 2, false));
        assert_eq!(counts(&[all, input(&said[1..], Some(2)), nothing]), (3, 3, false));
        assert_eq!(counts(&[input(&said[1..], Some(1))]), (2, 0, true));
    }

    fn observed(episode: u64, step: u32) -> RecordedInput {
        let encoding = ArrivalEncoding::Json;
        let (values, payload, beside) = (Vec::new(), Vec::new(), None);
        let sent = SentObservation { seq: 1, episode, values, encoding, payload, beside };
        let (input, observation) =
            (TakenInput::Observation { at: 0, is_other_clock: false }, Some(sent));
        RecordedInput { input, step, observation, ..self::input(&[], Some(0)) }
    }

    fn check(inputs: &[RecordedInput], is_cut: bool) -> Option<String> {
        let stretch = Stretch { is_beginning: true, inputs: inputs.to_vec() };
        let stretch = if is_cut { stretch.up_to_last_observation() } else { stretch };
        let checked = check_for_network(StepClock::Observation, &[stretch]);
        checked.err().map(|error| error.to_string())
    }

    #[test]
    fn what_depends_on_the_clock_alone_is_not_sent_over_a_network() {
        let cut = input(&[event(3, "cut")], Some(1));
        let flown = [observed(0, 0), observed(0, 1), input(&[], Some(0)), observed(1, 0)];
        assert_eq!(check(&flown, false), None);
        // A client that leaves without an end is cut off once it is missed.
        let left = [&flown[..], std::slice::from_ref(&cut)].concat();
        assert!(check(&left, false).unwrap().contains("or nothing came"));
        assert_eq!(check(&left, true), None);
        let in_between = [&left[..], &[observed(1, 1)]].concat();
        assert!(check(&in_between, true).unwrap().contains("or nothing came"));
        // One that was silent for long finds its past forgotten.
        let paused = [&flown[..], &[observed(1, 0)]].concat();
        assert!(check(&paused, true).unwrap().contains("an episode began anew"));
    }
}
