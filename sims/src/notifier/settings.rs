//! What can be chosen about a notifier.

use serde::{Deserialize, Serialize};

use super::cells::{CellTable, SayableCell};
use crate::check::{SettingError, require};
use crate::human::machine::MAX_WORDS;

/// Which parts of a message the policy chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NotificationType {
    /// The topic alone; k and l are the shortest allowed.
    TopicOnly,
    /// Topic and length; the message is understood with its last word, k = l.
    CompleteUtterance,
    /// Topic, comprehension time and length, k <= l.
    IncrementallyActionable,
}

/// Settings of the notifier.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NotifierSettings {
    /// Which parts of a message the policy chooses. Default `incrementally_actionable`.
    pub notification: NotificationType,
    /// The allowed values of k and of l, in words, increasing. Default 2, 3, 4, 5.
    pub words: Vec<u32>,
    /// The topics that may be spoken of, by name, in this order. Default: all of the domain's.
    pub topics: Option<Vec<String>>,
    /// The k and l that can be said on each topic; another choice becomes the nearest of its topic ([`CellTable`]).
    /// Default: all.
    pub cells: Option<Vec<SayableCell>>,
    /// How many (observation, action) pairs the policy sees (1..=64). Default 4.
    pub history: usize,
    /// Whether the policy sees how much of its own utterance is spoken, and on what topic. Default true.
    pub observe_utterance: bool,
    /// Cost of a started message, in reward (at least 0). Default 1; more makes the notifier quieter.
    pub initiation_cost: f64,
}

impl Default for NotifierSettings {
    fn default() -> Self {
        Self {
            notification: NotificationType::IncrementallyActionable,
            words: vec![2, 3, 4, 5],
            topics: None,
            cells: None,
            history: 4,
            observe_utterance: true,
            initiation_cost: 1.0,
        }
    }
}

impl NotifierSettings {
    /// Checks ranges, and the topics against those of the domain.
    ///
    /// # Errors
    ///
    /// [`SettingError`] naming the first impossible setting.
    pub fn check(&self, known_topics: &[&str]) -> Result<(), SettingError> {
        let increasing = self.words.is_sorted_by(|a, b| a < b);
        let in_range = self.words.iter().all(|words| (1..=MAX_WORDS).contains(words));
        let fits = !self.words.is_empty() && increasing && in_range;
        let given = format_args!("{:?}", self.words);
        require(
            fits,
            "notifier.words",
            given,
            "increasing numbers of words, 1 to 1000, at least one",
        )?;
        let fits = (1..=64).contains(&self.history);
        require(fits, "notifier.history", self.history, "1 to 64 pairs")?;
        let cost = self.initiation_cost;
        require((0.0..=1e6).contains(&cost), "notifier.initiation_cost", cost, "0 to 1000000")?;
        self.said(known_topics).map(drop)
    }

    /// Returns which k and l can be said, if not all.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if the table is impossible, or lacks a topic that may be spoken of.
    pub fn said(&self, known: &[&str]) -> Result<Option<CellTable>, SettingError> {
        let spoken = self.topic_ids(known)?;
        self.cells.as_ref().map(|cells| CellTable::new(cells, known, &spoken)).transpose()
    }

    /// Returns the domain's ids of the topics that may be spoken of.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if the list is empty, names one twice, or one that the domain does not know.
    pub fn topic_ids(&self, known: &[&str]) -> Result<Vec<usize>, SettingError> {
        let error = |given: String| SettingError {
            key: "notifier.topics",
            given,
            allowed: format!("at least one of {}, none twice", known.join(", ")).into(),
        };
        let Some(names) = &self.topics else {
            let all: Vec<usize> = (0..known.len()).collect();
            return if all.is_empty() { Err(error("[]".to_owned())) } else { Ok(all) };
        };
        let mut ids = Vec::with_capacity(names.len());
        for name in names {
            let id = known.iter().position(|topic| topic == name);
            match id.filter(|id| !ids.contains(id)) {
                Some(id) => ids.push(id),
                None => return Err(error(format!("{names:?}"))),
            }
        }
        if ids.is_empty() { Err(error("[]".to_owned())) } else { Ok(ids) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOPICS: &[&str] = &["up", "down"];

    fn refused(change: impl FnOnce(&mut NotifierSettings)) -> String {
        let mut settings = NotifierSettings::default();
        change(&mut settings);
        settings.check(TOPICS).unwrap_err().to_string()
    }

    #[test]
    fn impossible_settings_are_named() {
        let words = "allowed: increasing numbers of words, 1 to 1000, at least one";
        assert_eq!(refused(|s| s.words = vec![]), format!("`notifier.words` is []; {words}"));
        assert_eq!(
            refused(|s| s.words = vec![3, 2]),
            format!("`notifier.words` is [3, 2]; {words}")
        );
        assert_eq!(
            refused(|s| s.words = vec![0, 2]),
            format!("`notifier.words` is [0, 2]; {words}")
        );
        let topics = "allowed: at least one of up, down, none twice";
        assert_eq!(
            refused(|s| s.topics = Some(vec![])),
            format!("`notifier.topics` is []; {topics}")
        );
        let given = refused(|s| s.topics = Some(vec!["left".to_owned()]));
        assert_eq!(given, format!("`notifier.topics` is [\"left\"]; {topics}"));
        let given = refused(|s| s.topics = Some(vec!["up".to_owned(), "up".to_owned()]));
        assert!(given.contains(topics), "{given}");
        assert!(refused(|s| s.history = 0).contains("notifier.history"));
        assert!(refused(|s| s.initiation_cost = f64::NAN).contains("notifier.initiation_cost"));
        assert!(refused(|s| s.initiation_cost = 1e38).contains("allowed: 0 to 1000000"));
        NotifierSettings::default().check(TOPICS).unwrap();
    }

    #[test]
    fn topics_can_be_picked_and_reordered() {
        let topics = Some(vec!["down".to_owned(), "up".to_owned()]);
        let settings = NotifierSettings { topics, ..NotifierSettings::default() };
        assert_eq!(settings.topic_ids(TOPICS).unwrap(), [1, 0]);
    }
}
