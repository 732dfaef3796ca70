//! Which messages state a reason: what `I_why` of a message is.
//!
//! Whether a message says why is a fact about the sentence that is spoken. A world does not know sentences, so a task
//! is given the share of each cell's sentences that state a reason; they take turns, and the share is what a message of
//! that cell says on average.

use super::settings::MAX_WORDS;
use crate::Message;
use crate::check::SettingError;

/// A topic's name, k and l, and the share of its sentences that state a reason: `["ascend", 2, 4, 0.5]`.
pub type StatedReason = (String, u32, u32, f64);

/// The shares of all cells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReasonTable {
    /// By topic id: k, l and the share. Cells that are not listed state no reason.
    by_topic: Vec<Vec<(u32, u32, f64)>>,
}

impl ReasonTable {
    /// Sorts a table by the topics of a domain.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if a topic is not known, a k or l impossible, a share not above 0 and at most 1, or a cell there
    /// twice.
    pub(crate) fn new(reasons: &[StatedReason], known: &[&str]) -> Result<Self, SettingError> {
        let mut by_topic = vec![Vec::new(); known.len()];
        for (name, k, l, share) in reasons {
            let possible = 1 <= *k && k <= l && *l <= MAX_WORDS && *share > 0.0 && *share <= 1.0;
            let topic = known.iter().position(|topic| topic == name);
            match topic.map(|id| &mut by_topic[id]).filter(|_| possible) {
                Some(cells) if !cells.iter().any(|&(a, b, _)| (a, b) == (*k, *l)) => {
                    cells.push((*k, *l, *share));
                }
                _ => {
                    let topics = known.join(", ");
                    let given = format!("a table with [\"{name}\", {k}, {l}, {share}]");
                    let allowed = format!(
                        "[topic, k, l, share] with 1 <= k <= l <= {MAX_WORDS} and 0 < share <= 1, each cell once; \
                         topics: {topics}"
                    );
                    return Err(SettingError {
                        key: "notifier.reasons",
                        given,
                        allowed: allowed.into(),
                    });
                }
            }
        }
        Ok(Self { by_topic })
    }

    /// Returns `I_why` of a message: the share of the sentences of its cell that state a reason.
    pub(crate) fn share(&self, message: Message) -> f64 {
        let cell = (message.comprehension, message.conveyance);
        let mut cells = self.by_topic.get(message.topic).into_iter().flatten();
        cells.find(|&&(k, l, _)| (k, l) == cell).map_or(0.0, |&(.., share)| share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOPICS: &[&str] = &["up", "down"];

    fn table(list: &[(&str, u32, u32, f64)]) -> Result<ReasonTable, String> {
        let owned = |&(topic, k, l, share): &(&str, u32, u32, f64)| (topic.to_owned(), k, l, share);
        let list: Vec<StatedReason> = list.iter().map(owned).collect();
        ReasonTable::new(&list, TOPICS).map_err(|error| error.to_string())
    }

    #[test]
    fn a_cell_states_reasons_as_often_as_its_sentences_do() {
        let table = table(&[("down", 2, 4, 0.5), ("down", 4, 4, 1.0)]).unwrap();
        let share = |topic, comprehension, conveyance| {
            table.share(Message { topic, comprehension, conveyance })
        };
        assert_eq!(
            [share(1, 2, 4), share(1, 4, 4), share(1, 2, 5), share(0, 2, 4)],
            [0.5, 1., 0., 0.]
        );
        assert_eq!(ReasonTable::default(), ReasonTable { by_topic: Vec::new() });
    }

    #[test]
    fn impossible_tables_are_named() {
        for bad in [("left", 2, 2, 0.5), ("up", 3, 2, 0.5), ("up", 2, 3, 0.0), ("up", 2, 3, 1.5)] {
            let text = table(&[("up", 2, 2, 0.5), bad]).unwrap_err();
            let (topic, k, l, share) = bad;
            let given = format!(
                "`notifier.reasons` is a table with [\"{topic}\", {k}, {l}, {share}]; allowed: "
            );
            assert!(text.starts_with(&given), "{text}");
        }
        table(&[("up", 2, 2, 0.5), ("up", 2, 2, 1.0)]).unwrap_err();
        table(&[("up", 2, 2, f64::NAN)]).unwrap_err();
    }
}
