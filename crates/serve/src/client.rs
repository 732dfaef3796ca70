//! A client in Rust: opens a session, sends observations, hears what is said.

use std::time::{Duration, Instant};

use leadtime_link::live::{ClientPort, LiveClientLink, LiveMessage};
use leadtime_proto::{ClientName, Incarnation, ServiceName};
use serde_json::{Value, json};
use thiserror::Error;

use crate::observation::{ObservationHead, write_json_with, write_raw};
use crate::open::{LIVE_PROTOCOL, SayForm, StepClock, WordClock};
use crate::say::HeardSay;

/// Why a client cannot go on.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The network, or the notifier's refusal.
    #[error(transparent)]
    Link(#[from] leadtime_link::Error),
    /// What the notifier said is no answer.
    #[error("the notifier's answer cannot be read")]
    Answer(#[source] serde_json::Error),
    /// Nothing was said about an observation.
    #[error(
        "no answer to observation {seq} within {seconds} s; the notifier's last status: {status}"
    )]
    NoAnswer {
        /// Number of the observation that was not answered.
        seq: u64,
        /// For how long it was waited.
        seconds: u64,
        /// What the notifier reported last.
        status: String,
    },
    /// The notifier is gone.
    #[error("the notifier is gone")]
    Gone,
}

/// What a client asks for.
#[derive(Clone, Debug)]
pub struct ClientSettings {
    /// The notifier, by its name.
    pub service: ServiceName,
    /// Name of the client, which its keys carry.
    pub client: ClientName,
    /// This start of it.
    pub incarnation: Incarnation,
    /// The task, by its domain.
    pub domain: String,
    /// How many numbers an observation has; `None` asks for no certain one.
    pub obs_dim: Option<usize>,
    /// When steps are taken.
    pub clock: StepClock,
    /// How long a step takes, in seconds.
    pub seconds_per_step: f64,
    /// Seed of every draw.
    pub seed: u64,
    /// In which form observations go and events come.
    pub form: SayForm,
}

/// A client with a session, in which a word takes a step.
#[derive(Debug)]
pub struct LiveClient {
    port: ClientPort,
    settings: ClientSettings,
    answer: Value,
    /// The start of the notifier that answered; `None` of an earlier release, which does not say it.
    service_start: Option<Incarnation>,
    started: Instant,
    seq: u64,
    facts: Option<Vec<String>>,
    status: String,
}

impl LiveClient {
    /// Finds the notifier and opens a session.
    ///
    /// # Errors
    ///
    /// [`ClientError::Link`] if no notifier of that name is there, or if it refuses, with its own sentence;
    /// [`ClientError::Answer`] if its answer is no JSON.
    pub async fn open(
        link: &LiveClientLink,
        settings: ClientSettings,
    ) -> Result<Self, ClientError> {
        link.find(&settings.service).await?;
        let port = link.port(&settings.service, &settings.client, settings.incarnation)?;
        let question = json!({
            "protocol": LIVE_PROTOCOL,
            "domain": settings.domain,
            "obs_dim": settings.obs_dim,
            "clock": settings.clock,
            // Its listener is simulated, and hears a word a step.
            "word_clock": WordClock::Steps,
            "seconds_per_step": settings.seconds_per_step,
            "seed": settings.seed,
            "encoding": settings.form,
            "incarnation": settings.incarnation.hex(),
        });
        let answer = port.ask(question.to_string().into_bytes()).await?;
        let answer: Value = serde_json::from_slice(&answer).map_err(ClientError::Answer)?;
        let seq = answer["last_seq"].as_u64().unwrap_or(0);
        let service_start = answer["start"].as_str().and_then(Incarnation::from_hex);
        let started = Instant::now();
        let (facts, status) = (None, String::new());
        Ok(Self { port, settings, answer, service_start, started, seq, facts, status })
    }

    /// Returns the notifier's answer.
    pub fn answer(&self) -> &Value {
        &self.answer
    }

    /// Returns the notifier's last status, JSON.
    pub fn status(&self) -> &str {
        &self.status
    }

    /// Says by name what is the case, with this and every further observation in JSON; `None` says nothing about it.
    pub fn tell_facts(&mut self, facts: Option<Vec<String>>) {
        self.facts = facts;
    }

    /// Sends an observation; returns its number.
    ///
    /// # Errors
    ///
    /// [`ClientError::Link`] if the session with the network is closed.
    pub fn observe(&mut self, values: &[f32], episode: u64, end: bool) -> Result<u64, ClientError> {
        self.seq += 1;
        let t = self.started.elapsed().as_secs_f64();
        let head = ObservationHead { seq: self.seq, t, episode, end };
        match self.settings.form {
            SayForm::Json => {
                self.port.observe(&write_json_with(&head, values, self.facts.as_deref()))?;
            }
            SayForm::Binary => {
                let (numbers, beside) = write_raw(&head, values);
                self.port.observe_raw(&numbers, &beside)?;
            }
        }
        Ok(self.seq)
    }

    /// Waits for the next event of what is said; `None` once `timeout` is over.
    ///
    /// # Errors
    ///
    /// [`ClientError::Gone`] if the notifier that answered is not there any more.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<HeardSay>, ClientError> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.port.next(left) {
                None => return Ok(None),
                Some(LiveMessage::Say(bytes)) => {
                    if let Some(event) = HeardSay::read(&bytes) {
                        return Ok(Some(event));
                    }
                }
                Some(LiveMessage::Status(bytes)) => {
                    self.status = String::from_utf8_lossy(&bytes).into_owned();
                }
                // The token of one that was killed may go after the next one has answered.
                Some(LiveMessage::ServiceGone(start))
                    if self.service_start.is_none_or(|own| own == start) =>
                {
                    return Err(ClientError::Gone);
                }
                Some(LiveMessage::ServiceHere(_) | LiveMessage::ServiceGone(_)) => {}
            }
        }
    }

    /// Sends an observation and waits for all events about it: `clock = "observation"`.
    ///
    /// # Errors
    ///
    /// [`ClientError::NoAnswer`] if they do not come in time.
    pub fn step(
        &mut self,
        values: &[f32],
        episode: u64,
        timeout: Duration,
    ) -> Result<Vec<HeardSay>, ClientError> {
        let seq = self.observe(values, episode, false)?;
        let mut events = Vec::new();
        loop {
            let Some(event) = self.next(timeout)? else {
                let (seconds, status) = (timeout.as_secs(), self.status.clone());
                return Err(ClientError::NoAnswer { seq, seconds, status });
            };
            let is_last = event.seq == seq && event.last;
            if event.seq == seq {
                events.push(event);
            }
            if is_last {
                return Ok(events);
            }
        }
    }
}
