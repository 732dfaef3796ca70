//! Why a voice cannot speak, each with what to do about it.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a voice, or a loudspeaker, cannot be had.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum VoiceError {
    #[error("`{program}` is not there: install {package}, or use {instead}")]
    Missing { program: String, package: &'static str, instead: &'static str },
    #[error(
        "`{0}` is no voice; known: none, text, shipped, flite[:VOICE], espeak, pipe:COMMAND, recorded:DIR"
    )]
    Unknown(String),
    #[error("--voice {0} speaks nothing anew: use flite[:VOICE], espeak or pipe:COMMAND")]
    NoSpeaker(String),
    #[error("flite has no voice `{name}`; it has: {known}")]
    FliteVoice { name: String, known: String },
    #[error(
        "no voice is shipped for `{0}`; with flite installed, --voice flite speaks every sentence"
    )]
    NotShipped(String),
    #[error("{what} cannot be started")]
    Start {
        what: String,
        #[source]
        source: io::Error,
    },
    #[error("{}: {reason}", path.display())]
    Recorded { path: PathBuf, reason: String },
    #[error("no temporary directory can be made for sound")]
    Temporary(#[source] io::Error),
}
