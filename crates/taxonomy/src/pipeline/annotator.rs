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
//! `# ascend control` stand sentences in another order of words, which are rated but never proposed.

use std::collections::BTreeMap;

use super::backend::{Call, CallStage, Input, Model, Reply};
use super::error::BackendError;
use super::reply::joined;
use crate::utterance::{Cell, Fidelity};
use crate::words;

/// A sentence with its rating.
type RatedText = (String, Vec<u8>);

/// Answers from annotations.
#[derive(Clone, Debug)]
pub(super) struct Annotator {
    summary: String,
    /// By topic and cell, in the order of the file.
    sentences: BTreeMap<(String, Cell), Vec<RatedText>>,
    /// By topic, what is rated only.
    controls: BTreeMap<String, Vec<RatedText>>,
}

impl Annotator {
    /// Reads annotations; an error names the line.
    pub(super) fn parse(text: &str) -> Result<Self, BackendError> {
        let mut annotator =
            Self { summary: String::new(), sentences: BTreeMap::new(), controls: BTreeMap::new() };
        let mut section: Option<(String, Option<Cell>)> = None;
        let mut pending: Option<String> = None;
        for (i, line) in text.lines().enumerate() {
            let wrong = |what: &str| {
                BackendError::Local(format!("line {} of the annotations: {what}", i + 1))
            };
            if let Some(heading) = line.strip_prefix("# ") {
                section = match heading.trim() {
                    "summary" => None,
                    heading => Some(heading_of(heading).ok_or_else(|| {
                        wrong("a heading is `# summary`, `# TOPIC K L` or `# TOPIC control`")
                    })?),
                };
            } else if let Some((topic, cell)) = &section {
                if let Some(sentence) = line.strip_prefix("Instruction:") {
                    pending = Some(sentence.trim().to_owned());
                } else if let Some(numbers) = line.strip_prefix("Comprehension after each word:") {
                    let sentence =
                        pending.take().ok_or_else(|| wrong("there is no instruction"))?;
                    let curve = percentages(numbers, &sentence)
                        .ok_or_else(|| wrong("one percentage from 0 to 100 per word is needed"))?;
                    let topic = topic.clone();
                    let list = match cell {
                        Some(cell) => annotator.sentences.entry((topic, *cell)).or_default(),
                        None => annotator.controls.entry(topic).or_default(),
                    };
                    list.push((sentence, curve));
                } else if !line.trim().is_empty() && !line.starts_with("Words:") {
                    return Err(wrong("neither Instruction, Words nor Comprehension"));
                }
            } else {
                annotator.summary.push_str(line);
                annotator.summary.push('\n');
            }
        }
        let summary = annotator.summary.trim().to_owned();
        Ok(Self { summary, ..annotator })
    }

    fn generate(&self, topic: &str, cell: Cell, n: usize, round: u32) -> Reply {
        let all = self.sentences.get(&(topic.to_owned(), cell)).into_iter().flatten();
        Reply::page(all.map(|(text, _)| text.as_str()), n, round)
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

/// Reads a topic and its cell; no cell for controls.
fn heading_of(heading: &str) -> Option<(String, Option<Cell>)> {
    if let Some(topic) = heading.trim().strip_suffix(" control") {
        return Some((topic.trim().to_owned(), None));
    }
    let mut parts = heading.split_whitespace();
    let topic = parts.next()?.to_owned();
    let cell = Cell::new(parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    parts.next().is_none().then_some((topic, Some(cell)))
}

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

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        let found = match &call.input {
            Input::Domain => Some(Reply::complete(self.summary.clone())),
            Input::Sentences { topic, cell, n, round } => {
                Some(self.generate(topic, *cell, *n, *round))
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
    use crate::pipeline::Finish;

    const TEXT: &str = "# summary\nThe zone is near.\n\n# ascend 2 4\nInstruction: Go up, zone ahead.\n\
        Words: Go | up, | zone | ahead.\nComprehension after each word: 20, 90, 92, 95\n";

    #[test]
    fn what_was_written_is_what_is_answered() {
        let annotator = Annotator::parse(TEXT).unwrap();
        assert_eq!(annotator.summary, "The zone is near.");
        let reply = annotator.generate("ascend", Cell::new(2, 4), 8, 0);
        assert_eq!((reply.text.as_str(), reply.finish), ("Go up, zone ahead.", Finish::Stop));
        assert_eq!(annotator.generate("ascend", Cell::new(2, 4), 8, 1).finish, Finish::Exhausted);
        assert_eq!(annotator.generate("descend", Cell::new(2, 4), 8, 0).finish, Finish::Exhausted);
        let rating = annotator.rate("ascend", "Go up, zone ahead.", None).unwrap();
        assert!(TEXT.contains(&rating.text));
        let after = |topic, n| annotator.rate(topic, "Go up, zone ahead.", Some(n));
        assert_eq!(after("ascend", 2).unwrap().text, "90");
        assert_eq!(after("ascend", 0).unwrap().text, "0");
        assert!(after("descend", 2).is_none());
    }

    #[test]
    fn controls_are_rated_and_never_proposed() {
        let control = "# ascend control\nInstruction: ahead up zone go\nComprehension after each word: 5, 10, 20, 80\n";
        let annotator = Annotator::parse(&format!("{TEXT}\n{control}")).unwrap();
        assert_eq!(annotator.rate("ascend", "ahead up zone go", Some(4)).unwrap().text, "80");
        let reply = annotator.generate("ascend", Cell::new(2, 4), 8, 0);
        assert_eq!(reply.text, "Go up, zone ahead.");
    }

    #[test]
    fn a_wrong_line_is_named() {
        let cases = [
            ("20, 90, 92, 95", "20, 90, 95", "line 7 of the annotations: one percentage"),
            ("20, 90, 92, 95", "20, 90, 92, 195", "line 7 of the annotations: one percentage"),
            ("# ascend 2 4", "# ascend 2", "line 4 of the annotations: a heading is"),
            ("Words: Go", "Wrods: Go", "line 6 of the annotations: neither"),
            ("Instruction: Go up, zone ahead.", "", "line 7 of the annotations: there is no"),
        ];
        for (from, to, says) in cases {
            let error = Annotator::parse(&TEXT.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.starts_with(says), "{error}");
        }
    }
}
