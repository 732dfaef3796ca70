//! Identifiers: small types so that one number cannot stand in for another.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

macro_rules! counter {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(
            Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
        )]
        pub struct $name(pub $inner);

        impl $name {
            /// Returns the number after this one.
            pub fn next(self) -> Self {
                Self(self.0 + 1)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

counter! {
    /// Names one environment of a run, `0..n_envs`; its random streams derive from it.
    EnvId(u32)
}
counter! {
    /// Counts updates: the policy after `n` updates has version `n`.
    PolicyVersion(u64)
}
counter! {
    /// Counts the rollouts of one environment, from 0; update `i` of a deterministic schedule trains on
    /// iteration `i` of every environment.
    Iteration(u64)
}
counter! {
    /// Counts assignments over the life of a run; a rollout of an older epoch may be superseded.
    Epoch(u64)
}
counter! {
    /// Numbers the rollouts that one incarnation of an actor publishes, from 1; 0 means none yet.
    Sequence(u64)
}
counter! {
    /// Distinguishes one start of a process from the next start under the same id; drawn anew at every start. Those of
    /// learners and actors are digests of a key, so that a message can prove which start it comes from.
    Incarnation(u64)
}

impl Incarnation {
    /// Returns the number as 16 hexadecimal digits, as keys and messages have it.
    ///
    /// # Example
    ///
    /// ```
    /// use leadtime_proto::Incarnation;
    ///
    /// assert_eq!(Incarnation(0xa7).hex(), "00000000000000a7");
    /// assert_eq!(Incarnation::from_hex("00000000000000a7"), Some(Incarnation(0xa7)));
    /// assert_eq!(Incarnation::from_hex("+0000000000000a7"), None);
    /// assert_eq!(Incarnation::from_hex("a7"), None);
    /// ```
    pub fn hex(self) -> String {
        format!("{:016x}", self.0)
    }

    /// Reads 16 hexadecimal digits; `None` of anything else.
    pub fn from_hex(text: &str) -> Option<Self> {
        // A number might have a sign, too.
        let is_digits = text.len() == 16 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        let number = u64::from_str_radix(text, 16).ok().filter(|_| is_digits)?;
        Some(Self(number))
    }
}

/// How many versions a rollout's behaviour policy lies behind the learner's policy that trains on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Staleness(pub u64);

impl Staleness {
    /// Computes learner version minus behaviour version, 0 if the behaviour is newer.
    pub fn between(learner: PolicyVersion, behavior: PolicyVersion) -> Self {
        Self(learner.0.saturating_sub(behavior.0))
    }
}

/// Why a text cannot be an identifier.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "`{text}` is not a valid {kind}: use 1 to {max_len} of a-z, 0-9 and `-`, starting with a letter or digit"
)]
pub struct InvalidId {
    /// The text as given (at most its first 80 characters).
    pub text: String,
    /// What it was to name.
    pub kind: &'static str,
    /// The longest text that would do.
    pub max_len: usize,
}

/// Checks a text of at most `max_len` letters, digits and `marks`, none of these in front.
fn checked(
    text: String,
    kind: &'static str,
    max_len: usize,
    marks: &[char],
) -> Result<String, InvalidId> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || marks.contains(&c);
    let fits = (1..=max_len).contains(&text.len());
    if fits && text.chars().all(plain) && !text.starts_with(marks) {
        return Ok(text);
    }
    Err(InvalidId { text: text.chars().take(80).collect(), kind, max_len })
}

macro_rules! slug {
    ($(#[$doc:meta])* $name:ident, $kind:literal, $max_len:literal, $marks:expr) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(try_from = "String")]
        pub struct $name(String);

        impl $name {
            /// Checks a text and makes it an identifier.
            ///
            /// # Errors
            ///
            /// [`InvalidId`] unless the text is a short slug, so that it can be part of a key and a path.
            pub fn new(text: impl Into<String>) -> Result<Self, InvalidId> {
                checked(text.into(), $kind, $max_len, $marks).map(Self)
            }

            /// Returns the text, which has passed the check of [`Self::new`].
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl TryFrom<String> for $name {
            type Error = InvalidId;
            fn try_from(text: String) -> Result<Self, InvalidId> {
                Self::new(text)
            }
        }

        impl std::str::FromStr for $name {
            type Err = InvalidId;
            fn from_str(text: &str) -> Result<Self, InvalidId> {
                Self::new(text)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }
    };
}

slug! {
    /// Names an actor: started again under this name it is the same actor.
    ActorId, "actor id", 48, &['-']
}
slug! {
    /// Names a run: part of every key on the network and the run directory's name.
    RunName, "run name", 64, &['-']
}
slug! {
    /// Names a notifier at work: part of every key of its listeners.
    ServiceName, "service name", 48, &['-']
}
slug! {
    /// Names a client of a notifier at work: a robot, a car, a simulator.
    ClientName, "client name", 48, &['-']
}
slug! {
    /// Names a domain (`lander`, `cue_recall`, one of the user's own) where it is part of a key or a file name: `_` is
    /// possible, too.
    DomainName, "domain name", 48, &['-', '_']
}
slug! {
    /// Names a region: the actors that one relay of weights serves.
    RegionName, "region name", 48, &['-']
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_could_break_a_key_or_a_path_is_refused() {
        for text in ["", "-a", "a/b", "a*", "A", "..", "a b", "a_b", &"x".repeat(65)] {
            assert!(RunName::new(text).is_err(), "{text}");
        }
        assert_eq!(RunName::new("lander-20260101").unwrap().as_str(), "lander-20260101");
        assert_eq!(DomainName::new("cue_recall").unwrap().as_str(), "cue_recall");
        for text in ["", "_a", "a/b", "*", "A"] {
            assert!(DomainName::new(text).is_err(), "{text}");
        }
    }

    #[test]
    fn staleness_never_goes_below_zero() {
        assert_eq!(Staleness::between(PolicyVersion(3), PolicyVersion(5)), Staleness(0));
        assert_eq!(Staleness::between(PolicyVersion(5), PolicyVersion(3)), Staleness(2));
    }
}
