//! The learner's decisions, without network, clock or threads: what to do about each thing that happens.
//!
//! ```text
//! hello, token, rollout, refusal  ->  Coordinator  ->  Effect (send this, credit that, report)
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
//!   one will not come again, so without that its environment would wait for ever. One that may follow from what another actor sent
//!   of the environment goes to a third one instead.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use leadtime_link::RUN_IS_ENDING;
use leadtime_proto::message::{Assignment, Control, Credit, EnvAssignment, Hello};
use leadtime_proto::{
    ActorId, CheckedRollout, EnvId, Epoch, Header, Incarnation, PolicyVersion, Refusal,
    RefusalCause, Rollout, RunSpec, Sequence, limits, receive,
};

use crate::assign::{Assigner, Reassignment};
use crate::books::{Books, SenderKey};
use crate::builds::{Build, Builds};
use crate::report::{RosterEntry, RunEvent};
use crate::rollout_queue::RolloutQueue;
use crate::roster::{MembershipNumber, Roster};
use crate::stragglers::{Lateness, Stragglers};

mod lost_snapshots;

/// How often [`Coordinator::tick`] is to be called.
pub const TICK: Duration = Duration::from_millis(500);
const BEHIND: &str = "it is far behind the others";
/// How often in a row a member may follow an assignment that it was not given before it is given up.
const MAX_ASTRAY: u32 = 3;
/// Ticks of owing a rollout after which a member that says hello, and has nothing on its way, does not have the environments
/// that it was given: a little less than an actor without environments waits before it says so.
const IDLE_TICKS: u64 = 16;
/// The most bytes of snapshots in one assignment; more environments go into a second one. A checkpoint has to hold the snapshots of
/// all environments, so there are fewer parts than messages may wait for an actor.
const ASSIGNMENT_BYTES: usize = limits::MAX_CONTROL_BYTES / 2;
/// The most rollouts that an actor holds unacknowledged: a window, and one of every environment on top.
const MAX_UNACKNOWLEDGED: u64 = limits::MAX_WINDOW as u64 + limits::MAX_ENVS as u64;
/// The most rollouts of one actor that a killed learner can lose: more than an actor makes between two checkpoints.
const MAX_LOST: u64 = 1 << 20;
/// The most starts of actors whose reports of such a loss are believed without their being in the checkpoint: they joined after it.
const MAX_LOSERS: usize = 1_024;

/// What a run agreed on, as far as decisions depend on it.
#[derive(Clone, Debug)]
pub struct CoordinatorSettings {
    /// This start of the learner.
    pub learner: Incarnation,
    /// What is computed, and how: rollouts must fit it.
    pub spec: RunSpec,
    /// The most rollouts an actor may have unacknowledged.
    pub window: u32,
    /// Actors that must be there before a run starts.
    pub actors_min: usize,
}

/// Where a coordinator starts: the beginning, or a checkpoint.
#[derive(Clone, Debug, Default)]
pub struct CoordinatorStart {
    /// Where every environment stands.
    pub places: Vec<EnvAssignment>,
    /// The newest assignment so far.
    pub epoch: Epoch,
    /// The version of the policy that trains next.
    pub version: PolicyVersion,
    /// The books so far.
    pub books: Books,
    /// Who has computed the run so far, this learner included.
    pub builds: Builds,
}

/// What has to be done about something that happened.
#[derive(Clone, Debug)]
pub enum Effect {
    /// Send an actor a control message; those for one actor keep their order.
    Control {
        /// The start of the actor that it is for.
        to: SenderKey,
        /// The membership in which it is given; it is void in the next one.
        membership: MembershipNumber,
        /// The message, an assignment or an order to leave.
        control: Control,
    },
    /// Acknowledge an actor's rollouts, and permit more.
    Credit {
        /// The actor whose rollouts it is about.
        to: ActorId,
        /// How far they have arrived, and how many more may come.
        credit: Credit,
    },
    /// Report something to the sink.
    Event(RunEvent),
}

/// Why a hello is answered with a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HelloRefusal {
    /// The actor was cut off.
    #[error(
        "this actor was cut off, because what it sent was refused or could not be restored (the learner's log says more): \
         restart it"
    )]
    CutOff,
    /// Another incarnation is connected; reported as `HelloReply::Taken`.
    #[error("an actor of this name is already here")]
    Taken,
    /// Its counts contradict each other, or what this learner knows.
    #[error("its counts of published and unacknowledged rollouts make no sense")]
    Nonsense,
    /// It says that more of its rollouts were acknowledged before than is believed of one start.
    #[error(
        "it has delivered more rollouts of this run than this learner can take for lost (was the run begun anew?): \
         restart it"
    )]
    TooManyLost,
    /// The run is ending: there is nothing left to do. An actor knows it by this sentence.
    #[error("{RUN_IS_ENDING}")]
    Closing,
}

/// How far a run is, as far as moving environments is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RunStage {
    /// Too few actors so far.
    Gathering,
    /// Environments are moved when they have to be.
    Running,
    /// Actors are leaving, and nothing is moved any more.
    Closing,
}

/// The state behind a learner's decisions.
#[derive(Debug)]
pub struct Coordinator {
    settings: CoordinatorSettings,
    version: PolicyVersion,
    roster: Roster,
    assigner: Assigner,
    queue: RolloutQueue,
    stragglers: Stragglers,
    books: Books,
    builds: Builds,
    in_training: u64,
    stage: RunStage,
    rebalance_due: bool,
    /// Environments may wait for an actor: they are given once for all that has happened.
    orphans_due: bool,
    /// Environments whose owners were refused for what they made from others' snapshots: they are given away once, too.
    doubts_due: BTreeMap<SenderKey, BTreeSet<EnvId>>,
    /// Starts of actors whose lost rollouts are in the books, and that were not in the checkpoint.
    n_losers: usize,
    credit_due: BTreeSet<ActorId>,
    effects: Vec<Effect>,
}

impl Coordinator {
    /// Starts without actors: all environments wait for an owner.
    pub fn new(settings: CoordinatorSettings, start: CoordinatorStart) -> Self {
        let n_envs = start.places.len();
        Self {
            assigner: Assigner::new(n_envs, start.epoch),
            queue: RolloutQueue::new(settings.spec.schedule, start.places),
            stragglers: Stragglers::new(n_envs, settings.spec.schedule.is_deterministic()),
            settings,
            version: start.version,
            roster: Roster::default(),
            books: start.books,
            builds: start.builds,
            in_training: 0,
            stage: RunStage::Gathering,
            rebalance_due: false,
            orphans_due: false,
            doubts_due: BTreeMap::new(),
            n_losers: 0,
            credit_due: BTreeSet::new(),
            effects: Vec::new(),
        }
    }

    /// Takes in an actor's hello and returns the sequence from which its rollouts count.
    ///
    /// # Errors
    ///
    /// [`HelloRefusal::Closing`] if the run is ending, [`HelloRefusal::CutOff`] if this start was cut off,
    /// [`HelloRefusal::Taken`] if another start of the name is a member, [`HelloRefusal::Nonsense`] if its counts
    /// contradict each other or the books, [`HelloRefusal::TooManyLost`] if they are too far from the books. The
    /// sentence is for the actor's user.
    pub fn hello(&mut self, hello: &Hello) -> Result<Sequence, HelloRefusal> {
        let key = (hello.actor.clone(), hello.incarnation);
        if self.stage == RunStage::Closing {
            return Err(HelloRefusal::Closing); // An actor welcomed now would never be dismissed.
        }
        if self.roster.sender(&key).is_some_and(|sender| sender.cut_off) {
            return Err(HelloRefusal::CutOff);
        }
        if self.roster.is_taken(&key) {
            return Err(HelloRefusal::Taken);
        }
        // Before `greet`: an actor that has answered an order here has no rollouts to report that a killed learner took with it.
        let acknowledged = self.acknowledged(&key, hello)?;
        let was_member = self.roster.is_member(&key);
        let build = Build { program: hello.program.clone(), cpu: hello.cpu.clone() };
        self.roster.greet(&key, hello.published, build);
        if let Some(sender) = self.roster.sender(&key) {
            sender.acknowledged_before = sender.acknowledged_before.max(acknowledged);
        }
        self.admit(&key);
        self.credit_due.insert(hello.actor.clone());
        // At least the limit that the welcome's window promises, even if no credit message has been sent yet.
        let (heard, window) = (self.heard(&key), u64::from(self.window()));
        if let Some(sender) = self.roster.sender(&key) {
            sender.limit = sender.limit.max(Sequence(heard.0 + window));
        }
        // A copy of an older hello is behind what has been heard since.
        let has_nothing_on_its_way = hello.first_unacknowledged == hello.published.next();
        if was_member && has_nothing_on_its_way && hello.published == heard {
            self.give_again_if_quiet(&key);
        }
        Ok(heard.next())
    }

    /// Returns how far a sender has been heard, by this learner or one before it.
    fn heard(&mut self, key: &SenderKey) -> Sequence {
        let before = self.roster.sender(key).map(|sender| sender.acknowledged_before);
        self.books.sequence(key).max(before.unwrap_or_default())
    }

    /// Enters in the books what a killed learner took with it, now that this sender has shown that it works for this one: by an answer
    /// to an order, or a rollout. A hello shows nothing, for another learner of the run's name hears it, too.
    fn enter_lost(&mut self, key: &SenderKey) {
        let (known, heard) = (self.books.sequence(key), self.heard(key));
        if heard > known {
            self.n_losers += usize::from(known == Sequence(0));
            let n_steps = u64::from(self.settings.spec.n_steps);
            self.books.roll_back_through(key, heard, n_steps);
            self.fold_books(known);
        }
    }

    /// Keeps the books short if a sender is new in them, whose sequence was `known`.
    fn fold_books(&mut self, known: Sequence) {
        if known == Sequence(0) {
            let roster = &self.roster;
            self.books.fold(|key| roster.knows(key));
        }
    }

    /// Gives a member its environments again if it has delivered nothing of what it owed for [`IDLE_TICKS`]: it has dropped them, or
    /// somebody else has ordered it to. As seldom as that, too: a hello is small, and the snapshots of all its environments are not.
    fn give_again_if_quiet(&mut self, key: &SenderKey) {
        let n_idle_ticks = self.roster.sender(key).map_or(0, |sender| sender.n_idle_ticks);
        if n_idle_ticks >= IDLE_TICKS
            && self.stage == RunStage::Running
            && !self.stragglers.is_restoring(&key.0)
            && let Some(change) = self.assigner.renew(&key.0)
        {
            self.assign(change);
            if let Some(sender) = self.roster.sender(key) {
                sender.n_idle_ticks = 0;
            }
        }
    }

    /// Returns what a learner of this run has acknowledged to an actor, if that can be true.
    ///
    /// What exceeds the number that this learner received was lost with a killed predecessor: an actor reports that before it
    /// answers an order. Not in its first hello alone: that one may be a copy of an older one, which somebody kept.
    fn acknowledged(&mut self, key: &SenderKey, hello: &Hello) -> Result<Sequence, HelloRefusal> {
        let (published, first) = (hello.published.0, hello.first_unacknowledged.0);
        // In this order: each bound keeps the next subtraction from wrapping.
        let consistent = (1..=limits::MAX_COUNT).contains(&first)
            && first <= published.saturating_add(1)
            && published - (first - 1) <= MAX_UNACKNOWLEDGED;
        if !consistent {
            return Err(HelloRefusal::Nonsense);
        }
        let (acknowledged, known) = (Sequence(first - 1), self.books.sequence(key));
        if acknowledged > known {
            let is_new = self.roster.sender(key).is_none_or(|sender| !sender.was_heard());
            let stranger = known == Sequence(0);
            if !is_new {
                return Err(HelloRefusal::Nonsense);
            }
            // An actor that reports a loss and answers an order stays in the books, and so in every checkpoint: the number of such reports is
            // bounded, by this and the number of senders that are known at once.
            let has_room = !stranger || self.n_losers < MAX_LOSERS;
            if !has_room || acknowledged.0 - known.0 > MAX_LOST {
                return Err(HelloRefusal::TooManyLost);
            }
        }
        Ok(acknowledged)
    }

    /// Returns how many rollouts an actor that enters now may have unacknowledged: at least 1, for an actor takes no
    /// smaller window.
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
        }
    }

    /// Notes that an actor has answered an order of this membership: from its first answer on it may have environments.
    pub fn answered(&mut self, key: &SenderKey, membership: MembershipNumber) {
        if self.is_current(key, membership) && self.roster.answer(key) {
            self.enter_lost(key);
            // Its share of what others step waits for the end of the update; only what nobody steps is given out at once.
            self.rebalance_due = true;
            self.begin_if_enough();
            self.orphans_due = true;
        }
    }

    /// Notes that an actor follows the assignment that it was given: its environments are ready.
    pub fn followed(&mut self, key: &SenderKey, membership: MembershipNumber, epoch: Epoch) {
        if self.is_current(key, membership) {
            self.note_followed(key, epoch);
        }
        self.answered(key, membership);
    }

    /// Notes that a member has answered an assignment, whether it can restore all of it or not.
    fn note_followed(&mut self, key: &SenderKey, epoch: Epoch) {
        self.stragglers.restored(&key.0, epoch);
        if let Some(sender) = self.roster.sender(key) {
            sender.follows(epoch);
        }
    }

    /// Notes that an actor acknowledged no message of this membership: it is given up, unless it has come back meanwhile.
    pub fn silent(&mut self, key: &SenderKey, membership: MembershipNumber) {
        if self.is_current(key, membership) {
            self.give_up(key);
        }
    }

    /// Notes that an actor's answer to an order of this membership shows that it follows another assignment.
    pub fn astray(&mut self, key: &SenderKey, membership: MembershipNumber, told: Epoch) {
        if self.is_current(key, membership) {
            self.call_back(key, told);
        }
    }

    /// Gives a member that follows somebody else's assignment its environments again, under a number of its own that is higher. If
    /// there is none, or that has not helped, its membership ends: it says hello when it gets no credit, and starts over.
    fn call_back(&mut self, key: &SenderKey, told: Epoch) {
        let Some(sender) = self.roster.sender(key) else { return };
        sender.n_astray += 1;
        let n_astray = sender.n_astray;
        if n_astray == 1 {
            self.tell(RunEvent::Astray { actor: key.0.clone(), told });
        }
        if n_astray > MAX_ASTRAY {
            self.give_up(key);
        } else if told.0 > limits::MAX_HEARD_EPOCH {
            self.roster.expel(key);
            self.lose(&key.0);
        } else if self.stage != RunStage::Closing {
            let change = self.assigner.overrule(&key.0, told);
            self.assign(change);
        }
    }

    /// Gives up an actor that does not answer; if it comes back, it has to wait for environments.
    pub fn give_up(&mut self, key: &SenderKey) {
        if self.roster.expel(key) {
            self.stragglers.fail(&key.0, 0);
            self.lose(&key.0);
        }
    }

    /// Counts a message that the network layer refused.
    ///
    /// It is held against a member only if a readable header names that member's present start: anyone can publish
    /// under anyone's key, so everything else is a stranger's.
    pub fn refused_by_link(&mut self, actor: Option<ActorId>, refusal: Refusal) {
        let key = actor.clone().zip(refusal.sender);
        match key.filter(|key| self.roster.is_member(key)) {
            Some(key) => self.refuse(&key, refusal, false),
            None => self.refuse_stranger(actor, &refusal),
        }
    }

    /// Counts messages that the network layer refused without an event of their own. They are held against no actor.
    pub fn refused_without_event(
        &mut self,
        counts: impl IntoIterator<Item = ((Option<ActorId>, RefusalCause), u64)>,
    ) {
        let text =
            "no room in the queue, or its sender was cut off: such messages are only counted";
        for ((actor, cause), n) in counts {
            self.note_first(actor, &Refusal::new(cause, text));
            self.books.refuse_without_event(cause, n);
        }
    }

    /// Takes in a rollout message.
    pub fn rollout(&mut self, actor: ActorId, header: &Header, payload: &[u8]) {
        let key = (actor, header.incarnation);
        let Some(sender) = self.roster.sender(&key) else {
            let text = "it never said hello to this learner";
            return self.refuse_stranger(Some(key.0), &Refusal::new(RefusalCause::Stranger, text));
        };
        // The network layer drops and counts what follows, as far as it knows of it. This one was in the queue already.
        if sender.cut_off {
            return self.books.refuse_without_event(RefusalCause::CutOff, 1);
        }
        // A hello costs nothing, and what is entered in the books stays in every checkpoint. An honest actor's rollouts may
        // overtake its token: it notices after three seconds without an acknowledgement, and sends them again.
        if !sender.has_been_member() {
            return;
        }
        let (limit, made_before) = (sender.limit, sender.made_before);
        self.enter_lost(&key);
        let heard = self.books.sequence(&key);
        // Sequence and credit come before the payload: they cost nothing, and a copy must not be read a second time.
        if header.sequence <= heard {
            self.credit_due.insert(key.0);
            self.books.duplicates += 1;
            return;
        }
        if header.sequence > limit {
            let found = header.sequence;
            let text = format!("its sequence {found} is over the limit {limit}");
            self.credit_due.insert(key.0.clone());
            // It was not entered in the books, so their identity must not count its refusal.
            return self.refuse(&key, Refusal::new(RefusalCause::Credit, text), false);
        }
        if header.sequence > heard.next() {
            return; // Beyond a gap: not acknowledged, so it comes again in order.
        }
        // Each acknowledgement wakes threads in both processes. While an actor may send half of its window it does not wait for
        // one; those who are leaving do.
        let left = limit.0 - header.sequence.0;
        if left <= u64::from(self.room()) / 2 || self.stage == RunStage::Closing {
            self.credit_due.insert(key.0.clone());
        }
        // Made for a learner that is gone. Its epochs may have the numbers of ours, so ownership cannot be read from
        // them.
        let made_before = header.sequence <= made_before;
        // Entered before it is read: a refused rollout is acknowledged too, or its sender would send it again for ever.
        self.books.enter(&key, header.sequence);
        self.fold_books(heard);
        if made_before {
            return self.supersede();
        }
        match receive::open::<Rollout>(header, payload, receive::ROLLOUT) {
            Err(refusal) => self.refuse(&key, refusal, true),
            Ok(rollout) => {
                let (env_id, iteration) = (rollout.env_id, rollout.iteration);
                match self.read(header, rollout) {
                    Err(refusal) => self.refuse_read(&key, header, env_id, iteration, refusal),
                    Ok(rollout) => self.place(&key, header.epoch, rollout),
                }
            }
        }
    }

    /// Takes the rollouts of the next update, if they are all there.
    pub fn next_batch(&mut self) -> Option<Vec<CheckedRollout>> {
        let n_stale = self.queue.drop_stale(self.version);
        self.books.dropped_stale += n_stale;
        let batch = self.queue.take_batch(self.version);
        if let Some(batch) = &batch {
            self.in_training = batch.len() as u64;
            self.stragglers.updating();
        }
        if n_stale > 0 || batch.is_some() {
            self.credit_everyone();
        }
        batch
    }

    /// Returns the environments whose episodes were broken off, as far as training has not been told.
    pub fn take_broken_off(&mut self) -> BTreeSet<EnvId> {
        self.queue.take_broken_off()
    }

    /// Notes that the batch is trained and the policy has a new version.
    pub fn trained(&mut self, version: PolicyVersion) {
        self.books.trained += self.in_training;
        self.in_training = 0;
        self.queue.commit();
        self.version = version;
        // Now, because a move between two updates throws the least work away: in `sync` no actor has begun the next
        // rollout.
        if self.rebalance_due && self.stage == RunStage::Running {
            self.rebalance();
        }
    }

    /// Ends the run: what still waits, or was in training, is unused.
    pub fn close(&mut self) {
        self.books.unused_at_end = self.n_pending();
    }

    /// Notes that a [`TICK`] has passed: credit is repeated in case it was lost, and who is late is noticed.
    pub fn tick(&mut self) {
        self.credit_everyone();
        let (owing, lacking) = (self.owing(), self.lacking());
        self.roster.tick(&owing);
        let mut is_due = false;
        for finding in self.stragglers.tick(&lacking) {
            match finding {
                Lateness::Waiting { actor, n_ticks } => {
                    let n_envs = lacking.get(&actor).copied().unwrap_or_default();
                    let waited = n_ticks * TICK;
                    self.tell(RunEvent::WaitingForRollouts { actor, n_envs, waited });
                }
                Lateness::Behind(actor) => {
                    is_due = true;
                    self.tell(RunEvent::Distrusted { actor, reason: BEHIND });
                }
                // No hurry: it gets its share when the update is done, as one who joins does.
                Lateness::Trusted => self.rebalance_due = true,
            }
        }
        // At once, not after the update: it is this actor that the update waits for.
        if is_due && self.stage == RunStage::Running {
            self.rebalance();
        }
    }

    /// Counts, per member, the environments that keep the next update from beginning.
    fn lacking(&self) -> BTreeMap<ActorId, usize> {
        // While an update runs the learner itself is what takes time, so nobody is late.
        if self.in_training == 0 { self.without_rollouts() } else { BTreeMap::new() }
    }

    /// Lists the members that could deliver something now, and have not.
    fn owing(&self) -> BTreeSet<ActorId> {
        // Where versions are waited for, an update that runs leaves nothing to do for most. In `async` there is always
        // something, and one update may follow the other.
        let owing = if self.settings.spec.schedule.is_deterministic() {
            self.lacking()
        } else {
            self.without_rollouts()
        };
        owing.into_keys().collect()
    }

    /// Counts, per member, the environments of which no rollout waits.
    fn without_rollouts(&self) -> BTreeMap<ActorId, usize> {
        let mut n_envs = BTreeMap::new();
        if self.stage == RunStage::Running {
            for owner in self.queue.lacking().filter_map(|env_id| self.assigner.owner(env_id)) {
                *n_envs.entry(owner.key.0.clone()).or_default() += 1;
            }
        }
        n_envs
    }

    /// Orders every actor to leave; environments move no more.
    pub fn stop_everyone(&mut self, reason: &str) {
        self.stage = RunStage::Closing;
        for (actor, &incarnation) in self.roster.members() {
            let to = (actor.clone(), incarnation);
            let Some(membership) = self.roster.membership(&to) else { continue };
            let control = Control::Stop { reason: reason.to_owned(), cut_off: false };
            self.effects.push(Effect::Control { to, membership, control });
        }
    }

    fn credit_everyone(&mut self) {
        self.credit_due.extend(self.roster.members().keys().cloned());
    }

    /// Returns what is to be done since the last call.
    pub fn take_effects(&mut self) -> Vec<Effect> {
        self.settle_doubts();
        self.take_orphans();
        // Last, and one message per actor: many rollouts in a row are acknowledged together.
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
        self.assigner.epoch
    }

    /// Returns where environments go on after a resume.
    pub fn places(&self) -> Vec<EnvAssignment> {
        self.queue.consumed()
    }

    /// Returns the environments of which rollouts were dropped between the trainer's state and those places.
    pub fn passed_over(&self) -> &BTreeSet<EnvId> {
        self.queue.passed_over()
    }

    /// Returns how many rollouts have been accepted and not yet trained on.
    pub fn n_pending(&self) -> u64 {
        self.queue.len() as u64 + self.in_training
    }

    /// Counts the environments of which no rollout waits.
    pub fn n_envs_waiting(&self) -> usize {
        self.queue.lacking().count()
    }

    /// Returns the actors that are here.
    pub fn members(&self) -> &BTreeMap<ActorId, Incarnation> {
        self.roster.members()
    }

    /// Returns whether this membership is not over.
    pub fn is_current(&self, key: &SenderKey, membership: MembershipNumber) -> bool {
        self.roster.membership(key) == Some(membership)
    }

    /// Returns the state of every member, in the order of their names.
    pub fn roster_entries(&self) -> Vec<RosterEntry> {
        let entries = self.roster.member_senders().map(|(key, sender)| {
            let (newest, n_quiet_ticks) = sender.newest();
            let (envs, epoch) = self.assigner.holding(&key.0);
            RosterEntry {
                envs,
                epoch: epoch.0,
                iteration: newest.map(|(iteration, _)| iteration.0),
                staleness: newest.map(|(_, staleness)| staleness),
                acknowledged: self.books.sequence(&key).max(sender.acknowledged_before).0,
                limit: sender.limit.0,
                refused: sender.causes().clone(),
                silent_s: n_quiet_ticks as f64 * TICK.as_secs_f64(),
                incarnation: key.1.hex(),
                id: key.0,
            }
        });
        entries.collect()
    }

    /// Counts the actors that are members at present.
    pub fn n_actors(&self) -> usize {
        self.roster.members().len()
    }

    /// Counts those of them that have answered an order: behind the others there may be nobody.
    pub fn n_answering(&self) -> usize {
        self.roster.n_answering()
    }

    /// Returns how many actors have to be there, and answer, for the run to go on, if there are fewer.
    pub fn n_actors_needed(&self) -> Option<usize> {
        let n_needed = match self.stage {
            RunStage::Gathering => self.settings.actors_min,
            RunStage::Running => 1,
            RunStage::Closing => 0,
        };
        (self.n_answering() < n_needed).then_some(n_needed)
    }

    /// Returns who has computed the run so far.
    pub fn builds(&self) -> &Builds {
        &self.builds
    }

    fn tell(&mut self, event: RunEvent) {
        self.effects.push(Effect::Event(event));
    }

    fn read(&self, header: &Header, rollout: Rollout) -> Result<CheckedRollout, Refusal> {
        let spec = &self.settings.spec;
        let rollout =
            rollout.check(&spec.env, spec.n_steps as usize, spec.policy.recurrent_dim())?;
        let env_id = rollout.env_id;
        if self.queue.expected(env_id).is_none() {
            let text = format!("the run has no environment {env_id}");
            return Err(Refusal::new(RefusalCause::Assignment, text));
        }
        let (found, newest) = (rollout.version, self.version);
        // A deterministic schedule names the one version that may act an iteration; `async` takes any that exists.
        let required = spec.schedule.behavior_version(rollout.iteration);
        let expected = required.unwrap_or(newest);
        let wrong = found > newest || (required.is_some() && found != expected);
        let text = if wrong {
            format!("it was collected with policy version {found}, version {expected} is required")
        } else if header.version != found {
            let said = header.version;
            format!("its header says policy version {said}, the rollout itself {found}")
        } else {
            return Ok(rollout);
        };
        Err(Refusal::new(RefusalCause::Version, text))
    }

    fn supersede(&mut self) {
        self.books.superseded += 1;
        self.books.steps_redone += u64::from(self.settings.spec.n_steps);
    }

    fn place(&mut self, key: &SenderKey, epoch: Epoch, rollout: CheckedRollout) {
        let ordered = self.roster.sender(key).map(|sender| sender.ordered);
        if ordered.is_some_and(|ordered| epoch > ordered) {
            self.supersede();
            if self.roster.is_member(key) {
                self.call_back(key, epoch);
            }
            return;
        }
        let owned = self.assigner.owns(key, epoch, rollout.env_id);
        let expected = self.queue.expected(rollout.env_id).unwrap_or_default();
        // An actor cannot know yet that its environment has moved: that breaks no rule, so it is superseded and not
        // refused.
        if !owned || rollout.iteration < expected {
            self.supersede();
        } else if rollout.iteration > expected {
            let found = rollout.iteration;
            let text =
                format!("it is rollout {found} of its environment, rollout {expected} is next");
            self.refuse(key, Refusal::new(RefusalCause::Assignment, text), true);
        } else {
            self.stragglers.delivered(&key.0);
            if let Some(sender) = self.roster.sender(key) {
                let staleness = self.version.0.saturating_sub(rollout.version.0);
                sender.delivered(rollout.iteration, staleness);
            }
            self.accept(key, rollout);
        }
    }

    fn refuse(&mut self, key: &SenderKey, refusal: Refusal, sequenced: bool) {
        self.books.refuse(refusal.cause, sequenced);
        self.charge(key, refusal);
        if sequenced
            && self.roster.is_member(key)
            && let Some(change) = self.assigner.renew(&key.0)
        {
            // Which environment it was of cannot be known if it cannot be decoded: all of the sender's are given anew.
            self.assign(change);
        }
    }

    /// Holds a refusal against its sender, which is cut off if it was one too many.
    fn charge(&mut self, key: &SenderKey, refusal: Refusal) {
        let Some(sender) = self.roster.sender(key) else { return };
        let outcome = sender.refuse(refusal.cause);
        let Refusal { cause, text, .. } = refusal;
        if outcome.first {
            let (actor, reason) = (Some(key.0.clone()), text.to_string());
            self.tell(RunEvent::Refused { actor, cause, reason });
        }
        if outcome.cut_off {
            let reason =
                format!("the learner refused too many of its messages; the last one: {text}");
            self.cut_off(key, reason);
        }
    }

    fn refuse_stranger(&mut self, actor: Option<ActorId>, refusal: &Refusal) {
        self.note_first(actor, refusal);
        self.books.refuse(refusal.cause, false);
    }

    /// Reports the first refusal of its cause in the run.
    fn note_first(&mut self, actor: Option<ActorId>, refusal: &Refusal) {
        if !self.books.refusals.contains_key(&refusal.cause) {
            let (cause, reason) = (refusal.cause, refusal.text.to_string());
            self.tell(RunEvent::Refused { actor, cause, reason });
        }
    }

    fn cut_off(&mut self, key: &SenderKey, reason: String) {
        if let Some(sender) = self.roster.sender(key) {
            sender.cut_off = true;
        }
        // The name and not only this start: a restart does not get environments at once.
        self.stragglers.fail(&key.0, 0);
        // Before `give_up`, after which it is no member and hears nothing any more.
        if let Some(membership) = self.roster.membership(key) {
            let control = Control::Stop { reason: reason.clone(), cut_off: true };
            self.effects.push(Effect::Control { to: key.clone(), membership, control });
        }
        let (actor, incarnation) = key.clone();
        self.tell(RunEvent::CutOff { actor, incarnation, reason });
        self.give_up(key);
    }

    /// Makes an actor a member if it may be one. Only then does its build count: a hello alone computes nothing.
    fn admit(&mut self, key: &SenderKey) {
        let Some(build) = self.roster.admit(key) else { return };
        if let Some(ordered) = self.roster.sender(key).map(|sender| sender.ordered) {
            // It may have been overruled in an earlier membership: it follows no lower number.
            self.assigner.count_on_from(&key.0, ordered);
        }
        if self.builds.note(&build) {
            let actor = Some(key.0.clone());
            self.tell(RunEvent::OtherBuild { actor, build });
        }
        let (actor, n_actors) = (key.0.clone(), self.n_actors());
        self.tell(RunEvent::ActorJoined { actor, n_actors });
        let n_envs = self.assigner.n_envs();
        if n_actors == n_envs + 1 {
            self.tell(RunEvent::TooManyActors { n_actors, n_envs });
        }
        self.credit_due.insert(key.0.clone());
        if let Some(membership) = self.roster.membership(key) {
            let (to, control) = (key.clone(), Control::Wait);
            self.effects.push(Effect::Control { to, membership, control });
        }
    }

    fn lose(&mut self, actor: &ActorId) {
        let n_envs = self.assigner.release(actor);
        self.stragglers.left(actor);
        if self.stage != RunStage::Closing {
            self.books.steps_redone += n_envs as u64 * u64::from(self.settings.spec.n_steps);
        }
        let (actor, n_actors) = (actor.clone(), self.n_actors());
        self.tell(RunEvent::ActorLeft { actor, n_actors, n_envs });
        self.orphans_due = true;
    }

    /// Gives environments that wait for an actor to those that are here, if there may be some.
    fn take_orphans(&mut self) {
        // An actor that comes is asked first whether it is there; its answer makes this due again.
        let is_due = std::mem::take(&mut self.orphans_due) && self.roster.n_answering() > 0;
        if is_due && self.stage == RunStage::Running && self.assigner.has_orphans() {
            self.rebalance();
        }
    }

    fn begin_if_enough(&mut self) {
        if self.stage == RunStage::Gathering
            && self.roster.n_answering() >= self.settings.actors_min
        {
            self.stage = RunStage::Running;
        }
    }

    fn rebalance(&mut self) {
        self.rebalance_due = false;
        let (roster, stragglers) = (&self.roster, &self.stragglers);
        let limit = |actor: &ActorId| stragglers.max_envs(actor);
        // Nobody else, even if all of these may have none at present: behind a name that answers no order there may be nobody.
        let changes = self.assigner.rebalance(&roster.answering(), limit);
        self.assign_all(changes);
    }

    fn assign_all(&mut self, changes: Vec<Reassignment>) {
        for change in changes {
            self.assign(change);
        }
        self.stragglers.assigned(&self.assigner.counts(self.roster.members()));
    }

    /// Sends an assignment, in as many parts as its snapshots need; every part is an epoch of its own.
    fn assign(&mut self, change: Reassignment) {
        // An assignment replaces all that the actor had: each further part keeps what the parts before it gave.
        let Reassignment { actor, mut epoch, given, mut kept } = change;
        let Some(&incarnation) = self.roster.members().get(&actor) else { return };
        let to = (actor.clone(), incarnation);
        let Some(membership) = self.roster.membership(&to) else { return };
        let (n_given, n_kept) = (given.len(), kept.len());
        self.tell(RunEvent::Assigned { actor: actor.clone(), epoch, n_given, n_kept });
        let mut n_snapshots = 0;
        for (index, envs) in self.parts(&given).into_iter().enumerate() {
            if index > 0 {
                epoch = self.assigner.next_epoch(&actor);
            }
            n_snapshots += envs.iter().filter(|env| !env.snapshot.is_empty()).count();
            let keep = kept.clone();
            kept.extend(envs.iter().map(|env| env.env_id));
            let control = Control::Assign(Assignment { epoch, envs, keep });
            self.effects.push(Effect::Control { to: to.clone(), membership, control });
        }
        if n_snapshots > 0 {
            self.stragglers.restores(&actor, epoch, n_snapshots, n_given + n_kept);
        }
        if let Some(sender) = self.roster.sender(&to) {
            sender.ordered = epoch;
        }
    }

    fn parts(&self, given: &[EnvId]) -> Vec<Vec<EnvAssignment>> {
        // At least one part, also if it is empty: an actor that only loses environments has to be told.
        let mut parts = vec![Vec::new()];
        let mut n_bytes = 0;
        for env in given.iter().map(|&env_id| self.queue.newest(env_id)) {
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
        let Some(room) = self.queue.room() else { return self.settings.window };
        let share = room.div_euclid(self.n_answering().max(1)).max(room.min(1));
        u32::try_from(share).unwrap_or(u32::MAX).min(self.settings.window)
    }

    fn credit(&mut self, actor: &ActorId) -> Option<Credit> {
        let incarnation = *self.roster.members().get(actor)?;
        let key = (actor.clone(), incarnation);
        let acknowledged = self.heard(&key);
        let room = u64::from(self.room());
        let sender = self.roster.sender(&key)?;
        // A limit never falls: the actor may have published up to it by now.
        sender.limit = sender.limit.max(Sequence(acknowledged.0 + room));
        let (learner, limit) = (self.settings.learner, sender.limit);
        Some(Credit { incarnation, learner, acknowledged, limit })
    }
}

#[cfg(test)]
mod tests;
