//! Ego attention as a graph of fused layers: what [`leadtime_policy::attention::AttentionEncoder`] computes, with gradients, and with the
//! maps of queries, keys, values and output multiplied out in the graph as [`leadtime_policy::attention`] says.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{DType, Device, Result, Tensor, Var};
use leadtime_numerics::kernel::Activation;
use leadtime_policy::architecture::{AttentionLayers, Layer};
use leadtime_policy::attention::{Attention, PresentEntities};
use leadtime_proto::EgoAttention;

use super::dense;
use crate::attention_op::AttentionOp;
use crate::dense_op::DenseOp;
use crate::storage::with_floats;

/// The graph of ego attention over a history.
#[derive(Clone, Debug)]
pub(crate) struct AttentionGraph {
    spec: EgoAttention,
    layers: AttentionLayers,
    /// What stands for the biases of maps, which have none: `[H W]` zeros.
    no_bias: Tensor,
}

impl AttentionGraph {
    pub(crate) fn new(spec: &EgoAttention) -> Result<Self> {
        let no_bias = Tensor::zeros(spec.n_heads * spec.width, DType::F32, &Device::Cpu)?;
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
        let mut present = PresentEntities::default();
        with_floats(&frames, |frames| present.list(frames, &self.spec))?;
        let n_others = present.n_others();
        let PresentEntities { egos, others, frames: presence } = present;
        let rows = |rows, n| Tensor::from_vec(rows, (n, n_features), &Device::Cpu);
        let egos = embed(vars, &rows(egos, n)?, &self.layers.ego)?;
        let others = embed(vars, &rows(others, n_others)?, &self.layers.others)?;
        let attention = Attention { width, n_heads };
        let queries = self.map(&egos, &self.query_map(vars, attention)?)?;
        let op = AttentionOp { attention, presence: Arc::new(presence) };
        let taken = queries.apply_op3(&egos, &others, op)?;
        let combined = self.map(&taken, &self.output_map(vars, attention)?)?;
        let encoded = ((combined + egos)? * 0.5)?;
        let encoded = beside(&encoded, &frames, n_entities * n_features)?;
        let encoded = encoded.reshape((m, n_frames * (width + action_dim)))?;
        beside(&encoded, observations, n_frames * frame_dim)
    }

    /// Multiplies out Kᵀ Q, `[H W, W]`, heads one below the other.
    fn query_map(&self, vars: &BTreeMap<String, Var>, attention: Attention) -> Result<Tensor> {
        let (key, query) = (&vars[&self.layers.key.weight()], &vars[&self.layers.query.weight()]);
        let d = attention.head_width();
        let columns = |matrix: &Var, head| matrix.narrow(0, head * d, d)?.t()?.contiguous();
        let heads = (0..attention.n_heads)
            .map(|head| self.map(&columns(key, head)?, &columns(query, head)?));
        Tensor::cat(&heads.collect::<Result<Vec<_>>>()?, 0)
    }

    /// Multiplies out C V, `[W, H W]`, heads side by side.
    fn output_map(&self, vars: &BTreeMap<String, Var>, attention: Attention) -> Result<Tensor> {
        let value = &vars[&self.layers.value.weight()];
        let combine = &vars[&self.layers.combine.weight()];
        let d = attention.head_width();
        let head = |head| {
            let combine = combine.narrow(1, head * d, d)?.contiguous()?;
            self.map(&combine, &value.narrow(0, head * d, d)?.t()?.contiguous()?)
        };
        let heads = (0..attention.n_heads).map(head);
        Tensor::cat(&heads.collect::<Result<Vec<_>>>()?, 1)?.contiguous()
    }

    /// Multiplies x `[N, n_in]` by a matrix `[n_out, n_in]`: `x Wᵀ`.
    fn map(&self, x: &Tensor, weight: &Tensor) -> Result<Tensor> {
        let op = DenseOp { activation: Activation::Linear, input_gradient: true };
        x.apply_op3(weight, &self.no_bias.narrow(0, 0, weight.dim(0)?)?, op)
    }
}

/// Embeds entities `[n, F]`: two layers, the first of which sees what does not learn.
fn embed(vars: &BTreeMap<String, Var>, entities: &Tensor, layers: &[Layer; 2]) -> Result<Tensor> {
    dense(vars, &dense(vars, entities, &layers[0], false)?, &layers[1], true)
}

/// Puts what follows column `from` of `source` behind the columns of `x`.
fn beside(x: &Tensor, source: &Tensor, from: usize) -> Result<Tensor> {
    match source.dim(1)? - from {
        0 => Ok(x.clone()),
        n_columns => Tensor::cat(&[x, &source.narrow(1, from, n_columns)?], 1)?.contiguous(),
    }
}
