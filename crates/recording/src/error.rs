//! Why a recording cannot be written, read or replayed.

use std::io;

use thiserror::Error;

/// Why a recording cannot be written, read or replayed.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum Error {
    #[error("the recording cannot be written")]
    Write(#[source] io::Error),
    #[error("the recording cannot be written: {0}")]
    Format(String),
    #[error("the recording cannot be read")]
    Read(#[source] io::Error),
    #[error("it is no MCAP file: `leadtime record` writes one")]
    NoMcap,
    #[error("it holds no messages of a notifier at work, but {0}")]
    Foreign(String),
    #[error(
        "it holds no messages: nothing was said while it was recorded, or it was cut off at its beginning"
    )]
    Nothing,
    #[error("its chunks are compressed with {0}; `mcap convert --compression none` unpacks it")]
    Compressed(String),
    #[error("it ends before its first whole chunk: nothing in it can be read")]
    Empty,
    #[error("it is a recording of version {found}; this program reads version {known}")]
    Version { found: String, known: &'static str },
    #[error(
        "there is more than is read at a time, {0} bytes of messages: read one client of several with --live, or record shorter pieces"
    )]
    TooLarge(u64),
    #[error("the policy cannot take this session")]
    Session(#[from] leadtime_serve::OpenRefusal),
    #[error(transparent)]
    Client(#[from] leadtime_serve::ClientError),
    #[error("{0}")]
    NotOverNetwork(&'static str),
}

impl Error {
    /// Takes what the format's library says of writing: what the disk says is the disk's.
    pub(crate) fn writing(error: mcap::McapError) -> Self {
        match error {
            mcap::McapError::Io(error) => Self::Write(error),
            other => Self::Format(other.to_string()),
        }
    }
}
