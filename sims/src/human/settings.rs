//! Every choice that bends the model of the listener.
//!
//! `Default` is what serves real use: the values of `configs/notifier.toml`, which is what the built-in worlds start from. With [`FollowThroughEnd::Inclusive`] and [`Interrupt::Replace`] it follows the
//! letter of the source where that speaks, and its most likely reading where it does not.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::{MapAccessDeserializer, MapDeserializer, StrDeserializer};
use serde::de::{self, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::Message;
use crate::check::{SettingError, require, require_within};

/// The most words a message can have.
pub const MAX_WORDS: u32 = 1000;
/// The longest reaction delay, in steps; draws beyond it are cut.
pub(super) const MAX_REACTION_DELAY: u32 = 60;

/// How long after comprehension the reaction starts. Unit: steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ReactionDelay {
    /// The same number of steps for every message.
    Fixed(u32),
    /// Normally distributed, rounded to the nearest integer that is not negative.
    Normal {
        /// Mean, in steps, before rounding.
        mean: f64,
        /// Standard deviation, in steps.
        deviation: f64,
        /// How often it is drawn.
        drawn: DelayDraw,
    },
    /// Uniformly distributed over the integers `low..=high`.
    Uniform {
        /// Smallest delay, in steps.
        low: u32,
        /// Largest delay, in steps.
        high: u32,
        /// How often it is drawn.
        drawn: DelayDraw,
    },
    /// A person: their own mean is drawn once per episode, and they tire.
    Person {
        /// Mean over people, in steps.
        mean: f64,
        /// Standard deviation over people, in steps.
        spread: f64,
        /// Growth of the delay, in steps per step of the episode: 0.01 adds one step per hundred.
        drift: f64,
    },
}

/// How often a random delay is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DelayDraw {
    /// Once, when the episode starts.
    PerEpisode,
    /// Anew whenever a message is comprehended.
    PerNotification,
}

/// When the listener can use a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Comprehension {
    /// After its k-th word.
    Words,
    /// In the step in which it starts (k counts as 0).
    Immediate,
}

/// What a message's informativeness I counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Informativeness {
    /// All its words, l.
    Length,
    /// The words after it has become actionable, l - k.
    Tail,
}

/// How many steps the reaction lasts (`d_f`), from the informativeness I.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FollowThrough {
    /// As many steps as the informativeness I says.
    Length,
    /// 2 I - 2 steps.
    TwiceLengthMinusTwo,
    /// Always this many steps.
    Fixed(u32),
}

/// Whether the follow-through counts both its ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FollowThroughEnd {
    /// `d_f` steps: the end of the interval does not count.
    Exclusive,
    /// `d_f` + 1 steps: the source's closed interval.
    Inclusive,
}

/// When the reaction reward I - 2 is paid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReactionReward {
    /// Never: the notifier is paid by the task alone.
    Off,
    /// In the first step that follows the message.
    Once,
    /// In every step that follows the message.
    PerStep,
}

/// What an initiation does while an utterance runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interrupt {
    /// Cuts it at once; if it was not comprehended yet, it never is.
    Replace,
    /// Is blocked before its k-th word, cuts its tail after it.
    UntilComprehended,
    /// Is blocked before its last word.
    Finish,
}

/// What becomes of an initiation that may not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BlockedInitiation {
    /// It is not offered to the policy.
    Mask,
    /// It has no effect and costs nothing.
    IgnoreFree,
    /// It has no effect and costs as if it had started.
    IgnoreCharged,
}

/// What happens to a comprehended message whose reaction is not due yet when something new happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PendingRule {
    /// One slot: the next comprehended message takes it.
    OverwriteOnComprehension,
    /// One slot: it is emptied when a new message starts.
    CancelOnInitiation,
    /// All wait, and become due in the order in which they were comprehended.
    Queue,
}

/// What happens to a running reaction when something new happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunningRule {
    /// It runs until the next reaction is due.
    UntilNextDue,
    /// It ends when a new message starts.
    CancelOnInitiation,
    /// It ends when a new message is comprehended.
    CancelOnComprehension,
}

/// What an initiation of the topic does that is spoken, pending or carried out already.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Repeat {
    /// The same as of any other topic.
    Restart,
    /// Nothing: what is under way goes on, free of charge.
    Continue,
}

/// How the listener hears, understands and reacts. All times are in steps, one word each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HumanSettings {
    /// Steps from comprehension to reaction, `d_r` (0..=60). Default `{ fixed = 2 }`; a bare number means the same.
    #[serde(deserialize_with = "read_or_fixed")]
    pub reaction_delay: ReactionDelay,
    /// When a message is understood. Default `words`: after its k-th word.
    pub comprehension: Comprehension,
    /// The number that the first word has (0 or 1): 0 makes every comprehension one step earlier. Default 1.
    pub words_from: u32,
    /// Whether the words after comprehension take time; without, a message is over once understood. Default true.
    pub occupies: bool,
    /// What informativeness counts. Default `length`.
    pub informativeness: Informativeness,
    /// Weight of that count in I, α (at least 0). Default 1.
    pub informativeness_weight: f64,
    /// What a stated reason adds to I, β (at least 0). Default 0. Which messages state one is `notifier.reasons`.
    pub reason_weight: f64,
    /// Steps that a reaction lasts, `d_f`. Default `length`; a bare number means `{ fixed = number }`.
    #[serde(deserialize_with = "read_or_fixed")]
    pub follow_through: FollowThrough,
    /// Whether a reaction lasts `d_f` steps or one more. Default `exclusive`.
    pub follow_through_end: FollowThroughEnd,
    /// When the reaction reward I - 2 is added to the notifier's reward. Default `off`.
    pub reaction_reward: ReactionReward,
    /// What may interrupt an utterance. Default `until_comprehended`.
    pub interrupt: Interrupt,
    /// What becomes of an initiation that may not start. Default `mask`.
    pub blocked_initiation: BlockedInitiation,
    /// What may replace a pending reaction. Default `overwrite_on_comprehension`.
    pub pending: PendingRule,
    /// What may end a running reaction. Default `until_next_due`.
    pub running: RunningRule,
    /// What saying the same again does. Default `restart`.
    pub repeat: Repeat,
    /// Whether the notifier may break off its own utterance. Default false.
    pub can_stop: bool,
}

/// Reads a choice by its name, as a table with one key, or as a bare number of steps.
fn read_or_fixed<'de, T: Deserialize<'de>, D: Deserializer<'de>>(given: D) -> Result<T, D::Error> {
    struct Steps<T>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>> Visitor<'de> for Steps<T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a number of steps, or a choice such as { fixed = 2 }")
        }

        fn visit_u64<E: de::Error>(self, steps: u64) -> Result<T, E> {
            let wrong = |_| E::invalid_value(Unexpected::Unsigned(steps), &self);
            let fixed = ("fixed", u32::try_from(steps).map_err(wrong)?);
            self.visit_map(MapDeserializer::new(std::iter::once(fixed)))
        }

        fn visit_i64<E: de::Error>(self, steps: i64) -> Result<T, E> {
            let wrong = |_| E::invalid_value(Unexpected::Signed(steps), &self);
            let steps = u32::try_from(steps).map_err(wrong)?;
            self.visit_u64(steps.into())
        }

        fn visit_str<E: de::Error>(self, name: &str) -> Result<T, E> {
            T::deserialize(StrDeserializer::new(name))
        }

        fn visit_map<A: MapAccess<'de>>(self, mut table: A) -> Result<T, A::Error> {
            let choice = T::deserialize(MapAccessDeserializer::new(&mut table))?;
            match table.next_key::<String>()? {
                None => Ok(choice),
                Some(other) => Err(de::Error::custom(format!("a second choice `{other}`"))),
            }
        }
    }
    given.deserialize_any(Steps(PhantomData))
}

impl Default for HumanSettings {
    fn default() -> Self {
        Self {
            reaction_delay: ReactionDelay::Fixed(2),
            comprehension: Comprehension::Words,
            words_from: 1,
            occupies: true,
            informativeness: Informativeness::Length,
            informativeness_weight: 1.0,
            reason_weight: 0.0,
            follow_through: FollowThrough::Length,
            follow_through_end: FollowThroughEnd::Exclusive,
            reaction_reward: ReactionReward::Off,
            interrupt: Interrupt::UntilComprehended,
            blocked_initiation: BlockedInitiation::Mask,
            pending: PendingRule::OverwriteOnComprehension,
            running: RunningRule::UntilNextDue,
            repeat: Repeat::Restart,
            can_stop: false,
        }
    }
}

#[cfg(test)]
impl HumanSettings {
    /// Returns the listener who understands and reacts in the very step in which a message starts.
    pub(crate) fn delay_free() -> Self {
        Self {
            reaction_delay: ReactionDelay::Fixed(0),
            comprehension: Comprehension::Immediate,
            ..Self::default()
        }
    }
}

impl HumanSettings {
    /// Checks ranges; the error names the first impossible setting.
    pub(crate) fn check(&self) -> Result<(), SettingError> {
        self.check_delay()?;
        require(self.words_from <= 1, "human.words_from", self.words_from, "0 or 1")?;
        let weight = self.informativeness_weight;
        require_within("human.informativeness_weight", weight, 0.0..=1e6, "")?;
        require_within("human.reason_weight", self.reason_weight, 0.0..=1e6, "")?;
        match self.follow_through {
            FollowThrough::Fixed(steps) => {
                require_within("human.follow_through", steps, 1..=1000, "steps")
            }
            _ => Ok(()),
        }
    }

    fn check_delay(&self) -> Result<(), SettingError> {
        const KEY: &str = "human.reaction_delay";
        let possible = 0.0..=f64::from(MAX_REACTION_DELAY);
        match self.reaction_delay {
            ReactionDelay::Fixed(steps) => {
                require_within(KEY, steps, 0..=MAX_REACTION_DELAY, "steps")
            }
            ReactionDelay::Normal { mean, deviation, .. } => {
                require_within(KEY, mean, possible.clone(), "steps")?;
                let allowed = "a standard deviation of 0 to 60 steps";
                require(possible.contains(&deviation), KEY, deviation, allowed)
            }
            ReactionDelay::Uniform { low, high, .. } => {
                let fits = low <= high && high <= MAX_REACTION_DELAY;
                require(fits, KEY, format_args!("{low}..={high}"), "0 <= low <= high <= 60")
            }
            ReactionDelay::Person { mean, spread, drift } => {
                require_within(KEY, mean, possible.clone(), "steps")?;
                require(possible.contains(&spread), KEY, spread, "a spread of 0 to 60 steps")?;
                let fits = (-1.0..=1.0).contains(&drift);
                require(fits, KEY, drift, "a drift of -1 to 1 steps per step")
            }
        }
    }

    /// Computes the steps after which a message is understood (0: in the step in which it starts).
    pub(super) fn effective_comprehension(&self, message: Message) -> u32 {
        match self.comprehension {
            Comprehension::Words => (message.comprehension + self.words_from).saturating_sub(1),
            Comprehension::Immediate => 0,
        }
    }

    /// Computes how informative a message is: I = α · (l or l - k) + β · `I_why`, given `I_why`.
    pub(super) fn informativeness_of(&self, message: Message, reason: f64) -> f64 {
        let counted = match self.informativeness {
            Informativeness::Length => message.conveyance,
            Informativeness::Tail => message.conveyance - message.comprehension,
        };
        self.informativeness_weight * f64::from(counted) + self.reason_weight * reason
    }

    /// Computes how many steps the reaction to a message lasts, both conventions of its end included.
    pub(crate) fn reaction_steps(&self, message: Message, reason: f64) -> u32 {
        let informativeness = self.informativeness_of(message, reason);
        let steps = match self.follow_through {
            FollowThrough::Length => libm::round(informativeness) as u32,
            FollowThrough::TwiceLengthMinusTwo => libm::round(2.0 * informativeness - 2.0) as u32,
            FollowThrough::Fixed(steps) => steps,
        };
        steps + u32::from(self.follow_through_end == FollowThroughEnd::Inclusive)
    }
}

#[cfg(test)]
mod tests {
    use super::FollowThroughEnd::{Exclusive, Inclusive};
    use super::*;

    fn message(comprehension: u32, conveyance: u32) -> Message {
        Message { topic: 0, comprehension, conveyance }
    }

    #[test]
    fn follow_through_obeys_its_rule_and_its_end() {
        let steps = |follow_through, follow_through_end, l| {
            let settings =
                HumanSettings { follow_through, follow_through_end, ..HumanSettings::default() };
            settings.reaction_steps(message(2, l), 0.0)
        };
        assert_eq!(steps(FollowThrough::Length, Exclusive, 5), 5);
        assert_eq!(steps(FollowThrough::Length, Inclusive, 5), 6);
        assert_eq!(steps(FollowThrough::TwiceLengthMinusTwo, Exclusive, 4), 6);
        assert_eq!(steps(FollowThrough::TwiceLengthMinusTwo, Exclusive, 1), 0);
        assert_eq!(steps(FollowThrough::Fixed(3), Inclusive, 2), 4);
    }

    #[test]
    fn informativeness_counts_words_tail_and_reason() {
        let mut settings = HumanSettings { reason_weight: 0.5, ..HumanSettings::default() };
        assert_eq!(settings.informativeness_of(message(2, 5), 0.0), 5.0);
        assert_eq!(settings.informativeness_of(message(2, 5), 1.0), 5.5);
        settings.informativeness = Informativeness::Tail;
        settings.informativeness_weight = 2.0;
        assert_eq!(settings.informativeness_of(message(2, 5), 0.5), 6.25);
    }

    #[test]
    fn impossible_settings_are_named() {
        let delay = |reaction_delay| {
            HumanSettings { reaction_delay, ..HumanSettings::default() }.check().unwrap_err()
        };
        let error = delay(ReactionDelay::Fixed(61));
        assert_eq!(error.to_string(), "`human.reaction_delay` is 61; allowed: 0 to 60 steps");
        let drawn = DelayDraw::PerEpisode;
        let error = delay(ReactionDelay::Uniform { low: 3, high: 1, drawn });
        assert_eq!(error.given, "3..=1");
        delay(ReactionDelay::Normal { mean: f64::NAN, deviation: 1.0, drawn });
        delay(ReactionDelay::Person { mean: 2.0, spread: 0.5, drift: 2.0 });
        let error = HumanSettings { words_from: 2, ..HumanSettings::default() }.check();
        assert_eq!(error.unwrap_err().key, "human.words_from");
        HumanSettings::default().check().unwrap();
        HumanSettings::delay_free().check().unwrap();
    }

    #[test]
    fn settings_read_as_a_person_writes_them() {
        let text = r#"{"reaction_delay": {"normal": {"mean": 2, "deviation": 0.5, "drawn": "per_episode"}},
                       "follow_through": {"fixed": 3}, "interrupt": "replace"}"#;
        let settings: HumanSettings = serde_json::from_str(text).unwrap();
        assert_eq!(settings.follow_through, FollowThrough::Fixed(3));
        assert_eq!(settings.interrupt, Interrupt::Replace);
        let error = serde_json::from_str::<HumanSettings>(r#"{"delay": 2}"#).unwrap_err();
        assert!(error.to_string().contains("unknown field `delay`, expected"), "{error}");
    }
}
