//! What several tests of this crate need.

use candle_core::Tensor;

/// Asserts that two tensors have the same shape and numbers that differ by less than `tolerance`.
pub(crate) fn close(a: &Tensor, b: &Tensor, tolerance: f32) {
    let flat = |tensor: &Tensor| tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert_eq!(a.dims(), b.dims());
    for (i, (a, b)) in flat(a).iter().zip(flat(b)).enumerate() {
        assert!((a - b).abs() < tolerance, "{i}: {a} {b}");
    }
}
