//! Why a task cannot be built.

use leadtime_proto::spec::SpecError;
use thiserror::Error;

use crate::check::SettingError;

/// Why a task cannot be built.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum TaskError {
    #[error("there is no domain `{domain}`; known: {}", known.join(", "))]
    UnknownDomain { domain: String, known: Vec<String> },
    /// The settings are not of the right form: an unknown key, a wrong type.
    #[error("settings of domain `{domain}` cannot be read: {fault}")]
    Settings { domain: &'static str, fault: serde_json::Error },
    /// A well-formed setting that is impossible.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// What steps the environment, outside of this process, cannot be had.
    #[error(transparent)]
    Outside(Box<dyn std::error::Error + Send + Sync>),
    /// An action space that is impossible, for instance with too many choices, or metrics that cannot be told apart.
    #[error(transparent)]
    Spec(#[from] SpecError),
}
