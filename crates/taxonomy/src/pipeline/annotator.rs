//! Answers from a file of annotations: sentences and their word-by-word comprehension, written beforehand.
//!
//! The file is in the form that the prompts ask for, so it could have been pasted from a conversation:
//!
//! ```text
//! # summary
//! The start lies near the top-left zone.
//!
//! # ascend 2 4
//! Instruction: Go up, zone ahead.
//! Words: Go | up, | zone | ahead.
//! Comprehension after each word: 20, 90, 92, 95
//! ```
//!
//! A heading names the topic, k and l that were asked for; where a sentence lands its rating decides. Under
//! `# ascend control` stand sentences in another order of words, which are rated but never proposed. `Words` may be left
//! out, k and l as well, and so may the comprehension of a sentence: the plan's phrases rate it then.

use std::collections::BTreeMap;

use super::backend::{Call, CallStage, Input, Model, Reply};
use super::complete::Completer;
use super::error::BackendError;
use super::plan::DatabasePlan;
use super::reply::{self, joined};
use crate::utterance::{Cell, Fidelity};
use crate::words;

type RatedText = (String, Vec<u8>);

/// Answers with what a file of annotations says; no model is asked.
#[derive(Clone, Debug)]
pub(super) struct Annotator {
    summary: String,
    /// By topic and cell, in the order of the file.
    sentences: BTreeMap<(String, Cell), Vec<RatedText>>,
    /// By topic, what is rated only.
    controls: BTreeMap<String, Vec<RatedText>>,
}

impl Annotator {
    /// Reads annotations for a plan; an error names the line.
    pub(super) fn parse(text: &str, plan: &DatabasePlan) -> Result<Self, BackendError> {
        let mut annotator =
            Self { summary: String::new(), sentences: BTreeMap::new(), controls: BTreeMap::new() };
        let completer = Completer::new(plan);
        let mut section: Option<AnnotationSection> = None;
        let mut pending: Option<UnratedSentence> = None;
        for (line, number) in text.lines().zip(1..) {
            let wrong = |what: &str| wrong(number, what);
            if let Some(heading) = line.strip_prefix("# ") {
                annotator.add_unrated(pending.take(), section.as_ref(), &completer)?;
                section = match heading.trim() {
                    "summary" => None,
                    heading => {
                        Some(AnnotationSection::parse(heading, plan).map_err(|what| wrong(&what))?)
                    }
                };
            } else if let Some(section) = &section {
                if let Some(sentence) = line.strip_prefix("Instruction:") {
                    annotator.add_unrated(pending.take(), Some(section), &completer)?;
                    pending = Some(UnratedSentence::read(sentence, number)?);
                } else if let Some(numbers) = line.strip_prefix("Comprehension after each word:") {
                    let UnratedSentence { text, .. } =
                        pending.take().ok_or_else(|| wrong("there is no instruction"))?;
                    let curve = percentages(numbers, &text)
                        .ok_or_else(|| wrong("one percentage from 0 to 100 per word is needed"))?;
                    let landed = || completer.cell(&curve).map_err(|what| wrong(&what));
                    let cell = match section.cell {
                        // Where it lands is measured again; here it decides under which cell it is proposed.
                        None if !section.is_control => Some(landed()?),
                        cell => cell,
                    };
                    annotator.add(section, cell, text, curve);
                } else if !line.trim().is_empty() && !line.starts_with("Words:") {
                    return Err(wrong("neither Instruction, Words nor Comprehension"));
                }
            } else {
                annotator.summary.push_str(line);
                annotator.summary.push('\n');
            }
        }
        annotator.add_unrated(pending, section.as_ref(), &completer)?;
        let summary = annotator.summary.trim().to_owned();
        Ok(Self { summary, ..annotator })
    }

    fn add(
        &mut self,
        section: &AnnotationSection,
        cell: Option<Cell>,
        text: String,
        curve: Vec<u8>,
    ) {
        let topic = section.topic.clone();
        let list = match cell {
            Some(cell) if !section.is_control => self.sentences.entry((topic, cell)).or_default(),
            _ => self.controls.entry(topic).or_default(),
        };
        list.push((text, curve));
    }

    /// Rates a sentence without a rating by the plan's phrases, and adds it.
    fn add_unrated(
        &mut self,
        pending: Option<UnratedSentence>,
        section: Option<&AnnotationSection>,
        completer: &Completer<'_>,
    ) -> Result<(), BackendError> {
        let (Some(UnratedSentence { text, number }), Some(section)) = (pending, section) else {
            return Ok(());
        };
        if section.is_control {
            return Err(wrong(number, "a control needs its comprehension after each word"));
        }
        let rated = completer.rate(&section.topic, &text).map_err(|what| {
            let text = format!("\"{text}\" has no comprehension after each word, and {what}");
            wrong(number, &text)
        });
        let (cell, curve) = rated?;
        self.add(section, Some(section.cell.unwrap_or(cell)), text, curve);
        Ok(())
    }

    /// Returns every sentence of a cell at once, however many were asked for: nothing that was written may vanish.
    fn generate(&self, topic: &str, cell: Cell, round: u32) -> Reply {
        let all = self.sentences.get(&(topic.to_owned(), cell)).into_iter().flatten();
        let all = all.take(if round == 0 { usize::MAX } else { 0 });
        Reply::page(all.map(|(text, _)| text.as_str()), usize::MAX, 0)
    }

    fn rate(&self, topic: &str, text: &str, n_words: Option<usize>) -> Option<Reply> {
        let of_topic = self.sentences.iter().filter(|((id, _), _)| id == topic);
        let said = of_topic.flat_map(|(_, list)| list);
        let mut all = said.chain(self.controls.get(topic).into_iter().flatten());
        let (text, curve) = all.find(|(other, _)| other == text)?;
        if let Some(n) = n_words {
            let percent = n.checked_sub(1).and_then(|word| curve.get(word)).copied();
            return Some(Reply::complete(percent.unwrap_or_default().to_string()));
        }
        let spoken: Vec<&str> = text.split_whitespace().collect();
        let (spoken, numbers) = (spoken.join(" | "), joined(curve));
        Some(Reply::complete(format!(
            "Instruction: {text}\nWords: {spoken}\nComprehension after each word: {numbers}"
        )))
    }
}

/// A sentence that waits for its rating, and the number of its line.
#[derive(Debug)]
struct UnratedSentence {
    text: String,
    number: usize,
}

impl UnratedSentence {
    fn read(sentence: &str, number: usize) -> Result<Self, BackendError> {
        let text = sentence.trim().to_owned();
        // The reader of replies takes it apart again: what that would drop or cut is refused here.
        let is_one = reply::sentences(&Reply::complete(&text)).whole == [text.as_str()];
        let says = "this is not one sentence; no list, and no colon at its end";
        if is_one { Ok(Self { text, number }) } else { Err(wrong(number, says)) }
    }
}

/// What the sentences below a heading are.
#[derive(Debug)]
struct AnnotationSection {
    topic: String,
    /// Where they should land; where they do, if none is given.
    cell: Option<Cell>,
    is_control: bool,
}

impl AnnotationSection {
    /// Reads a heading; the error says what is wrong with it.
    fn parse(heading: &str, plan: &DatabasePlan) -> Result<Self, String> {
        let form =
            || "a heading is `# summary`, `# TOPIC`, `# TOPIC K L` or `# TOPIC control`".to_owned();
        let parts: Vec<&str> = heading.split_whitespace().collect();
        let (topic, cell, is_control) = match parts[..] {
            [topic] => (topic, None, false),
            [topic, "control"] => (topic, None, true),
            [topic, k, l] => {
                let number = |text: &str| text.parse().map_err(|_not_a_number| form());
                (topic, Some(Cell::new(number(k)?, number(l)?)), false)
            }
            _ => return Err(form()),
        };
        if plan.topic_idx(topic).is_none() {
            let known: Vec<&str> = plan.topic.iter().map(|topic| topic.id.as_str()).collect();
            return Err(format!("topic `{topic}` is not in the plan: {}", known.join(", ")));
        }
        let [from, to] = plan.words;
        if let Some(cell) =
            cell.filter(|cell| !Cell::feasible(from, to).any(|other| other == *cell))
        {
            return Err(format!("(k, l) is {cell}; allowed: {from} <= k <= l <= {to}"));
        }
        Ok(Self { topic: topic.to_owned(), cell, is_control })
    }
}

fn wrong(number: usize, what: &str) -> BackendError {
    BackendError::Local(format!("line {number} of the annotations: {what}"))
}

/// Reads one percentage per word.
fn percentages(numbers: &str, sentence: &str) -> Option<Vec<u8>> {
    let list: Vec<u8> =
        numbers.split(',').map(|number| number.trim().parse().ok()).collect::<Option<_>>()?;
    let fits = list.len() == words::count(sentence) as usize && list.iter().all(|p| *p <= 100);
    fits.then_some(list)
}

impl Model for Annotator {
    fn id(&self) -> &'static str {
        "annotator (a language model writing by hand, no sampled run)"
    }

    fn fidelity(&self) -> Fidelity {
        Fidelity::Authored
    }

    fn holds(&self, topic: &str, cell: Cell) -> bool {
        self.sentences.contains_key(&(topic.to_owned(), cell))
    }

    fn is_written(&self) -> bool {
        true
    }

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        let found = match &call.input {
            Input::Domain => Some(Reply::complete(self.summary.clone())),
            Input::Sentences { topic, cell, round, .. } => {
                Some(self.generate(topic, *cell, *round))
            }
            Input::Sentence { topic, text, words } => self.rate(topic, text, *words),
            Input::Text { .. } => None,
        };
        // Controls are welcome and not owed.
        let found = found.or_else(|| (call.stage == CallStage::Control).then(Reply::exhausted));
        found.ok_or_else(|| BackendError::Local(format!("the annotations lack {}", call.what())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{Finish, job};

    const TEXT: &str = "# summary\nThe zone is near.\n\n# ascend 2 4\nInstruction: Go up, zone ahead.\n\
        Words: Go | up, | zone | ahead.\nComprehension after each word: 20, 90, 92, 95\n";

    fn parse(text: &str) -> Result<Annotator, BackendError> {
        Annotator::parse(text, &job::plan("lander").unwrap())
    }

    #[test]
    fn what_was_written_is_what_is_answered() {
        let annotator = parse(TEXT).unwrap();
        assert_eq!(annotator.summary, "The zone is near.");
        let reply = annotator.generate("ascend", Cell::new(2, 4), 0);
        assert_eq!((reply.text.as_str(), reply.finish), ("Go up, zone ahead.", Finish::Stop));
        assert_eq!(annotator.generate("ascend", Cell::new(2, 4), 1).finish, Finish::Exhausted);
        assert_eq!(annotator.generate("descend", Cell::new(2, 4), 0).finish, Finish::Exhausted);
        let rating = annotator.rate("ascend", "Go up, zone ahead.", None).unwrap();
        assert!(TEXT.contains(&rating.text));
        let after = |topic, n| annotator.rate(topic, "Go up, zone ahead.", Some(n));
        assert_eq!(after("ascend", 2).unwrap().text, "90");
        assert_eq!(after("ascend", 0).unwrap().text, "0");
        assert!(after("descend", 2).is_none());
    }

    #[test]
    fn a_sentence_needs_only_its_topic() {
        let text = "# ascend\nInstruction: Zone ahead, go up.\nInstruction: Go up now.\n# ascend 3 3\n\
            Instruction: Please go up.\n# descend\nInstruction: Go down gently.\nComprehension after each word: 5, 9, 80\n";
        let annotator = parse(text).unwrap();
        let reply = |topic, k, l| annotator.generate(topic, Cell::new(k, l), 0).text;
        assert_eq!(reply("ascend", 4, 4), "Zone ahead, go up.");
        assert_eq!(reply("ascend", 2, 3), "Go up now.");
        assert_eq!(reply("ascend", 3, 3), "Please go up.");
        assert_eq!(reply("descend", 3, 3), "Go down gently.");
        let rating = annotator.rate("ascend", "Zone ahead, go up.", None).unwrap().text;
        assert!(rating.ends_with("Comprehension after each word: 10, 20, 30, 95"), "{rating}");
    }

    #[test]
    fn more_sentences_than_a_call_asks_for_are_proposed_as_well() {
        let manners =
            ["now", "quickly", "gently", "slowly", "carefully", "soon", "here", "again", "instead"];
        let sentences = manners.map(|how| format!("Instruction: Go up {how}.\n")).concat();
        let annotator = parse(&format!("# ascend 2 3\n{sentences}")).unwrap();
        let reply = annotator.generate("ascend", Cell::new(2, 3), 0);
        assert_eq!(reply.text.lines().count(), manners.len());
    }

    #[test]
    fn controls_are_rated_and_never_proposed() {
        let control = "# ascend control\nInstruction: ahead up zone go\nComprehension after each word: 5, 10, 20, 80\n\
            Instruction: zone up\nComprehension after each word: 5, 10\n";
        let annotator = parse(&format!("{TEXT}\n{control}")).unwrap();
        // Not understood at all, it has no cell; it needs none.
        assert_eq!(annotator.rate("ascend", "zone up", Some(2)).unwrap().text, "10");
        assert_eq!(annotator.rate("ascend", "ahead up zone go", Some(4)).unwrap().text, "80");
        let reply = annotator.generate("ascend", Cell::new(2, 4), 0);
        assert_eq!(reply.text, "Go up, zone ahead.");
    }

    #[test]
    fn a_wrong_line_is_named() {
        let sentence = "Instruction: Go up, zone ahead.";
        let cases = [
            ("20, 90, 92, 95", "20, 90, 95", "line 7 of the annotations: one percentage"),
            ("20, 90, 92, 95", "20, 90, 92, 195", "line 7 of the annotations: one percentage"),
            ("# ascend 2 4", "# ascend 2", "line 4 of the annotations: a heading is"),
            (
                "# ascend 2 4",
                "# asend 2 4",
                "line 4 of the annotations: topic `asend` is not in the plan: ascend,",
            ),
            (
                "# ascend 2 4",
                "# ascend 4 2",
                "line 4 of the annotations: (k, l) is (4, 2); allowed: 2 <= k <= l <= 5",
            ),
            ("Words: Go", "Wrods: Go", "line 6 of the annotations: neither"),
            (sentence, "", "line 7 of the annotations: there is no"),
            (
                sentence,
                "Instruction: Go up:",
                "line 5 of the annotations: this is not one sentence",
            ),
            (
                sentence,
                "Instruction: Higher, please.\nInstruction: Go up, zone ahead.",
                "line 5 of the annotations: \"Higher, please.\" has no comprehension after each word, and it cannot be \
                 taken apart (`no_directive`): add a phrase to `what` or `also_what` of topic `ascend` in the plan",
            ),
            (
                sentence,
                "Instruction: Go down.\nInstruction: Go up, zone ahead.",
                "line 5 of the annotations: \"Go down.\" has no comprehension after each word, and it says what topic \
                 `descend` says",
            ),
            (
                "# ascend 2 4",
                "# ascend control\nInstruction: up go\n# ascend 2 4",
                "line 5 of the annotations: a control needs its comprehension after each word",
            ),
        ];
        for (from, to, says) in cases {
            let error = parse(&TEXT.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.starts_with(says), "{error}");
        }
    }
}
