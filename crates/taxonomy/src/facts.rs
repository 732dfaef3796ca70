//! What a sentence presupposes: named facts of the world, and which of them hold.
//!
//! "Zone below, go up." is false where no zone is below. A sentence therefore names what must be so (`zone_below`), and
//! is said only while the world, or a client that sees it, states that it holds. A fact that is not stated does not
//! hold.

/// The most facts that the sentences of a database may name.
pub const MAX_FACTS: usize = u64::BITS as usize;

/// Some of a database's facts, by their places in [`Taxonomy::facts`](crate::Taxonomy::facts).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FactSet(u64);

impl FactSet {
    /// No fact: what a sentence presupposes that is always true.
    pub const NONE: Self = Self(0);
    /// Every fact: what holds where sentences are not compared with the world.
    pub const ALL: Self = Self(u64::MAX);

    /// Adds the fact at a place; one beyond [`MAX_FACTS`] is no fact.
    #[must_use]
    pub fn with(self, place: usize) -> Self {
        if place < MAX_FACTS { Self(self.0 | 1 << place) } else { self }
    }

    /// Returns whether all of the presupposed facts are in it.
    pub fn includes(self, presupposed: Self) -> bool {
        presupposed.0 & !self.0 == 0
    }

    /// Lists the places of its facts.
    pub fn places(self) -> impl Iterator<Item = usize> {
        (0..MAX_FACTS).filter(move |place| self.0 >> place & 1 == 1)
    }
}

/// Returns whether a text can be the name of a fact: lower-case letters, digits and `_`.
pub(crate) fn is_name(text: &str) -> bool {
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    !text.is_empty() && text.chars().all(allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_includes_what_is_in_it() {
        let some = FactSet::NONE.with(0).with(5).with(63);
        assert_eq!(some.places().collect::<Vec<_>>(), [0, 5, 63]);
        assert!(some.includes(FactSet::NONE) && some.includes(FactSet::NONE.with(5)));
        assert!(!some.includes(FactSet::NONE.with(5).with(6)));
        assert!(FactSet::ALL.includes(some) && !FactSet::NONE.includes(some));
        assert_eq!(some.with(MAX_FACTS), some);
    }

    #[test]
    fn a_name_is_written_like_a_topic() {
        assert!(is_name("zone_below") && is_name("car2"));
        assert!(!is_name("") && !is_name("zone below") && !is_name("Zone"));
    }
}
