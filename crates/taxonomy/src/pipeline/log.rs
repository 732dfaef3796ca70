//! The call log: append-only, one JSON object per line, written through before the reply is used.
//!
//! The first line says who was asked; each further line is a call and its reply. A process that is killed while it
//! writes leaves a torn last line, which is cut off at the next start; any other damage is refused.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::backend::{Call, CallStage, Input, Reply};
use super::error::PipelineError;
use crate::utterance::Fidelity;

/// The first line: for whom, and who was asked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogHeader {
    /// Form of the log.
    pub schema: u32,
    /// The domain.
    pub domain: String,
    /// What may be claimed of the sentences.
    pub fidelity: Fidelity,
    /// Who wrote them.
    pub generator: String,
    /// Who rated them.
    pub rater: String,
    /// Who embedded them.
    pub embedder: String,
}

impl LogHeader {
    fn describe(&self) -> String {
        let Self { domain, generator, rater, embedder, .. } = self;
        format!("{domain} with {generator}, {rater} and {embedder}")
    }
}

/// One further line.
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
pub struct CallLog {
    path: PathBuf,
    /// None: read only.
    file: Option<File>,
    header: Option<LogHeader>,
    replies: BTreeMap<String, Reply>,
}

impl CallLog {
    /// Opens a log to go on with, or begins one.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if the file cannot be opened or is damaged before its last line.
    pub fn open(path: &Path) -> Result<Self, PipelineError> {
        let wrong = |error| PipelineError::file(path)(error);
        let mut options = OpenOptions::new();
        let file = options.append(true).create(true).open(path).map_err(wrong)?;
        let text = std::fs::read(path).map_err(PipelineError::file(path))?;
        let whole = text.iter().rposition(|byte| *byte == b'\n').map_or(0, |last| last + 1);
        if whole < text.len() {
            file.set_len(whole as u64).map_err(PipelineError::file(path))?;
        }
        Self::read(path, &String::from_utf8_lossy(&text[..whole]), Some(file))
    }

    /// Reads a finished log, which nothing is added to.
    ///
    /// # Errors
    ///
    /// [`PipelineError`] if a line is damaged.
    pub fn finished(path: &Path, text: &str) -> Result<Self, PipelineError> {
        Self::read(path, text, None)
    }

    fn read(path: &Path, text: &str, file: Option<File>) -> Result<Self, PipelineError> {
        let mut log = Self { path: path.to_owned(), file, header: None, replies: BTreeMap::new() };
        for (i, line) in text.lines().enumerate() {
            let damaged = |error: serde_json::Error| PipelineError::DamagedLog {
                path: path.to_owned(),
                line: i + 1,
                message: error.to_string(),
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

    /// Returns who was asked, if the log has begun.
    pub fn header(&self) -> Option<&LogHeader> {
        self.header.as_ref()
    }

    /// Makes sure that the log is this run's; a new one becomes it.
    ///
    /// # Errors
    ///
    /// [`PipelineError::OtherLog`] if others were asked.
    pub fn claim(&mut self, header: &LogHeader) -> Result<(), PipelineError> {
        match &self.header {
            Some(found) if found == header => Ok(()),
            Some(found) => Err(PipelineError::OtherLog {
                path: self.path.clone(),
                found: found.describe(),
                expected: header.describe(),
            }),
            None => {
                self.header = Some(header.clone());
                self.write(header)
            }
        }
    }

    /// Looks a reply up.
    pub fn reply(&self, key: &str) -> Option<&Reply> {
        self.replies.get(key)
    }

    /// Returns the number of replies.
    pub fn len(&self) -> usize {
        self.replies.len()
    }

    /// Tells whether nobody was asked yet.
    pub fn is_empty(&self) -> bool {
        self.replies.is_empty()
    }

    /// Adds a call and its reply, through to the file.
    ///
    /// # Errors
    ///
    /// [`PipelineError::File`] if the file cannot be written.
    pub fn add(&mut self, key: String, call: &Call, reply: Reply) -> Result<(), PipelineError> {
        let (stage, input, seed) = (call.stage, call.input.clone(), call.seed);
        let record = LogLine { key, stage, input, seed, reply };
        self.write(&record)?;
        self.replies.insert(record.key, record.reply);
        Ok(())
    }

    fn write(&mut self, line: &impl Serialize) -> Result<(), PipelineError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        let write = || {
            let mut text = serde_json::to_string(line)?;
            text.push('\n');
            // One write per line: a kill can tear the last line only.
            file.write_all(text.as_bytes())?;
            file.flush()
        };
        let mut write = write;
        write().map_err(PipelineError::file(&self.path))
    }
}

#[cfg(test)]
#[path = "log_tests.rs"]
mod tests;
