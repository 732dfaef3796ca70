//! Whichever encoder a network has.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{Result, Tensor, Var};
use leadtime_proto::{Encoder, PolicySpec};

use super::attention::AttentionGraph;
use super::lstm::LstmGraph;
use crate::lstm_op::Sequences;

/// The graph of an encoder.
#[derive(Clone, Debug)]
pub(crate) enum EncoderGraph {
    Identity,
    Lstm(LstmGraph),
    Attention(Box<AttentionGraph>),
}

impl EncoderGraph {
    pub(crate) fn new(spec: &PolicySpec) -> Result<Self> {
        Ok(match &spec.encoder {
            Encoder::Identity => Self::Identity,
            &Encoder::Lstm { projection, state } => {
                Self::Lstm(LstmGraph::new(spec.obs_dim, projection, state))
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
            Self::Lstm(lstm) => lstm.forward(vars, observations, sequences),
            Self::Attention(attention) => attention.forward(vars, observations),
        }
    }
}
