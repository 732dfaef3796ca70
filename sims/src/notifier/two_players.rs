//! A notifier's task in which the listener is played, too.

use super::environment::NotifierEnv;
use crate::Domain;
use crate::description::Quantity;
use crate::environment::{Environment, EpisodeSeed, SharedOutcome, TwoPlayers};
use crate::human::{Initiation, SpeechAct};

/// After so many steps a message was understood long ago.
const LONG_AGO: u32 = 20;

/// A [`NotifierEnv`] whose listener hears as the model does, and acts as somebody else decides.
///
/// When a message is understood is the model's; there is no reaction delay and no follow-through but the listener's
/// own.
pub(crate) struct PlayedByTwo<D> {
    env: NotifierEnv<D>,
    /// The longest message, in words.
    longest: u32,
    understood: Option<Understood>,
}

/// The topic that was understood last, and how many steps ago.
#[derive(Clone, Copy)]
struct Understood {
    topic: usize,
    steps_ago: u32,
}

impl Understood {
    fn a_step_later(self) -> Self {
        Self { steps_ago: self.steps_ago.saturating_add(1), ..self }
    }
}

impl<D: Domain> PlayedByTwo<D> {
    pub(crate) fn new(mut env: NotifierEnv<D>) -> Self {
        env.hand_over();
        let messages = env.session_ref().actions().messages();
        let longest = messages.iter().map(|message| message.conveyance).max().unwrap_or(1);
        Self { env, longest, understood: None }
    }

    /// Writes what the listener sees and remembers.
    fn write_person(&self, out: &mut [f32]) {
        let (world, rest) = out.split_at_mut(self.env.domain().obs_dim());
        self.env.domain().observe(world);
        rest.fill(0.0);
        if let Some((_, heard)) = self.env.human().speech() {
            rest[0] = (heard as f32 / self.longest as f32).min(1.0);
        }
        let (topics, ago) = rest[1..].split_at_mut(self.env.domain().topics().len());
        if let Some(Understood { topic, steps_ago }) = self.understood {
            topics[topic] = 1.0;
            ago[0] = steps_ago.min(LONG_AGO) as f32 / LONG_AGO as f32;
        }
    }
}

impl<D: Domain> TwoPlayers for PlayedByTwo<D> {
    fn notifier(&self) -> &dyn Environment {
        &self.env
    }

    fn topics(&self) -> &[&'static str] {
        self.env.domain().topics()
    }

    fn person_quantities(&self) -> Vec<Quantity> {
        let mut all = self.env.domain().quantities();
        let heard = "words heard of the running message, as a share of the longest there is";
        all.push(Quantity::flag("heard", heard));
        all.extend(self.topics().iter().map(|topic| {
            let meaning = format!("1 if the message that was understood last is on {topic}");
            Quantity::flag(format!("understood.{topic}"), meaning)
        }));
        let ago = "steps since then, as a share of 20, and 1 from there on";
        all.push(Quantity::flag("understood.ago", ago));
        all
    }

    fn reset(&mut self, seed: EpisodeSeed, notifier: &mut [f32], person: &mut [f32]) {
        self.env.reset(seed, notifier);
        self.understood = None;
        self.write_person(person);
    }

    fn step(
        &mut self,
        action: &[u8],
        topic: Option<usize>,
        notifier: &mut [f32],
        person: &mut [f32],
    ) -> SharedOutcome {
        assert!(topic.is_none_or(|topic| topic < self.topics().len()), "topic {topic:?}");
        let act = self.env.session_ref().speech_act(action);
        let running = self.env.human().speech().map(|(message, _)| message);
        let n_comprehended = self.env.human().tally().comprehended;
        let (paid, initiation) = self.env.step_together(act, topic, notifier);
        let heard = match (act, initiation) {
            (SpeechAct::Start(message), Initiation::Started) => Some(message),
            _ => running,
        };
        let is_new = self.env.human().tally().comprehended > n_comprehended;
        self.understood = match heard.filter(|_| is_new) {
            Some(message) => Some(Understood { topic: message.topic, steps_ago: 0 }),
            None => self.understood.map(Understood::a_step_later),
        };
        self.write_person(person);
        let (notifier_reward, person_reward) = (paid.notifier() as f32, paid.world as f32);
        SharedOutcome { notifier_reward, person_reward, end: paid.end }
    }
}
