//! What can be wrong with a policy, its parameters or a file of them.

use leadtime_numerics::DenseError;
use thiserror::Error;

/// Why parameters cannot be made, read, written or used.
#[derive(Debug, Error)]
pub enum Error {
    /// The tensor engine refused.
    #[error("tensor operation failed")]
    Tensor(#[from] candle_core::Error),
    /// The bytes are no safetensors file.
    #[error("parameters cannot be read as safetensors")]
    Read(#[source] safetensors::SafeTensorError),
    /// The tensors cannot be written.
    #[error("parameters cannot be written as safetensors")]
    Write(#[source] safetensors::SafeTensorError),
    /// A tensor that the architecture needs is not there.
    #[error("parameters hold no tensor `{name}`")]
    Missing {
        /// The tensor's name, as `actor.0.weight`.
        name: String,
    },
    /// A tensor that the architecture does not know.
    #[error("parameters hold a tensor `{name}` that this architecture does not know")]
    Unknown {
        /// The tensor's name, as `actor.0.weight`.
        name: String,
    },
    /// A tensor of the wrong shape.
    #[error("tensor `{name}` has shape {found:?}, the architecture needs {expected:?}")]
    Shape {
        /// The tensor's name, as `actor.0.weight`.
        name: String,
        /// The shape that it has.
        found: Vec<usize>,
        /// The shape it must have.
        expected: Vec<usize>,
    },
    /// A tensor of another number type.
    #[error("tensor `{name}` has numbers of type {found:?}")]
    Type {
        /// The tensor's name, as `actor.0.weight`.
        name: String,
        /// The number type that it has; `F32` is needed, and `F64` for statistics.
        found: safetensors::Dtype,
    },
    /// A NaN or an infinity.
    #[error("tensor `{name}` holds a value that is not finite")]
    NonFinite {
        /// The tensor's name, as `actor.0.weight`.
        name: String,
    },
    /// As many initial biases as logits are needed, or none.
    #[error("`logit_bias` has {found} entries, the heads have {expected} choices")]
    LogitBias {
        /// How many the specification gives.
        found: usize,
        /// How many there are, one per choice.
        expected: usize,
    },
    /// The heads or the encoder are impossible.
    #[error("impossible architecture")]
    Spec(#[from] leadtime_proto::spec::SpecError),
    /// A layer's numbers do not fit together.
    #[error("a layer's weights do not fit its biases")]
    Layer(#[from] DenseError),
}
