//! One session: from observations to words. Pure: time comes in as a number, what is said goes out as bytes.
//!
//! ```text
//! arrive(observation)   order, content, age  ->  the newest one; with `clock = "observation"` also a step
//! hear(report)          what the loudspeaker really did
//! tick                  staleness, the watchdog, words and steps by the clock, the status once a second
//! ```
//!
//! A step: a word of what is said has been heard; the notifier observes; the policy decides; what starts, goes on, ends or is cut
//! is published. It is the order of training ([`Session`]), so the policy sees what it has learned with.
//!
//! How long a word takes: a step with `clock = "observation"` and without a voice; else as long as in the voice's sound. Words then
//! end between steps, and a decision sees how many have ended. A client's reports count more than either.
//!
//! # What must happen
//!
//! | event | then |
//! |---|---|
//! | a number not above the last | dropped, `out_of_order`; the same number with other content is refused |
//! | a gap in the numbers | `missed`; with `clock = "observation"` the steps in between are taken in silence, on what was seen last |
//! | the newest is older than `stale_after` | an utterance is cut unless it is understood; nothing new starts |
//! | older than `lost_after`, or the client gone | silence; the past is kept for 30 s; the next observation goes on |
//! | nothing for ten minutes | the session is closed and says so; its kept state stays |
//! | `end`, or another `episode` | the utterance is cut, the past forgotten |
//! | what cannot be used | refused and reported; 16 in a row end the session |
//! | a number three widths outside of its range | taken, `strange`, reported once per number |
//! | a fact that the task does not have | ignored, counted in `unknown_facts`, reported once per name |
//!
//! The session of a robot that cannot ask for another one ([`ObservationSource::Robot`]) is never ended by what it sends.

use std::sync::Arc;

use leadtime_episodes::episode_seed;
use leadtime_numerics::{Pcg64, Purpose};
use leadtime_sims::human::{Initiation, SpeechAct};
use leadtime_sims::notifier::{Session, SessionState};
use leadtime_sims::{Fact, Message, Quantity};
use leadtime_voice::{SpokenSentence, VoiceBook};
use serde::{Deserialize, Serialize};

use crate::latency::LatencyHistogram;
use crate::observation::LiveObservation;
use crate::open::{SessionPlan, StepClock, WordClock};
use crate::phrases::{PhraseBook, PhraseTurns};
use crate::robot::{ObservationSource, RobotReader};
use crate::say::{SayEvent, SayTo};
use crate::status::{LiveCounts, LiveState, Silence};
use crate::travel::TravelTime;
use crate::working_policy::{LiveDecider, WorkingPolicy};

mod arrivals;
mod published;

pub use arrivals::{MAX_REFUSED, ObservationBytes};

/// How long the past of a lost client is kept, in nanoseconds.
const KEPT: u64 = 30_000_000_000;
/// After how long a session is over to which nothing comes, in nanoseconds.
const FORGOTTEN: u64 = 600_000_000_000;
/// A millisecond, in nanoseconds.
const MILLISECOND: u64 = 1_000_000;
/// How late a step may be, in nanoseconds.
const LATE: u64 = 20_000_000;
/// How often a status is published, in nanoseconds, and how soon after a change another one may be.
const STATUS_EVERY: u64 = 1_000_000_000;
const STATUS_PAUSE: u64 = 20_000_000;
/// The longest sentence that is spoken without further memory, in bytes.
const TEXT: usize = 512;
/// Numbers of utterances that a restarted notifier passes over: some may have been said after its last snapshot.
const UTTERANCES_PASSED: u32 = 16;

/// What is being said, or was said last.
#[derive(Clone, Debug)]
struct RunningUtterance {
    number: u32,
    message: Message,
    text: String,
    stand_in: bool,
    /// The sentence in the notifier's voice.
    spoken: Option<Arc<SpokenSentence>>,
    /// Words that have ended.
    heard: u32,
    /// The client reports what it hears: the clock does not count.
    is_reported: bool,
    started: u64,
}

/// Everything that a session's future depends on but the time, for a restarted notifier.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LiveSnapshot {
    session: SessionState,
    turns: PhraseTurns,
    draws: Pcg64,
    recurrent: Vec<f32>,
    episode: u64,
    step: u32,
    last_seq: Option<u64>,
    last_t: f64,
    is_begun: bool,
    has_ended: bool,
    last_utterance: u32,
    counts: LiveCounts,
}

/// A notifier at work for one client.
#[derive(Clone, Debug)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a fact of its own, and none excludes another"
)]
pub struct LiveSession {
    id: String,
    plan: SessionPlan,
    step_ns: u64,
    stale_ns: u64,
    lost_ns: u64,
    notifier: Session,
    phrases: PhraseBook,
    voice: Option<Arc<VoiceBook>>,
    ranges: Arc<[Quantity]>,
    facts: Arc<[Fact]>,
    // The episode.
    is_begun: bool,
    episode: u64,
    /// The step of the episode, from 0.
    step: u32,
    draws: Pcg64,
    recurrent: Vec<f32>,
    // What arrives.
    robot: Option<RobotReader>,
    /// The last observation is the first of its source.
    is_other_clock: bool,
    incoming: LiveObservation,
    newest: LiveObservation,
    newest_at: Option<u64>,
    last_seq: Option<u64>,
    last_t: f64,
    travel: TravelTime,
    n_refused_in_a_row: u32,
    /// Observations in a row whose numbers are below one that was taken.
    n_late_in_a_row: u32,
    /// How many messages were refused in this process, and why the last one was.
    refusals: (u64, String),
    told: String,
    /// Which numbers were strange before.
    was_strange: Vec<bool>,
    /// Which facts were unknown before.
    unknown: Vec<String>,
    is_gone: bool,
    is_mute: bool,
    // What is said.
    utterance: RunningUtterance,
    /// The sentence of the message that is about to start.
    next_text: String,
    next_stands_in: bool,
    is_word_due: bool,
    state: LiveState,
    since: u64,
    why: Silence,
    next_step: Option<u64>,
    // Memory that is used again.
    row: Vec<f32>,
    choices: Vec<u8>,
    held: Vec<u8>,
    status: Vec<u8>,
    is_held: bool,
    // What is published of it.
    counts: LiveCounts,
    latency: LatencyHistogram,
    status_due: u64,
    status_put: u64,
    has_news: bool,
}

impl LiveSession {
    /// Opens a session at `now`, in nanoseconds of the notifier's own clock.
    pub fn new(
        id: String,
        plan: SessionPlan,
        policy: &WorkingPolicy,
        decider: &LiveDecider,
        now: u64,
    ) -> Self {
        let notifier = policy.session.clone();
        let obs_dim = notifier.obs_dim();
        let ns = |seconds: f64| (seconds * 1e9) as u64;
        Self {
            id,
            step_ns: ns(plan.seconds_per_step),
            stale_ns: ns(plan.stale_after),
            lost_ns: ns(plan.lost_after),
            phrases: PhraseBook::new(policy.taxonomy()),
            voice: policy.voice(),
            ranges: policy.observation().into(),
            facts: policy.known_facts().into(),
            is_begun: false,
            episode: 0,
            step: 0,
            draws: Pcg64::seed_from_u64(0),
            recurrent: vec![0.0; decider.recurrent_dim()],
            robot: match plan.source {
                ObservationSource::Client => None,
                ObservationSource::Robot(form) => Some(RobotReader::new(form, ns(plan.lost_after))),
            },
            is_other_clock: false,
            incoming: LiveObservation::new(obs_dim),
            newest: LiveObservation::new(obs_dim),
            newest_at: None,
            last_seq: None,
            last_t: 0.0,
            travel: TravelTime::default(),
            n_refused_in_a_row: 0,
            n_late_in_a_row: 0,
            refusals: (0, String::new()),
            told: String::new(),
            was_strange: vec![false; obs_dim],
            unknown: Vec::new(),
            is_gone: false,
            is_mute: false,
            utterance: RunningUtterance {
                number: 0,
                message: Message { topic: 0, comprehension: 0, conveyance: 0 },
                text: String::with_capacity(TEXT),
                stand_in: false,
                spoken: None,
                heard: 0,
                is_reported: false,
                started: 0,
            },
            next_text: String::with_capacity(TEXT),
            next_stands_in: false,
            is_word_due: false,
            state: LiveState::Waiting,
            since: now,
            why: Silence::NoObservation,
            next_step: None,
            row: vec![0.0; notifier.row_dim()],
            choices: vec![0; decider.n_heads()],
            held: Vec::with_capacity(2 * TEXT),
            status: Vec::with_capacity(2 * TEXT),
            is_held: false,
            counts: LiveCounts::default(),
            latency: LatencyHistogram::default(),
            status_due: now,
            status_put: 0,
            has_news: true,
            notifier,
            plan,
        }
    }

    /// Returns the session's name.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Returns what the session does.
    pub fn state(&self) -> LiveState {
        self.state
    }

    /// Returns what has happened to the client's messages.
    pub fn counts(&self) -> LiveCounts {
        self.counts
    }

    /// Returns how many messages were refused in this process, and why the last one was.
    pub(crate) fn refusals(&self) -> (u64, &str) {
        (self.refusals.0, &self.refusals.1)
    }

    /// Returns the number of the newest observation; 0 before the first.
    pub fn last_seq(&self) -> u64 {
        self.last_seq.unwrap_or(0)
    }

    /// Returns the step of the episode, from 0.
    pub fn step_of_episode(&self) -> u32 {
        self.step
    }

    /// Counts how long it took from what caused an event to the end of telling it, in nanoseconds.
    pub fn record_latency(&mut self, nanoseconds: u64) {
        self.latency.record(nanoseconds);
    }

    /// Notes how many further messages were never looked at.
    pub fn note_overwritten(&mut self, n: u64) {
        self.counts.overwritten += n;
    }

    /// Returns why the session is over, `None` if it goes on. One to which nothing has come for long is closed first.
    pub fn end(&mut self, now: u64, out: &mut impl SayTo) -> Option<&Silence> {
        let quiet_since = self.newest_at.map_or(self.since, |at| at.max(self.since));
        let is_quiet = now.saturating_sub(quiet_since) > FORGOTTEN && self.robot.is_none();
        let may_end = matches!(self.state, LiveState::Waiting | LiveState::Lost | LiveState::Ended);
        if is_quiet && may_end {
            self.forget();
            self.close(now, Silence::Forgotten, out);
        }
        (self.state == LiveState::Closed).then_some(&self.why)
    }

    /// Returns when [`LiveSession::tick`] has something to do.
    pub fn next_deadline(&self) -> u64 {
        if self.is_gone && self.is_watched() {
            return 0;
        }
        let watched = match self.state {
            LiveState::Silent | LiveState::Speaking => Some(self.stale_ns),
            LiveState::Stale => Some(self.lost_ns),
            _ => None,
        };
        let watched = watched.zip(self.newest_at).map(|(after, at)| at + after + 1);
        let status = if self.has_news {
            (self.status_put + STATUS_PAUSE).min(self.status_due)
        } else {
            self.status_due
        };
        [self.next_step, watched, self.next_word()].into_iter().flatten().fold(status, u64::min)
    }

    /// Starts an episode with the newest observation.
    fn begin(&mut self, now: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        let seed = episode_seed(self.plan.seed, self.episode);
        self.draws = seed.stream(Purpose::Act);
        self.phrases.begin(&mut seed.stream(Purpose::Words));
        self.recurrent.fill(0.0);
        self.step = 0;
        let newest = &self.newest.values;
        self.notifier.begin(|observation| observation.copy_from_slice(newest));
        let is_timed = self.plan.clock != StepClock::Observation;
        self.next_step = is_timed.then_some(now + self.step_ns);
        self.decide_if_fresh(now, decider, out);
    }

    /// Takes a step: a word was heard, the notifier observes, the policy decides.
    fn step(&mut self, now: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        self.step += 1;
        self.pass_word(now, out);
        self.observe();
        self.decide_if_fresh(now, decider, out);
    }

    /// Lets a step pass in which nothing new was seen and nothing is decided.
    fn pass(&mut self, now: u64, out: &mut impl SayTo) {
        self.step += 1;
        self.pass_word(now, out);
        self.observe();
        self.go_on_speaking(now, out);
    }

    /// Publishes that a further word begins, if one does.
    fn go_on_speaking(&mut self, now: u64, out: &mut impl SayTo) {
        let is_pause = self.next_word().is_some_and(|begins| begins > now);
        if self.is_word_due && !is_pause {
            self.is_word_due = false;
            self.emit(now, SayEvent::Word, out);
        }
    }

    /// Returns the running sentence, if its words take the time that they take in the voice.
    fn timed(&self) -> Option<&SpokenSentence> {
        let is_timed = self.plan.word_clock == WordClock::Voice && self.notifier.speech().is_some();
        self.utterance.spoken.as_deref().filter(|_| is_timed)
    }

    /// Returns when the voice ends the running word, or begins the next one after a pause; `None` where a client reports it.
    fn next_word(&self) -> Option<u64> {
        let spoken = self.timed().filter(|_| !self.utterance.is_reported)?;
        // A sentence of another length than the message's: k and l are parts of it.
        let (n, l) = (spoken.words.len() as u32, self.utterance.message.conveyance);
        let first_after = |heard: u32| (heard * n).div_ceil(l.max(1)) as usize;
        let heard = self.utterance.heard;
        let milliseconds = if self.is_word_due {
            spoken.words.get(first_after(heard))?.begin
        } else {
            spoken.words.get(first_after(heard + 1).checked_sub(1)?)?.end
        };
        Some(self.utterance.started + u64::from(milliseconds) * MILLISECOND)
    }

    /// Hears what the voice has said by now.
    fn hear_voice(&mut self, now: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        let before = self.utterance.heard;
        while self.next_word().is_some_and(|at| at <= now) {
            if self.is_word_due {
                self.go_on_speaking(now, out);
            } else {
                self.hear_word(now, out);
            }
        }
        self.follow(before, now, decider, out);
    }

    /// Goes on after words have ended: with `clock = "word"` by a step.
    fn follow(&mut self, before: u32, now: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        let has_moved = self.utterance.heard > before;
        if has_moved && self.plan.clock == StepClock::Word && self.state == LiveState::Speaking {
            self.step += 1;
            self.observe();
            self.decide_if_fresh(now, decider, out);
            self.next_step = Some(now + self.step_ns);
        } else {
            self.go_on_speaking(now, out);
        }
        self.release(self.plan.clock != StepClock::Observation, out);
    }

    /// Returns the age of the newest observation, in nanoseconds.
    fn age(&self, now: u64) -> u64 {
        self.newest_at.map_or(u64::MAX, |at| now.saturating_sub(at))
    }

    /// Nothing new is said on what is stale, whatever brought it here.
    fn decide_if_fresh(&mut self, now: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        if self.age(now) <= self.stale_ns {
            self.decide(now, decider, out);
        } else {
            self.become_stale(now, out);
            self.go_on_speaking(now, out);
        }
    }

    /// Cuts what is said unless it is understood.
    fn become_stale(&mut self, now: u64, out: &mut impl SayTo) {
        if self.notifier.speech().is_some_and(|speech| !speech.understood) {
            self.cut(now, out);
        }
        self.become_state(now, LiveState::Stale, Silence::Stale(self.plan.stale_after));
    }

    fn observe(&mut self) {
        let newest = &self.newest.values;
        self.notifier.observe(|observation| observation.copy_from_slice(newest));
    }

    /// A step of speech is over, if the client does not say itself what it hears.
    fn pass_word(&mut self, now: u64, out: &mut impl SayTo) {
        let steps = u64::from(self.utterance.message.conveyance) * self.step_ns;
        let usual = self.timed().map_or(steps, |it| u64::from(it.end()) * MILLISECOND);
        let is_overdue = now.saturating_sub(self.utterance.started) > 2 * usual + self.lost_ns;
        let is_timed = self.timed().is_some() && !self.utterance.is_reported;
        if !is_timed && (!self.utterance.is_reported || is_overdue) {
            self.hear_word(now, out);
        }
    }

    fn hear_word(&mut self, now: u64, out: &mut impl SayTo) {
        if self.notifier.speech().is_none() {
            return;
        }
        self.utterance.heard += 1;
        if self.notifier.hear_word().is_some() {
            self.is_word_due = false;
            self.emit(now, SayEvent::End, out);
        } else {
            // Published once it is clear that the utterance goes on.
            self.is_word_due = true;
        }
    }

    fn decide(&mut self, now: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        self.notifier.write_row(&mut self.row);
        let (mask, draws) = (self.notifier.mask(), &mut self.draws);
        decider.decide(&self.row, mask, &mut self.recurrent, draws, &mut self.choices);
        let act = self.notifier.speech_act(&self.choices);
        let mut initiation = self.notifier.initiation_of(act);
        let mut why = match initiation {
            Initiation::Blocked => Silence::Blocked,
            _ => Silence::Policy,
        };
        if let (SpeechAct::Start(message), Initiation::Started) = (act, initiation)
            && !self.find_words(message)
        {
            (initiation, why) = (Initiation::None, Silence::NoSentence);
        }
        let cuts = matches!(initiation, Initiation::Started | Initiation::Stopped);
        if cuts && self.notifier.speech().is_some() {
            self.is_word_due = false;
            self.emit(now, SayEvent::Cut, out);
        }
        self.go_on_speaking(now, out);
        if let Some(message) = self.notifier.carry_out(act, initiation) {
            self.start(now, message, out);
        }
        self.counts.steps += 1;
        if self.notifier.speech().is_some() {
            self.become_state(now, LiveState::Speaking, Silence::None);
        } else {
            self.become_state(now, LiveState::Silent, why);
        }
    }

    /// Finds the sentence of a message that is about to start.
    fn find_words(&mut self, message: Message) -> bool {
        let Some(phrase) = self.phrases.find(message, self.newest.facts()) else { return false };
        self.next_text.clear();
        self.next_text.push_str(phrase.text);
        self.next_stands_in = phrase.stand_in;
        true
    }

    fn start(&mut self, now: u64, message: Message, out: &mut impl SayTo) {
        let utterance = &mut self.utterance;
        std::mem::swap(&mut utterance.text, &mut self.next_text);
        let voice = self.voice.as_ref();
        utterance.spoken = voice.and_then(|voice| voice.get(&utterance.text)).cloned();
        utterance.number += 1;
        utterance.message = message;
        utterance.stand_in = self.next_stands_in;
        (utterance.heard, utterance.is_reported, utterance.started) = (0, false, now);
        self.counts.utterances += 1;
        self.emit(now, SayEvent::Start, out);
        if let Some(spoken) = &self.utterance.spoken {
            out.play(spoken);
        }
    }

    /// Cuts what is said, because nobody should be spoken to.
    fn cut(&mut self, now: u64, out: &mut impl SayTo) {
        if self.notifier.speech().is_some() {
            self.notifier.fall_silent();
            self.is_word_due = false;
            self.emit(now, SayEvent::Cut, out);
        }
    }

    /// Cuts what is said, because another session takes the place of this one.
    pub fn break_off(&mut self, now: u64, out: &mut impl SayTo) {
        self.cut(now, out);
        self.release(true, out);
    }

    /// Ends the session: cuts what is said and puts a last status.
    pub fn close(&mut self, now: u64, why: Silence, out: &mut impl SayTo) {
        self.break_off(now, out);
        self.next_step = None;
        self.become_state(now, LiveState::Closed, why);
        self.status_due = now;
        self.tell(now, out);
    }

    fn fall_silent(&mut self, now: u64, out: &mut impl SayTo) {
        self.cut(now, out);
        self.release(self.plan.clock != StepClock::Observation, out);
    }

    /// Notes that this start of the client has appeared or disappeared.
    pub fn note_presence(&mut self, is_here: bool) {
        self.is_gone = !is_here;
    }

    /// Notes whether the loudspeaker has failed.
    pub fn note_mute(&mut self, is_mute: bool) {
        self.has_news |= self.is_mute != is_mute;
        self.is_mute = is_mute;
    }

    /// Does what is due: the watchdog, a step by the clock, a status.
    pub fn tick(&mut self, now: u64, decider: &mut LiveDecider, out: &mut impl SayTo) {
        self.watch(now, out);
        if self.next_word().is_some_and(|at| at <= now) {
            self.hear_voice(now, decider, out);
        }
        if let Some(due) = self.next_step.filter(|due| *due <= now) {
            self.counts.late_steps += u64::from(now - due > LATE);
            if self.state == LiveState::Stale {
                self.pass(now, out);
            } else {
                self.step(now, decider, out);
            }
            self.release(true, out);
            // Missed steps are not made up for: that would mean speaking faster.
            let next = due + self.step_ns;
            self.next_step = Some(if next > now { next } else { now + self.step_ns });
        }
        self.tell(now, out);
    }

    /// Returns whether it matters how old the newest observation is.
    fn is_watched(&self) -> bool {
        matches!(self.state, LiveState::Silent | LiveState::Speaking | LiveState::Stale)
    }

    /// Looks how old the newest observation is.
    fn watch(&mut self, now: u64, out: &mut impl SayTo) {
        if !self.is_watched() {
            return;
        }
        let age = self.age(now);
        if self.is_gone || age > self.lost_ns {
            self.next_step = None;
            let quiet = Silence::Quiet(self.plan.lost_after);
            let why = if self.is_gone { Silence::ClientGone } else { quiet };
            self.fall_silent(now, out);
            self.become_state(now, LiveState::Lost, why);
        } else if age > self.stale_ns {
            self.become_stale(now, out);
            self.release(self.plan.clock != StepClock::Observation, out);
        } else if self.state == LiveState::Stale {
            if self.notifier.speech().is_some() {
                self.become_state(now, LiveState::Speaking, Silence::None);
            } else {
                self.become_state(now, LiveState::Silent, Silence::Policy);
            }
        }
    }

    fn become_state(&mut self, now: u64, state: LiveState, why: Silence) {
        if self.state != state {
            (self.state, self.since) = (state, now);
            self.has_news = true;
        }
        if self.why != why {
            self.why = why;
            self.has_news = true;
        }
    }

    /// Returns everything that the future depends on but the time.
    pub fn snapshot(&self, now: u64) -> LiveSnapshot {
        LiveSnapshot {
            session: self.notifier.state(),
            turns: self.phrases.turns(),
            draws: self.draws.clone(),
            recurrent: self.recurrent.clone(),
            episode: self.episode,
            step: self.step,
            last_seq: self.last_seq,
            last_t: self.last_t,
            is_begun: self.is_begun && !self.is_past_over(now),
            has_ended: self.state == LiveState::Ended,
            last_utterance: self.utterance.number,
            counts: self.counts,
        }
    }

    /// Returns whether the past is too long ago to go on from. Who was restored waits as one who was lost: it ages all the same.
    fn is_past_over(&self, now: u64) -> bool {
        let is_quiet = matches!(self.state, LiveState::Lost | LiveState::Waiting);
        is_quiet && now.saturating_sub(self.since) > KEPT
    }

    /// Returns how long the past is kept of a client that says nothing, in nanoseconds.
    pub fn kept_for(&self) -> u64 {
        self.lost_ns + KEPT
    }

    /// Returns whether the next observation goes on where the session was, or there is nothing yet that it could go on from.
    pub(crate) fn goes_on(&self) -> bool {
        self.is_begun || self.last_seq.is_none()
    }

    /// Forgets the past, but not the numbers: the next observation begins an episode.
    pub fn forget(&mut self) {
        self.is_begun = false;
    }

    /// Goes on from a snapshot, silent: whatever was being said has been cut with the process that said it. `false` if it is
    /// another notifier's; the session is of no use then.
    pub fn restore(&mut self, snapshot: LiveSnapshot) -> bool {
        let finite = snapshot.recurrent.iter().all(|value| value.is_finite());
        let fits = finite && snapshot.recurrent.len() == self.recurrent.len();
        let begun = !snapshot.is_begun || self.phrases.restore(&snapshot.turns);
        if !fits || !begun || !self.notifier.restore(&snapshot.session) {
            return false;
        }
        self.notifier.fall_silent();
        self.draws = snapshot.draws;
        self.recurrent = snapshot.recurrent;
        (self.episode, self.step) = (snapshot.episode, snapshot.step);
        (self.last_seq, self.last_t) = (snapshot.last_seq, snapshot.last_t);
        self.is_begun = snapshot.is_begun;
        self.utterance.number = snapshot.last_utterance.saturating_add(UTTERANCES_PASSED);
        self.counts = snapshot.counts;
        if snapshot.has_ended {
            (self.state, self.why) = (LiveState::Ended, Silence::Ended);
        }
        true
    }
}

#[cfg(test)]
mod tests;
