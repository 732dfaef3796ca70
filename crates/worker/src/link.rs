//! One worker with its environments: what is asked of it, and how it is replaced when it dies.
//!
//! A worker that ends, hangs or sends what cannot be read is killed and started again; its environments are put back by what
//! their [`WorkerSlot`]s remember, and what was under way is asked once more. An environment whose step raises an exception is put
//! back once, too; if it raises again, or shows something else than before, it has failed. One that cannot be put back has failed
//! with its first exception.

use std::time::{Duration, Instant};

use leadtime_sims::EpisodeSeed;
use tracing::warn;

use crate::deaths::{MAX_DEATHS, WorkerDeaths};
use crate::error::Error;
use crate::launch::{MAX_STATE_BYTES, WorkerLaunch};
use crate::process::{LineLimit, NotBegun, WorkerProcess};
use crate::protocol::{
    FrameKind, FrameShape, FrameWriter, ProtocolError, StepRow, WorkerHello, read_stepped,
};
use crate::settings::SnapshotKind;
use crate::slot::{StepProgress, WorkerSlot, reset_seed};

/// How long a worker says nothing while its environments work, none of them for long; python/leadtime/worker.py has the same.
const SIGN_OF_LIFE: Duration = Duration::from_secs(1);

/// A worker and its environments.
#[derive(Debug)]
pub(crate) struct WorkerLink {
    launch: WorkerLaunch,
    hello: WorkerHello,
    shape: FrameShape,
    process: Option<WorkerProcess>,
    slots: Vec<WorkerSlot>,
    /// Whether the process has an environment at the place. Making one may take longer than a step.
    made: Vec<bool>,
    /// Slots whose steps are announced, and not sent yet.
    announced: Vec<usize>,
    /// Slots whose steps are sent, and not answered yet.
    sent: Vec<usize>,
    deaths: WorkerDeaths,
    /// Why there is no worker any more.
    lost: Option<String>,
    frame: FrameWriter,
    rows: Vec<StepRow>,
    /// Bounds what is logged about steps that are taken again.
    limit: LineLimit,
}

impl WorkerLink {
    /// Starts a worker.
    ///
    /// # Errors
    ///
    /// [`Error`] if it does not begin, or steps other environments than it should.
    pub(crate) fn start(launch: WorkerLaunch) -> Result<Self, Error> {
        let mut n_killed = 0;
        let (process, hello) = loop {
            let NotBegun { how, was_killed } = match WorkerProcess::start(&launch)? {
                Ok(begun) => break begun,
                Err(not_begun) => not_begun,
            };
            n_killed += 1;
            if !was_killed || n_killed == MAX_DEATHS {
                return Err(Error::Start { command: launch.command.clone(), reason: how });
            }
            warn!("the worker `{}` is started again: {how}", launch.command);
        };
        let shape = launch.check(&hello)?;
        Ok(Self {
            hello,
            slots: (0..launch.batch).map(|_| WorkerSlot::default()).collect(),
            made: vec![false; launch.batch],
            launch,
            shape,
            process: Some(process),
            announced: Vec::new(),
            sent: Vec::new(),
            deaths: WorkerDeaths::default(),
            lost: None,
            frame: FrameWriter::default(),
            rows: Vec::new(),
            limit: LineLimit::new(),
        })
    }

    /// Tells the worker that nothing more is asked of it.
    pub(crate) fn let_go(&mut self) {
        if let Some(process) = &mut self.process {
            process.let_go();
        }
    }

    /// Returns what the worker has said of itself.
    pub(crate) fn hello(&self) -> &WorkerHello {
        &self.hello
    }

    pub(crate) fn launch(&self) -> &WorkerLaunch {
        &self.launch
    }

    /// Returns how many of its environments are in use.
    pub(crate) fn n_used(&self) -> usize {
        self.slots.iter().filter(|slot| slot.is_used).count()
    }

    /// Returns whether one more environment can be stepped.
    pub(crate) fn has_room(&self) -> bool {
        self.lost.is_none() && self.n_used() < self.slots.len()
    }

    /// Reserves an environment for a caller; `None` if all are in use.
    pub(crate) fn reserve(&mut self) -> Option<usize> {
        let place = self.slots.iter().position(|slot| !slot.is_used)?;
        self.slots[place] = WorkerSlot { is_used: true, ..WorkerSlot::default() };
        Some(place)
    }

    /// Gives a reserved environment back.
    pub(crate) fn release(&mut self, place: usize) {
        if self.sent.contains(&place) {
            // The answer has to be read before anything else.
            self.settle();
        }
        self.announced.retain(|slot| *slot != place);
        self.slots[place].is_used = false;
    }

    pub(crate) fn slot(&self, place: usize) -> &WorkerSlot {
        &self.slots[place]
    }

    pub(crate) fn slot_mut(&mut self, place: usize) -> &mut WorkerSlot {
        &mut self.slots[place]
    }

    /// Begins the episode of a seed; the slot's row shows it.
    pub(crate) fn begin(&mut self, place: usize, seed: EpisodeSeed) {
        self.settle();
        self.slots[place].begin(seed);
        self.put_back(place);
    }

    /// Puts an environment where its slot says; the slot's row shows it.
    pub(crate) fn put_back(&mut self, place: usize) {
        self.settle();
        let slot = &mut self.slots[place];
        slot.action.resize(self.shape.n_heads, 0);
        slot.row.observation.clear();
        loop {
            if self.is_lost(place) {
                return;
            }
            match self.ask_to_begin(&[place]) {
                Ok(()) => break,
                Err(error) => self.replace(&error),
            }
        }
        let slot = &mut self.slots[place];
        std::mem::swap(&mut slot.row, &mut self.rows[0]);
        slot.put_back();
        if slot.row.has_failed {
            slot.fail(failed);
        }
    }

    /// Notes the action of a slot's coming step.
    pub(crate) fn announce(&mut self, place: usize, action: &[u8]) {
        let slot = &mut self.slots[place];
        if slot.failure.is_none() && slot.progress == StepProgress::Idle {
            slot.action.clear();
            slot.action.extend_from_slice(action);
            slot.progress = StepProgress::Announced;
            self.announced.push(place);
        }
    }

    /// Sends the steps that are announced, without waiting for what they show.
    pub(crate) fn send_steps(&mut self) {
        if self.announced.is_empty() {
            return;
        }
        self.settle();
        self.sent = std::mem::take(&mut self.announced);
        self.announced = Vec::with_capacity(self.sent.len());
        for &place in &self.sent {
            self.slots[place].progress = StepProgress::Sent;
        }
        if let Err(error) = self.ask_to_step() {
            self.replace(&error);
        }
    }

    /// Waits for what the steps that were sent have shown.
    pub(crate) fn settle(&mut self) {
        while !self.sent.is_empty() {
            if self.lost.is_some() {
                self.sent.clear();
                return;
            }
            let sent = std::mem::take(&mut self.sent);
            let timeout = self.launch.step_timeout;
            // Each may end an episode, and begin another one.
            match self.read_rows(&sent, timeout, timeout.saturating_mul(2 * sent.len() as u32)) {
                Ok(()) => {
                    self.deaths.stepped();
                    self.take_in(&sent);
                }
                Err(error) => {
                    self.sent = sent;
                    self.replace(&error);
                }
            }
        }
    }

    /// Hands the rows of an answer to their slots, and asks once more for the steps that failed for the first time.
    fn take_in(&mut self, sent: &[usize]) {
        let can_be_put_back = self.launch.snapshot != SnapshotKind::None;
        let mut rows = std::mem::take(&mut self.rows);
        for (&place, row) in sent.iter().zip(&mut rows) {
            let slot = &mut self.slots[place];
            if !row.has_failed {
                slot.stepped(row, &self.launch.metrics, can_be_put_back);
            } else if slot.progress == StepProgress::SentAgain || !can_be_put_back {
                slot.fail(failed);
            } else {
                self.sent.push(place);
            }
        }
        self.rows = rows;
        if self.sent.is_empty() {
            return;
        }
        for &place in &self.sent {
            let slot = &mut self.slots[place];
            slot.progress = StepProgress::SentAgain;
            // One that fails now and then does so for as long as the run lasts.
            if self.limit.admits() {
                warn!(
                    "environment {}: {}; its step is taken again",
                    slot.seed.env_id, slot.exception
                );
            }
        }
        let again = self.sent.clone();
        let asked = self.ask_to_begin(&again).and_then(|()| {
            self.look_at_put_back(&again);
            self.ask_to_step()
        });
        if let Err(error) = asked {
            self.replace(&error);
        }
    }

    /// Sees whether environments that were put back are where they were; no step is asked of those that are not.
    fn look_at_put_back(&mut self, places: &[usize]) {
        for (row, &place) in self.rows.iter().zip(places) {
            let slot = &mut self.slots[place];
            let is_other =
                !slot.row.observation.is_empty() && !same(&row.observation, &slot.row.observation);
            if row.has_failed {
                slot.fail(failed);
            } else if is_other {
                slot.fail(|slot| not_the_same(slot.seed));
            }
        }
        let slots = &self.slots;
        self.sent.retain(|place| slots[*place].failure.is_none());
    }

    /// Sees to it that an environment's actions fit a snapshot: they begin anew at a pickle, or the episode is too long.
    pub(crate) fn bound_actions(&mut self, place: usize) {
        let slot = &mut self.slots[place];
        if slot.actions.len() <= self.launch.max_action_bytes {
            return;
        }
        if self.launch.snapshot == SnapshotKind::Pickle {
            self.pickle(place);
        } else {
            slot.fail(too_long);
        }
    }

    /// Takes a pickle of an environment, from which it goes on if it has to be put back.
    pub(crate) fn pickle(&mut self, place: usize) {
        self.settle();
        let bytes = loop {
            if self.is_lost(place) || self.slots[place].failure.is_some() {
                return;
            }
            match self.ask_for_pickle(place) {
                Ok(bytes) => break bytes,
                Err(error) => self.replace(&error),
            }
        };
        let slot = &mut self.slots[place];
        if bytes.is_empty() {
            slot.fail(failed);
            return;
        }
        slot.n_before = slot.n_steps() as u32;
        slot.base = bytes;
        slot.actions.clear();
    }

    /// Takes note that there is no worker any more, if so.
    fn is_lost(&mut self, place: usize) -> bool {
        let Some(lost) = &self.lost else { return false };
        self.slots[place].fail(|_| lost.clone());
        true
    }

    fn ask_to_begin(&mut self, places: &[usize]) -> Result<(), ProtocolError> {
        let frame = &mut self.frame;
        frame.begin(FrameKind::Begin);
        frame.slot(places.len());
        let mut n_steps = 0;
        for &place in places {
            let slot = &self.slots[place];
            frame.slot(place);
            frame.number(reset_seed(slot.seed));
            frame.number((4 + slot.base.len() + slot.actions.len()) as u32);
            frame.number(slot.base.len() as u32);
            frame.bytes(&slot.base);
            frame.bytes(&slot.actions);
            n_steps += 1 + slot.actions.len() / self.shape.n_heads.max(1);
        }
        let process = self.process.as_mut().ok_or(ProtocolError::Closed)?;
        process.send(self.frame.finish())?;
        // One that the process has yet to make may take as long as its first one.
        let (step, making) = (self.launch.step_timeout, self.launch.start_timeout());
        let n_made = places.iter().filter(|place| self.made[**place]).count();
        let n_new = (places.len() - n_made) as u32;
        let timeout = if n_new > 0 { making } else { step };
        let patience = step.saturating_mul(n_steps as u32);
        self.read_rows(places, timeout, patience.saturating_add(making.saturating_mul(n_new)))?;
        for (&place, row) in places.iter().zip(&self.rows) {
            self.made[place] |= !row.has_failed;
        }
        Ok(())
    }

    fn ask_to_step(&mut self) -> Result<(), ProtocolError> {
        if self.sent.is_empty() {
            return Ok(());
        }
        let frame = &mut self.frame;
        frame.begin(FrameKind::Step);
        frame.slot(self.sent.len());
        for &place in &self.sent {
            let slot = &self.slots[place];
            frame.slot(place);
            frame.number(reset_seed(slot.next_seed()));
            frame.bytes(&slot.action);
        }
        let process = self.process.as_mut().ok_or(ProtocolError::Closed)?;
        process.send(self.frame.finish())
    }

    fn ask_for_pickle(&mut self, place: usize) -> Result<Vec<u8>, ProtocolError> {
        self.frame.begin(FrameKind::Snapshot);
        self.frame.slot(place);
        let (timeout, slots) = (self.launch.step_timeout, &mut self.slots);
        let process = self.process.as_mut().ok_or(ProtocolError::Closed)?;
        process.send(self.frame.finish())?;
        process.answer(FrameKind::Snapshotted, MAX_STATE_BYTES, timeout, timeout, |slot, text| {
            if let Some(slot) = slots.get_mut(usize::from(slot)) {
                slot.exception = text;
            }
        })
    }

    /// Reads an answer about some slots, which may take `patience` in all, and one of them `timeout`.
    fn read_rows(
        &mut self,
        places: &[usize],
        timeout: Duration,
        patience: Duration,
    ) -> Result<(), ProtocolError> {
        let (shape, slots) = (self.shape, &mut self.slots);
        let process = self.process.as_mut().ok_or(ProtocolError::Closed)?;
        let (timeout, patience) = (timeout + SIGN_OF_LIFE, patience.saturating_add(SIGN_OF_LIFE));
        let (kind, most) = (FrameKind::Stepped, shape.max_stepped_bytes(places.len()));
        let body = process.answer(kind, most, timeout, patience, |slot, text| {
            if let Some(slot) = slots.get_mut(usize::from(slot)) {
                slot.exception = text;
            }
        })?;
        self.rows.resize_with(places.len(), StepRow::default);
        read_stepped(&body, shape, &mut self.rows)
    }

    /// Starts a worker in place of one that has died, puts its environments back, and asks once more for the steps that
    /// were under way.
    fn replace(&mut self, error: &ProtocolError) {
        let mut how = match self.process.take() {
            Some(process) => process.end(error),
            None => error.to_string(),
        };
        while self.may_try_again(&how) {
            warn!("the worker `{}` is started again: {how}", self.launch.command);
            how = match self.start_again() {
                Ok(()) => return,
                Err(reason) => reason,
            };
        }
    }

    /// Counts a death, and gives the worker up if there were too many.
    fn may_try_again(&mut self, how: &str) -> bool {
        let (command, reason) = (self.launch.command.clone(), how.to_owned());
        let lost = match self.deaths.count(Instant::now()) {
            _ if self.launch.snapshot == SnapshotKind::None => {
                Error::NotPutBack { command, reason }
            }
            Some(over) => Error::Lost { command, n_deaths: MAX_DEATHS, over, reason },
            None => return true,
        };
        let lost = lost.to_string();
        for slot in self.slots.iter_mut().filter(|slot| slot.is_used) {
            slot.fail(|_| lost.clone());
        }
        self.lost = Some(lost);
        self.sent.clear();
        self.announced.clear();
        false
    }

    fn start_again(&mut self) -> Result<(), String> {
        let started = WorkerProcess::start(&self.launch).map_err(|error| error.to_string())?;
        let (process, hello) = started.map_err(|not_begun| not_begun.how)?;
        let shape = self.launch.check(&hello).map_err(|error| error.to_string())?;
        if shape != self.shape {
            return Err("it has other environments than before".to_owned());
        }
        self.process = Some(process);
        self.made.fill(false);
        let begun = |slot: &WorkerSlot| slot.is_used && slot.is_begun && slot.failure.is_none();
        let places: Vec<usize> =
            (0..self.slots.len()).filter(|place| begun(&self.slots[*place])).collect();
        let again = if places.is_empty() { Ok(()) } else { self.ask_to_begin(&places) };
        let again = again.and_then(|()| {
            self.look_at_put_back(&places);
            self.ask_to_step()
        });
        again.map_err(|error| match self.process.take() {
            Some(process) => process.end(&error),
            None => error.to_string(),
        })
    }
}

fn same(a: &[f32], b: &[f32]) -> bool {
    let bits = |x: &f32| x.to_bits();
    a.iter().map(bits).eq(b.iter().map(bits))
}

/// Says what is wrong with an environment that raises an exception.
fn failed(slot: &WorkerSlot) -> String {
    format!("environment {} fails: {}", slot.seed.env_id, slot.exception)
}

/// Says that an episode has too many steps.
fn too_long(slot: &WorkerSlot) -> String {
    format!(
        "environment {}: episode {} has {} steps, more than can be played again; end episodes by a time limit, or try \
         world.snapshot = \"pickle\"",
        slot.seed.env_id,
        slot.seed.episode,
        slot.n_steps()
    )
}

/// Says that an environment that was put back is not where it was.
pub(crate) fn not_the_same(seed: EpisodeSeed) -> String {
    format!(
        "environment {} was put back in episode {} and shows something else than before: it does not depend on its seed and \
         its actions alone (`leadtime check` finds where); world.snapshot = \"none\" with learner.mode = \"async\" can train on it",
        seed.env_id, seed.episode
    )
}
