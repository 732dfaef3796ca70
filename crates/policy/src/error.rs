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
    /// Tensors that are not those of the architecture: missing, unknown, misshapen, of another type or not finite.
    #[error("{0}")]
    Misfit(String),
    /// The heads or the encoder are impossible.
    #[error("impossible architecture")]
    Spec(#[from] leadtime_proto::spec::SpecError),
    /// A layer's numbers do not fit together.
    #[error("a layer's weights do not fit its biases")]
    Layer(#[from] DenseError),
}

/// Says that a tensor which the architecture needs is not there.
pub(crate) fn missing(name: &str) -> Error {
    Error::Misfit(format!("parameters hold no tensor `{name}`"))
}

/// Says that the architecture does not know a tensor.
pub(crate) fn unknown(name: &str) -> Error {
    Error::Misfit(format!("parameters hold a tensor `{name}` that this architecture does not know"))
}

/// Makes sure that a tensor has the shape that the architecture needs.
pub(crate) fn check_shape(name: &str, found: &[usize], expected: &[usize]) -> Result<(), Error> {
    if found == expected {
        return Ok(());
    }
    let says = format!("tensor `{name}` has shape {found:?}, the architecture needs {expected:?}");
    Err(Error::Misfit(says))
}

/// Says that a tensor holds a NaN or an infinity.
pub(crate) fn non_finite(name: &str) -> Error {
    Error::Misfit(format!("tensor `{name}` holds a value that is not finite"))
}
