//! What is said about a setting that cannot be: its key, what was given, what is allowed.

use std::borrow::Cow;
use std::fmt;

use thiserror::Error;

/// A setting that is well formed but impossible.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{key}` is {given}; allowed: {allowed}")]
pub struct SettingError {
    /// The key, as a person writes it: `human.reaction_delay`.
    pub key: &'static str,
    /// What was given.
    pub given: String,
    /// What would do.
    pub allowed: Cow<'static, str>,
}

/// Returns an error about `key` unless the condition holds.
///
/// # Errors
///
/// [`SettingError`] with the value as given.
pub fn require(
    holds: bool,
    key: &'static str,
    given: impl fmt::Display,
    allowed: impl Into<Cow<'static, str>>,
) -> Result<(), SettingError> {
    if holds {
        Ok(())
    } else {
        Err(SettingError { key, given: given.to_string(), allowed: allowed.into() })
    }
}
