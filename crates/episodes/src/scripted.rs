//! Scripts that are no part of a task: rules from a file, a planner.

use std::error::Error as StdError;
use std::fmt;

use leadtime_sims::Environment;

use crate::slot::EnvSlot;

/// Decides without a network, and may look at more than an observation.
pub trait Scripted: fmt::Debug + Send + Sync {
    /// Checks that it can play a task.
    ///
    /// # Errors
    ///
    /// What does not fit, if the script needs a number or a message that the task does not have.
    fn check(&self, environment: &dyn Environment) -> Result<(), Box<dyn StdError + Send + Sync>>;

    /// Returns how many numbers it keeps from step to step in [`EnvSlot::memory`]; they begin as 0.
    fn memory_dim(&self) -> usize {
        0
    }

    /// Writes the action of the coming step. It may step the slot's environment, and must restore it. Shape `[n_heads]`.
    fn choose(&mut self, slot: &mut EnvSlot, choices: &mut [u8]);

    /// Makes another one like this, which has not played yet.
    fn copy(&self) -> Box<dyn Scripted>;
}

impl Clone for Box<dyn Scripted> {
    fn clone(&self) -> Self {
        self.copy()
    }
}
