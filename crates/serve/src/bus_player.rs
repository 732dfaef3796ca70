//! A notifier at work plays our own worlds: what it says over the network is what the simulated listener hears.
//!
//! So its success can be compared with what an evaluation finds of the same policy. With `clock = "observation"` every step
//! waits for its answer, and both are equal, message by message. With `clock = "timer"` the world goes at the pace of words, as
//! a real one would, and the notifier has to keep up with it:
//!
//! ```text
//! one step of the world   ├── what was said is heard ──┬── moved, observed, sent ──┤
//!                         0                           1/2                         3/4
//! the notifier's step     0: takes what was sent a quarter before
//! ```

use std::error::Error as StdError;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use leadtime_episodes::{EnvSlot, Scripted};
use leadtime_sims::human::SpeechAct;
use leadtime_sims::{Environment, Message};

use crate::client::{ClientError, LiveClient};
use crate::open::StepClock;
use crate::say::{HeardSay, SayEvent};

/// How long an answer may take.
const ANSWER: Duration = Duration::from_secs(10);

/// Something that was said, with the step in which it started.
#[derive(Clone, Debug, PartialEq)]
pub struct SaidMessage {
    /// The episode that the client counts it to.
    pub episode: u64,
    /// The step of the world.
    pub step: u32,
    /// What was said, as a message.
    pub message: Message,
    /// The sentence in words.
    pub text: String,
}

/// What the players of one client share.
#[derive(Debug)]
struct SharedClient {
    client: LiveClient,
    failure: Option<ClientError>,
    said: Vec<SaidMessage>,
    /// When the episode's first observation was sent.
    began: Instant,
}

/// A player whose decisions come over the network.
#[derive(Clone, Debug)]
pub struct BusPlayer {
    shared: Arc<Mutex<SharedClient>>,
    clock: StepClock,
    step: Duration,
    now: Vec<f32>,
    before: Vec<f32>,
}

impl BusPlayer {
    /// Plays as a client's notifier says.
    pub fn new(client: LiveClient, clock: StepClock, seconds_per_step: f64) -> Self {
        let (failure, said, began) = (None, Vec::new(), Instant::now());
        let shared = Arc::new(Mutex::new(SharedClient { client, failure, said, began }));
        let step = Duration::from_secs_f64(seconds_per_step);
        Self { shared, clock, step, now: Vec::new(), before: Vec::new() }
    }

    fn lock(&self) -> MutexGuard<'_, SharedClient> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether it cannot go on.
    pub fn has_failed(&self) -> bool {
        self.lock().failure.is_some()
    }

    /// Takes why it cannot go on.
    pub fn take_failure(&self) -> Option<ClientError> {
        self.lock().failure.take()
    }

    /// Takes everything that was said.
    pub fn take_said(&self) -> Vec<SaidMessage> {
        std::mem::take(&mut self.lock().said)
    }

    /// Finds out what is said in the coming step.
    fn ask(
        &mut self,
        slot: &EnvSlot,
        values: &[f32],
        topics: &[&str],
    ) -> Result<SpeechAct, ClientError> {
        let (clock, step) = (self.clock, self.step);
        let shared = &mut *self.lock();
        let seed = slot.seed();
        let episode = u64::from(seed.env_id.0) | seed.episode << 32;
        let events = if clock == StepClock::Observation {
            shared.client.step(values, episode, ANSWER)?
        } else {
            in_time(shared, step, slot.n_steps(), values, episode)?
        };
        let mut act = SpeechAct::Continue;
        for event in events {
            match event.event {
                SayEvent::Start => {
                    let Some(message) = message(&event, topics) else { continue };
                    act = SpeechAct::Start(message);
                    let (step, text) = (slot.n_steps(), event.text);
                    shared.said.push(SaidMessage { episode, step, message, text });
                }
                // What was cut with the end of an episode is nothing in the next one.
                SayEvent::Cut if slot.n_steps() > 0 => act = SpeechAct::Stop,
                SayEvent::Cut | SayEvent::Silent | SayEvent::Word | SayEvent::End => {}
            }
        }
        Ok(act)
    }
}

/// Sends what is observed at the pace of words, and hears until the middle of the step.
fn in_time(
    shared: &mut SharedClient,
    step: Duration,
    n_steps: u32,
    values: &[f32],
    episode: u64,
) -> Result<Vec<HeardSay>, ClientError> {
    if n_steps == 0 {
        // Events about the previous episode are dropped.
        while shared.client.next(Duration::ZERO)?.is_some() {}
        shared.began = Instant::now();
    } else {
        std::thread::sleep(until(shared.began + step * (n_steps - 1) + step * 3 / 4));
    }
    shared.client.observe(values, episode, false)?;
    let mut events = Vec::new();
    while let Some(event) = shared.client.next(until(shared.began + step * n_steps + step / 2))? {
        if event.episode == episode {
            events.push(event);
        }
    }
    Ok(events)
}

fn until(moment: Instant) -> Duration {
    moment.saturating_duration_since(Instant::now())
}

fn message(event: &HeardSay, topics: &[&str]) -> Option<Message> {
    let by_name = || topics.iter().position(|topic| *topic == event.topic);
    let topic = event.topic_id.map(usize::from).or_else(by_name)?;
    Some(Message { topic, comprehension: event.k, conveyance: event.l })
}

impl Scripted for BusPlayer {
    fn check(&self, environment: &dyn Environment) -> Result<(), Box<dyn StdError + Send + Sync>> {
        if environment.scriptable().is_some() {
            Ok(())
        } else {
            Err("nobody is spoken to in this task".into())
        }
    }

    fn choose(&mut self, slot: &mut EnvSlot, choices: &mut [u8]) {
        choices.fill(0);
        if self.has_failed() {
            return;
        }
        let Some(task) = slot.env().scriptable() else { return };
        let n = task.quantities().len();
        self.now.resize(n, 0.0);
        self.before.resize(n, 0.0);
        task.write_quantities(&mut self.now, &mut self.before);
        let values = self.now[..task.n_observed()].to_vec();
        let facts = slot.env().facts_that_hold().into_iter().map(str::to_owned).collect();
        self.lock().client.tell_facts(Some(facts));
        match self.ask(slot, &values, task.topics()) {
            Ok(act) => task.write_act(act, choices),
            Err(error) => self.lock().failure = Some(error),
        }
    }

    fn copy(&self) -> Box<dyn Scripted> {
        Box::new(self.clone())
    }
}
