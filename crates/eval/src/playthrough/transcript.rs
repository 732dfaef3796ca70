//! An episode as a listener would hear it: each word when it is spoken, what they understood, what they did.
//!
//! ```text
//!    time  hears      understands                does
//!   1.8 s  Zone                                  own plan
//!   2.1 s  ahead,
//!   2.4 s  go
//!   2.7 s  up.        ascend, word 4 of 4
//!   3.6 s                                        follows ascend
//! ```

use leadtime_proto::phrase::counted;
use leadtime_table::{columns, padded};

use super::record::Playthrough;
use super::timeline::{Activity, topic_name};
use super::voice::Spoken;
use crate::measure::LoggedMessage;

/// How fast sentences are spoken.
///
/// # Source
///
/// arXiv:2509.07438 takes 0.3 s per word. A speech synthesiser took 0.335 s per word over sentences of two to
/// five words (20 sentences, three voices), people read at about 0.4.
const SECONDS_PER_WORD: f64 = 0.3;

/// One moment in which something happens; empty text where nothing does.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Moment {
    step: usize,
    hears: String,
    understands: String,
    does: String,
}

impl Spoken {
    /// Writes the episode word by word; without sentences, a word is its number in the message on a topic.
    ///
    /// # Units
    ///
    /// Times are those of speech: a step is a word, whatever time the world takes it for.
    pub fn transcript(&self) -> String {
        let moments = self.moments_of_change();
        let widest = |text: fn(&Moment) -> &String, title: &str| {
            let widths = moments.iter().map(|moment| columns(text(moment)));
            widths.fold(title.len(), usize::max)
        };
        let hears = widest(|moment| &moment.hears, "hears");
        let understands = widest(|moment| &moment.understands, "understands");
        let mut out = self.heading();
        let mut line = |time: &str, [first, second, third]: [&str; 3]| {
            let (first, second) = (padded(first, hears), padded(second, understands));
            let line = format!("{time:>8}  {first}  {second}  {third}");
            out.extend([line.trim_end(), "\n"]);
        };
        line("time", ["hears", "understands", "does"]);
        for moment in &moments {
            let seconds = moment.step as f64 * SECONDS_PER_WORD;
            let Moment { hears, understands, does, .. } = moment;
            line(&format!("{seconds:.1} s"), [hears, understands, does]);
        }
        out + &self.stand_ins()
    }

    fn heading(&self) -> String {
        let Playthrough { index, seed, total_reward, .. } = &self.played;
        format!(
            "{} (episode {index} of seed {seed})\nreturn {total_reward:.1}, {} steps of a word each, {} s; {}\n",
            self.played.title(),
            self.played.n_steps(),
            SECONDS_PER_WORD,
            self.n_notifications(),
        )
    }

    fn n_notifications(&self) -> String {
        counted(self.timeline.utterances.len(), "notification")
    }

    /// Writes the episode's numbers in a line.
    pub fn numbers(&self) -> String {
        let Playthrough { index, seed, total_reward, .. } = &self.played;
        let (n_steps, said) = (self.played.n_steps(), self.n_notifications());
        format!(
            "return {total_reward:.1} \u{b7} {n_steps} steps \u{b7} {said} \u{b7} episode {index} of seed {seed}"
        )
    }

    /// Lists the moments in which a word is heard, something is understood, or the listener begins to do another thing.
    fn moments_of_change(&self) -> Vec<Moment> {
        let timeline = &self.timeline;
        let (mut moments, mut did) = (Vec::new(), String::new());
        for step in 1..=self.played.n_steps() {
            let mut moment = Moment { step, ..Moment::default() };
            if let Some(said) = timeline.spoken(step) {
                let utterance = &timeline.utterances[said];
                let (n, l) = (step - utterance.start, utterance.conveyance);
                moment.hears = self.word(said, utterance, n);
                // What is understood before its first word is understood in that word's step.
                let first = utterance.start + 1;
                if utterance.understood().map(|at| at.max(first)) == Some(step) {
                    let topic = topic_name(&self.played.scenes[0], utterance.topic);
                    moment.understands = format!("{topic}, word {n} of {l}");
                }
            }
            let does = self.does(step);
            if does != did {
                moment.does.clone_from(&does);
                did = does;
            }
            if moment != (Moment { step, ..Moment::default() }) {
                moments.push(moment);
            }
        }
        moments
    }

    /// Returns the `n`-th word of a message as it is written, with a dash where it is cut off.
    fn word(&self, said: usize, utterance: &LoggedMessage, n: usize) -> String {
        let conveyance = utterance.conveyance;
        let word = if let Some(sentence) = self.sentences.get(said) {
            let before = sentence.so_far(n - 1, conveyance).len();
            sentence.so_far(n, conveyance)[before..].trim().to_owned()
        } else {
            let topic = topic_name(&self.played.scenes[0], utterance.topic);
            format!("[{topic} {n}/{conveyance}]")
        };
        if utterance.start + n == utterance.end && n < conveyance {
            // Where the voice breaks off, no comma is heard.
            let heard = word.trim_end_matches([',', ';', ':']);
            return format!("{heard} \u{2013}");
        }
        word
    }

    /// Describes what the listener does in the step that leads to scene `step`.
    fn does(&self, step: usize) -> String {
        let listener = &self.played.scenes[step].listener;
        match (self.timeline.activities[step - 1], listener.reacting) {
            (Activity::Following, Some(topic)) => {
                format!("follows {}", topic_name(&self.played.scenes[0], topic))
            }
            (Activity::Waiting, _) => "about to react".to_owned(),
            _ => Activity::OwnPlan.label().to_owned(),
        }
    }

    /// Lists which sentences stand for messages of another k or l.
    fn stand_ins(&self) -> String {
        let said = self.sentences.iter().zip(&self.timeline.utterances);
        let lines = said.filter(|(sentence, _)| sentence.fallback).map(|(sentence, utterance)| {
            let (k, l, cell) = (utterance.comprehension, utterance.conveyance, sentence.cell);
            format!("{sentence} is understood and over at {cell}; the message was at ({k}, {l})\n")
        });
        lines.collect()
    }
}

#[cfg(test)]
mod tests {
    use leadtime_sims::Scene;
    use leadtime_sims::human::{Comprehension, HumanSettings, ReactionDelay, SpeechAct};
    use leadtime_taxonomy::Cell;

    use super::*;
    use crate::playthrough::{Sentence, synthetic};

    fn played() -> Playthrough {
        // Said at 2 with k = 2, l = 3: comprehended at 4, two steps of delay, followed from 7 to 9. The second one is
        // cut off at 14 by the third.
        let scenes = synthetic::scenes(20, &[(2, 1, 2, 3), (11, 0, 4, 5), (14, 3, 2, 2)]);
        let player = "trained".to_owned();
        Playthrough { player, scenes, ..synthetic::playthrough() }
    }

    fn sentence(text: &str, k: u32, l: u32, fallback: bool) -> Sentence {
        Sentence { text: text.to_owned(), cell: Cell::new(k, l), fallback }
    }

    #[test]
    fn words_come_one_by_one_and_actions_when_they_change() {
        let sentences = vec![
            sentence("Shift left, now!", 2, 3, false),
            sentence("Zone ahead, go, up.", 4, 4, true),
            sentence("Go down.", 2, 2, false),
        ];
        let expected = "\
trained: success (episode 3 of seed 7)
return 215.4, 19 steps of a word each, 0.3 s; 3 notifications
    time  hears   understands              does
   0.3 s                                   own plan
   0.9 s  Shift
   1.2 s  left,   shift left, word 2 of 3
   1.5 s  now!                             about to react
   2.1 s                                   follows shift left
   3.0 s                                   own plan
   3.6 s  Zone
   3.9 s  ahead,
   4.2 s  go \u{2013}
   4.5 s  Go
   4.8 s  down.   descend, word 2 of 2
   5.1 s                                   about to react
   5.7 s                                   follows descend
\u{201c}Zone ahead, go, up.\u{201d} is understood and over at (4, 4); the message was at (4, 5)
";
        let spoken = Spoken::new(played(), sentences);
        assert_eq!(spoken.transcript(), expected);
    }

    fn told(scenes: Vec<Scene>) -> String {
        Spoken::from(Playthrough { scenes, ..synthetic::playthrough() }).transcript()
    }

    #[test]
    fn a_message_is_understood_in_the_word_with_which_its_listener_understands_it() {
        let acts = [synthetic::ascend(3, 5), SpeechAct::Continue, SpeechAct::Continue];
        let sooner = told(synthetic::lander(|human| human.words_from = 0, &acts));
        assert!(sooner.contains("[ascend 2/5]    ascend, word 2 of 5"), "{sooner}");
        let at_once = |human: &mut HumanSettings| {
            human.comprehension = Comprehension::Immediate;
            human.reaction_delay = ReactionDelay::Fixed(0);
        };
        let at_once = told(synthetic::lander(at_once, &acts));
        let row = "[ascend 1/5]    ascend, word 1 of 5  follows ascend";
        assert!(at_once.contains(row), "{at_once}");
        assert_eq!(at_once.matches("ascend, word").count(), 1, "{at_once}");
    }

    #[test]
    fn a_message_that_is_stopped_has_the_words_that_were_heard() {
        let acts = [synthetic::ascend(3, 3), SpeechAct::Continue, SpeechAct::Stop];
        let stopped = told(synthetic::lander(|human| human.can_stop = true, &acts));
        assert!(stopped.contains("[ascend 2/3] \u{2013}"), "{stopped}");
        assert!(!stopped.contains("3/3") && !stopped.contains("ascend, word"), "{stopped}");
    }

    #[test]
    fn without_sentences_words_are_numbers() {
        let told = Spoken::from(played()).transcript();
        assert!(told.contains("[shift left 2/3]  shift left, word 2 of 3"), "{told}");
        assert!(told.contains("[ascend 3/5] \u{2013}"), "{told}");
        assert!(told.contains("[descend 1/2]"), "{told}");
        let mut played = played();
        played.scenes.truncate(1);
        assert_eq!(Spoken::from(played).transcript().lines().count(), 3);
    }
}
