//! The newest policy at work: it plays an episode again and again, paced so that it can be followed.
//!
//! A thread of its own plays a whole episode in a few milliseconds, and then publishes it moment by moment. Episodes
//! count up from the first, so that two watchers of a run see the same ones. Nothing is played where nobody looks.

use std::fmt;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use leadtime_eval::measure::{Choice, Player};
use leadtime_eval::playthrough::{Activity, Playthrough, Spoken, Voice, topic_name};
use leadtime_policy::Parameters;
use leadtime_proto::PolicySpec;
use leadtime_sims::{Environment, TaskError};
use serde_json::{Value, json};

use crate::error::Error;
use crate::events::EventKind;
use crate::scene::{SceneGrid, still};

/// The time that a step takes on the page.
const STEP: Duration = Duration::from_millis(100);
/// How long the end of an episode stays.
const END: Duration = Duration::from_millis(1_600);
/// Pause before it is tried again to play, unless something is given before.
const PAUSE: Duration = Duration::from_millis(500);
/// The same before it is looked again whether anybody looks.
const LOOK_PAUSE: Duration = Duration::from_millis(100);
/// Policies that wait to be played; only the newest is.
const QUEUED: usize = 64;

/// Makes one more environment of the task.
pub type MakeTask = dyn Fn() -> Result<Box<dyn Environment>, TaskError> + Send + Sync;

/// What is played: the task as it is in evaluation, and how its policies are read and speak.
#[derive(Clone)]
pub struct FlightPlan {
    /// Makes an environment of the task.
    pub make: Arc<MakeTask>,
    /// The architecture of the networks.
    pub policy: PolicySpec,
    /// How actions are chosen.
    pub choice: Choice,
    /// The sentences, where there are some.
    pub voice: Option<Voice>,
    /// Seed of the episodes.
    pub seed: u64,
}

impl fmt::Debug for FlightPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FlightPlan(seed {})", self.seed)
    }
}

/// Whoever receives what is played.
pub trait FlightWatcher: Send + Sync {
    /// Returns whether anybody looks.
    fn is_watched(&self) -> bool;

    /// Takes in the beginning of an episode, or one of its moments.
    fn tell(&self, kind: EventKind, data: &Value);
}

/// What reaches the thread.
#[derive(Debug)]
enum FlightInput {
    Plan(Box<Result<FlightPlan, String>>),
    Policy(u64, Vec<u8>),
}

/// The thread; it ends when this is dropped.
#[derive(Debug)]
pub struct FlightThread {
    inputs: Option<flume::Sender<FlightInput>>,
    thread: Option<JoinHandle<()>>,
}

impl FlightThread {
    /// Starts without a plan.
    ///
    /// # Errors
    ///
    /// [`Error::Thread`] if the system starts no further thread.
    pub fn start(watcher: Arc<dyn FlightWatcher>) -> Result<Self, Error> {
        let (sender, inputs) = flume::bounded(QUEUED);
        let work = move || FlightLoop::new(inputs, watcher).run();
        let thread = thread::Builder::new().name("playthrough".to_owned()).spawn(work);
        Ok(Self { inputs: Some(sender), thread: Some(thread.map_err(Error::Thread)?) })
    }

    /// Says what is played, or why nothing can be.
    pub fn plan(&self, plan: Result<FlightPlan, String>) {
        self.give(FlightInput::Plan(Box::new(plan)));
    }

    /// Gives a newer policy, as safetensors.
    pub fn policy(&self, version: u64, weights: Vec<u8>) {
        self.give(FlightInput::Policy(version, weights));
    }

    fn give(&self, input: FlightInput) {
        if let Some(inputs) = &self.inputs {
            // A full queue means that the thread is far behind; the next policy comes soon.
            drop(inputs.try_send(input));
        }
    }
}

impl Drop for FlightThread {
    fn drop(&mut self) {
        self.inputs = None;
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// The thread ends: its owner is gone.
struct OwnerGone;

struct FlightLoop {
    inputs: flume::Receiver<FlightInput>,
    watcher: Arc<dyn FlightWatcher>,
    plan: Option<FlightPlan>,
    player: Option<(u64, Player)>,
    weights: Option<(u64, Vec<u8>)>,
    /// The number of the next episode.
    index: u64,
    /// What was reported last about why nothing is played.
    obstacle: String,
}

impl FlightLoop {
    fn new(inputs: flume::Receiver<FlightInput>, watcher: Arc<dyn FlightWatcher>) -> Self {
        Self {
            inputs,
            watcher,
            plan: None,
            player: None,
            weights: None,
            index: 0,
            obstacle: String::new(),
        }
    }

    fn run(mut self) {
        while self.turn().is_ok() {}
    }

    /// Plays an episode, or waits for what is missing.
    fn turn(&mut self) -> Result<(), OwnerGone> {
        self.take_inputs(Instant::now())?;
        if !self.watcher.is_watched() {
            // The next page gets it at once.
            self.obstacle.clear();
            return self.wait(LOOK_PAUSE);
        }
        match self.play() {
            Ok(Some((version, spoken))) => {
                self.obstacle.clear();
                self.index += 1;
                self.show(version, &spoken)
            }
            Ok(None) => self.wait(PAUSE),
            Err(obstacle) => {
                self.tell_obstacle(obstacle);
                self.wait(PAUSE)
            }
        }
    }

    /// Takes what is given until a moment.
    fn take_inputs(&mut self, until: Instant) -> Result<(), OwnerGone> {
        while self.take_input(until)? {}
        Ok(())
    }

    /// Waits for what may let it go on, at most so long.
    fn wait(&mut self, pause: Duration) -> Result<(), OwnerGone> {
        self.take_input(Instant::now() + pause).map(|_is_given| ())
    }

    /// Takes the next thing that is given until a moment. Returns whether there was one.
    fn take_input(&mut self, until: Instant) -> Result<bool, OwnerGone> {
        match self.inputs.recv_deadline(until) {
            Ok(FlightInput::Plan(plan)) => {
                self.player = None;
                match *plan {
                    Ok(plan) => self.plan = Some(plan),
                    Err(reason) => {
                        self.plan = None;
                        self.tell_obstacle(reason);
                    }
                }
            }
            Ok(FlightInput::Policy(version, weights)) => self.weights = Some((version, weights)),
            Err(flume::RecvTimeoutError::Timeout) => return Ok(false),
            Err(flume::RecvTimeoutError::Disconnected) => return Err(OwnerGone),
        }
        Ok(true)
    }

    fn tell_obstacle(&mut self, obstacle: String) {
        if obstacle != self.obstacle {
            self.watcher.tell(EventKind::Flight, &json!({"flight": 0, "problem": obstacle}));
            self.obstacle = obstacle;
        }
    }

    fn play(&mut self) -> Result<Option<(u64, Spoken)>, String> {
        let Some(plan) = &self.plan else { return Ok(None) };
        if let Some((version, weights)) = self.weights.take() {
            let parameters = Parameters::from_safetensors(&weights, &plan.policy);
            let player =
                parameters.map_err(leadtime_episodes::Error::from).and_then(|parameters| {
                    Player::policy("newest", &plan.policy, &parameters, plan.choice)
                });
            let player = player.map_err(|error| {
                format!("the policy cannot be read, which another release may have made: {error}")
            })?;
            self.player = Some((version, player));
        }
        let Some((version, player)) = &self.player else { return Ok(None) };
        let played = Playthrough::record(plan.make.as_ref(), player, plan.seed, self.index);
        let spoken = played.and_then(|played| match &plan.voice {
            Some(voice) => voice.speak(played),
            None => Ok(played.into()),
        });
        Ok(Some((*version, spoken.map_err(|error| format!("no episode can be shown: {error}"))?)))
    }

    /// Publishes an episode moment by moment.
    fn show(&mut self, version: u64, spoken: &Spoken) -> Result<(), OwnerGone> {
        let flight = self.index;
        self.watcher.tell(EventKind::Flight, &beginning(flight, version, spoken));
        let scenes = &spoken.played.scenes;
        let grid = SceneGrid::of(&scenes[0].view);
        let still = still(scenes);
        let mut due = Instant::now();
        for step in 0..scenes.len() {
            if !self.watcher.is_watched() {
                return Ok(());
            }
            let frame = moment(flight, step, spoken, grid, &still);
            self.watcher.tell(EventKind::Frame, &frame);
            due += STEP;
            self.take_inputs(due)?;
        }
        self.take_inputs(Instant::now() + END)
    }
}

/// Writes what stands still in an episode.
fn beginning(flight: u64, version: u64, spoken: &Spoken) -> Value {
    let played = &spoken.played;
    let scenes = &played.scenes;
    let first = &scenes[0];
    let grid = SceneGrid::of(&first.view);
    let shapes: Vec<Value> = still(scenes).into_iter().map(|shape| grid.shape(shape)).collect();
    let gauges = scenes.iter().map(|scene| scene.gauge.value);
    let (low, high) = gauges.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    json!({
        "flight": flight,
        "version": version,
        "seed": played.seed,
        "index": played.index,
        "steps": played.n_steps(),
        "view": grid.view(&first.view),
        "still": shapes,
        "gauge": {"label": first.gauge.label, "low": low, "high": high},
        "messages": spoken.timeline.utterances.len(),
    })
}

/// Writes a moment of an episode: what moves, what is heard, what the listener does.
fn moment(
    flight: u64,
    step: usize,
    spoken: &Spoken,
    grid: SceneGrid,
    still: &[&leadtime_sims::Shape],
) -> Value {
    let scenes = &spoken.played.scenes;
    let scene = &scenes[step];
    let shapes = scene.shapes.iter().filter(|shape| !still.contains(shape));
    let topic = |id: usize| topic_name(scene, id);
    let said = spoken.timeline.utterances.iter().rposition(|it| it.start < step && step <= it.end);
    let said = said.map(|place| {
        let utterance = &spoken.timeline.utterances[place];
        let heard = step - utterance.start;
        let words = |heard: usize| {
            let sentence = spoken.sentences.get(place);
            sentence.map(|sentence| sentence.so_far(heard, utterance.conveyance))
        };
        json!({
            "topic": topic(utterance.topic),
            "k": utterance.comprehension,
            "l": utterance.conveyance,
            "heard": heard,
            "words": words(heard),
            "sentence": words(utterance.conveyance),
        })
    });
    let activity = step.checked_sub(1).map(|step| spoken.timeline.activities[step]);
    let is_last = step + 1 == scenes.len();
    let mut frame = json!({
        "flight": flight,
        "step": step,
        "shapes": shapes.map(|shape| grid.shape(shape)).collect::<Vec<_>>(),
        "at": grid.point(scene.position),
        "said": said,
        "pending": scene.listener.pending.map(topic),
        "reacting": scene.listener.reacting.map(topic),
        "activity": activity.map(Activity::label),
        "gauge": crate::actors::round(scene.gauge.value),
        "outcome": scene.outcome,
    });
    if scene.view != scenes[0].view {
        frame["view"] = grid.view(&scene.view);
    }
    if is_last {
        frame["end"] = json!({
            "title": spoken.played.title(),
            "success": spoken.played.success,
            "return": crate::actors::round(spoken.played.total_reward),
        });
    }
    frame
}

#[cfg(test)]
#[path = "flight_tests.rs"]
mod tests;
