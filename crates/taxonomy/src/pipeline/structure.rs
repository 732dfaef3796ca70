//! What, How and Why by phrase lists: which words say what to do, how, and for what reason.

use super::candidate::Reason;
use super::plan::{DatabasePlan, TopicPlan};
use crate::utterance::{SpanKind, WordSpan};
use crate::words;

#[derive(Clone, Debug)]
struct Phrases {
    statement: bool,
    what: Vec<Vec<String>>,
}

/// Knows how the topics of a domain are said.
#[derive(Clone, Debug)]
pub(super) struct Lexicon {
    topics: Vec<Phrases>,
    how: Vec<Vec<String>>,
    fillers: Vec<String>,
}

/// A sentence taken apart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Structure {
    /// Index of the topic that its directive belongs to.
    pub(super) topic: usize,
    /// What, How, Why, in order.
    pub(super) spans: Vec<WordSpan>,
}

impl Lexicon {
    /// Collects a plan's phrases.
    pub(super) fn new(plan: &DatabasePlan) -> Self {
        let split = |phrases: &[String], also: &[String]| {
            phrases.iter().chain(also).map(|phrase| words::words(phrase)).collect()
        };
        let topic = |topic: &TopicPlan| Phrases {
            statement: topic.statement,
            what: split(&topic.what, &topic.also_what),
        };
        Self {
            topics: plan.topic.iter().map(topic).collect(),
            how: split(&plan.how, &plan.also_how),
            fillers: plan.fillers.clone(),
        }
    }

    /// Takes a sentence apart.
    ///
    /// Facts are looked for only where nothing says what to do: "Board full, go right." says to go right.
    pub(super) fn analyse(&self, words: &[String]) -> Result<Structure, Reason> {
        let mut directives = self.find(words, false);
        if directives.is_empty() {
            // Further facts of a sentence support the first.
            directives = self.find(words, true);
            directives.truncate(1);
        }
        match directives[..] {
            [] => Err(Reason::NoDirective),
            [(topic, what)] => Ok(Structure { topic, spans: self.spans(words, what) }),
            _ => Err(Reason::TwoDirectives),
        }
    }

    /// Lists the directives (or the facts) of a sentence: of phrases that start with the same word, the longest.
    fn find(&self, words: &[String], statement: bool) -> Vec<(usize, WordSpan)> {
        let mut found = Vec::new();
        let mut from = 0;
        while from < words.len() {
            let topics = self.topics.iter().enumerate();
            let phrases = topics.filter(|(_, topic)| topic.statement == statement);
            let longest = phrases
                .filter_map(|(i, topic)| Some((longest(&topic.what, &words[from..])?, i)))
                .max_by_key(|(n, i)| (*n, std::cmp::Reverse(*i)));
            match longest {
                Some((n, topic)) => {
                    found.push((topic, span(SpanKind::What, from, from + n)));
                    from += n;
                }
                None => from += 1,
            }
        }
        found
    }

    fn spans(&self, words: &[String], what: WordSpan) -> Vec<WordSpan> {
        let mut spans = Vec::new();
        let mut reason: Option<(usize, usize)> = None;
        let mut from = 0;
        while from < words.len() {
            let how = longest(&self.how, &words[from..])
                .filter(|n| from >= what.to as usize || from + n <= what.from as usize);
            let how = how.map(|n| span(SpanKind::How, from, from + n));
            let next = if from == what.from as usize { Some(what) } else { how };
            if let Some(span) = next {
                spans.extend(self.reason(words, reason.take()));
                spans.push(span);
                from = span.to as usize;
            } else {
                reason = Some((reason.map_or(from, |(start, _)| start), from + 1));
                from += 1;
            }
        }
        spans.extend(self.reason(words, reason));
        spans
    }

    /// Makes a reason of words that are nothing else, unless they are only fillers.
    fn reason(&self, words: &[String], run: Option<(usize, usize)>) -> Option<WordSpan> {
        let (mut from, mut to) = run?;
        let filler = |i: usize| self.fillers.contains(&words[i]);
        while from < to && filler(from) {
            from += 1;
        }
        while from < to && filler(to - 1) {
            to -= 1;
        }
        (from < to).then_some(span(SpanKind::Why, from, to))
    }
}

fn span(part: SpanKind, from: usize, to: usize) -> WordSpan {
    WordSpan { part, from: from as u32, to: to as u32 }
}

/// Returns the length of the longest phrase that `words` starts with.
fn longest(phrases: &[Vec<String>], words: &[String]) -> Option<usize> {
    let starts = |phrase: &&Vec<String>| !phrase.is_empty() && words.starts_with(phrase);
    phrases.iter().filter(starts).map(Vec::len).max()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::job;

    /// Topic and spans, as they are easiest to compare.
    type Analysed = (String, Vec<(SpanKind, u32, u32)>);

    fn analyse(domain: &str, text: &str) -> Result<Analysed, Reason> {
        let plan = job::plan(domain).unwrap();
        let structure = Lexicon::new(&plan).analyse(&words::words(text))?;
        let spans = structure.spans.into_iter().map(Into::into).collect();
        Ok((plan.topic[structure.topic].id.clone(), spans))
    }

    #[test]
    fn a_sentence_falls_into_what_how_and_why() {
        let (topic, spans) = analyse("lander", "Avoid top-left danger zone, ascend.").unwrap();
        assert_eq!(topic, "ascend");
        assert_eq!(spans, [(SpanKind::Why, 0, 4), (SpanKind::What, 4, 5)]);
        let (topic, spans) = analyse("highway", "Now slow down, traffic ahead.").unwrap();
        assert_eq!(topic, "slow_down");
        assert_eq!(spans, [(SpanKind::How, 0, 1), (SpanKind::What, 1, 3), (SpanKind::Why, 3, 5)]);
        let (_, spans) = analyse("highway", "Please slow down.").unwrap();
        assert_eq!(spans, [(SpanKind::What, 1, 3)]);
    }

    #[test]
    fn a_fact_beside_a_directive_is_a_reason() {
        let (topic, spans) = analyse("steakhouse", "Chopping board full, go right.").unwrap();
        assert_eq!(topic, "move_right");
        assert_eq!(spans, [(SpanKind::Why, 0, 3), (SpanKind::What, 3, 5)]);
        assert_eq!(analyse("steakhouse", "Chopping board full.").unwrap().0, "inform");
    }

    #[test]
    fn none_or_two_directives_are_refused() {
        assert_eq!(analyse("lander", "Lovely weather today."), Err(Reason::NoDirective));
        assert_eq!(analyse("lander", "Go up, shift left."), Err(Reason::TwoDirectives));
    }
}
