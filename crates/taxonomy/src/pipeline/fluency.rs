//! Is it English at all? A sentence that its writer finds much less likely than the plan's examples is turned down.
//!
//! Compared without capitals and punctuation: models that go on with lists leave them out.

use super::caller::Caller;
use super::error::PipelineError;
use super::plan::Plan;
use crate::words;

/// The least likelihood that is taken for English.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fluency {
    /// Mean log-probability per token; none: nobody is asked.
    least: Option<f64>,
}

impl Fluency {
    /// Measures the plan's examples, and takes the percentile that it names.
    pub(super) fn of_examples(plan: &Plan, caller: &mut Caller<'_>) -> Result<Self, PipelineError> {
        let percentile = usize::from(plan.settings.fluency);
        if percentile == 0 {
            return Ok(Self { least: None });
        }
        let rated = plan.topic.iter().flat_map(|topic| &topic.rated).map(|rated| &rated.text);
        let mut found = Vec::new();
        for text in plan.examples.iter().chain(&plan.pinned).chain(rated) {
            found.push(caller.likelihood(&words::normalised(text))?);
        }
        found.sort_by(f64::total_cmp);
        Ok(Self { least: found.get(percentile * found.len() / 100).copied() })
    }

    /// Tells whether a sentence is likely enough.
    pub(super) fn accepts(
        self,
        caller: &mut Caller<'_>,
        text: &str,
    ) -> Result<bool, PipelineError> {
        match self.least {
            None => Ok(true),
            Some(least) => Ok(caller.likelihood(&words::normalised(text))? >= least),
        }
    }
}
