//! From choices to speech acts and back: the factored action of a notifier.
//!
//! | type | heads | k, l |
//! |---|---|---|
//! | topic only | initiate, topic | both the shortest |
//! | complete utterance | initiate, topic, l | k = l, at most `k_max` |
//! | incrementally actionable | initiate, topic, k, l | l >= k given k, k at most `k_max` |
//!
//! The initiate head has the choices silence (0), start (1) and, where a message can be stopped, stop (2).

use leadtime_proto::{ActionSpec, Conditional, Gate, Head, Mask};

use super::cells::CellTable;
use super::settings::{NotificationType, NotifierSettings};
use crate::Message;
use crate::check::SettingError;
use crate::description::{NamedHead, Quantity};
use crate::human::SpeechAct;

/// Names of the heads whose choices are numbers of words, in increasing order.
const LENGTH_HEADS: [&str; 2] = ["k", "l"];

const START: u8 = 1;
const STOP: u8 = 2;

/// Returns the biases of an untrained policy's logits, one per choice: `initiate` for starting a message, `length` for every
/// choice of k and of l beyond the shortest. Empty where there is nothing to say, or no bias.
pub fn initial_bias(actions: &ActionSpec, initiate: f64, length: f64) -> Vec<f32> {
    let Some(gate) = actions.gate else { return Vec::new() };
    let mut biases = vec![0.0; actions.n_choices()];
    let offsets = actions.offsets();
    biases[offsets[gate.head] + gate.choice] = initiate as f32;
    for (head, offset) in actions.heads.iter().zip(offsets) {
        if LENGTH_HEADS.contains(&head.name.as_str()) {
            let head = &mut biases[offset..offset + head.n_choices];
            head.iter_mut().enumerate().for_each(|(i, bias)| *bias = (i as f64 * length) as f32);
        }
    }
    if biases.iter().all(|bias| *bias == 0.0) { Vec::new() } else { biases }
}

/// Which choices of the initiate head, besides silence, a step offers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offered {
    pub(super) start: bool,
    pub(super) stop: bool,
}

/// The action space of one notifier, and what its choices mean.
#[derive(Clone, Debug)]
pub(super) struct Actions {
    notification: NotificationType,
    words: Vec<u32>,
    /// How many of them k may be: those up to `k_max`.
    n_k: usize,
    /// The domain's id of each topic choice.
    topic_ids: Vec<usize>,
    /// What can be said, if not everything.
    cells: Option<CellTable>,
    can_stop: bool,
}

impl Actions {
    pub(super) fn new(
        settings: &NotifierSettings,
        known_topics: &[&str],
        can_stop: bool,
    ) -> Result<Self, SettingError> {
        settings.check()?;
        let topic_ids = settings.topic_ids(known_topics)?;
        let table =
            |cells: &Vec<_>| CellTable::up_to(settings.k_max, cells, known_topics, &topic_ids);
        let cells = settings.cells.as_ref().map(table).transpose()?;
        let words = settings.words.clone();
        let n_k = words.iter().filter(|&&k| settings.k_max.is_none_or(|most| k <= most)).count();
        Ok(Self { notification: settings.notification, words, n_k, topic_ids, cells, can_stop })
    }

    /// Describes the heads, the gate on starting, and the rule k <= l.
    pub(super) fn spec(&self) -> ActionSpec {
        let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
        let (n_words, n_k) = (self.words.len(), self.n_k);
        let initiate = head("initiate", if self.can_stop { 3 } else { 2 });
        let mut heads = vec![initiate, head("topic", self.topic_ids.len())];
        let mut conditionals = Vec::new();
        match self.notification {
            NotificationType::TopicOnly => {}
            NotificationType::CompleteUtterance => heads.push(head(LENGTH_HEADS[1], n_k)),
            NotificationType::IncrementallyActionable => {
                heads.push(head(LENGTH_HEADS[0], n_k));
                heads.push(head(LENGTH_HEADS[1], n_words));
                // Words increase, so l >= k means a choice of at least the same index. At most 64 choices fit a
                // mask, so clamp the shift: the caller reports the error.
                let allowed = (0..n_k).map(|k| u64::MAX << k.min(63)).collect();
                conditionals.push(Conditional { head: 3, given: 2, allowed });
            }
        }
        let gate = Some(Gate { head: 0, choice: usize::from(START) });
        ActionSpec { heads, gate, conditionals }
    }

    /// Names the choices of every head.
    pub(super) fn heads(&self, topics: &[&str]) -> Vec<NamedHead> {
        let words = |n| self.words.iter().take(n).map(|n| format!("{n} words")).collect();
        let choices = |name: &str, n_choices| match name {
            "initiate" => ["silence", "start", "stop"][..2 + usize::from(self.can_stop)]
                .iter()
                .map(|&choice| choice.to_owned())
                .collect(),
            "topic" => self.topic_ids.iter().map(|&id| topics[id].to_owned()).collect(),
            _ => words(n_choices),
        };
        let named = |head: Head| NamedHead {
            choices: choices(&head.name, head.n_choices),
            name: head.name,
        };
        self.spec().heads.into_iter().map(named).collect()
    }

    /// Says what the numbers of [`Actions::encode`] are.
    pub(super) fn quantities(&self, topics: &[&str]) -> Vec<Quantity> {
        let mut all = vec![Quantity::flag("said.start", "whether a message was started")];
        all.extend(self.topic_quantities("said", "that message", topics));
        for head in LENGTH_HEADS {
            let meaning = format!("whether {head} of that message is so many words");
            let flag = |n: &u32| Quantity::flag(format!("said.{head}{n}"), &meaning);
            all.extend(self.words.iter().map(flag));
        }
        let stop = || Quantity::flag("said.stop", "whether the running message was stopped");
        all.extend(self.can_stop.then(stop));
        all
    }

    /// Says what the numbers of [`Actions::encode_topic`] are.
    pub(super) fn topic_quantities(
        &self,
        prefix: &str,
        whose: &str,
        topics: &[&str],
    ) -> Vec<Quantity> {
        let meaning = format!("whether this is the topic of {whose}");
        let flag = |&id: &usize| Quantity::flag(format!("{prefix}.{}", topics[id]), &meaning);
        self.topic_ids.iter().map(flag).collect()
    }

    /// Reads an action.
    ///
    /// # Panics
    ///
    /// If a choice is not one of its head's.
    pub(super) fn speech_act(&self, action: &[u8]) -> SpeechAct {
        match action[0] {
            START => SpeechAct::Start(self.message(action)),
            STOP => SpeechAct::Stop,
            _ => SpeechAct::Continue,
        }
    }

    fn message(&self, action: &[u8]) -> Message {
        let words = |choice: u8| self.words[usize::from(choice)];
        let (comprehension, conveyance) = match self.notification {
            NotificationType::TopicOnly => (self.words[0], self.words[0]),
            NotificationType::CompleteUtterance => (words(action[2]), words(action[2])),
            NotificationType::IncrementallyActionable => (words(action[2]), words(action[3])),
        };
        let topic = self.topic_ids[usize::from(action[1])];
        let chosen = Message { topic, comprehension, conveyance: conveyance.max(comprehension) };
        self.cells.as_ref().map_or(chosen, |cells| cells.nearest(chosen))
    }

    /// Lists what the choices can say, each message once.
    pub(super) fn messages(&self) -> Vec<Message> {
        let (n_k, n_l) = (self.n_k as u8, self.words.len() as u8);
        let (n_first, n_last) = match self.notification {
            NotificationType::TopicOnly => (1, 1),
            NotificationType::CompleteUtterance => (n_k, 1),
            NotificationType::IncrementallyActionable => (n_k, n_l),
        };
        let mut all: Vec<Message> = Vec::new();
        for topic in 0..self.topic_ids.len() as u8 {
            for (first, last) in (0..n_first).flat_map(|i| (0..n_last).map(move |j| (i, j))) {
                let message = self.message(&[START, topic, first, last]);
                if !all.contains(&message) {
                    all.push(message);
                }
            }
        }
        all
    }

    /// Writes the action that starts a message, with the nearest k and l there are; silence if it cannot be said.
    pub(super) fn write(&self, message: Option<Message>, action: &mut [u8]) {
        action.fill(0);
        let Some(message) = message else { return };
        let Some(topic) = self.topic_ids.iter().position(|&id| id == message.topic) else { return };
        (action[0], action[1]) = (START, topic as u8);
        match self.notification {
            NotificationType::TopicOnly => {}
            NotificationType::CompleteUtterance => action[2] = self.nearest_k(message.conveyance),
            NotificationType::IncrementallyActionable => {
                action[2] = self.nearest_k(message.comprehension);
                action[3] = self.nearest(message.conveyance).max(action[2]);
            }
        }
    }

    /// Writes the action that carries out a speech act; silence if it is not among the choices.
    pub(super) fn write_act(&self, act: SpeechAct, action: &mut [u8]) {
        match act {
            SpeechAct::Start(message) => self.write(Some(message), action),
            SpeechAct::Continue | SpeechAct::Stop => self.write(None, action),
        }
        if act == SpeechAct::Stop && self.can_stop {
            action[0] = STOP;
        }
    }

    fn nearest(&self, words: u32) -> u8 {
        let distance = |&i: &usize| self.words[i].abs_diff(words);
        (0..self.words.len()).min_by_key(distance).unwrap_or(0) as u8
    }

    fn nearest_k(&self, words: u32) -> u8 {
        self.nearest(words).min((self.n_k - 1) as u8)
    }

    /// Returns what may be chosen, given what the listener's rules allow.
    pub(super) fn mask(&self, offered: Offered) -> Mask {
        let start = u64::from(!offered.start) << START;
        let stop = u64::from(self.can_stop && !offered.stop) << STOP;
        Mask(!(start | stop))
    }

    pub(super) fn encoded_dim(&self) -> usize {
        1 + self.topic_ids.len() + 2 * self.words.len() + usize::from(self.can_stop)
    }

    pub(super) fn n_topics(&self) -> usize {
        self.topic_ids.len()
    }

    /// Writes what was done in a step: initiate flag, one-hot topic, k and l (and stop); zeros for silence.
    pub(super) fn encode(&self, started: Option<Message>, stopped: bool, out: &mut [f32]) {
        out.fill(0.0);
        if stopped && let Some(flag) = out.last_mut() {
            *flag = 1.0;
        }
        let Some(message) = started else { return };
        let (n_topics, n_words) = (self.n_topics(), self.words.len());
        out[0] = 1.0;
        self.encode_topic(message.topic, &mut out[1..=n_topics]);
        out[1 + n_topics + usize::from(self.nearest(message.comprehension))] = 1.0;
        out[1 + n_topics + n_words + usize::from(self.nearest(message.conveyance))] = 1.0;
    }

    /// Writes a one-hot topic. Shape `[n_topics]`.
    pub(super) fn encode_topic(&self, topic: usize, out: &mut [f32]) {
        for (flag, &id) in out.iter_mut().zip(&self.topic_ids) {
            *flag = f32::from(u8::from(id == topic));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::NotificationType::{CompleteUtterance, IncrementallyActionable, TopicOnly};
    use super::*;

    const TOPICS: &[&str] = &["up", "down", "wait"];

    fn actions(notification: NotificationType, can_stop: bool) -> Actions {
        let settings = NotifierSettings { notification, ..NotifierSettings::default() };
        Actions::new(&settings, TOPICS, can_stop).unwrap()
    }

    fn message(topic: usize, comprehension: u32, conveyance: u32) -> Message {
        Message { topic, comprehension, conveyance }
    }

    #[test]
    fn a_type_restricts_the_heads() {
        for (notification, expected) in [
            (TopicOnly, &["initiate", "topic"][..]),
            (CompleteUtterance, &["initiate", "topic", "l"]),
            (IncrementallyActionable, &["initiate", "topic", "k", "l"]),
        ] {
            let spec = actions(notification, false).spec();
            spec.check().unwrap();
            let names: Vec<&str> = spec.heads.iter().map(|head| head.name.as_str()).collect();
            assert_eq!(names, expected);
        }
    }

    #[test]
    fn ten_of_the_sixteen_pairs_are_possible() {
        let actions = actions(IncrementallyActionable, false);
        let spec = actions.spec();
        let pairs = (0..4).flat_map(|k| (0..4).map(move |l| [1, 0, k, l]));
        let possible: Vec<[u8; 4]> = pairs.filter(|a| spec.allows(Mask::ALL, a)).collect();
        assert_eq!(possible.len(), 10);
        for action in possible {
            let act = actions.speech_act(&action);
            assert!(matches!(act, SpeechAct::Start(said) if said.comprehension <= said.conveyance));
        }
    }

    #[test]
    fn no_k_beyond_the_greatest_is_offered() {
        let settings = |notification| NotifierSettings {
            notification,
            k_max: Some(3),
            ..NotifierSettings::default()
        };
        let actions = Actions::new(&settings(IncrementallyActionable), TOPICS, false).unwrap();
        let spec = actions.spec();
        spec.check().unwrap();
        assert_eq!(spec.heads.iter().map(|head| head.n_choices).collect::<Vec<_>>(), [2, 3, 2, 4]);
        assert!(spec.allows(Mask::ALL, &[1, 0, 1, 3]) && !spec.allows(Mask::ALL, &[1, 0, 1, 0]));
        let of_up = actions.messages().iter().filter(|said| said.topic == 0).count();
        assert_eq!((of_up, actions.heads(TOPICS)[2].choices.len()), (7, 2));
        let mut action = [0; 4];
        actions.write(Some(message(0, 5, 5)), &mut action);
        assert_eq!(actions.speech_act(&action), SpeechAct::Start(message(0, 3, 5)));
        // What was said is encoded as without a bound: a policy's observation has the same shape.
        assert_eq!(
            actions.encoded_dim(),
            self::actions(IncrementallyActionable, false).encoded_dim()
        );
        let complete = Actions::new(&settings(CompleteUtterance), TOPICS, false).unwrap();
        assert!(complete.messages().iter().all(|said| said.conveyance <= 3));
    }

    #[test]
    fn actions_and_messages_correspond() {
        let topic_only = actions(TopicOnly, false);
        assert_eq!(topic_only.speech_act(&[1, 2]), SpeechAct::Start(message(2, 2, 2)));
        let complete = actions(CompleteUtterance, false);
        assert_eq!(complete.speech_act(&[1, 1, 3]), SpeechAct::Start(message(1, 5, 5)));
        let full = actions(IncrementallyActionable, true);
        assert_eq!(full.speech_act(&[1, 0, 1, 3]), SpeechAct::Start(message(0, 3, 5)));
        assert_eq!(full.speech_act(&[0, 0, 1, 3]), SpeechAct::Continue);
        assert_eq!(full.speech_act(&[2, 0, 1, 3]), SpeechAct::Stop);
        let mut action = [9; 4];
        full.write(Some(message(0, 3, 9)), &mut action);
        assert_eq!(action, [1, 0, 1, 3]);
        full.write(None, &mut action);
        assert_eq!(action, [0; 4]);
    }

    #[test]
    fn a_choice_that_cannot_be_said_becomes_the_nearest_that_can() {
        let cell = |topic: &str, k, l| (topic.to_owned(), k, l);
        let cells = vec![cell("up", 2, 4), cell("down", 3, 3), cell("wait", 2, 2)];
        let settings = NotifierSettings { cells: Some(cells), ..NotifierSettings::default() };
        let actions = Actions::new(&settings, TOPICS, false).unwrap();
        assert_eq!(actions.speech_act(&[1, 0, 0, 2]), SpeechAct::Start(message(0, 2, 4)));
        assert_eq!(actions.speech_act(&[1, 0, 2, 3]), SpeechAct::Start(message(0, 2, 4)));
        assert_eq!(actions.speech_act(&[1, 1, 0, 0]), SpeechAct::Start(message(1, 3, 3)));
        // What is offered does not change: a policy for one database fits another.
        assert_eq!(actions.spec(), self::actions(settings.notification, false).spec());
        let lacking = NotifierSettings { cells: Some(vec![cell("up", 2, 4)]), ..settings };
        let error = Actions::new(&lacking, TOPICS, false).unwrap_err().to_string();
        assert!(error.starts_with("`notifier.cells` is a table without `down`"), "{error}");
    }

    #[test]
    fn no_cell_that_is_said_has_a_k_beyond_the_greatest() {
        let settings = |cells: &[(u32, u32)], notification| NotifierSettings {
            notification,
            k_max: Some(3),
            topics: Some(vec!["up".to_owned()]),
            cells: Some(cells.iter().map(|&(k, l)| ("up".to_owned(), k, l)).collect()),
            ..NotifierSettings::default()
        };
        for notification in [TopicOnly, CompleteUtterance, IncrementallyActionable] {
            // (3, 3) is nearer to the first of them.
            let both = settings(&[(4, 4), (2, 9)], notification);
            let actions = Actions::new(&both, TOPICS, false).unwrap();
            assert_eq!(actions.messages(), [message(0, 2, 9)], "{notification:?}");
            let late = settings(&[(4, 4)], notification);
            let error = Actions::new(&late, TOPICS, false).unwrap_err().to_string();
            let says = "`notifier.cells` is a table without `up` with k up to 3; allowed: ";
            assert!(error.starts_with(says), "{error}");
        }
    }

    #[test]
    fn masks_withhold_start_and_stop() {
        let actions = actions(IncrementallyActionable, true);
        let spec = actions.spec();
        for (start, stop) in [(true, true), (false, true), (true, false), (false, false)] {
            let mask = actions.mask(Offered { start, stop });
            let offered = [0, 1, 2].map(|choice| spec.allows(mask, &[choice, 2, 1, 3]));
            assert_eq!(offered, [true, start, stop]);
        }
    }

    #[test]
    fn what_was_done_is_encoded_one_hot() {
        let actions = actions(IncrementallyActionable, true);
        let mut out = [7.0; 13];
        assert_eq!(actions.encoded_dim(), out.len());
        actions.encode(Some(message(1, 2, 4)), false, &mut out);
        assert_eq!(out, [1., 0., 1., 0., 1., 0., 0., 0., 0., 0., 1., 0., 0.]);
        actions.encode(None, true, &mut out);
        assert_eq!(out, [0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 1.]);
    }
}
