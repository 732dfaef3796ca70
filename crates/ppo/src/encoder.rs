//! What stands between observations and stacks, forward and backward: what an actor's encoder computes.

use std::collections::BTreeMap;

use candle_core::{Result, Var};
use leadtime_policy::architecture::LstmLayers;
use leadtime_proto::{Encoder, PolicySpec};

mod attention;
mod lstm;

use attention::AttentionPass;
use lstm::LstmPass;
pub(crate) use lstm::Sequences;

use crate::dense::Gradients;

/// An encoder that learns, and the memory of its pass.
#[derive(Debug)]
pub(crate) enum EncoderPass {
    Lstm(Box<LstmPass>),
    Attention(Box<AttentionPass>),
}

impl EncoderPass {
    /// Prepares the encoder of a specification; `None` if observations are the features.
    pub(crate) fn new(spec: &PolicySpec) -> Option<Self> {
        match &spec.encoder {
            Encoder::Identity => None,
            &Encoder::Lstm { projection, state } => {
                let layers = LstmLayers::new(spec.obs_dim, projection, state);
                Some(Self::Lstm(Box::new(LstmPass::new(layers))))
            }
            Encoder::EgoAttention(attention) => {
                Some(Self::Attention(Box::new(AttentionPass::new(attention, spec.obs_dim))))
            }
        }
    }

    /// Takes over the variables' present numbers.
    pub(crate) fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        match self {
            Self::Lstm(pass) => pass.pack(vars),
            Self::Attention(pass) => pass.pack(vars),
        }
    }

    /// Encodes observations `[M, D]`, already normalised, to features `[M, F]`.
    ///
    /// A recurrent encoder takes the samples as whole sequences, one behind the other.
    pub(crate) fn forward(&mut self, observations: Vec<f32>, sequences: Sequences) -> &[f32] {
        match self {
            Self::Lstm(pass) => pass.forward(observations, sequences),
            Self::Attention(pass) => pass.forward(&observations),
        }
    }

    /// Computes the gradients of the last forward pass from the slopes in its features, `[M, F]`.
    pub(crate) fn backward(&mut self, d_features: &[f32]) -> Gradients {
        match self {
            Self::Lstm(pass) => pass.backward(d_features),
            Self::Attention(pass) => pass.backward(d_features),
        }
    }
}

#[cfg(test)]
#[path = "encoder_tests.rs"]
mod tests;
