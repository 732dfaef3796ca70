//! Which k and l can be said on which topic: where sentences are missing, a choice becomes the nearest that there is.
//!
//! A notifier that learns with cells which nobody can fill learns timings that nobody will hear. With a table of those
//! that a database fills, it hears of each choice what a listener would: another k or l, and never another topic.

use crate::Message;
use crate::check::SettingError;
use crate::human::MAX_WORDS;

/// A topic's name, k and l, as a person writes them: `["ascend", 2, 4]`.
pub type SayableCell = (String, u32, u32);

/// What a word costs, in sixths of the dearest: understood later, understood earlier, another length.
const LATE: u32 = 6;
const EARLY: u32 = 2;
const LENGTH: u32 = 1;

/// The k and l that can be said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellTable {
    /// By topic id, in rising order.
    by_topic: Vec<Vec<(u32, u32)>>,
}

impl CellTable {
    /// Sorts a table by the topics of a domain.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if a topic is not known, a k or l impossible, or one of the `spoken` topics has no cell.
    pub fn new(
        cells: &[SayableCell],
        known: &[&str],
        spoken: &[usize],
    ) -> Result<Self, SettingError> {
        Self::up_to(None, cells, known, spoken)
    }

    /// Does as [`CellTable::new`], and leaves out what is understood after more than `k_max` words.
    pub(super) fn up_to(
        k_max: Option<u32>,
        cells: &[SayableCell],
        known: &[&str],
        spoken: &[usize],
    ) -> Result<Self, SettingError> {
        let topics = known.join(", ");
        let allowed = format!(
            "[topic, k, l] with 1 <= k <= l <= {MAX_WORDS}, at least one for each topic that may be spoken of; \
             topics: {topics}"
        );
        let error = |given| SettingError { key: "notifier.cells", given, allowed: allowed.into() };
        let mut by_topic = vec![Vec::new(); known.len()];
        for (name, k, l) in cells {
            let fits = 1 <= *k && k <= l && *l <= MAX_WORDS;
            match known.iter().position(|topic| topic == name).filter(|_| fits) {
                // Here and not in `nearest`, which would turn a k that is allowed into a greater one.
                Some(id) if k_max.is_none_or(|most| *k <= most) => by_topic[id].push((*k, *l)),
                Some(_) => {}
                None => return Err(error(format!("a table with [\"{name}\", {k}, {l}]"))),
            }
        }
        if let Some(&id) = spoken.iter().find(|&&id| by_topic[id].is_empty()) {
            let bound = k_max.map_or_else(String::new, |most| format!(" with k up to {most}"));
            return Err(error(format!("a table without `{}`{bound}", known[id])));
        }
        for cells in &mut by_topic {
            cells.sort_unstable();
        }
        Ok(Self { by_topic })
    }

    /// Returns the message that is said in place of another: the same topic, and the k and l that lose least; of
    /// equals the smaller k, then the smaller l.
    ///
    /// # Source
    ///
    /// The weights are those by which the program finds a sentence: three for a word by which it is understood
    /// later, one for earlier, a half for another length.
    pub fn nearest(&self, message: Message) -> Message {
        let (asked_k, asked_l) = (message.comprehension, message.conveyance);
        let lost = |&(k, l): &(u32, u32)| {
            let (late, early) = (k.saturating_sub(asked_k), asked_k.saturating_sub(k));
            LATE * late + EARLY * early + LENGTH * l.abs_diff(asked_l)
        };
        // Cells come in rising order, and the first of the least is taken.
        let cells = self.by_topic.get(message.topic).into_iter().flatten();
        let nearest = cells.min_by_key(|cell| lost(cell));
        let (comprehension, conveyance) = nearest.copied().unwrap_or((asked_k, asked_l));
        Message { comprehension, conveyance, ..message }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOPICS: &[&str] = &["up", "down"];

    fn cells(list: &[(&str, u32, u32)]) -> Vec<SayableCell> {
        list.iter().map(|(topic, k, l)| ((*topic).to_owned(), *k, *l)).collect()
    }

    #[test]
    fn an_empty_cell_becomes_the_nearest_of_its_topic() {
        let list = cells(&[("up", 4, 4), ("up", 2, 2), ("up", 3, 5), ("down", 2, 2)]);
        let cells = CellTable::new(&list, TOPICS, &[0, 1]).unwrap();
        let message =
            |topic, comprehension, conveyance| Message { topic, comprehension, conveyance };
        let said = |topic, k, l| cells.nearest(message(topic, k, l));
        assert_eq!(said(0, 3, 5), message(0, 3, 5));
        assert_eq!(said(0, 3, 3), message(0, 3, 5));
        assert_eq!(said(0, 2, 5), message(0, 2, 2));
        assert_eq!(said(0, 5, 5), message(0, 4, 4));
        assert_eq!(said(1, 5, 5), message(1, 2, 2));
    }

    #[test]
    fn impossible_tables_are_named() {
        let refused = |list: &[(&str, u32, u32)]| {
            CellTable::new(&cells(list), TOPICS, &[0, 1]).unwrap_err().to_string()
        };
        let text = refused(&[("up", 2, 2)]);
        assert!(text.starts_with("`notifier.cells` is a table without `down`; allowed:"), "{text}");
        for (topic, k, l) in [("left", 2, 2), ("up", 3, 2), ("up", 0, 2), ("up", 2, 1001)] {
            let text = refused(&[("up", 2, 2), ("down", 2, 2), (topic, k, l)]);
            let given = format!("is a table with [\"{topic}\", {k}, {l}]; allowed");
            assert!(text.contains(&given), "{text}");
        }
        CellTable::new(&cells(&[("up", 2, 2)]), TOPICS, &[0]).unwrap();
    }
}
