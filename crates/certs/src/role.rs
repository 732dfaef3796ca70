//! What a process is allowed to be.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// What a process does in a run; its certificate's subject has it as organisational unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Passes on what others send.
    Router,
    /// Owns runs and trains their policies.
    Learner,
    /// Steps environments and sends rollouts.
    Actor,
    /// Reads presence, metrics and weights.
    Observer,
    /// An observer that may also read rollouts.
    Recorder,
    /// A notifier at work.
    Service,
    /// Takes notifications for a machine.
    Robot,
}

impl Role {
    /// Every role, in the order of the variants.
    pub const ALL: [Self; 7] = [
        Self::Router,
        Self::Learner,
        Self::Actor,
        Self::Observer,
        Self::Recorder,
        Self::Service,
        Self::Robot,
    ];

    /// Returns the role's name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Router => "router",
            Self::Learner => "learner",
            Self::Actor => "actor",
            Self::Observer => "observer",
            Self::Recorder => "recorder",
            Self::Service => "service",
            Self::Robot => "robot",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Role {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let found = Self::ALL.into_iter().find(|role| role.as_str() == text);
        found.ok_or_else(|| Error::Role(text.chars().take(80).collect()))
    }
}
