//! What is said about a database that cannot be used.

use thiserror::Error;

/// Why a text is not a usable database, or does not have what was asked of it.
///
/// One sentence for a person: which line, key, sentence or topic; what it is, and what it should be.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct TaxonomyError(pub(crate) String);
