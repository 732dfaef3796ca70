//! The encoder in front of actor and critic, as actors run it: without a graph and without allocation.
//!
//! ```text
//! none        observation ─────────────────────────────────────────────────────────► features
//! lstm        observation, state of the step before ─► gates ─► state ─────────────► features = its hidden half
//! attention   history of entities ─► per frame: attention of the ego (file `attention`) ─► features
//! ```

use leadtime_proto::{Encoder, PolicySpec};

mod lstm;

use lstm::LstmEncoder;

use crate::architecture::{LstmLayers, feature_dim};
use crate::attention::AttentionEncoder;
use crate::{Error, Parameters};

/// An encoder with fixed weights, and room for a block of rows.
#[derive(Clone, Debug)]
pub(crate) enum FastEncoder {
    Identity,
    Lstm(Box<LstmEncoder>),
    Attention { encoder: Box<AttentionEncoder>, features: Vec<f32> },
}

impl FastEncoder {
    /// Packs an encoder's weights, with room for `block` rows at a time.
    pub(crate) fn new(
        spec: &PolicySpec,
        parameters: &Parameters,
        block: usize,
    ) -> Result<Self, Error> {
        Ok(match &spec.encoder {
            Encoder::Identity => Self::Identity,
            &Encoder::Lstm { projection, state } => {
                let layers = LstmLayers::new(spec.obs_dim, projection, state);
                Self::Lstm(Box::new(LstmEncoder::new(&layers, parameters, block)?))
            }
            Encoder::EgoAttention(attention) => Self::Attention {
                encoder: Box::new(AttentionEncoder::new(attention, spec.obs_dim, parameters)?),
                features: vec![0.0; block * feature_dim(spec)],
            },
        })
    }

    /// Encodes a block of `n` rows, and reads the rows' states without moving them on.
    ///
    /// # Shapes
    ///
    /// `x`: `[n, D]`; `recurrent`: `[n, S]`. Returns features `[n, F]`.
    pub(crate) fn forward<'a>(
        &'a mut self,
        x: &'a [f32],
        recurrent: &[f32],
        n: usize,
    ) -> &'a [f32] {
        match self {
            Self::Identity => x,
            Self::Lstm(lstm) => lstm.encode(x, recurrent, n),
            Self::Attention { encoder, features } => {
                let features = &mut features[..n * encoder.feature_dim()];
                encoder.encode(x, features);
                features
            }
        }
    }

    /// Writes the states after the rows that were encoded last.
    pub(crate) fn write_states(&self, recurrent: &mut [f32]) {
        if let Self::Lstm(lstm) = self {
            lstm.write_states(recurrent);
        }
    }
}
