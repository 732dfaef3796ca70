//! Asks how well a sentence is understood, word by word, and whether another action is as clear.

use super::backend::{Call, CallStage, Finish, Reply};
use super::caller::Caller;
use super::candidate::{Candidate, Reason};
use super::error::PipelineError;
use super::plan::{DatabasePlan, RateForm};
use super::prompts::PromptWriter;
use super::reply;
use crate::words;

/// Asks the rater, in the form that the plan chooses. An error is that there are no replies.
#[derive(Debug)]
pub(super) struct Rating<'a> {
    pub(super) writer: &'a PromptWriter<'a>,
    /// Either [`CallStage::Rate`] or [`CallStage::Control`].
    pub(super) stage: CallStage,
}

impl Rating<'_> {
    /// Has a sentence rated after each word; none if no reply can be read. Shape `[l]`.
    pub(super) fn words(
        &self,
        caller: &mut Caller<'_>,
        topic: usize,
        text: &str,
    ) -> Result<Option<Vec<u8>>, PipelineError> {
        let DatabasePlan { settings, topic: topics, .. } = self.writer.plan;
        let n_words = words::count(text) as usize;
        let mut ratings: Vec<Vec<u8>> = Vec::new();
        for repeat in 0..settings.repeats {
            let rating = match settings.rate {
                RateForm::Joint => {
                    let ask = |attempt| self.writer.rate_joint(&topics[topic], text, attempt);
                    self.readable(caller, repeat, ask, |reply| reply::joint_rating(reply, n_words))?
                }
                RateForm::Prefix => (1..=n_words)
                    .map(|n| self.after(caller, topic, text, n, repeat))
                    .collect::<Result<_, _>>()?,
            };
            let Some(rating) = rating else { return Ok(None) };
            ratings.push(rating);
        }
        Ok(Some((0..n_words).map(|word| median(&ratings, word)).collect()))
    }

    /// Has the first `n` words rated, 0 for silence; none if no reply can be read.
    pub(super) fn after(
        &self,
        caller: &mut Caller<'_>,
        topic: usize,
        text: &str,
        n: usize,
        repeat: u32,
    ) -> Result<Option<u8>, PipelineError> {
        let topic = &self.writer.plan.topic[topic];
        let ask = |attempt| self.writer.rate_prefix(topic, text, n, attempt);
        self.readable(caller, repeat, ask, reply::percentage)
    }

    /// Turns a sentence down if another action is as clear, or nearly, at the word where its own is understood.
    pub(super) fn margin(
        &self,
        caller: &mut Caller<'_>,
        candidate: &Candidate,
    ) -> Result<Result<(), Reason>, PipelineError> {
        let plan = self.writer.plan;
        let least = i16::from(plan.settings.min_margin);
        let Some(cell) = candidate.landed.filter(|_| least > 0) else { return Ok(Ok(())) };
        let n = cell.comprehension as usize;
        let own = candidate.curve.get(n - 1).copied().unwrap_or_default();
        let mut most = 0;
        for other in (0..plan.topic.len()).filter(|other| *other != candidate.topic) {
            let Some(percent) = self.after(caller, other, &candidate.text, n, 0)? else {
                return Ok(Err(Reason::Malformed));
            };
            most = most.max(percent);
        }
        Ok(match i16::from(own) - i16::from(most) {
            ahead if ahead < 0 => Err(Reason::WrongAction),
            ahead if ahead < least => Err(Reason::LowMargin),
            _ => Ok(()),
        })
    }

    /// Asks again, with another seed, until a reply can be read.
    fn readable<T>(
        &self,
        caller: &mut Caller<'_>,
        repeat: u32,
        ask: impl Fn(u32) -> Result<Call, PipelineError>,
        read: impl Fn(&Reply) -> Option<T>,
    ) -> Result<Option<T>, PipelineError> {
        let tries = self.writer.plan.settings.tries;
        for attempt in repeat * tries..(repeat + 1) * tries {
            let call = Call { stage: self.stage, ..ask(attempt)? };
            let reply = caller.ask(&call)?.1;
            if reply.finish == Finish::Exhausted {
                return Ok(None);
            }
            let found = read(&reply);
            caller.judge(self.stage, found.is_some())?;
            if found.is_some() {
                return Ok(found);
            }
        }
        Ok(None)
    }
}

fn median(ratings: &[Vec<u8>], word: usize) -> u8 {
    let mut values: Vec<u8> = ratings.iter().map(|rating| rating[word]).collect();
    values.sort_unstable();
    values[values.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_repeated_ratings_counts() {
        let ratings = [vec![10, 90], vec![30, 20], vec![20, 80]];
        assert_eq!((median(&ratings, 0), median(&ratings, 1)), (20, 80));
    }
}
