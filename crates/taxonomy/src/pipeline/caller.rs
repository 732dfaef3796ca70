//! Asks, but only what the log does not hold; and gives up on a model that talks nonsense.

use std::collections::{BTreeMap, VecDeque};

use super::backend::{Call, CallStage, Embedder, Input, Model, Reply, Sampling};
use super::embedding::Embedding;
use super::error::PipelineError;
use super::log::{CallLog, LogHeader};
use crate::utterance::Fidelity;

/// Replies over which nonsense is counted.
pub const WINDOW: usize = 50;

/// Whether anybody may be asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CallMode {
    /// Whatever the log lacks is asked for, up to this many calls.
    Live {
        /// Calls after which the run stops; none: no limit.
        max_calls: Option<u64>,
    },
    /// Whatever the log lacks is an error.
    Replay,
}

/// Who is asked.
pub struct Backends {
    /// Writes.
    pub generator: Box<dyn Model>,
    /// Rates; the writer if none is given.
    pub rater: Option<Box<dyn Model>>,
    /// Embeds.
    pub embedder: Box<dyn Embedder>,
}

impl std::fmt::Debug for Backends {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Backends").field("generator", &self.generator.id()).finish_non_exhaustive()
    }
}

impl Backends {
    /// Returns who is asked in a stage.
    fn of(&mut self, stage: CallStage) -> &mut dyn Model {
        match (&mut self.rater, stage) {
            (Some(rater), CallStage::Rate | CallStage::Control) => rater.as_mut(),
            _ => self.generator.as_mut(),
        }
    }

    /// Describes a run for its log. What may be claimed is what the weaker of writer and rater allows.
    pub fn header(&self, domain: &str) -> LogHeader {
        let rater = self.rater.as_ref().unwrap_or(&self.generator);
        let fidelity: Fidelity = self.generator.fidelity().max(rater.fidelity());
        LogHeader {
            schema: 1,
            domain: domain.to_owned(),
            fidelity,
            generator: self.generator.id().to_owned(),
            rater: rater.id().to_owned(),
            embedder: self.embedder.id().to_owned(),
        }
    }
}

/// Asks on behalf of the stages.
#[derive(Debug)]
pub struct Caller<'a> {
    backends: Backends,
    log: &'a mut CallLog,
    mode: CallMode,
    /// Calls made in this run, replies from the log not counted.
    calls: u64,
    /// Of the last replies, which were useless.
    recent: VecDeque<bool>,
    /// Per stage, replies that could be read and those that could not.
    replies: BTreeMap<CallStage, [usize; 2]>,
}

impl<'a> Caller<'a> {
    /// Begins or goes on with a run.
    ///
    /// # Errors
    ///
    /// [`PipelineError::OtherLog`] if the log is another run's.
    pub fn new(
        backends: Backends,
        log: &'a mut CallLog,
        mode: CallMode,
        domain: &str,
    ) -> Result<Self, PipelineError> {
        log.claim(&backends.header(domain))?;
        let recent = VecDeque::with_capacity(WINDOW);
        Ok(Self { backends, log, mode, calls: 0, recent, replies: BTreeMap::new() })
    }

    /// Returns who is asked, as the log says it.
    pub fn header(&self) -> LogHeader {
        let domain = self.log.header().map(|header| header.domain.clone()).unwrap_or_default();
        self.backends.header(&domain)
    }

    /// Returns the number of calls made so far; what the log answered is not counted.
    pub fn calls(&self) -> u64 {
        self.calls
    }

    /// Returns per stage how many replies could be read, and how many could not; those from the log included.
    pub fn replies(&self) -> &BTreeMap<CallStage, [usize; 2]> {
        &self.replies
    }

    /// Asks the writer or the rater, as the stage says; also returns the call's key.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if there is no answer.
    pub fn ask(&mut self, call: &Call) -> Result<(String, Reply), PipelineError> {
        let id = self.backends.of(call.stage).id().to_owned();
        let key = call.key(&id);
        if let Some(reply) = self.log.reply(&key) {
            return Ok((key, reply.clone()));
        }
        self.spend(call)?;
        let reply = self.backends.of(call.stage).complete(call)?;
        self.log.add(key.clone(), call, reply.clone())?;
        Ok((key, reply))
    }

    /// Asks the embedder.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if there is no answer.
    pub fn embed(&mut self, text: &str) -> Result<Embedding, PipelineError> {
        let call = Call {
            stage: CallStage::Embed,
            system: String::new(),
            prompt: text.to_owned(),
            sampling: Sampling { temperature: 0.0, top_p: 1.0, max_tokens: 0 },
            seed: 0,
            input: Input::Text { text: text.to_owned() },
        };
        let key = call.key(self.backends.embedder.id());
        if let Some(reply) = self.log.reply(&key) {
            return Ok(Embedding::from_hex(&reply.text)?);
        }
        self.spend(&call)?;
        let embedding = self.backends.embedder.embed(text)?;
        self.log.add(key, &call, Reply::complete(embedding.to_hex()))?;
        Ok(embedding)
    }

    fn spend(&mut self, call: &Call) -> Result<(), PipelineError> {
        match self.mode {
            CallMode::Replay => return Err(PipelineError::NotInLog { what: call.what() }),
            CallMode::Live { max_calls: Some(most) } if self.calls >= most => {
                return Err(PipelineError::BudgetSpent { calls: self.calls });
            }
            CallMode::Live { .. } => {}
        }
        self.calls += 1;
        Ok(())
    }

    /// Is told whether a reply could be read.
    ///
    /// # Errors
    ///
    /// [`PipelineError::Malformed`] once more than half of the last [`WINDOW`] replies could not.
    pub fn judge(&mut self, stage: CallStage, useful: bool) -> Result<(), PipelineError> {
        self.replies.entry(stage).or_default()[usize::from(!useful)] += 1;
        if self.recent.len() == WINDOW {
            self.recent.pop_front();
        }
        self.recent.push_back(useful);
        let malformed = self.recent.iter().filter(|useful| !**useful).count();
        if self.recent.len() < WINDOW || 2 * malformed <= WINDOW {
            return Ok(());
        }
        let model = self.backends.of(stage).id().to_owned();
        Err(PipelineError::Malformed { malformed, window: WINDOW, model })
    }
}
