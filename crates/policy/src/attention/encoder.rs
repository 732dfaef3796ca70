//! Ego attention for acting, without a graph and without allocation.
//!
//! ```text
//! frame ─┬─ ego ──────► embedding ─┬─► query ─┐
//!        │                         ├──────────┴─► attention ─► combine ─► (· + ego's embedding) / 2 ─┐
//!        ├─ others ───► embedding ─┘                                                                ├─► features
//!        └─ own action ─────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! Every frame of a history goes through the same weights. The result of a frame does not depend on what else is
//! encoded with it.

use leadtime_numerics::{Activation, Dense};
use leadtime_proto::EgoAttention;

use super::folded::FoldedAttention;
use super::presence::PresentEntities;
use super::shares::Attention;
use crate::architecture::AttentionLayers;
use crate::{Error, Parameters};

/// Frames per pass: with ten entities, two 64-wide activations of them take 40 KiB.
const FRAMES: usize = 8;

/// Ego attention with fixed weights.
#[derive(Clone, Debug)]
pub struct AttentionEncoder {
    spec: EgoAttention,
    attention: Attention,
    obs_dim: usize,
    ego: [Dense; 2],
    others: [Dense; 2],
    folded: FoldedAttention,
    scratch: Scratch,
}

/// Room for one pass; N entities of F numbers, width W, H heads.
#[derive(Clone, Debug)]
struct Scratch {
    present: PresentEntities,
    /// `[FRAMES * N, W]` each: a layer of embeddings.
    first: Vec<f32>,
    egos: Vec<f32>,
    others: Vec<f32>,
    /// `[FRAMES, H, W]` each.
    queries: Vec<f32>,
    taken: Vec<f32>,
    /// What all heads together take from the entities. `[FRAMES, W]`
    combined: Vec<f32>,
    /// Each head's attention to the entities. `[H, N]`
    shares: Vec<f32>,
}

impl AttentionEncoder {
    /// Packs parameters for encoding.
    ///
    /// # Errors
    ///
    /// [`Error`] if the parameters are not those of this architecture, or the architecture does not fit `obs_dim`.
    pub fn new(
        spec: &EgoAttention,
        obs_dim: usize,
        parameters: &Parameters,
    ) -> Result<Self, Error> {
        spec.check(obs_dim)?;
        let &EgoAttention { n_entities, width, n_heads, .. } = spec;
        let layers = AttentionLayers::new(spec);
        let attention = Attention { width, n_heads };
        let pair = |[first, second]: &[_; 2]| -> Result<_, Error> {
            Ok([parameters.dense(first)?, parameters.dense(second)?])
        };
        let zeros = |n: usize| vec![0.0; FRAMES * n];
        Ok(Self {
            spec: *spec,
            attention,
            obs_dim,
            ego: pair(&layers.ego)?,
            others: pair(&layers.others)?,
            folded: FoldedAttention::new(attention, &layers, parameters)?,
            scratch: Scratch {
                present: PresentEntities::with_capacity(FRAMES, spec),
                first: zeros(n_entities * width),
                egos: zeros(width),
                others: zeros((n_entities - 1) * width),
                queries: zeros(n_heads * width),
                taken: zeros(n_heads * width),
                combined: zeros(width),
                shares: vec![0.0; n_heads * n_entities],
            },
        })
    }

    /// Returns the width of the features.
    pub fn feature_dim(&self) -> usize {
        self.spec.feature_dim(self.obs_dim)
    }

    /// Encodes observations.
    ///
    /// # Shapes
    ///
    /// `observations`: `[M, D]`; `features`: `[M, feature_dim]`: per frame its encoding and its action, then the rest.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn encode(&mut self, observations: &[f32], features: &mut [f32]) {
        let (obs_dim, feature_dim) = (self.obs_dim, self.feature_dim());
        let fits = observations.len() * feature_dim == features.len() * obs_dim;
        assert!(fits, "as many observations as features");
        let (frame_dim, out_dim) = (self.spec.frame_dim(), self.spec.width + self.spec.action_dim);
        let n_frames = self.spec.n_frames;
        let rows = observations.chunks_exact(obs_dim).zip(features.chunks_exact_mut(feature_dim));
        for (observation, features) in rows {
            let (frames, rest) = observation.split_at(n_frames * frame_dim);
            let (encoded, passed_on) = features.split_at_mut(n_frames * out_dim);
            passed_on.copy_from_slice(rest);
            let passes = frames.chunks(FRAMES * frame_dim);
            for (frames, encoded) in passes.zip(encoded.chunks_mut(FRAMES * out_dim)) {
                self.encode_frames(frames, encoded);
            }
        }
    }

    /// Encodes up to [`FRAMES`] frames.
    fn encode_frames(&mut self, frames: &[f32], out: &mut [f32]) {
        let EgoAttention { n_entities, n_features, action_dim, width, .. } = self.spec;
        self.scratch.present.list(frames, &self.spec);
        self.embed();
        let n = self.scratch.present.frames.len();
        let (wide, frame_dim) = (self.spec.n_heads * width, self.spec.frame_dim());
        let Scratch { present, egos, others, queries, taken, combined, shares, .. } =
            &mut self.scratch;
        let egos = &egos[..n * width];
        self.folded.query.forward(egos, &mut queries[..n * wide], Activation::Linear);
        let mut others = others.as_slice();
        for (m, &frame) in present.frames.iter().enumerate() {
            let (now, later) = others.split_at(frame.n_others * width);
            others = later;
            let (ego, heads) = (&egos[m * width..][..width], m * wide..(m + 1) * wide);
            let shares = &mut shares[..self.spec.n_heads * frame.n_entities()];
            self.attention.shares(&queries[heads.clone()], ego, now, frame, shares);
            self.attention.gather(shares, ego, now, &mut taken[heads]);
        }
        let combined = &mut combined[..n * width];
        self.folded.combine.forward(&taken[..n * wide], combined, Activation::Linear);
        for (m, out) in out.chunks_exact_mut(width + action_dim).enumerate() {
            let (encoded, action) = out.split_at_mut(width);
            let sums = combined[m * width..].iter().zip(&egos[m * width..]);
            for (out, (taken, ego)) in encoded.iter_mut().zip(sums) {
                *out = (taken + ego) * 0.5;
            }
            let own = m * frame_dim + n_entities * n_features;
            action.copy_from_slice(&frames[own..][..action_dim]);
        }
    }

    /// Embeds the egos and the present others.
    fn embed(&mut self) {
        let width = self.spec.width;
        let Scratch { present, first, egos, others, .. } = &mut self.scratch;
        let (n, n_others) = (present.frames.len(), present.n_others());
        let mut embed = |layers: &[Dense; 2], x: &[f32], n: usize, out: &mut [f32]| {
            let first = &mut first[..n * width];
            layers[0].forward(x, first, Activation::Relu);
            layers[1].forward(first, &mut out[..n * width], Activation::Relu);
        };
        embed(&self.ego, &present.egos, n, egos);
        embed(&self.others, &present.others, n_others, others);
    }
}
