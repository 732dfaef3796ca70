//! What the listener was doing in each step, and when each message was spoken.
//!
//! A scene describes the moment after a step; step `i` leads from scene `i` to scene `i + 1`. Several things can be
//! true of a step (following one message while hearing the next), so a path has the colour of the first that
//! holds: following, waiting, hearing, own plan.

use leadtime_sims::Scene;

use crate::measure::LoggedMessage;

/// What the listener did in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// Acting by their own plan, and no message is running.
    OwnPlan,
    /// Hearing words that cannot be understood yet.
    Hearing,
    /// Having understood, not yet reacting.
    Waiting,
    /// Carrying out what a message asked for.
    Following,
}

impl Activity {
    /// Lists everything, in the order of a message's life.
    pub const ALL: [Self; 4] = [Self::OwnPlan, Self::Hearing, Self::Waiting, Self::Following];

    /// Returns the words of a legend.
    pub fn label(self) -> &'static str {
        match self {
            Self::OwnPlan => "own plan",
            Self::Hearing => "hearing, not yet understood",
            Self::Waiting => "reaction delay",
            Self::Following => "follows through",
        }
    }
}

/// A stretch of time about one topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Index of the topic in the task.
    pub topic: usize,
    /// The first scene that belongs to it.
    pub start: usize,
    /// Scene at which it is over.
    pub end: usize,
}

/// What happened in an episode, and when.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timeline {
    /// What the listener was doing in each step.
    pub activities: Vec<Activity>,
    /// The messages, in the order in which they were started.
    pub utterances: Vec<LoggedMessage>,
    /// When a comprehended message waited for the reaction delay.
    pub waits: Vec<Span>,
    /// When the listener reacted.
    pub reactions: Vec<Span>,
}

impl Timeline {
    /// Returns the place of the message that is spoken in the step which leads to scene `i`.
    pub(crate) fn spoken(&self, i: usize) -> Option<usize> {
        self.utterances.iter().rposition(|utterance| utterance.start < i && i <= utterance.end)
    }

    /// Reads an episode's scenes.
    pub fn new(scenes: &[Scene]) -> Self {
        let speech: Vec<_> = scenes.iter().map(|scene| scene.listener.speech).collect();
        // A message that is pending from scene `a` to scene `b` waits from the one to the other.
        let mut waits = spans(scenes.iter().map(|scene| scene.listener.pending));
        waits.retain_mut(|span| {
            span.end -= 1;
            span.start < span.end
        });
        Self {
            activities: scenes.windows(2).map(|pair| activity(&pair[0], &pair[1])).collect(),
            utterances: LoggedMessage::all(&speech),
            waits,
            reactions: spans(scenes.iter().skip(1).map(|scene| scene.listener.reacting)),
        }
    }
}

/// Returns a topic's name in words.
pub fn topic_name(scene: &Scene, topic: usize) -> String {
    let name = scene.listener.topics.get(topic).copied();
    name.map_or_else(|| format!("topic {topic}"), |name| name.replace('_', " "))
}

fn activity(before: &Scene, after: &Scene) -> Activity {
    let begun = after.listener.speech.is_some_and(|speech| speech.started);
    let unclear = before.listener.speech.is_some_and(|s| s.heard < s.comprehension);
    if after.listener.reacting.is_some() {
        Activity::Following
    } else if before.listener.pending.is_some() {
        Activity::Waiting
    } else if begun || unclear {
        Activity::Hearing
    } else {
        Activity::OwnPlan
    }
}

/// Joins equal neighbours: item `i` lasts from scene `i` to `i + 1`.
fn spans(topics: impl Iterator<Item = Option<usize>>) -> Vec<Span> {
    let mut all: Vec<Span> = Vec::new();
    for (i, topic) in topics.enumerate() {
        let Some(topic) = topic else { continue };
        match all.last_mut().filter(|span| span.topic == topic && span.end == i) {
            Some(span) => span.end = i + 1,
            None => all.push(Span { topic, start: i, end: i + 1 }),
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::playthrough::synthetic;

    #[test]
    fn a_message_is_heard_then_waited_for_then_followed() {
        // Said at 3 with k = 2, l = 3; comprehended at 5; two steps of delay; followed for three steps.
        let timeline = Timeline::new(&synthetic::scenes(14, &[(3, 1, 2, 3)]));
        let said = LoggedMessage { topic: 1, start: 3, comprehension: 2, conveyance: 3, end: 6 };
        assert_eq!(timeline.utterances, [said]);
        assert_eq!(timeline.waits, [Span { topic: 1, start: 5, end: 7 }]);
        assert_eq!(timeline.reactions, [Span { topic: 1, start: 7, end: 10 }]);
        let letters = timeline.activities.iter().map(|activity| &activity.label()[..1]);
        assert_eq!(letters.collect::<String>(), "ooohhrrfffooo");
    }

    #[test]
    fn a_message_that_is_cut_off_ends_where_the_next_begins() {
        let timeline = Timeline::new(&synthetic::scenes(20, &[(3, 1, 4, 5), (5, 0, 2, 2)]));
        let ends: Vec<_> = timeline.utterances.iter().map(|u| (u.start, u.end)).collect();
        assert_eq!(ends, [(3, 5), (5, 7)]);
        let timeline = Timeline::new(&synthetic::scenes(1, &[]));
        assert!(timeline.activities.is_empty() && timeline.utterances.is_empty());
    }
}
