//! What can be chosen about a notifier.

use serde::{Deserialize, Serialize};

use super::cells::SayableCell;
use crate::check::{SettingError, require, require_within};
use crate::human::MAX_WORDS;
use crate::human::StatedReason;

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
    /// The greatest k that may be chosen, `k_max`, in words (at least the first of `words`); where k = l, it bounds l too.
    /// Default: none.
    pub k_max: Option<u32>,
    /// The topics that may be spoken of, by name, in this order. Default: all of the domain's.
    pub topics: Option<Vec<String>>,
    /// The k and l that can be said on each topic; another choice becomes the nearest of its topic
    /// ([`CellTable`](super::CellTable)). Those with a k above `k_max` are left out.
    /// Default: all.
    pub cells: Option<Vec<SayableCell>>,
    /// How often what is said on a topic with k and l states a reason; left out cells never do. Default: none does.
    pub reasons: Option<Vec<StatedReason>>,
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
            k_max: None,
            topics: None,
            cells: None,
            reasons: None,
            history: 4,
            observe_utterance: true,
            initiation_cost: 1.0,
        }
    }
}

impl NotifierSettings {
    /// Checks ranges; the error names the first impossible setting.
    pub(super) fn check(&self) -> Result<(), SettingError> {
        let increasing = self.words.is_sorted_by(|a, b| a < b);
        let in_range = self.words.iter().all(|words| (1..=MAX_WORDS).contains(words));
        let fits = !self.words.is_empty() && increasing && in_range;
        let allowed = "increasing numbers of words, 1 to 1000, at least one";
        require(fits, "notifier.words", format_args!("{:?}", self.words), allowed)?;
        if let (Some(k_max), Some(&shortest)) = (self.k_max, self.words.first()) {
            let allowed = format!("at least {shortest}, the fewest of `notifier.words`");
            require(k_max >= shortest, "notifier.k_max", k_max, allowed)?;
        }
        require_within("notifier.history", self.history, 1..=64, "pairs")?;
        require_within("notifier.initiation_cost", self.initiation_cost, 0.0..=1e6, "")
    }

    /// Returns the domain's ids of the topics that may be spoken of.
    ///
    /// The error says that the list is empty, names one twice, or one that the domain does not know.
    pub(super) fn topic_ids(&self, known: &[&str]) -> Result<Vec<usize>, SettingError> {
        let all = || known.iter().map(|&name| name.to_owned()).collect();
        let names = self.topics.clone().unwrap_or_else(all);
        let mut ids = Vec::with_capacity(names.len());
        for name in &names {
            let id = known.iter().position(|topic| topic == name);
            ids.extend(id.filter(|id| !ids.contains(id)));
        }
        let fits = !ids.is_empty() && ids.len() == names.len();
        let allowed = format!("at least one of {}, none twice", known.join(", "));
        require(fits, "notifier.topics", format_args!("{names:?}"), allowed)?;
        Ok(ids)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOPICS: &[&str] = &["up", "down"];

    fn refused(change: impl FnOnce(&mut NotifierSettings)) -> String {
        let mut settings = NotifierSettings::default();
        change(&mut settings);
        settings.check().unwrap_err().to_string()
    }

    fn topic_ids(names: &[&str]) -> Result<Vec<usize>, String> {
        let topics = Some(names.iter().map(|&name| name.to_owned()).collect());
        let settings = NotifierSettings { topics, ..NotifierSettings::default() };
        settings.topic_ids(TOPICS).map_err(|error| error.to_string())
    }

    #[test]
    fn impossible_settings_are_named() {
        let allowed = "allowed: increasing numbers of words, 1 to 1000, at least one";
        for words in [vec![], vec![3, 2], vec![0, 2]] {
            let text = format!("`notifier.words` is {words:?}; {allowed}");
            assert_eq!(refused(|s| s.words = words), text);
        }
        assert!(
            refused(|s| s.history = 0).contains("`notifier.history` is 0; allowed: 1 to 64 pairs")
        );
        let text = "`notifier.k_max` is 1; allowed: at least 2, the fewest of `notifier.words`";
        assert_eq!(refused(|s| s.k_max = Some(1)), text);
        assert!(refused(|s| s.initiation_cost = f64::NAN).contains("notifier.initiation_cost"));
        assert!(refused(|s| s.initiation_cost = 1e38).ends_with("; allowed: 0 to 1000000"));
        NotifierSettings::default().check().unwrap();
    }

    #[test]
    fn topics_can_be_picked_and_reordered_but_not_invented() {
        assert_eq!(topic_ids(&["down", "up"]), Ok(vec![1, 0]));
        let allowed = "allowed: at least one of up, down, none twice";
        for names in [&[][..], &["left"], &["up", "up"]] {
            let text = format!("`notifier.topics` is {names:?}; {allowed}");
            assert_eq!(topic_ids(names), Err(text));
        }
    }
}
