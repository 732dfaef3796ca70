//! What the listener was doing in each step, and when each message was spoken.
//!
//! A scene describes the moment after a step; step `i` leads from scene `i` to scene `i + 1`. Several things can be
//! true of a step (following one message while hearing the next), so a path has the colour of the first that
//! holds: following, waiting, hearing, own plan.

use leadtime_sims::{Listener, Scene};

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
        let words: Vec<_> = scenes.iter().map(|scene| scene.listener.word).collect();
        // A message that is pending from scene `a` to scene `b` waits from the one to the other.
        let mut waits = spans(scenes.iter().map(|scene| scene.listener.pending));
        waits.retain_mut(|span| {
            span.start -= usize::from(waits_from_its_start(&scenes[span.start]));
            span.end -= 1;
            span.start < span.end
        });
        Self {
            activities: scenes.windows(2).map(|pair| activity(&pair[0], &pair[1])).collect(),
            utterances: LoggedMessage::all(&words),
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
    if after.listener.reacting.is_some() {
        Activity::Following
    } else if before.listener.pending.is_some() || waits_from_its_start(after) {
        Activity::Waiting
    } else if after.listener.word.is_some_and(|word| word.heard <= word.needed) {
        Activity::Hearing
    } else {
        Activity::OwnPlan
    }
}

/// Returns whether what waits in this scene was understood before its first word, which the step before it brought.
fn waits_from_its_start(scene: &Scene) -> bool {
    let Listener { word, pending, .. } = &scene.listener;
    word.is_some_and(|word| word.started && word.needed == 0 && *pending == Some(word.topic))
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
    use leadtime_sims::human::{Comprehension, HumanSettings, SpeechAct};

    use super::*;
    use crate::playthrough::synthetic;

    #[test]
    fn a_message_is_heard_then_waited_for_then_followed() {
        // Said at 3 with k = 2, l = 3; comprehended at 5; two steps of delay; followed for three steps.
        let timeline = Timeline::new(&synthetic::scenes(14, &[(3, 1, 2, 3)]));
        let (topic, start, end) = (1, 3, 6);
        let said = LoggedMessage { topic, start, comprehension: 2, conveyance: 3, needed: 2, end };
        assert_eq!(timeline.utterances, [said]);
        assert_eq!(timeline.waits, [Span { topic: 1, start: 5, end: 7 }]);
        assert_eq!(timeline.reactions, [Span { topic: 1, start: 7, end: 10 }]);
        let letters = timeline.activities.iter().map(|activity| &activity.label()[..1]);
        assert_eq!(letters.collect::<String>(), "ooohhrrfffooo");
    }

    #[test]
    fn who_understands_at_once_waits_from_the_start() {
        let at_once = |human: &mut HumanSettings| human.comprehension = Comprehension::Immediate;
        let quiet = SpeechAct::Continue;
        let acts = [quiet, synthetic::ascend(3, 5), quiet, quiet, quiet];
        let timeline = Timeline::new(&synthetic::lander(at_once, &acts));
        let letters = timeline.activities.iter().map(|activity| &activity.label()[..1]);
        assert_eq!(letters.collect::<String>(), "orrff");
        assert_eq!(timeline.waits, [Span { topic: 0, start: 1, end: 3 }]);
    }

    #[test]
    fn nothing_is_heard_in_the_step_that_stops_a_message() {
        let acts = [synthetic::ascend(3, 3), SpeechAct::Continue, SpeechAct::Stop];
        let timeline = Timeline::new(&synthetic::lander(|human| human.can_stop = true, &acts));
        let (heard, own) = (Activity::Hearing, Activity::OwnPlan);
        assert_eq!(timeline.activities, [heard, heard, own]);
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
