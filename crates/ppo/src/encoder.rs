//! What stands between observations and stacks, as a graph with gradients: what an actor's encoder computes.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{Result, Tensor, Var};
use leadtime_policy::architecture::{Layer, LstmLayers};
use leadtime_proto::{Encoder, PolicySpec};

mod attention;

use attention::AttentionGraph;

use crate::dense_op::DenseOp;
use crate::lstm_op::{LstmOp, Sequences};

/// The graph of an encoder.
#[derive(Clone, Debug)]
pub(crate) enum EncoderGraph {
    Identity,
    Lstm(LstmLayers),
    Attention(Box<AttentionGraph>),
}

impl EncoderGraph {
    pub(crate) fn new(spec: &PolicySpec) -> Result<Self> {
        Ok(match &spec.encoder {
            Encoder::Identity => Self::Identity,
            &Encoder::Lstm { projection, state } => {
                Self::Lstm(LstmLayers::new(spec.obs_dim, projection, state))
            }
            Encoder::EgoAttention(attention) => {
                Self::Attention(Box::new(AttentionGraph::new(attention)?))
            }
        })
    }

    /// Tells whether anything in it learns, so that what follows must hand its gradient on.
    pub(crate) fn learns(&self) -> bool {
        !matches!(self, Self::Identity)
    }

    /// Builds the graph from observations `[M, D]` to features `[M, F]`.
    pub(crate) fn forward(
        &self,
        vars: &BTreeMap<String, Var>,
        observations: &Tensor,
        sequences: &Arc<Sequences>,
    ) -> Result<Tensor> {
        match self {
            Self::Identity => Ok(observations.clone()),
            Self::Lstm(layers) => lstm(layers, vars, observations, sequences),
            Self::Attention(attention) => attention.forward(vars, observations),
        }
    }
}

/// Builds the graph of a recurrent encoder from observations `[M, D]`, whole sequences one behind the other, to hidden
/// states `[M, H]`.
fn lstm(
    layers: &LstmLayers,
    vars: &BTreeMap<String, Var>,
    observations: &Tensor,
    sequences: &Arc<Sequences>,
) -> Result<Tensor> {
    let LstmLayers { projection, input, state } = layers;
    let gates = match projection {
        None => dense(vars, observations, input, false)?,
        Some(projection) => {
            dense(vars, &dense(vars, observations, projection, false)?, input, true)?
        }
    };
    let op = LstmOp::new(Arc::clone(sequences), state.n_in);
    gates.apply_op3(&vars[&state.weight()], &vars[&state.bias()], op)
}

/// Builds the graph of one layer.
pub(crate) fn dense(
    vars: &BTreeMap<String, Var>,
    x: &Tensor,
    layer: &Layer,
    input_gradient: bool,
) -> Result<Tensor> {
    let op = DenseOp { activation: layer.activation, input_gradient };
    x.apply_op3(&vars[&layer.weight()], &vars[&layer.bias()], op)
}
