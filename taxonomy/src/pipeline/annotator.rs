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
//! A heading names the topic, k and l that were asked for; where a sentence lands its rating decides.

use std::collections::BTreeMap;

use super::backend::{Call, Finish, Input, Model, Reply};
use super::error::BackendError;
use crate::utterance::{Cell, Fidelity};
use crate::words;

/// Who wrote the annotations that come with the crate.
pub const AUTHORED: &str = "annotator (a language model writing by hand, no sampled run)";

/// A sentence with its rating.
type Rated = (String, Vec<u8>);

/// Answers from annotations.
#[derive(Clone, Debug)]
pub struct Annotator {
    summary: String,
    /// By topic and cell, in the order of the file.
    sentences: BTreeMap<(String, Cell), Vec<Rated>>,
}

impl Annotator {
    /// Reads annotations.
    ///
    /// # Errors
    ///
    /// [`BackendError::Annotations`] naming the line.
    pub fn parse(text: &str) -> Result<Self, BackendError> {
        let mut annotator = Self { summary: String::new(), sentences: BTreeMap::new() };
        let mut section: Option<(String, Cell)> = None;
        let mut pending: Option<String> = None;
        for (i, line) in text.lines().enumerate() {
            let wrong = |message: &str| BackendError::Annotations {
                line: i + 1,
                message: message.to_owned(),
            };
            if let Some(heading) = line.strip_prefix("# ") {
                section = match heading.trim() {
                    "summary" => None,
                    heading => Some(
                        heading_of(heading)
                            .ok_or_else(|| wrong("a heading is `# summary` or `# TOPIC K L`"))?,
                    ),
                };
            } else if let Some(key) = &section {
                if let Some(sentence) = line.strip_prefix("Instruction:") {
                    pending = Some(sentence.trim().to_owned());
                } else if let Some(numbers) = line.strip_prefix("Comprehension after each word:") {
                    let sentence =
                        pending.take().ok_or_else(|| wrong("there is no instruction"))?;
                    let curve = percentages(numbers, &sentence)
                        .ok_or_else(|| wrong("one percentage from 0 to 100 per word is needed"))?;
                    annotator.sentences.entry(key.clone()).or_default().push((sentence, curve));
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

    fn generate(&self, topic: &str, cell: Cell, (n, round): (usize, u32)) -> Reply {
        let key = (topic.to_owned(), cell);
        let all = self.sentences.get(&key).map(Vec::as_slice).unwrap_or_default();
        let rest = all.iter().skip(n * round as usize).take(n);
        let lines: Vec<&str> = rest.map(|(text, _)| text.as_str()).collect();
        let finish = if lines.is_empty() { Finish::Exhausted } else { Finish::Stop };
        Reply { text: lines.join("\n"), finish, tokens: None }
    }

    fn rate(&self, topic: &str, text: &str, n_words: Option<usize>) -> Result<Reply, BackendError> {
        let of_topic = self.sentences.iter().filter(|((id, _), _)| id == topic);
        let found = of_topic.flat_map(|(_, list)| list).find(|(other, _)| other == text);
        let Some((text, curve)) = found else {
            let what = format!("a rating of \"{text}\" for topic `{topic}`");
            return Err(BackendError::NotAnnotated { what });
        };
        if let Some(n) = n_words {
            let percent = curve.get(n.saturating_sub(1)).copied().unwrap_or_default();
            return Ok(Reply::complete(percent.to_string()));
        }
        let spoken: Vec<&str> = text.split_whitespace().collect();
        let numbers: Vec<String> = curve.iter().map(u8::to_string).collect();
        Ok(Reply::complete(format!(
            "Instruction: {text}\nWords: {}\nComprehension after each word: {}",
            spoken.join(" | "),
            numbers.join(", ")
        )))
    }
}

fn heading_of(heading: &str) -> Option<(String, Cell)> {
    let mut parts = heading.split_whitespace();
    let topic = parts.next()?.to_owned();
    let cell = Cell::new(parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    parts.next().is_none().then_some((topic, cell))
}

fn percentages(numbers: &str, sentence: &str) -> Option<Vec<u8>> {
    let list: Vec<u8> =
        numbers.split(',').map(|number| number.trim().parse().ok()).collect::<Option<_>>()?;
    let fits = list.len() == words::count(sentence) as usize && list.iter().all(|p| *p <= 100);
    fits.then_some(list)
}

impl Model for Annotator {
    fn id(&self) -> &'static str {
        AUTHORED
    }

    fn fidelity(&self) -> Fidelity {
        Fidelity::Authored
    }

    fn complete(&mut self, call: &Call) -> Result<Reply, BackendError> {
        match &call.input {
            Input::Domain => Ok(Reply::complete(self.summary.clone())),
            Input::Sentences { topic, cell, n, round } => {
                Ok(self.generate(topic, *cell, (*n, *round)))
            }
            Input::Sentence { topic, text, words } => self.rate(topic, text, *words),
            Input::Text { .. } => Err(BackendError::NotAnnotated { what: call.what() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# summary\nThe zone is near.\n\n# ascend 2 4\nInstruction: Go up, zone ahead.\n\
        Words: Go | up, | zone | ahead.\nComprehension after each word: 20, 90, 92, 95\n";

    #[test]
    fn what_was_written_is_what_is_answered() {
        let annotator = Annotator::parse(TEXT).unwrap();
        assert_eq!(annotator.summary, "The zone is near.");
        let reply = annotator.generate("ascend", Cell::new(2, 4), (8, 0));
        assert_eq!((reply.text.as_str(), reply.finish), ("Go up, zone ahead.", Finish::Stop));
        assert_eq!(annotator.generate("ascend", Cell::new(2, 4), (8, 1)).finish, Finish::Exhausted);
        assert_eq!(
            annotator.generate("descend", Cell::new(2, 4), (8, 0)).finish,
            Finish::Exhausted
        );
        let rating = annotator.rate("ascend", "Go up, zone ahead.", None).unwrap();
        assert!(TEXT.contains(&rating.text));
        assert_eq!(annotator.rate("ascend", "Go up, zone ahead.", Some(2)).unwrap().text, "90");
        let error = annotator.rate("descend", "Go up, zone ahead.", None).unwrap_err();
        assert!(error.to_string().starts_with("the annotations lack a rating of"), "{error}");
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
