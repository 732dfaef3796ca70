//! The call log: append-only, one JSON object per line, written through before the reply is used.
//!
//! The first line says who was asked; each further line is a call and its reply. A process that is killed while it
//! writes leaves a torn last line, which is cut off at the next start; any other damage is refused.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::backend::{Call, CallStage, Input, Reply};
use super::error::PipelineError;
use super::regular;
use crate::utterance::Fidelity;

/// How every log begins.
const BEGINNING: &[u8] = b"{\"schema\":";

/// The first line: for whom, and who was asked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogHeader {
    /// Form of the log.
    pub schema: u32,
    /// The domain that the sentences are for.
    pub domain: String,
    /// What may be claimed of the sentences.
    pub fidelity: Fidelity,
    /// The model that wrote them.
    pub generator: String,
    /// The model that rated them.
    pub rater: String,
    /// The model that embedded them.
    pub embedder: String,
}

impl fmt::Display for LogHeader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { domain, fidelity, generator, rater, embedder, .. } = self;
        let fidelity = fidelity.name();
        write!(f, "{domain} ({fidelity}) with {generator}, {rater} and {embedder}")
    }
}

/// Every further line: a call's key, and its reply.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LogLine {
    key: String,
    stage: CallStage,
    input: Input,
    seed: u64,
    reply: Reply,
}

/// Replies by key, and the file they are kept in.
#[derive(Debug)]
pub(super) struct CallLog {
    path: PathBuf,
    /// Where replies are added; `None` if the log is only read.
    file: Option<File>,
    /// Who was asked, if the log has begun.
    pub(super) header: Option<LogHeader>,
    replies: BTreeMap<String, Reply>,
}

impl CallLog {
    /// Opens a log to go on with, or begins one; an error if it is damaged before its last line, if it is no log, or if
    /// somebody else writes to it. What is refused stays as it is.
    pub(super) fn open(path: &Path) -> Result<Self, PipelineError> {
        regular::check_if_there(path)?;
        let file = OpenOptions::new().append(true).create(true).open(path);
        let file = file.map_err(PipelineError::file(path))?;
        // Two that find it empty would both begin it. A file system without locks is no reason to refuse.
        if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            return Err(PipelineError::Unusable(format!(
                "the call log {} is written by another command; wait for its end, or give another log",
                path.display()
            )));
        }
        let text = regular::read(path)?;
        let whole = text.iter().rposition(|byte| *byte == b'\n').map_or(0, |last| last + 1);
        // A header may be torn as well, but what begins otherwise is somebody's own file.
        if whole == 0 && !text.starts_with(BEGINNING) && !BEGINNING.starts_with(&text) {
            return Err(PipelineError::Unusable(format!(
                "{} is no call log; give another one",
                path.display()
            )));
        }
        let mut log = Self::read(path, &String::from_utf8_lossy(&text[..whole]))?;
        if whole < text.len() {
            file.set_len(whole as u64).map_err(PipelineError::file(path))?;
        }
        log.file = Some(file);
        Ok(log)
    }

    /// Reads the text of a log, to which nothing is added.
    pub(super) fn read(path: &Path, text: &str) -> Result<Self, PipelineError> {
        let (header, replies) = (None, BTreeMap::new());
        let mut log = Self { path: path.to_owned(), file: None, header, replies };
        for (i, line) in text.lines().enumerate() {
            let damaged = |error: serde_json::Error| {
                PipelineError::Unusable(format!(
                    "line {} of the call log {} is damaged: {error}; only a torn last line is forgiven",
                    i + 1,
                    path.display()
                ))
            };
            if i == 0 {
                log.header = Some(serde_json::from_str(line).map_err(damaged)?);
            } else {
                let record: LogLine = serde_json::from_str(line).map_err(damaged)?;
                log.replies.insert(record.key, record.reply);
            }
        }
        Ok(log)
    }

    /// Makes sure that the log is this run's; a new one becomes it.
    pub(super) fn claim(&mut self, header: &LogHeader) -> Result<(), PipelineError> {
        match &self.header {
            Some(found) if found == header => Ok(()),
            Some(found) if found.schema != header.schema => Err(PipelineError::Unusable(format!(
                "the call log {} is of form {}; this program writes form {}; give another log",
                self.path.display(),
                found.schema,
                header.schema
            ))),
            // What was paid is of use: only the claim differs.
            Some(found) if *found == (LogHeader { fidelity: found.fidelity, ..header.clone() }) => {
                let (begun, asked) = (found.fidelity.name(), header.fidelity.name());
                Err(PipelineError::Unusable(format!(
                    "the call log {} was begun with --fidelity {begun}, not {asked}; give --fidelity {begun}, or \
                     another log",
                    self.path.display()
                )))
            }
            Some(found) => Err(PipelineError::Unusable(format!(
                "the call log {} was made for {found}, not for {header}; give another log",
                self.path.display()
            ))),
            None => {
                self.header = Some(header.clone());
                self.write(header)
            }
        }
    }

    /// Looks a reply up.
    pub(super) fn reply(&self, key: &str) -> Option<&Reply> {
        self.replies.get(key)
    }

    /// Adds a call and its reply, through to the file.
    pub(super) fn add(
        &mut self,
        key: String,
        call: &Call,
        reply: Reply,
    ) -> Result<(), PipelineError> {
        let (stage, input, seed) = (call.stage, call.input.clone(), call.seed);
        let record = LogLine { key, stage, input, seed, reply };
        self.write(&record)?;
        self.replies.insert(record.key, record.reply);
        Ok(())
    }

    fn write(&mut self, line: &impl Serialize) -> Result<(), PipelineError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        // One write per line: a kill can tear the last line only.
        let written = serde_json::to_string(line)
            .map_err(std::io::Error::from)
            .and_then(|text| file.write_all(format!("{text}\n").as_bytes()))
            .and_then(|()| file.flush());
        written.map_err(PipelineError::file(&self.path))
    }
}

#[cfg(test)]
#[path = "log_tests.rs"]
mod tests;
