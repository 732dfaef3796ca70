//! Episodes of our own cook and its listener, through the very environment that policies are trained in.

use std::collections::BTreeMap;

use leadtime_proto::EnvId;
use leadtime_sims::TaskError;
use leadtime_sims::human::{Initiation, ReactionDelay, SpeechAct};
use leadtime_sims::{Domain as _, Environment as _, EpisodeSeed, Message, NotifierEnv};
use leadtime_steakhouse::task::{LastStep, SteakhouseDomain, SteakhouseTaskSettings, golden};
use leadtime_steakhouse::world::{
    Action, Content, Grid, KitchenStart, Pose, Subtask, WorkTimes, interactions_left,
};
use serde::Deserialize;

use super::public::{direction_name, item_name, read_direction};
use super::report::RecordingReport;
use crate::error::ReplayError;

/// The recordings' names of the topics, by id.
const TOPICS: [&str; 5] = ["UP", "DOWN", "LEFT", "RIGHT", "INFO"];
/// The most words of a message, by which words are scaled in observations.
const MAX_WORDS: f32 = 8.0;
/// Steps since the last message beyond which all count alike.
const MAX_SINCE: u32 = 20;
/// How far numbers may be off that were recorded to six digits and are held in single precision.
const TOLERANCE: f32 = 2e-6;

#[derive(Deserialize)]
pub(super) struct CookEpisode {
    name: String,
    /// By time: topic, k and l.
    messages: BTreeMap<u32, (String, u32, u32)>,
    start: Situation,
    steps: Vec<CookStep>,
    total: Total,
}

#[derive(Deserialize)]
struct Situation {
    layout: String,
    pos: [i32; 2],
    ori: String,
    #[serde(rename = "T")]
    max_steps: u32,
    d_r: u32,
    d_f: u32,
    t_ref: u32,
    deadline: u32,
    see_delay: Option<u8>,
    stations: Vec<(String, [usize; 2])>,
    content: Vec<Option<u8>>,
    belief: Vec<Option<u8>>,
    aware: Vec<u8>,
    limits: BTreeMap<String, u8>,
    obs: Vec<f32>,
}

#[derive(Deserialize)]
struct CookStep {
    t: u32,
    said: Option<(usize, u32, u32)>,
    subtask: String,
    action: String,
    pos: [usize; 2],
    ori: String,
    held: Option<String>,
    content: Vec<Option<u8>>,
    belief: Vec<Option<u8>>,
    aware: Vec<u8>,
    #[serde(rename = "override")]
    reaction: Option<(String, u32)>,
    speaking: bool,
    redundant: bool,
    remaining: u32,
    reward: f32,
    done: bool,
    obs: Vec<f32>,
}

#[derive(Deserialize)]
struct Total {
    steps: u32,
    delivered: bool,
    in_time: bool,
    notifications: u32,
    redundant_steps: u32,
    redundant_pickups: u32,
    noop: u32,
}

/// A number recorded to six digits, equal to whatever it may stand for.
#[derive(Clone, Copy, Debug)]
struct Digits(f32);

impl PartialEq for Digits {
    fn eq(&self, other: &Self) -> bool {
        (self.0 - other.0).abs() <= TOLERANCE
    }
}

fn digits(values: &[f32]) -> Vec<Digits> {
    values.iter().copied().map(Digits).collect()
}

impl CookEpisode {
    fn impossible(&self, what: &'static str) -> ReplayError {
        ReplayError::Impossible { run: self.name.clone(), what }
    }

    pub(super) fn replay(&self) -> Result<RecordingReport, ReplayError> {
        let mut run = self.begin()?;
        let mut comparison = RecordingReport::new(&self.name);
        self.compare_start(&run, &mut comparison);
        for step in &self.steps {
            let order = self.order(step.t)?;
            let (outcome, initiation) = run.env.step_with(order, &mut run.observation);
            let started = match (order, initiation) {
                (SpeechAct::Start(message), Initiation::Started) => Some(message),
                _ => None,
            };
            run.since = if started.is_some() { 0 } else { run.since + 1 };
            compare_step(&run, step, started, &mut comparison);
            let at = step.t;
            let (ours, theirs) = (Digits(outcome.reward), Digits(step.reward));
            comparison.check(format_args!("reward of step {at}"), &ours, &theirs);
            let done = outcome.end.is_some();
            comparison.check(format_args!("end of step {at}"), &done, &step.done);
            comparison.n_compared += 1;
        }
        self.compare_total(&run, &mut comparison);
        Ok(comparison)
    }

    fn begin(&self) -> Result<CookRun, ReplayError> {
        let refused = |source: TaskError| ReplayError::Settings { run: self.name.clone(), source };
        let settings = self.settings()?;
        let domain = SteakhouseDomain::new(&settings.world).map_err(|it| refused(it.into()))?;
        let start = self.start(&domain.kitchen.plan.grid, settings.world.times())?;
        let domain = domain.with_start(start);
        let mut env =
            NotifierEnv::new(domain, &settings.human, &settings.notifier).map_err(refused)?;
        let mut observation = vec![0.0; env.spec().obs_dim];
        let seed = EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode: 0 };
        env.reset(seed, &mut observation);
        Ok(CookRun { env, observation, since: MAX_SINCE, follow_through: self.start.d_f })
    }

    fn settings(&self) -> Result<SteakhouseTaskSettings, ReplayError> {
        let mut settings = golden();
        let limit = |character| {
            let limit = self.start.limits.get(character).copied();
            limit.ok_or_else(|| self.impossible("time limit"))
        };
        let world = &mut settings.world;
        world.layout.clone_from(&self.start.layout);
        (world.cook_time, world.chop_time, world.wash_time) =
            (limit("P")?, limit("B")?, limit("W")?);
        world.max_steps = self.start.max_steps;
        world.aware = self.start.belief == self.start.content;
        // Older recordings name the delay in the episode's name only.
        let named = self.name.strip_prefix("see_delay_").and_then(|delay| delay.parse().ok());
        world.see_delay = self.start.see_delay.or(named).unwrap_or(1);
        settings.human.reaction_delay = ReactionDelay::Fixed(self.start.d_r);
        settings.human.follow_through = leadtime_sims::human::FollowThrough::Fixed(self.start.d_f);
        Ok(settings)
    }

    fn start(&self, grid: &Grid, times: WorkTimes) -> Result<KitchenStart, ReplayError> {
        let [x, y] = self.start.pos;
        let place = grid.place(x, y).filter(|&place| grid.is_floor(place));
        let facing = read_direction(&self.start.ori);
        let (place, facing) = place.zip(facing).ok_or_else(|| self.impossible("start pose"))?;
        let read = |counter: &Option<u8>| counter.map_or(Content::Empty, Content::Work);
        let contents: Vec<Content> = self.start.content.iter().map(read).collect();
        if !grid.can_hold(&contents, times) {
            return Err(self.impossible("station state"));
        }
        Ok(KitchenStart { pose: Pose { place, facing }, contents, release_at: None })
    }

    fn order(&self, time: u32) -> Result<SpeechAct, ReplayError> {
        let Some(&(ref name, comprehension, conveyance)) = self.messages.get(&time) else {
            return Ok(SpeechAct::Continue);
        };
        let topic = TOPICS.iter().position(|topic| topic == name);
        let topic = topic.filter(|_| (1..=conveyance).contains(&comprehension));
        let topic = topic.ok_or_else(|| self.impossible("message"))?;
        Ok(SpeechAct::Start(Message { topic, comprehension, conveyance }))
    }

    fn compare_start(&self, run: &CookRun, comparison: &mut RecordingReport) {
        let (domain, theirs) = (run.env.domain(), &self.start);
        let grid = domain.kitchen.world.grid();
        let slots = grid.slots.iter();
        let stations: Vec<(String, [usize; 2])> =
            slots.map(|at| (at.station.name().to_owned(), grid.position(at.place))).collect();
        let (reference, deadline) = (domain.reference_steps(), domain.deadline());
        comparison.check(format_args!("stations at start"), &stations, &theirs.stations);
        comparison.check(format_args!("T_ref at start"), &reference, &theirs.t_ref);
        comparison.check(format_args!("deadline at start"), &deadline, &theirs.deadline);
        comparison.check(format_args!("belief at start"), &run.belief(), &theirs.belief);
        comparison.check(format_args!("awareness at start"), &run.aware(), &theirs.aware);
        let (ours, theirs) = (digits(&run.observe()), digits(&theirs.obs));
        comparison.check(format_args!("observation at start"), &ours, &theirs);
    }

    fn compare_total(&self, run: &CookRun, comparison: &mut RecordingReport) {
        let total = &self.total;
        let mut metrics = vec![0.0; run.env.spec().metrics.len()];
        run.env.metrics(&mut metrics);
        let yes_or_no = |yes| f32::from(u8::from(yes));
        for (name, theirs) in [
            ("success", yes_or_no(total.in_time)),
            ("dish_delivered", yes_or_no(total.delivered)),
            ("steps_to_deliver", total.steps as f32),
            ("notifications", total.notifications as f32),
            ("redundant_steps", total.redundant_steps as f32),
            ("pointless_pickups", total.redundant_pickups as f32),
            ("ineffective_actions", total.noop as f32),
        ] {
            let names = run.env.spec().metrics.iter();
            let ours = names.zip(&metrics).find(|(metric, _)| *metric == name).map(|(_, v)| *v);
            comparison.check(format_args!("{name} at the end"), &ours, &Some(theirs));
        }
    }
}

/// An episode under way.
struct CookRun {
    env: NotifierEnv<SteakhouseDomain>,
    observation: Vec<f32>,
    /// Steps since the last message started.
    since: u32,
    follow_through: u32,
}

impl CookRun {
    fn aware(&self) -> Vec<u8> {
        let kitchen = &self.env.domain().kitchen;
        let is_aware = |slot| kitchen.mind.belief.is_aware(slot, &kitchen.world);
        (0..kitchen.world.contents().len()).map(|slot| u8::from(is_aware(slot))).collect()
    }

    fn belief(&self) -> Vec<Option<u8>> {
        counters(&self.env.domain().kitchen.mind.belief.contents)
    }

    /// The reaction of the coming step, and how many of its steps are left.
    fn reaction(&self) -> Option<(String, u32)> {
        self.env.human().upcoming().map(|(it, steps)| (TOPICS[it.topic].to_owned(), steps))
    }

    /// Returns the recorded episodes' observation: the domain's, then what is said and done.
    fn observe(&self) -> Vec<f32> {
        let domain = self.env.domain();
        let mut out = vec![0.0; domain.obs_dim()];
        domain.observe(&mut out);
        let speech = self.env.human().speech();
        let yes_or_no = |yes| f32::from(u8::from(yes));
        out.push(yes_or_no(speech.is_some()));
        let topic = speech.map(|(message, _)| message.topic);
        out.extend((0..TOPICS.len()).map(|id| yes_or_no(topic == Some(id))));
        let words = speech
            .map_or([0; 3], |(message, heard)| [heard, message.comprehension, message.conveyance]);
        out.extend(words.map(|words| words as f32 / MAX_WORDS));
        let steps = self.reaction().map(|(_, steps)| steps);
        out.push(yes_or_no(steps.is_some()));
        out.push(steps.unwrap_or(0) as f32 / self.follow_through as f32);
        out.push(self.since.min(MAX_SINCE) as f32 / MAX_SINCE as f32);
        out
    }
}

fn compare_step(
    run: &CookRun,
    step: &CookStep,
    started: Option<Message>,
    comparison: &mut RecordingReport,
) {
    let world = &run.env.domain().kitchen.world;
    let (cook, at) = (world.cook(), step.t);
    let said = started.map(|m| (m.topic, m.comprehension, m.conveyance));
    comparison.check(format_args!("message of step {at}"), &said, &step.said);
    if let Some(LastStep { action, subtask, redundant }) = run.env.domain().last_step {
        let subtask = subtask.map_or("override", subtask_name);
        comparison.check(format_args!("subtask of step {at}"), &subtask, &step.subtask.as_str());
        let action = action_name(action);
        comparison.check(format_args!("action of step {at}"), &action, &step.action.as_str());
        comparison.check(format_args!("redundancy of step {at}"), &redundant, &step.redundant);
    }
    let pose = (world.grid().position(cook.pose.place), direction_name(cook.pose.facing));
    let theirs = (step.pos, step.ori.as_str());
    comparison.check(format_args!("pose of step {at}"), &pose, &theirs);
    let held = cook.held.map(item_name);
    comparison.check(format_args!("hand of step {at}"), &held, &step.held.as_deref());
    let contents = counters(world.contents());
    comparison.check(format_args!("stations of step {at}"), &contents, &step.content);
    comparison.check(format_args!("belief of step {at}"), &run.belief(), &step.belief);
    comparison.check(format_args!("awareness of step {at}"), &run.aware(), &step.aware);
    comparison.check(format_args!("reaction of step {at}"), &run.reaction(), &step.reaction);
    let speaking = run.env.human().speech().is_some();
    comparison.check(format_args!("speech of step {at}"), &speaking, &step.speaking);
    let left = interactions_left(world);
    comparison.check(format_args!("work left of step {at}"), &left, &step.remaining);
    let (ours, theirs) = (digits(&run.observe()), digits(&step.obs));
    comparison.check(format_args!("observation of step {at}"), &ours, &theirs);
}

fn counters(contents: &[Content]) -> Vec<Option<u8>> {
    contents.iter().map(|content| content.work()).collect()
}

fn action_name(action: Action) -> &'static str {
    match action {
        Action::Go(direction) => direction_name(direction),
        Action::Stay => "STAY",
        Action::Interact => "INTERACT",
    }
}

fn subtask_name(subtask: Subtask) -> &'static str {
    match subtask {
        Subtask::TakeDish => "pickup_dish",
        Subtask::TakePlatedSteak => "pickup_plated_steak",
        Subtask::Chop => "chop_onion",
        Subtask::Wash => "wash_plate",
        Subtask::FetchMeat => "pickup_meat",
        Subtask::FetchOnion => "pickup_onion",
        Subtask::FetchPlate => "pickup_plate",
        Subtask::TakeCleanPlate => "pickup_hot_plate",
        Subtask::PlaceMeat => "drop_meat",
        Subtask::PlaceOnion => "drop_onion",
        Subtask::PlacePlate => "drop_plate",
        Subtask::PlateSteak => "pickup_steak",
        Subtask::Garnish => "pickup_garnish",
        Subtask::Serve => "deliver_dish",
        Subtask::Discard => "discard",
        Subtask::Wait => "wait",
    }
}
