//! The learner's decisions, without network, clock or threads: what to do about each thing that happens.
//!
//! ```text
//! hello, token, rollout, refusal  ->  Coordinator  ->  Effect (say this, credit that, tell the log)
//!                                         |
//!                        rollouts that are ready -> the trainer -> trained()
//! ```
//!
//! A rollout counts if its environment's owner sent it, under an assignment not older than that ownership, and
//! if it is the environment's next one. Every other rollout that arrives in order is *superseded* (its
//! environment went on elsewhere) or *refused* (it breaks a rule); either way it is acknowledged, because the
//! actor need not send it again.
//!
//! # Invariants
//!
//! * Everything that arrives in order is counted exactly once in the [`Books`].
//! * After a refused rollout its sender gets its environments anew, from their newest snapshots: the refused
//!   one will not come again, so without that its environment would wait for ever.

mod terms;

use std::collections::{BTreeMap, BTreeSet};

use leadtime_proto::message::{Assignment, Control, Credit, EnvAssignment, Hello};
use leadtime_proto::{
    ActorId, CheckedRollout, EnvId, Epoch, Header, Incarnation, PolicyVersion, Refusal,
    RefusalCause, Rollout, Sequence, limits, receive,
};

use crate::assign::{Assigner, Change};
use crate::books::{Books, SenderKey};
use crate::collect::{Batch, Collector};
use crate::report::RunEvent;
use crate::roster::Roster;

use terms::Stage;
pub use terms::{Effect, HelloRefusal, Start, Terms};

/// The most bytes of snapshots in one assignment; more environments go into a second one.
const ASSIGNMENT_BYTES: usize = limits::MAX_CONTROL_BYTES / 2;
/// A count of rollouts that no actor reaches: a hello beyond it is nonsense.
const MAX_SEQUENCE: u64 = 1 << 48;
/// The most rollouts that an actor holds unacknowledged: a window, and one of every environment on top.
const MAX_UNACKNOWLEDGED: u64 = limits::MAX_WINDOW as u64 + limits::MAX_ENVS as u64;
/// The most rollouts of one actor that a killed learner takes with it: more than is made between two checkpoints.
const MAX_LOST: u64 = 1 << 20;
/// The most starts of actors that may say so without being in the checkpoint: those that came after it.
const MAX_LOSERS: usize = 1_024;

/// The state behind a learner's decisions.
#[derive(Debug)]
pub struct Coordinator {
    terms: Terms,
    version: PolicyVersion,
    roster: Roster,
    assigner: Assigner,
    collector: Collector,
    books: Books,
    in_training: u64,
    stage: Stage,
    rebalance_due: bool,
    same_program: bool,
    same_cpu: bool,
    /// Starts of actors that told of lost rollouts and were not in the checkpoint.
    n_losers: usize,
    credit_due: BTreeSet<ActorId>,
    effects: Vec<Effect>,
}

impl Coordinator {
    /// Starts with nobody.
    pub fn new(terms: Terms, start: Start) -> Self {
        Self {
            assigner: Assigner::new(start.places.len(), start.epoch),
            collector: Collector::new(terms.spec.schedule, start.places),
            terms,
            version: start.version,
            roster: Roster::default(),
            books: start.books,
            in_training: 0,
            stage: Stage::Gathering,
            rebalance_due: false,
            same_program: true,
            same_cpu: true,
            n_losers: 0,
            credit_due: BTreeSet::new(),
            effects: Vec::new(),
        }
    }

    /// Hears an actor's hello and returns the sequence from which its rollouts count.
    ///
    /// # Errors
    ///
    /// [`HelloRefusal`], to be told to the actor.
    pub fn hello(&mut self, hello: &Hello) -> Result<Sequence, HelloRefusal> {
        let key = (hello.actor.clone(), hello.incarnation);
        if self.roster.sender(&key).is_some_and(|sender| sender.cut_off) {
            return Err(HelloRefusal::CutOff);
        }
        if self.roster.is_taken(&key) {
            return Err(HelloRefusal::Taken);
        }
        let acknowledged = self.acknowledged(&key, hello)?;
        self.roster.greet(&key, hello.published);
        let n_steps = u64::from(self.terms.spec.n_steps);
        self.books.roll_back_through(&key, acknowledged, n_steps);
        if hello.program != self.terms.program {
            self.same_program = false;
            let (actor, program) = (hello.actor.clone(), hello.program.clone());
            self.effects.push(Effect::Event(RunEvent::OtherProgram { actor, program }));
        }
        if hello.cpu != self.terms.cpu {
            self.same_cpu = false;
            let (actor, cpu) = (hello.actor.clone(), hello.cpu.clone());
            self.effects.push(Effect::Event(RunEvent::OtherCpu { actor, cpu }));
        }
        self.admit(&key);
        self.credit_due.insert(hello.actor.clone());
        let (heard, window) = (self.books.sequence(&key), u64::from(self.window()));
        if let Some(sender) = self.roster.sender(&key) {
            sender.limit = sender.limit.max(Sequence(heard.0 + window));
        }
        Ok(heard.next())
    }

    /// Returns what a learner of this run has acknowledged to an actor, if that can be true.
    ///
    /// More than this learner has heard is what one before it took with it when it was killed: an actor tells of
    /// that once, in its first hello.
    fn acknowledged(&mut self, key: &SenderKey, hello: &Hello) -> Result<Sequence, HelloRefusal> {
        let (published, first) = (hello.published.0, hello.first_unacknowledged.0);
        let consistent = (1..=MAX_SEQUENCE).contains(&first)
            && first <= published.saturating_add(1)
            && published - (first - 1) <= MAX_UNACKNOWLEDGED;
        if !consistent {
            return Err(HelloRefusal::Nonsense);
        }
        let (acknowledged, heard) = (Sequence(first - 1), self.books.sequence(key));
        if acknowledged > heard {
            let is_new = self.roster.sender(key).is_none();
            let stranger = heard == Sequence(0);
            let credible = is_new && acknowledged.0 - heard.0 <= MAX_LOST;
            if !credible || (stranger && self.n_losers >= MAX_LOSERS) {
                return Err(HelloRefusal::Nonsense);
            }
            self.n_losers += usize::from(stranger);
        }
        Ok(acknowledged)
    }

    /// Returns how many rollouts an actor that enters now may have unacknowledged.
    pub fn window(&self) -> u32 {
        self.room().max(1)
    }

    /// Notes that an actor's token is there.
    pub fn joined(&mut self, actor: ActorId, incarnation: Incarnation) {
        let key = (actor, incarnation);
        self.roster.appear(&key);
        self.admit(&key);
    }

    /// Notes that an actor's token is gone: its environments go to the others.
    pub fn left(&mut self, actor: ActorId, incarnation: Incarnation) {
        let key = (actor, incarnation);
        if self.roster.vanish(&key) {
            self.lose(&key.0);
            self.rebalance_if_orphaned();
        }
    }

    /// Gives up an actor that does not answer.
    pub fn give_up(&mut self, key: &SenderKey) {
        if self.roster.expel(key) {
            self.lose(&key.0);
            self.rebalance_if_orphaned();
        }
    }

    /// Counts a message that the network layer refused.
    ///
    /// It is held against a member only if a readable header names that member's present start: anyone can publish
    /// under anyone's key, so everything else is a stranger's.
    pub fn refused_by_link(&mut self, actor: Option<ActorId>, refusal: Refusal) {
        let key = actor.clone().zip(refusal.sender);
        match key.filter(|key| self.roster.members().get(&key.0) == Some(&key.1)) {
            Some(key) => self.refuse(&key, refusal, false),
            None => self.refuse_stranger(actor, refusal),
        }
    }

    /// Counts messages that the network layer refused without an event of their own. They are held against nobody.
    pub fn refused_without_event(
        &mut self,
        counts: impl IntoIterator<Item = ((Option<ActorId>, RefusalCause), u64)>,
    ) {
        for ((actor, cause), n) in counts {
            self.note_first(actor, &Refusal::new(cause, "no room in the queue, or its sender was cut off: such messages are only counted"));
            self.books.refuse_without_event(cause, n);
        }
    }

    /// Hears which environments an actor cannot restore under an assignment.
    ///
    /// Until they are given anew they stand still.
    pub fn cannot_restore(&mut self, key: &SenderKey, envs: &[EnvId]) {
        let (actor, n_envs) = (key.0.clone(), envs.len());
        self.effects.push(Effect::Event(RunEvent::CannotRestore { actor, n_envs }));
    }

    /// Takes in a rollout message.
    pub fn rollout(&mut self, actor: ActorId, header: &Header, payload: &[u8]) {
        let key = (actor, header.incarnation);
        let heard = self.books.sequence(&key);
        let Some(sender) = self.roster.sender(&key) else {
            let text = "it never said hello to this learner";
            return self.refuse_stranger(Some(key.0), Refusal::new(RefusalCause::Stranger, text));
        };
        if sender.cut_off {
            return;
        }
        self.credit_due.insert(key.0.clone());
        if header.sequence <= heard {
            self.books.duplicates += 1;
            return;
        }
        if header.sequence > sender.limit {
            let (found, limit) = (header.sequence, sender.limit);
            let text = format!("its sequence {found} is over the limit {limit}");
            return self.refuse(&key, Refusal::new(RefusalCause::Credit, text), false);
        }
        if header.sequence > heard.next() {
            return; // Beyond a gap: not acknowledged, so it comes again in order.
        }
        let made_before = header.sequence <= sender.made_before;
        self.books.enter(&key, header.sequence);
        if made_before {
            return self.supersede();
        }
        match self.read(header, payload) {
            Err(refusal) => self.refuse(&key, refusal, true),
            Ok(rollout) => self.place(&key, header.epoch, rollout),
        }
    }

    /// Takes the rollouts of the next update, if they are all there.
    pub fn next_batch(&mut self) -> Option<Batch> {
        let n_stale = self.collector.drop_stale(self.version);
        self.books.dropped_stale += n_stale;
        let batch = self.collector.take_batch(self.version);
        self.in_training = batch.as_ref().map_or(0, |batch| batch.rollouts.len() as u64);
        if n_stale > 0 || batch.is_some() {
            self.credit_everyone();
        }
        batch
    }

    /// Notes that the batch is trained and the policy has a new version.
    pub fn trained(&mut self, version: PolicyVersion) {
        self.books.trained += self.in_training;
        self.in_training = 0;
        self.version = version;
        if self.rebalance_due && self.stage == Stage::Running {
            self.rebalance();
        }
    }

    /// Ends the run: what still waits, or was in training, is unused.
    pub fn close(&mut self) {
        self.books.unused_at_end = self.n_pending();
    }

    /// Tells every actor to leave; environments move no more.
    pub fn stop_everyone(&mut self, reason: &str) {
        self.stage = Stage::Closing;
        for (actor, &incarnation) in self.roster.members() {
            let control = Control::Stop { reason: reason.to_owned(), cut_off: false };
            self.effects.push(Effect::Control { to: (actor.clone(), incarnation), control });
        }
    }

    /// Makes every actor's credit due, as once a second in case one was lost.
    pub fn credit_everyone(&mut self) {
        self.credit_due.extend(self.roster.members().keys().cloned());
    }

    /// Returns what is to be done since the last call.
    pub fn take_effects(&mut self) -> Vec<Effect> {
        for actor in std::mem::take(&mut self.credit_due) {
            if let Some(credit) = self.credit(&actor) {
                self.effects.push(Effect::Credit { to: actor, credit });
            }
        }
        std::mem::take(&mut self.effects)
    }

    /// Returns the books as they are.
    pub fn books(&self) -> &Books {
        &self.books
    }

    /// Returns the newest assignment's number.
    pub fn epoch(&self) -> Epoch {
        self.assigner.epoch()
    }

    /// Returns where environments go on after a resume.
    pub fn places(&self) -> Vec<EnvAssignment> {
        self.collector.consumed()
    }

    /// Returns how many rollouts have been accepted and not yet trained on.
    pub fn n_pending(&self) -> u64 {
        self.collector.len() as u64 + self.in_training
    }

    /// Returns the actors that are here.
    pub fn members(&self) -> &BTreeMap<ActorId, Incarnation> {
        self.roster.members()
    }

    /// Returns how many actors are here.
    pub fn n_actors(&self) -> usize {
        self.roster.members().len()
    }

    /// Returns how many actors there have to be for the run to go on, if there are fewer.
    pub fn n_actors_needed(&self) -> Option<usize> {
        let n_needed = match self.stage {
            Stage::Gathering => self.terms.actors_min,
            Stage::Running => 1,
            Stage::Closing => 0,
        };
        (self.n_actors() < n_needed).then_some(n_needed)
    }

    /// Tells whether everyone so far ran the learner's build on the learner's class of CPU.
    pub fn is_uniform(&self) -> bool {
        self.same_program && self.same_cpu
    }

    fn read(&self, header: &Header, payload: &[u8]) -> Result<CheckedRollout, Refusal> {
        let spec = &self.terms.spec;
        let rollout: Rollout = receive::open(header, payload, receive::ROLLOUT)?;
        let recurrent_dim = spec.policy.recurrent_dim();
        let rollout = rollout.check(&spec.env, spec.n_steps as usize, recurrent_dim)?;
        let env_id = rollout.env_id;
        if self.collector.expected(env_id).is_none() {
            let text = format!("the run has no environment {env_id}");
            return Err(Refusal::new(RefusalCause::Assignment, text));
        }
        let found = rollout.version;
        let newest = self.version;
        let required = spec.schedule.behavior_version(rollout.iteration);
        let expected = required.unwrap_or(newest);
        let wrong = found > newest || (required.is_some() && found != expected);
        if wrong || header.version != found {
            let text = format!("policy version {found} acted it where {expected} had to");
            return Err(Refusal::new(RefusalCause::Version, text));
        }
        Ok(rollout)
    }

    fn supersede(&mut self) {
        self.books.superseded += 1;
        self.books.steps_redone += u64::from(self.terms.spec.n_steps);
    }

    fn place(&mut self, key: &SenderKey, epoch: Epoch, rollout: CheckedRollout) {
        let owned = self.assigner.owner(rollout.env_id).is_some_and(|owner| {
            owner.actor == key.0 && owner.incarnation == key.1 && epoch >= owner.since
        });
        let expected = self.collector.expected(rollout.env_id).unwrap_or_default();
        if !owned || rollout.iteration < expected {
            self.supersede();
        } else if rollout.iteration > expected {
            let found = rollout.iteration;
            let text = format!("it is rollout {found} of its environment where {expected} is next");
            self.refuse(key, Refusal::new(RefusalCause::Assignment, text), true);
        } else {
            self.collector.accept(rollout);
        }
    }

    fn refuse(&mut self, key: &SenderKey, refusal: Refusal, sequenced: bool) {
        let Refusal { cause, text, .. } = refusal;
        self.books.refuse(cause, sequenced);
        let Some(sender) = self.roster.sender(key) else { return };
        let verdict = sender.refuse(cause);
        if verdict.first {
            let (actor, reason) = (Some(key.0.clone()), text.to_string());
            self.effects.push(Effect::Event(RunEvent::Refused { actor, cause, reason }));
        }
        if verdict.cut_off {
            self.cut_off(key, text.into_owned());
        } else if sequenced
            && self.roster.members().get(&key.0) == Some(&key.1)
            && let Some(change) = self.assigner.renew(&key.0)
        {
            self.tell(change);
        }
    }

    fn refuse_stranger(&mut self, actor: Option<ActorId>, refusal: Refusal) {
        self.note_first(actor, &refusal);
        self.books.refuse(refusal.cause, false);
    }

    /// Reports the first refusal of its cause in the run.
    fn note_first(&mut self, actor: Option<ActorId>, refusal: &Refusal) {
        if !self.books.refusals.contains_key(&refusal.cause) {
            let (cause, reason) = (refusal.cause, refusal.text.to_string());
            self.effects.push(Effect::Event(RunEvent::Refused { actor, cause, reason }));
        }
    }

    fn cut_off(&mut self, key: &SenderKey, reason: String) {
        let control = Control::Stop {
            reason: format!("the learner refused too many messages; the last one: {reason}"),
            cut_off: true,
        };
        self.effects.push(Effect::Control { to: key.clone(), control });
        let (actor, incarnation) = key.clone();
        self.effects.push(Effect::Event(RunEvent::CutOff { actor, incarnation, reason }));
        self.give_up(key);
    }

    /// Makes an actor a member if it may be one.
    fn admit(&mut self, key: &SenderKey) {
        if !self.roster.admit(key) {
            return;
        }
        let (actor, n_actors) = (key.0.clone(), self.n_actors());
        self.effects.push(Effect::Event(RunEvent::ActorJoined { actor, n_actors }));
        self.credit_due.insert(key.0.clone());
        self.rebalance_due = true;
        self.rebalance_if_orphaned();
    }

    fn lose(&mut self, actor: &ActorId) {
        let n_envs = self.assigner.release(actor);
        if self.stage != Stage::Closing {
            self.books.steps_redone += n_envs as u64 * u64::from(self.terms.spec.n_steps);
        }
        let (actor, n_actors) = (actor.clone(), self.n_actors());
        self.effects.push(Effect::Event(RunEvent::ActorLeft { actor, n_actors, n_envs }));
    }

    fn rebalance_if_orphaned(&mut self) {
        if self.stage == Stage::Gathering && self.n_actors() >= self.terms.actors_min {
            self.stage = Stage::Running;
        }
        if self.stage == Stage::Running && self.assigner.has_orphans() {
            self.rebalance();
        }
    }

    fn rebalance(&mut self) {
        self.rebalance_due = false;
        for change in self.assigner.rebalance(self.roster.members()) {
            self.tell(change);
        }
    }

    /// Says an assignment, in as many parts as its snapshots need; every part is an epoch of its own.
    fn tell(&mut self, change: Change) {
        let Change { actor, mut epoch, given, mut kept } = change;
        let Some(&incarnation) = self.roster.members().get(&actor) else { return };
        let (n_given, n_kept) = (given.len(), kept.len());
        self.effects.push(Effect::Event(RunEvent::Assigned {
            actor: actor.clone(),
            epoch,
            n_given,
            n_kept,
        }));
        for (index, envs) in self.parts(&given).into_iter().enumerate() {
            if index > 0 {
                epoch = self.assigner.next_epoch();
            }
            let ids: Vec<EnvId> = envs.iter().map(|env| env.env_id).collect();
            let control = Control::Assign(Assignment { epoch, envs, keep: kept.clone() });
            self.effects.push(Effect::Control { to: (actor.clone(), incarnation), control });
            kept.extend(ids);
        }
    }

    fn parts(&self, given: &[EnvId]) -> Vec<Vec<EnvAssignment>> {
        let mut parts = vec![Vec::new()];
        let mut n_bytes = 0;
        for env in given.iter().map(|&env_id| self.collector.newest(env_id)) {
            n_bytes += env.snapshot.len();
            if n_bytes > ASSIGNMENT_BYTES {
                n_bytes = env.snapshot.len();
                parts.push(Vec::new());
            }
            if let Some(part) = parts.last_mut() {
                part.push(env);
            }
        }
        parts
    }

    /// Returns how many rollouts each actor may have on their way: in `async` its share of what may still wait, so
    /// that little grows stale on the way; at least one, unless nothing more may wait.
    fn room(&self) -> u32 {
        let Some(room) = self.collector.room() else { return self.terms.window };
        let share = room.div_euclid(self.n_actors().max(1)).max(room.min(1));
        u32::try_from(share).unwrap_or(u32::MAX).min(self.terms.window)
    }

    fn credit(&mut self, actor: &ActorId) -> Option<Credit> {
        let incarnation = *self.roster.members().get(actor)?;
        let key = (actor.clone(), incarnation);
        let acknowledged = self.books.sequence(&key);
        let room = u64::from(self.room());
        let sender = self.roster.sender(&key)?;
        sender.limit = sender.limit.max(Sequence(acknowledged.0 + room));
        Some(Credit { incarnation, learner: self.terms.learner, acknowledged, limit: sender.limit })
    }
}

#[cfg(test)]
mod tests;
