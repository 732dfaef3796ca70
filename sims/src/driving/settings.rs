//! Everything about a driving run: the world, and what differs for its listener and notifier.

use serde::{Deserialize, Deserializer, Serialize};

use super::world_settings::WorldSettings;
use crate::human::{FollowThrough, HumanSettings};
use crate::notifier::NotifierSettings;
use crate::setting::read_over;

/// Everything about a driving run.
///
/// What is not given of the listener and the notifier is as for driving: follow-through 2 l - 2, and an initiation
/// cost of 0.3.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DrivingSettings {
    /// The road and the cars on it.
    pub world: WorldSettings,
    /// The person at the wheel as a listener.
    #[serde(deserialize_with = "over_human")]
    pub human: HumanSettings,
    /// The notifier.
    #[serde(deserialize_with = "over_notifier")]
    pub notifier: NotifierSettings,
}

impl Default for DrivingSettings {
    fn default() -> Self {
        Self { world: WorldSettings::default(), human: human(), notifier: notifier() }
    }
}

impl DrivingSettings {
    /// Returns the settings under which a policy is measured: arriving ends the episode, so that what is counted per
    /// step is counted while driving.
    pub fn for_evaluation(mut self) -> Self {
        self.world.absorb_until = 0;
        self
    }
}

fn human() -> HumanSettings {
    let follow_through = FollowThrough::TwiceLengthMinusTwo;
    HumanSettings { follow_through, ..HumanSettings::default() }
}

fn notifier() -> NotifierSettings {
    NotifierSettings { initiation_cost: 0.3, ..NotifierSettings::default() }
}

fn over_human<'de, D: Deserializer<'de>>(given: D) -> Result<HumanSettings, D::Error> {
    read_over(&human(), given)
}

fn over_notifier<'de, D: Deserializer<'de>>(given: D) -> Result<NotifierSettings, D::Error> {
    read_over(&notifier(), given)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::human::{Interrupt, ReactionDelay};

    #[test]
    fn what_is_not_given_is_as_for_driving() {
        let text = r#"{"human": {"interrupt": "finish"}, "notifier": {"history": 2}}"#;
        let settings: DrivingSettings = serde_json::from_str(text).unwrap();
        assert_eq!(settings.human.interrupt, Interrupt::Finish);
        assert_eq!(settings.human.follow_through, FollowThrough::TwiceLengthMinusTwo);
        assert_eq!((settings.notifier.history, settings.notifier.initiation_cost), (2, 0.3));
        assert_eq!(
            serde_json::from_str::<DrivingSettings>("{}").unwrap(),
            DrivingSettings::default()
        );
        let text = r#"{"human": {"reaction_delay": {"uniform": {"low": 1, "high": 3, "drawn": "per_episode"}}}}"#;
        let settings: DrivingSettings = serde_json::from_str(text).unwrap();
        assert!(matches!(settings.human.reaction_delay, ReactionDelay::Uniform { low: 1, .. }));
    }

    #[test]
    fn settings_survive_their_own_text() {
        let mut settings = DrivingSettings::default();
        settings.notifier.topics = Some(vec!["slow_down".to_owned()]);
        settings.world.ego.lane = Some(1);
        let text = serde_json::to_string(&settings).unwrap();
        assert_eq!(serde_json::from_str::<DrivingSettings>(&text).unwrap(), settings);
    }

    #[test]
    fn a_wrong_key_is_named() {
        let refused = |text| serde_json::from_str::<DrivingSettings>(text).unwrap_err().to_string();
        assert!(refused(r#"{"human": {"delay": 2}}"#).contains("unknown field `delay`, expected"));
        assert!(refused(r#"{"world": {"roads": 2}}"#).contains("unknown field `roads`"));
        assert!(
            refused(
                r#"{"world": {"road": {"lanes": [{"from": "a", "to": "b", "start": [0, 0]}]}}}"#
            )
            .contains("missing field `end`")
        );
    }
}
