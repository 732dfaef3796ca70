//! Settings as they are read, and what is said about one that cannot be: its key, what was given, what is allowed.

use std::borrow::Cow;
use std::fmt;
use std::ops::RangeInclusive;

use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize as _, Deserializer, Serialize};
use serde_json::{Map, Value};
use thiserror::Error;

/// A setting that is well formed but impossible.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{key}` is {given}; allowed: {allowed}")]
pub struct SettingError {
    /// The key, as a person writes it: `human.reaction_delay`.
    pub key: &'static str,
    /// What was given, as text.
    pub given: String,
    /// The values that are possible, with their unit.
    pub allowed: Cow<'static, str>,
}

/// Returns an error about `key` unless the condition holds.
///
/// # Errors
///
/// [`SettingError`] if `holds` is false, with the value as given.
pub fn require(
    holds: bool,
    key: &'static str,
    given: impl fmt::Display,
    allowed: impl Into<Cow<'static, str>>,
) -> Result<(), SettingError> {
    let error = || SettingError { key, given: given.to_string(), allowed: allowed.into() };
    holds.then_some(()).ok_or_else(error)
}

/// Returns an error about `key` unless the value lies in the range, which is named with its unit; a NaN lies in none.
///
/// # Errors
///
/// [`SettingError`] if the value is outside of the range, with the value as given.
pub fn require_within<T: PartialOrd + fmt::Display>(
    key: &'static str,
    given: T,
    range: RangeInclusive<T>,
    unit: &str,
) -> Result<(), SettingError> {
    let allowed = format!("{} to {} {unit}", range.start(), range.end());
    require(range.contains(&given), key, given, allowed.trim_end().to_owned())
}

/// Reads a table whose missing entries are those of `defaults` (a domain's own), and not those of its type.
///
/// # Errors
///
/// The deserializer's, if a key is unknown or has a value of the wrong type.
pub fn read_over<'de, T, D>(defaults: &T, given: D) -> Result<T, D::Error>
where
    T: Serialize + DeserializeOwned,
    D: Deserializer<'de>,
{
    let given = Map::<String, Value>::deserialize(given)?;
    let mut all = serde_json::to_value(defaults).map_err(D::Error::custom)?;
    if let Value::Object(all) = &mut all {
        all.extend(given);
    }
    serde_json::from_value(all).map_err(D::Error::custom)
}
