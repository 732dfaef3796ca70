//! Turns what the tensor library and the tokenizer complain about into our error.

use crate::pipeline::error::BackendError;

/// Says what the tensor library or the tokenizer complained about.
pub(super) fn local(error: impl std::fmt::Display) -> BackendError {
    BackendError::Local { message: error.to_string().lines().next().unwrap_or_default().to_owned() }
}
