//! The maps of an attention with one query, multiplied out: see [`super::shares`].

use leadtime_numerics::{Activation, Dense};

use super::shares::Attention;
use crate::architecture::{AttentionLayers, Layer};
use crate::{Error, Parameters};

/// What is left of queries, keys, values and their combination; W wide, H heads.
#[derive(Clone, Debug)]
pub(super) struct FoldedAttention {
    /// The ego's embedding `[W]` to what embeddings are compared with, `[H, W]`: Kᵀ Q head by head.
    pub(super) query: Dense,
    /// What is taken from embeddings, `[H, W]`, to the output `[W]`: C V head by head.
    pub(super) combine: Dense,
}

impl FoldedAttention {
    /// Multiplies the maps out.
    pub(super) fn new(
        attention: Attention,
        layers: &AttentionLayers,
        parameters: &Parameters,
    ) -> Result<Self, Error> {
        let (width, n_heads) = (attention.width, attention.n_heads);
        let values = |layer: &Layer| parameters.values(&layer.weight());
        let (key, query) = (values(&layers.key)?, values(&layers.query)?);
        let (value, combine) = (values(&layers.value)?, values(&layers.combine)?);
        let mut asks = Vec::with_capacity(n_heads * width * width);
        let mut takes = vec![0.0; width * n_heads * width];
        for head in 0..n_heads {
            let rows = |matrix: &[f32]| attention.rows_of_head(matrix, head);
            asks.extend(product(&rows(&key), &rows(&query), width)?);
            let product =
                product(&attention.columns_of_head(&combine, head), &rows(&value), width)?;
            let places = takes.chunks_exact_mut(n_heads * width);
            for (place, row) in places.zip(product.chunks_exact(width)) {
                place[head * width..][..width].copy_from_slice(row);
            }
        }
        Ok(Self {
            query: Dense::new(&asks, &vec![0.0; n_heads * width])?,
            combine: Dense::new(&takes, &vec![0.0; width])?,
        })
    }
}

/// Multiplies `[W, d]` by the transpose of `[W, d]`, as the learner's graph does.
fn product(a: &[f32], b: &[f32], width: usize) -> Result<Vec<f32>, Error> {
    let mut out = vec![0.0; width * width];
    Dense::new(b, &vec![0.0; width])?.forward(a, &mut out, Activation::Linear);
    Ok(out)
}
