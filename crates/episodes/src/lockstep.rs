//! Slots stepped together: one batched inference, an action each, one step each.
//!
//! ```text
//! act      [slot 0 | slot 1 | slot 2] ── one batched inference ──► an action each
//! advance  an action each ──► one step each ──► which episodes ended, and how
//! ```
//!
//! All actions are announced before the first step is taken, so that environments in another process take theirs together.
//!
//! An episode that ended keeps its final observation until its slot begins another one, so whoever drives the slots sees
//! both. Which slots are stepped together makes no difference to the bits: every slot draws from its own stream, and
//! inference is row-invariant.
//!
//! # Invariants
//!
//! * Buffers are reused: acting and advancing allocate nothing once the batch has had its size.
//! * Observers are called in the order of the slots.

use std::borrow::BorrowMut;

use leadtime_policy::Policy;
use leadtime_proto::Mask;
use leadtime_sims::{End, StepOutcome};

use crate::player::{Choice, Decider};
use crate::slot::EnvSlot;

/// What a player decided in one slot.
#[derive(Clone, Copy, Debug)]
pub struct Decision<'a> {
    /// What the environment offered.
    pub mask: Mask,
    /// One choice per head. Shape `[H]`.
    pub choices: &'a [u8],
    /// Log-probability of the choices; 0 for a script.
    pub log_prob: f32,
    /// The policy's value of the observation; 0 for a script.
    pub value: f32,
    /// The policy's logits, before the mask. Shape `[C]`; empty for a script.
    pub logits: &'a [f32],
    /// What the policy's heads saw, if [`Observer::wants_hidden`]; empty for a script.
    pub hidden: Option<&'a [f32]>,
}

/// Watches one slot; every hook does nothing unless it is implemented.
pub trait Observer {
    /// There is a moment to see: an episode has begun, or a step has been taken.
    fn on_moment(&mut self, _slot: &EnvSlot) {}

    /// An episode has begun; the slot holds its first observation.
    fn on_reset(&mut self, slot: &EnvSlot) {
        self.on_moment(slot);
    }

    /// Asks, once before every step, whether the policy's hidden features are wanted for it.
    fn wants_hidden(&mut self, _slot: &EnvSlot) -> bool {
        false
    }

    /// An action has been chosen; the slot holds the observation that it was chosen for, and the recurrent state after it.
    fn on_decision(&mut self, _slot: &EnvSlot, _decision: &Decision<'_>) {}

    /// A step has been taken; the slot holds the observation after it.
    fn on_step(&mut self, slot: &EnvSlot, _outcome: StepOutcome) {
        self.on_moment(slot);
    }
}

/// For slots that are only played.
impl Observer for () {}

/// Both watch; the first one comes first.
impl<A: Observer, B: Observer> Observer for (A, B) {
    fn on_reset(&mut self, slot: &EnvSlot) {
        self.0.on_reset(slot);
        self.1.on_reset(slot);
    }

    fn wants_hidden(&mut self, slot: &EnvSlot) -> bool {
        let first = self.0.wants_hidden(slot);
        self.1.wants_hidden(slot) || first
    }

    fn on_decision(&mut self, slot: &EnvSlot, decision: &Decision<'_>) {
        self.0.on_decision(slot, decision);
        self.1.on_decision(slot, decision);
    }

    fn on_step(&mut self, slot: &EnvSlot, outcome: StepOutcome) {
        self.0.on_step(slot, outcome);
        self.1.on_step(slot, outcome);
    }
}

/// The buffers of a batch, and what its last step ended.
#[derive(Debug, Default)]
pub struct Lockstep {
    /// What the policies see, slot by slot. `[N, D]`
    observations: Vec<f32>,
    /// Recurrent states, slot by slot. `[N, S]`
    recurrent: Vec<f32>,
    /// Logits of all heads. `[N, C]`
    logits: Vec<f32>,
    /// The critic's values. `[N]`
    values: Vec<f32>,
    /// The chosen actions. `[N, H]`
    choices: Vec<u8>,
    /// What the heads saw in the latest slot that wanted to know.
    hidden: Vec<f32>,
    n_heads: usize,
    ended: Vec<(usize, End)>,
}

impl Lockstep {
    /// Chooses an action in every slot.
    ///
    /// # Panics
    ///
    /// If the slots' environments are not of the decider's task, or if there is not one observer per slot.
    pub fn act<S: BorrowMut<EnvSlot>, O: Observer>(
        &mut self,
        decider: &mut Decider<'_>,
        slots: &mut [S],
        observers: &mut [O],
    ) {
        assert_eq!(slots.len(), observers.len(), "one observer per slot");
        let Some(first) = slots.first() else { return };
        let n_heads = first.borrow().env.spec().actions.heads.len();
        self.n_heads = n_heads;
        self.choices.resize(slots.len() * n_heads, 0);
        if let Decider::Policy { policy, .. } = decider {
            self.think(policy, slots);
        }
        let rows = slots.iter_mut().map(S::borrow_mut).zip(observers).enumerate();
        for (row, (slot, observer)) in rows {
            let choices = &mut self.choices[row * n_heads..][..n_heads];
            let mask = slot.env.mask();
            let (log_prob, value, logits, hidden);
            match decider {
                Decider::Policy { policy, distribution, choice } => {
                    // Before the recurrent state moves on: that is what the heads saw.
                    hidden = if observer.wants_hidden(slot) {
                        self.hidden.resize(policy.hidden_dim(), 0.0);
                        policy.hidden(&slot.observation, &slot.recurrent, &mut self.hidden);
                        Some(self.hidden.as_slice())
                    } else {
                        None
                    };
                    let state = slot.recurrent.len();
                    slot.recurrent.copy_from_slice(&self.recurrent[row * state..][..state]);
                    let width = distribution.n_choices();
                    logits = &self.logits[row * width..][..width];
                    log_prob = match choice {
                        Choice::Sample => {
                            distribution.sample(logits, mask, &mut slot.draws, choices)
                        }
                        Choice::Greedy => distribution.greedy(logits, mask, choices),
                    };
                    value = self.values[row];
                }
                Decider::Script(name) => {
                    hidden = observer.wants_hidden(slot).then_some(&[][..]);
                    let known = slot.env.baseline_action(name, choices);
                    debug_assert!(known, "`Player::check` comes first");
                    (log_prob, value, logits) = (0.0, 0.0, &[][..]);
                }
                Decider::Scripted(script) => {
                    hidden = observer.wants_hidden(slot).then_some(&[][..]);
                    script.choose(slot, choices);
                    (log_prob, value, logits) = (0.0, 0.0, &[][..]);
                }
            }
            observer
                .on_decision(slot, &Decision { mask, choices, log_prob, value, logits, hidden });
        }
    }

    /// Takes a step in every slot, with the actions that [`Lockstep::act`] chose in the same slots.
    ///
    /// # Panics
    ///
    /// If [`Lockstep::act`] was not called with as many slots.
    pub fn advance<S: BorrowMut<EnvSlot>, O: Observer>(
        &mut self,
        slots: &mut [S],
        observers: &mut [O],
    ) {
        self.ended.clear();
        let (choices, n_heads) = (&self.choices, self.n_heads);
        let action = |row: usize| &choices[row * n_heads..][..n_heads];
        for (row, slot) in slots.iter_mut().map(S::borrow_mut).enumerate() {
            slot.env.announce(action(row));
        }
        let rows = slots.iter_mut().map(S::borrow_mut).zip(observers).enumerate();
        for (row, (slot, observer)) in rows {
            let outcome = slot.step(action(row));
            observer.on_step(slot, outcome);
            self.ended.extend(outcome.end.map(|end| (row, end)));
        }
    }

    /// Lists the slots whose episodes ended in the last step, in order.
    pub fn ended(&self) -> &[(usize, End)] {
        &self.ended
    }

    /// Values what the slots show now, without moving their recurrent states on. Shape of the result `[N]`.
    pub fn values<S: BorrowMut<EnvSlot>>(&mut self, policy: &mut Policy, slots: &[S]) -> &[f32] {
        self.value_rows(policy, slots.iter().map(S::borrow))
    }

    /// Values the final observations of the slots whose episodes a time limit ended in the last step.
    pub fn final_values<S: BorrowMut<EnvSlot>>(
        &mut self,
        policy: &mut Policy,
        slots: &[S],
    ) -> impl Iterator<Item = (usize, f32)> {
        let ended = std::mem::take(&mut self.ended);
        let truncated = || ended.iter().filter(|(_, end)| *end == End::Truncated);
        self.value_rows(policy, truncated().map(|(row, _)| slots[*row].borrow()));
        self.ended = ended;
        let truncated = self.ended.iter().filter(|(_, end)| *end == End::Truncated);
        truncated.map(|(row, _)| *row).zip(self.values.iter().copied())
    }

    fn value_rows<'s>(
        &mut self,
        policy: &mut Policy,
        slots: impl Iterator<Item = &'s EnvSlot>,
    ) -> &[f32] {
        let n = self.gather(slots);
        self.values.resize(n, 0.0);
        policy.values_only(&self.observations, &self.recurrent, &mut self.values);
        &self.values
    }

    /// Computes logits and values of every slot, and the recurrent states after the step.
    fn think<S: BorrowMut<EnvSlot>>(&mut self, policy: &mut Policy, slots: &[S]) {
        let n = self.gather(slots.iter().map(S::borrow));
        self.logits.resize(n * policy.n_choices(), 0.0);
        self.values.resize(n, 0.0);
        let Self { observations, recurrent, logits, values, .. } = self;
        policy.evaluate(observations, recurrent, logits, values);
    }

    /// Fills the inputs of an inference and returns the number of rows.
    fn gather<'s>(&mut self, slots: impl Iterator<Item = &'s EnvSlot>) -> usize {
        self.observations.clear();
        self.recurrent.clear();
        let mut n = 0;
        for slot in slots {
            self.observations.extend_from_slice(&slot.observation);
            self.recurrent.extend_from_slice(&slot.recurrent);
            n += 1;
        }
        n
    }
}
