//! Reading the engine's tensors as plain slices.

use candle_core::{CpuStorage, Layout, Result, Storage, Tensor};

/// Returns the numbers of a contiguous 32-bit tensor; an error if it is something else.
pub(crate) fn floats<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&storage.as_slice::<f32>()?[start..end]),
        None => candle_core::bail!("a fused operation needs contiguous tensors"),
    }
}

/// Runs `read` on the numbers of a contiguous 32-bit tensor on the CPU; an error if it is something else.
pub(crate) fn with_floats<T>(tensor: &Tensor, read: impl FnOnce(&[f32]) -> T) -> Result<T> {
    let (storage, layout) = tensor.storage_and_layout();
    match &*storage {
        Storage::Cpu(storage) => Ok(read(floats(storage, layout)?)),
        _ => candle_core::bail!("a fused operation needs tensors on the CPU"),
    }
}
