//! Reading the engine's tensors as plain slices.

use candle_core::{Result, Storage, Tensor};

/// Runs `read` on the numbers of a contiguous 32-bit tensor on the CPU; an error if it is something else.
pub(crate) fn with_floats<T>(tensor: &Tensor, read: impl FnOnce(&[f32]) -> T) -> Result<T> {
    let (storage, layout) = tensor.storage_and_layout();
    match (&*storage, layout.contiguous_offsets()) {
        (Storage::Cpu(storage), Some((start, end))) => {
            Ok(read(&storage.as_slice::<f32>()?[start..end]))
        }
        (Storage::Cpu(_), None) => candle_core::bail!("parameters must be contiguous"),
        _ => candle_core::bail!("parameters must be on the CPU"),
    }
}
