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
use crate::team::Team;

/// The samples that are to be encoded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EncoderInput<'a> {
    /// Of all samples of an update, normalised. `[N, D]`
    pub(crate) observations: &'a [f32],
    /// Which of them, in their order. `[M]`
    pub(crate) samples: &'a [usize],
    /// Numbers of an observation: D.
    pub(crate) obs_dim: usize,
}

impl<'a> EncoderInput<'a> {
    /// Returns the observation of one sample.
    fn row(&self, sample: usize) -> &'a [f32] {
        &self.observations[sample * self.obs_dim..][..self.obs_dim]
    }
}

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
                Some(Self::Attention(Box::new(AttentionPass::new(attention))))
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

    /// Encodes samples to features `[M, F]`.
    ///
    /// A recurrent encoder takes the samples as whole sequences, one behind the other.
    pub(crate) fn forward(
        &mut self,
        input: EncoderInput<'_>,
        sequences: Sequences,
        team: &Team,
    ) -> &[f32] {
        match self {
            Self::Lstm(pass) => pass.forward(input, sequences, team),
            Self::Attention(pass) => pass.forward(input, team),
        }
    }

    /// Computes the gradients of the last forward pass from the slopes in its features, `[M, F]`.
    pub(crate) fn backward(&mut self, d_features: &[f32], gradients: &mut Gradients, team: &Team) {
        match self {
            Self::Lstm(pass) => pass.backward(d_features, gradients, team),
            Self::Attention(pass) => pass.backward(d_features, gradients, team),
        }
    }
}

#[cfg(test)]
#[path = "encoder_tests.rs"]
mod tests;
