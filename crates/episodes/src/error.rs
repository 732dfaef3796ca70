//! What can go wrong when playing.

use leadtime_sims::TaskError;
use thiserror::Error;

/// Lists the scripted players of a task, as the end of a sentence about one that it does not have.
pub fn known_players(known: &[&str]) -> String {
    if known.is_empty() { "it has none".to_owned() } else { format!("known: {}", known.join(", ")) }
}

/// Why episodes could not be played.
#[derive(Debug, Error)]
pub enum Error {
    /// The environment cannot be made.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The policy cannot be made.
    #[error("the policy cannot be used")]
    Policy(#[from] leadtime_policy::Error),
    /// The policy is for another task.
    #[error(
        "the policy takes {} observations and has {} choices, the task has {} and {}: it was trained for another \
         task or with other settings",
        found[0], found[1], expected[0], expected[1]
    )]
    PolicyShape {
        /// The policy's observation length and number of choices.
        found: [usize; 2],
        /// The task's observation length and number of choices.
        expected: [usize; 2],
    },
    /// The task has no such scripted player.
    #[error("the task has no scripted player `{name}`; {}", known_players(known))]
    UnknownBaseline {
        /// The name that was asked for.
        name: String,
        /// The scripts that the task has.
        known: &'static [&'static str],
    },
    /// A script does not fit the task.
    #[error("`{name}` cannot play this task")]
    Script {
        /// The name of the script.
        name: String,
        /// What does not fit.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// An episode does not come to an end.
    #[error("episode {index} did not end within {n_steps} steps")]
    Endless {
        /// Index of the episode.
        index: u64,
        /// Number of steps after which it was given up.
        n_steps: u64,
    },
    /// What steps an environment outside of this process has failed.
    #[error("episode {index} could not be played: {reason}")]
    Outside {
        /// Index of the episode.
        index: u64,
        /// What the process that steps it reports.
        reason: String,
    },
    /// The caller stopped it ([`crate::PlaySettings::stop`]).
    #[error("the evaluation was interrupted")]
    Interrupted,
    /// A thread cannot be started.
    #[error("a thread for the evaluation cannot be started")]
    Thread(#[source] std::io::Error),
}
