//! Asks, but only what the log does not hold; and gives up on a model that answers nonsense.

use std::collections::{BTreeMap, VecDeque};

use super::backend::{Call, CallStage, Embedder, Input, Model, Reply, Sampling};
use super::embedding::Embedding;
use super::error::{BackendError, PipelineError};
use super::log::{CallLog, LogHeader};

/// Replies over which nonsense is counted.
const WINDOW: usize = 50;

/// Whether anybody may be asked.
#[derive(Clone, Copy, Debug)]
pub(super) enum CallMode {
    /// Whatever the log lacks is asked for, up to this many calls; none: no limit.
    Live { max_calls: Option<u64> },
    /// Whatever the log lacks is an error.
    Replay,
}

/// Who is asked; the writer also rates if no rater is given.
#[derive(Debug)]
pub(super) struct Backends {
    pub(super) generator: Box<dyn Model>,
    pub(super) rater: Option<Box<dyn Model>>,
    pub(super) embedder: Box<dyn Embedder>,
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
    fn header(&self, domain: &str) -> LogHeader {
        let rater = self.rater.as_ref().unwrap_or(&self.generator);
        LogHeader {
            schema: 1,
            domain: domain.to_owned(),
            fidelity: self.generator.fidelity().max(rater.fidelity()),
            generator: self.generator.id().to_owned(),
            rater: rater.id().to_owned(),
            embedder: self.embedder.id().to_owned(),
        }
    }
}

/// Asks on behalf of the stages.
#[derive(Debug)]
pub(super) struct Caller<'a> {
    backends: Backends,
    log: &'a mut CallLog,
    mode: CallMode,
    /// Who is asked, as the log says it.
    pub(super) header: LogHeader,
    /// Calls made in this run, replies from the log not counted.
    pub(super) calls: u64,
    /// Which of the last replies could be read.
    recent: VecDeque<bool>,
    /// Per stage, replies that could be read and those that could not; those from the log included.
    pub(super) replies: BTreeMap<CallStage, [usize; 2]>,
}

impl<'a> Caller<'a> {
    /// Begins or goes on with a run; an error if the log is another run's.
    pub(super) fn new(
        backends: Backends,
        log: &'a mut CallLog,
        mode: CallMode,
        domain: &str,
    ) -> Result<Self, PipelineError> {
        let header = backends.header(domain);
        log.claim(&header)?;
        let recent = VecDeque::with_capacity(WINDOW);
        Ok(Self { backends, log, mode, header, calls: 0, recent, replies: BTreeMap::new() })
    }

    /// Asks the writer or the rater, as the stage says; also returns the call's key.
    pub(super) fn ask(&mut self, call: &Call) -> Result<(String, Reply), PipelineError> {
        let backend = self.backends.of(call.stage);
        let id = backend.id().to_owned();
        let must_agree = backend.is_written() && matches!(self.mode, CallMode::Live { .. });
        if must_agree
            && let Some(logged) = self.log.reply(&call.key(&id))
            && backend.complete(call)? != *logged
        {
            return Err(PipelineError::Unusable(format!(
                "the annotations have changed since the call log was written: it holds another reply to {}; build into \
                 another directory, or remove the log",
                call.what()
            )));
        }
        self.logged(&id, call, |backends| backends.of(call.stage).complete(call))
    }

    /// Returns whether the log answers a call for sentences, or the writer holds some that nobody asked for.
    pub(super) fn holds(&mut self, call: &Call) -> bool {
        let generator = &self.backends.generator;
        let is_held = match (&call.input, self.mode) {
            (Input::Sentences { topic, cell, .. }, CallMode::Live { .. }) => {
                generator.holds(topic, *cell)
            }
            _ => false,
        };
        is_held || self.log.reply(&call.key(generator.id())).is_some()
    }

    /// Returns a sentence's embedding, from the log if it has it. Only a new one costs a call.
    pub(super) fn embed(&mut self, text: &str) -> Result<Embedding, PipelineError> {
        let (system, prompt) = (String::new(), text.to_owned());
        let sampling = Sampling { temperature: 0.0, top_p: 1.0, max_tokens: 0 };
        let input = Input::Text { text: text.to_owned() };
        let call = Call { stage: CallStage::Embed, system, prompt, sampling, seed: 0, input };
        let id = self.backends.embedder.id().to_owned();
        let (_, reply) = self.logged(&id, &call, |backends| {
            Ok(Reply::complete(backends.embedder.embed(text)?.to_hex()))
        })?;
        Ok(Embedding::from_hex(&reply.text)?)
    }

    /// Takes a reply from the log, or asks and adds it.
    fn logged(
        &mut self,
        id: &str,
        call: &Call,
        answer: impl FnOnce(&mut Backends) -> Result<Reply, BackendError>,
    ) -> Result<(String, Reply), PipelineError> {
        let key = call.key(id);
        if let Some(reply) = self.log.reply(&key) {
            return Ok((key, reply.clone()));
        }
        self.spend(call)?;
        let reply = answer(&mut self.backends)?;
        self.log.add(key.clone(), call, reply.clone())?;
        Ok((key, reply))
    }

    fn spend(&mut self, call: &Call) -> Result<(), PipelineError> {
        match self.mode {
            CallMode::Replay => return Err(not_in_log(&call.what())),
            CallMode::Live { max_calls: Some(most) } if self.calls >= most => {
                return Err(PipelineError::BudgetSpent { calls: self.calls });
            }
            CallMode::Live { .. } => {}
        }
        self.calls += 1;
        Ok(())
    }

    /// Notes whether a reply could be read. An error once more than half of the last [`WINDOW`] could not.
    pub(super) fn judge(&mut self, stage: CallStage, useful: bool) -> Result<(), PipelineError> {
        self.replies.entry(stage).or_default()[usize::from(!useful)] += 1;
        if self.recent.len() == WINDOW {
            self.recent.pop_front();
        }
        self.recent.push_back(useful);
        let malformed = self.recent.iter().filter(|useful| !**useful).count();
        if self.recent.len() < WINDOW || 2 * malformed <= WINDOW {
            return Ok(());
        }
        let model = self.backends.of(stage).id();
        Err(PipelineError::Unusable(format!(
            "{malformed} of the last {WINDOW} replies of {model} are malformed: its template or the model is wrong"
        )))
    }
}

/// Says that the log does not hold what is needed, and that no model may be asked.
pub(super) fn not_in_log(what: &str) -> PipelineError {
    PipelineError::Unusable(format!(
        "the call log lacks the reply to {what}; the plan, a prompt or the log has changed"
    ))
}
