//! The name of a process: the common name of its certificate, and that of its files.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// The longest name: that of an actor, which is part of keys.
const MAX_LEN: usize = 48;
/// The name of the authority's own files.
const AUTHORITY: &str = "ca";

/// The name of a process in its certificate: 1 to 48 of a-z, 0-9 and `-`, as an actor's id.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PeerName(String);

impl PeerName {
    /// Returns the name as text, as certificates and files have it.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for PeerName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let fits = (1..=MAX_LEN).contains(&text.len()) && text.chars().all(plain);
        if fits && !text.starts_with('-') && text != AUTHORITY {
            return Ok(Self(text.to_owned()));
        }
        Err(Error::Name(text.chars().take(80).collect()))
    }
}

impl fmt::Display for PeerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_a_slug_and_not_the_authoritys() {
        for name in ["a7", "box-1", "0", &"x".repeat(48)] {
            assert_eq!(name.parse::<PeerName>().unwrap().as_str(), name);
        }
        for name in ["", "-a", "A", "a b", "a_b", "../a", "ca", "a.b", &"x".repeat(49)] {
            assert!(name.parse::<PeerName>().is_err(), "{name}");
        }
    }
}
