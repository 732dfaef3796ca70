//! What a world can say of itself, so that what is said to the listener is true.

use serde::Serialize;

/// Something that is true of a world at some moments and not at others: `zone_below`.
///
/// Sentences name the facts that they presuppose, and are said only while those hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Fact {
    /// Its name, as sentences spell it: lower-case letters, digits and `_`.
    pub name: &'static str,
    /// When it holds, in words that a person in the listener's place would agree to; with its thresholds.
    pub meaning: &'static str,
}
