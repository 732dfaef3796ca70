//! The sentences of an episode: from topic, k and l of each message to the words that a listener would hear.
//!
//! A sentence is said only if everything that it presupposes holds at the moment at which it starts.
//!
//! Which of a cell's sentences comes first is drawn from a stream named by (evaluation seed, episode), and after that
//! they take turns: the same episode always gets the same sentences.

use std::fmt;

use leadtime_numerics::Purpose;
use leadtime_taxonomy::{Cell, FactSet, Request, Rotation, Taxonomy, Utterance, shipped, words};

use super::record::Playthrough;
use super::timeline::{Timeline, topic_name};
use crate::error::Error;
use crate::measure::{LoggedMessage, episode_seed};

/// A message in words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sentence {
    /// As it is spoken: `Zone ahead, go up.`; the topic in brackets, if nothing true can be said on it.
    pub text: String,
    /// The cell that it stands in.
    pub cell: Cell,
    /// No true sentence has exactly the message's k and l; this one stands in.
    pub fallback: bool,
}

impl Sentence {
    /// Returns what has been heard after `heard` of a message's `conveyance` words.
    ///
    /// A sentence of another length than the message's keeps its pace: both end together.
    pub fn so_far(&self, heard: usize, conveyance: usize) -> String {
        let l = self.cell.conveyance as usize;
        match (heard * l).div_ceil(conveyance.max(1)) {
            n if n < l => words::prefix(&self.text, n),
            _ => self.text.split_whitespace().collect::<Vec<_>>().join(" "),
        }
    }
}

/// Writes the sentence in quotation marks.
impl fmt::Display for Sentence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\u{201c}{}\u{201d}", self.text)
    }
}

/// Which of the sentences for a message take turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choosing {
    /// All of them, true or not.
    InTurn,
    /// Those of which everything holds.
    TrueInTurn,
}

/// What is said for a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chosen<'a> {
    pub(super) utterance: &'a Utterance,
    /// It stands for a message of another k or l.
    pub(super) fallback: bool,
}

/// Speaks a domain's messages, in the sentences of a database.
#[derive(Clone, Debug)]
pub struct Voice(Taxonomy);

impl Voice {
    /// Takes the sentences of a database.
    ///
    /// # Errors
    ///
    /// [`Error::Words`] if it is not about these topics, in this order.
    pub fn new(taxonomy: Taxonomy, topics: &[&str]) -> Result<Self, Error> {
        taxonomy.expect_topics(topics)?;
        Ok(Self(taxonomy))
    }

    /// Takes the sentences that come with the program; `None` if there are none for this domain and these topics.
    pub fn shipped(domain: &str, topics: &[&str]) -> Option<Self> {
        Self::new(shipped(domain).ok()?, topics).ok()
    }

    /// Finds a sentence for every message of an episode.
    ///
    /// # Errors
    ///
    /// [`Error::Words`] if the episode has a topic that the database does not know.
    pub fn speak(&self, played: Playthrough) -> Result<Spoken, Error> {
        let spoken = Spoken::from(played);
        let (played, messages) = (&spoken.played, &spoken.timeline.utterances);
        let told = messages.iter().map(|it| (it, &played.scenes[it.start].facts[..]));
        let told: Vec<(&LoggedMessage, &[&str])> = told.collect();
        let chosen = self.choose(played.seed, played.index, &told, Choosing::TrueInTurn)?;
        let sentence = |(message, chosen): (&LoggedMessage, Option<Chosen<'_>>)| {
            if let Some(Chosen { utterance, fallback }) = chosen {
                Sentence { text: utterance.text.clone(), cell: utterance.cell, fallback }
            } else {
                let text = format!("[{}]", topic_name(&played.scenes[0], message.topic));
                Sentence { text, cell: cell(message), fallback: false }
            }
        };
        let sentences = messages.iter().zip(chosen).map(sentence).collect();
        Ok(Spoken { sentences, ..spoken })
    }

    pub(super) fn taxonomy(&self) -> &Taxonomy {
        &self.0
    }

    /// Chooses a sentence for each message of an episode, given the facts that hold when it is begun; none where nothing true
    /// can be said.
    pub(super) fn choose(
        &self,
        seed: u64,
        index: u64,
        told: &[(&LoggedMessage, &[&str])],
        choosing: Choosing,
    ) -> Result<Vec<Option<Chosen<'_>>>, Error> {
        let mut generator = episode_seed(seed, index).stream(Purpose::Words);
        let mut rotation = Rotation::new(&self.0, &mut generator);
        let mut say = |(message, facts): &(&LoggedMessage, &[&str])| {
            let request = Request { topic: message.topic, cell: cell(message) };
            let holding = match choosing {
                Choosing::InTurn => FactSet::ALL,
                Choosing::TrueInTurn => self.0.facts_named(facts.iter().copied()),
            };
            let Some(found) = self.0.retrieve_true(request, holding)? else {
                return Ok(None);
            };
            let utterance = rotation.next(&found);
            Ok(utterance.map(|utterance| Chosen { utterance, fallback: found.fallback }))
        };
        told.iter().map(&mut say).collect()
    }
}

fn cell(message: &LoggedMessage) -> Cell {
    Cell::new(message.comprehension as u32, message.conveyance as u32)
}

/// An episode with the words of its messages, ready to be drawn and written out.
#[derive(Clone, Debug, PartialEq)]
pub struct Spoken {
    /// The episode, scene by scene.
    pub played: Playthrough,
    /// What happened in it, and when.
    pub timeline: Timeline,
    /// The words of each of the timeline's utterances; none without a [`Voice`].
    pub sentences: Vec<Sentence>,
}

impl Spoken {
    /// Joins an episode with the words of its messages, in order.
    pub fn new(played: Playthrough, sentences: Vec<Sentence>) -> Self {
        Self { timeline: Timeline::new(&played.scenes), played, sentences }
    }
}

/// Leaves the messages without words.
impl From<Playthrough> for Spoken {
    fn from(played: Playthrough) -> Self {
        Self::new(played, Vec::new())
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::TaskSpec;
    use leadtime_sims::Message;
    use leadtime_sims::notifier::CellTable;

    use super::*;
    use crate::playthrough::synthetic;

    fn lander() -> Voice {
        let topics = ["ascend", "shift_left", "shift_right", "descend"];
        Voice::shipped("lander", &topics).unwrap()
    }

    #[test]
    fn every_message_gets_a_sentence_of_its_topic_and_cell_in_turn() {
        let Spoken { timeline, sentences, .. } = lander().speak(synthetic::playthrough()).unwrap();
        assert_eq!(sentences.len(), timeline.utterances.len());
        let taxonomy = shipped("lander").unwrap();
        for (sentence, utterance) in sentences.iter().zip(&timeline.utterances) {
            let filed = taxonomy.topics()[utterance.topic].cell(sentence.cell);
            assert!(filed.iter().any(|utterance| utterance.text == sentence.text), "{sentence}");
            let asked = Cell::new(utterance.comprehension as u32, utterance.conveyance as u32);
            assert_eq!((sentence.cell, sentence.fallback), (asked, false));
        }
        // The same episode sounds the same; of twenty others, some do not.
        let again = lander().speak(synthetic::playthrough()).unwrap();
        assert_eq!(again.sentences, sentences);
        let differs = (0..20).any(|index| {
            let other = Playthrough { index, ..synthetic::playthrough() };
            lander().speak(other).unwrap().sentences != sentences
        });
        assert!(differs);
    }

    #[test]
    fn the_shipped_sentences_are_about_the_topics_of_the_built_in_domains() {
        let registry = leadtime_worlds::builtin();
        for domain in shipped::domains() {
            let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
            let mut environment = registry.build(&task).unwrap();
            let mut observation = vec![0.0; environment.spec().obs_dim];
            environment.reset(episode_seed(0, 0), &mut observation);
            let topics = environment.scene().unwrap().listener.topics;
            assert!(Voice::shipped(domain, &topics).is_some(), "{domain}: {topics:?}");
        }
        assert!(Voice::shipped("cartpole", &[]).is_none());
        assert!(Voice::shipped("lander", &["ascend"]).is_none());
    }

    #[test]
    fn what_a_notifier_learns_with_is_what_a_voice_says() {
        // Every table of up to three cells of one topic, and every choice.
        let all: Vec<Cell> = Cell::feasible(2, 5).collect();
        let header = "schema = 1\ndomain = \"d\"\nfidelity = \"grammar\"\ngenerator = \"g\"\nrater = \"r\"\n\
                      embedder = \"e\"\ntheta = 70\nwords = [2, 5]\ntopics = [\"a\"]\nconfig = \"\"\n";
        let entry = |cell: Cell| {
            let Cell { comprehension: k, conveyance: l } = cell;
            let text: Vec<String> = (0..l).map(|i| format!("w{k}{l}{i}")).collect();
            let curve: Vec<u32> = (1..=l).map(|i| if i < k { 10 } else { 90 }).collect();
            format!(
                "[[utterance]]\ntopic = \"a\"\ncomprehension = {k}\nconveyance = {l}\ntext = \"{}\"\n\
                 spans = [[\"what\", 0, {k}]]\ncurve = {curve:?}\n",
                text.join(" ")
            )
        };
        for bits in (1_u32..1 << all.len()).filter(|bits| bits.count_ones() <= 3) {
            let filled = (0..all.len()).filter(|i| bits >> i & 1 == 1).map(|i| all[i]);
            let text: String = filled.clone().map(entry).collect();
            let taxonomy = Taxonomy::from_toml(&format!("{header}{text}")).unwrap();
            let row = |cell: Cell| ("a".to_owned(), cell.comprehension, cell.conveyance);
            let table: Vec<_> = filled.map(row).collect();
            let cells = CellTable::new(&table, &["a"], &[0]).unwrap();
            for &cell in &all {
                let request = Request { topic: 0, cell };
                let said = taxonomy.retrieve_true(request, FactSet::ALL);
                let said = said.unwrap().unwrap().cell;
                let Cell { comprehension, conveyance } = cell;
                let learned = cells.nearest(Message { topic: 0, comprehension, conveyance });
                let learned = Cell::new(learned.comprehension, learned.conveyance);
                assert_eq!(learned, said, "{table:?}");
            }
        }
    }

    #[test]
    fn a_sentence_is_heard_word_by_word_and_whole_at_its_end() {
        let text = "Zone ahead - go up!".to_owned();
        let sentence = Sentence { text, cell: Cell::new(4, 4), fallback: false };
        let heard: Vec<String> = (0..=4).map(|heard| sentence.so_far(heard, 4)).collect();
        assert_eq!(heard, ["", "Zone", "Zone ahead", "Zone ahead - go", "Zone ahead - go up!"]);
        // As the stand-in of a message of two words, it is over after two.
        assert_eq!(sentence.so_far(1, 2), "Zone ahead");
        assert_eq!(sentence.so_far(2, 2), "Zone ahead - go up!");
    }
}
