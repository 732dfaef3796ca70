//! Why a configuration is refused.

use std::fmt::Display;

use thiserror::Error;

/// Why a configuration is refused: where it was written, the key, the value and what is allowed.
///
/// Nobody decides anything by its kind, so it is the message alone.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct ConfigError(pub(crate) String);

impl ConfigError {
    /// Makes an error of another one's message.
    pub(crate) fn of(message: impl Display) -> Self {
        Self(message.to_string())
    }

    /// Names the place of an error: a file, an option, a section.
    pub(crate) fn at(self, place: impl Display) -> Self {
        Self(format!("{place}: {self}"))
    }
}

/// Refuses a value unless `holds`.
pub(crate) fn ensure(
    holds: bool,
    key: &str,
    value: impl Display,
    allowed: impl Display,
) -> Result<(), ConfigError> {
    let refused = || ConfigError(format!("`{key}` is {value}; allowed: {allowed}"));
    if holds { Ok(()) } else { Err(refused()) }
}

/// Refuses a value below `low` or above `high`, and what is not a number.
pub(crate) fn within<T: Copy + PartialOrd + Display>(
    key: &str,
    value: T,
    low: T,
    high: T,
) -> Result<(), ConfigError> {
    ensure(low <= value && value <= high, key, value, format_args!("{low} to {high}"))
}
