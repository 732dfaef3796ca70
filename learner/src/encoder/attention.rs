//! Ego attention as a graph of fused layers: what [`leadtime_policy::encoder`] computes, with gradients.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{Device, Result, Tensor, Var};
use leadtime_policy::architecture::{AttentionLayers, Layer};
use leadtime_policy::attention::Attention;
use leadtime_proto::EgoAttention;

use crate::attention_op::AttentionOp;
use crate::dense_op::DenseOp;
use crate::storage::with_floats;

/// The graph of ego attention over a history.
#[derive(Clone, Debug)]
pub(crate) struct AttentionGraph {
    spec: EgoAttention,
    layers: AttentionLayers,
    /// What stands for the biases of layers without: `[W]` zeros.
    no_bias: Tensor,
}

impl AttentionGraph {
    pub(crate) fn new(spec: &EgoAttention) -> Result<Self> {
        let no_bias = Tensor::zeros(spec.width, candle_core::DType::F32, &Device::Cpu)?;
        Ok(Self { spec: *spec, layers: AttentionLayers::new(spec), no_bias })
    }

    /// Builds the graph from observations `[M, D]` to features `[M, feature_dim]`.
    pub(crate) fn forward(
        &self,
        vars: &BTreeMap<String, Var>,
        observations: &Tensor,
    ) -> Result<Tensor> {
        let &EgoAttention { n_frames, n_entities, n_features, action_dim, width, n_heads } =
            &self.spec;
        let m = observations.dim(0)?;
        let (n, frame_dim) = (m * n_frames, self.spec.frame_dim());
        let frames = observations.narrow(1, 0, n_frames * frame_dim)?.reshape((n, frame_dim))?;
        let entities = frames.narrow(1, 0, n_entities * n_features)?;
        let entities = entities.reshape((n, n_entities, n_features))?.contiguous()?;
        let ego = self.embed(vars, &entities.narrow(1, 0, 1)?, &self.layers.ego)?;
        let others = entities.narrow(1, 1, n_entities - 1)?;
        let others = self.embed(vars, &others, &self.layers.others)?;
        let others = others.reshape((n, n_entities - 1, width))?;
        let all = Tensor::cat(&[&ego.unsqueeze(1)?, &others], 1)?.contiguous()?;
        let all = all.reshape((n * n_entities, width))?;
        let query = self.layer(vars, &ego, &self.layers.query, true)?;
        let keys = self.layer(vars, &all, &self.layers.key, true)?;
        let values = self.layer(vars, &all, &self.layers.value, true)?;
        let presence = entities.narrow(2, 0, 1)?.contiguous()?;
        let presence = Arc::new(with_floats(&presence, <[f32]>::to_vec)?);
        let attention = Attention { n_entities, width, n_heads };
        let seen = query.apply_op3(&keys, &values, AttentionOp { attention, presence })?;
        let combined = self.layer(vars, &seen, &self.layers.combine, true)?;
        let encoded = ((combined + ego)? * 0.5)?;
        let encoded = beside(&encoded, &frames, n_entities * n_features)?;
        let encoded = encoded.reshape((m, n_frames * (width + action_dim)))?;
        beside(&encoded, observations, n_frames * frame_dim)
    }

    fn embed(
        &self,
        vars: &BTreeMap<String, Var>,
        entities: &Tensor,
        layers: &[Layer; 2],
    ) -> Result<Tensor> {
        let n_rows = entities.elem_count() / self.spec.n_features;
        let rows = entities.contiguous()?.reshape((n_rows, self.spec.n_features))?;
        let hidden = self.layer(vars, &rows, &layers[0], false)?;
        self.layer(vars, &hidden, &layers[1], true)
    }

    fn layer(
        &self,
        vars: &BTreeMap<String, Var>,
        x: &Tensor,
        layer: &Layer,
        input_gradient: bool,
    ) -> Result<Tensor> {
        let op = DenseOp { activation: layer.activation, input_gradient };
        let bias = if layer.biased { vars[&layer.bias()].as_tensor() } else { &self.no_bias };
        x.apply_op3(&vars[&layer.weight()], bias, op)
    }
}

/// Puts what follows column `from` of `source` behind the columns of `x`.
fn beside(x: &Tensor, source: &Tensor, from: usize) -> Result<Tensor> {
    match source.dim(1)? - from {
        0 => Ok(x.clone()),
        n_columns => Tensor::cat(&[x, &source.narrow(1, from, n_columns)?], 1)?.contiguous(),
    }
}
