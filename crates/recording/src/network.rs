//! Replaying over the network: a notifier is sent the same observations, as the client that was recorded.

use std::time::{Duration, Instant};

use leadtime_link::live::{ClientPort, LiveMessage};
use leadtime_proto::Incarnation;
use leadtime_serve::{ClientError, HeardSay, SessionNote, TakenInput};
use serde_json::Value;

use crate::error::Error;
use crate::replay::ReplayTarget;
use crate::sessions::RecordedInput;

/// How long an answer may take.
const ANSWER: Duration = Duration::from_secs(10);

/// A session of a notifier over the network, where every observation is a step.
#[derive(Debug)]
pub struct SessionOverNetwork {
    port: ClientPort,
    /// The start of the notifier that answered last, if it says it.
    service_start: Option<Incarnation>,
}

impl SessionOverNetwork {
    /// Feeds sessions that are opened at this port.
    pub fn new(port: ClientPort) -> Self {
        Self { port, service_start: None }
    }

    /// Opens the recorded session again, the `n`-th time at this port; returns the answer.
    ///
    /// # Errors
    ///
    /// [`Error::Client`] if it is refused; the sentence is the notifier's own.
    pub async fn open(&mut self, note: &SessionNote, n: usize) -> Result<Value, Error> {
        let mut question = note.question.clone();
        question["seed"] = note.answer["seed"].clone();
        question["incarnation"] = self.port.incarnation().hex().into();
        // The same question would be answered with the session that is there; what differs begins anew.
        let question = question.to_string() + &" ".repeat(n);
        let answer = self.port.ask(question.into_bytes()).await.map_err(ClientError::Link)?;
        let answer: Value = serde_json::from_slice(&answer).map_err(ClientError::Answer)?;
        self.service_start = answer["start"].as_str().and_then(Incarnation::from_hex);
        Ok(answer)
    }
}

impl ReplayTarget for SessionOverNetwork {
    fn feed(&mut self, input: &RecordedInput) -> Result<Vec<HeardSay>, Error> {
        let (TakenInput::Observation { .. }, Some(sent)) = (input.input, &input.observation) else {
            return Ok(Vec::new());
        };
        let seq = sent.seq;
        let put = match &sent.beside {
            Some(beside) => self.port.observe_raw(&sent.payload, beside),
            None => self.port.observe(&sent.payload),
        };
        put.map_err(ClientError::Link)?;
        let (mut events, mut status) = (Vec::new(), String::new());
        let deadline = Instant::now() + ANSWER;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.port.next(left) {
                None => {
                    let seconds = ANSWER.as_secs();
                    return Err(ClientError::NoAnswer { seq, seconds, status }.into());
                }
                Some(LiveMessage::Say(bytes)) => {
                    let Some(event) = HeardSay::read(&bytes).filter(|event| event.seq == seq)
                    else {
                        continue;
                    };
                    let is_last = event.last;
                    events.push(event);
                    if is_last {
                        return Ok(events);
                    }
                }
                Some(LiveMessage::Status(bytes)) => {
                    status = String::from_utf8_lossy(&bytes).into_owned();
                }
                Some(LiveMessage::ServiceGone(start))
                    if self.service_start.is_none_or(|own| own == start) =>
                {
                    return Err(ClientError::Gone.into());
                }
                Some(LiveMessage::ServiceHere(_) | LiveMessage::ServiceGone(_)) => {}
            }
        }
    }
}
