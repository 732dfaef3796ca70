//! Ego attention for acting: a history of observations of entities becomes features, without a graph and without
//! allocation.
//!
//! ```text
//! frame ─┬─ ego ──────► embedding ─┬────────────────────► query ─┐
//!        │                         ├─► key, value ─► attention ──┴─► combine ─► (· + ego's embedding) / 2 ─┐
//!        ├─ others ───► embedding ─┘                                                                       ├─► features
//!        └─ own action ─────────────────────────────────────────────────────────────────────────────────── ┘
//! ```
//!
//! Every frame of a history goes through the same weights. The result of a frame does not depend on what else is
//! encoded with it.

use leadtime_numerics::{Activation, Dense};
use leadtime_proto::EgoAttention;

use crate::architecture::AttentionLayers;
use crate::attention::Attention;
use crate::inference::dense;
use crate::{Error, Parameters};

/// Frames per pass: with ten entities, three 64-wide activations of them take 60 KiB.
const FRAMES: usize = 8;

/// Ego attention with fixed weights.
#[derive(Clone, Debug)]
pub struct AttentionEncoder {
    spec: EgoAttention,
    attention: Attention,
    obs_dim: usize,
    ego: [Dense; 2],
    others: [Dense; 2],
    key: Dense,
    value: Dense,
    query: Dense,
    combine: Dense,
    scratch: Scratch,
}

/// Room for one pass; N entities of F numbers, width W.
#[derive(Clone, Debug)]
struct Scratch {
    /// `[FRAMES * N, F]`, egos first.
    entities: Vec<f32>,
    /// `[FRAMES, N]`
    presence: Vec<f32>,
    /// `[FRAMES * N, W]` each: embeddings layer by layer, egos first; then frame by frame; keys; values.
    hidden: [Vec<f32>; 2],
    embedded: Vec<f32>,
    keys: Vec<f32>,
    values: Vec<f32>,
    /// `[FRAMES, W]` each.
    queries: Vec<f32>,
    seen: Vec<f32>,
    combined: Vec<f32>,
    /// `[H, N]`
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
        let &EgoAttention { n_entities, n_features, width, n_heads, .. } = spec;
        let layers = AttentionLayers::new(spec);
        let pair = |[first, second]: &[_; 2]| -> Result<_, Error> {
            Ok([dense(first, parameters)?, dense(second, parameters)?])
        };
        let zeros = |n: usize| vec![0.0; FRAMES * n];
        let wide = || zeros(n_entities * width);
        Ok(Self {
            spec: *spec,
            attention: Attention { n_entities, width, n_heads },
            obs_dim,
            ego: pair(&layers.ego)?,
            others: pair(&layers.others)?,
            key: dense(&layers.key, parameters)?,
            value: dense(&layers.value, parameters)?,
            query: dense(&layers.query, parameters)?,
            combine: dense(&layers.combine, parameters)?,
            scratch: Scratch {
                entities: zeros(n_entities * n_features),
                presence: zeros(n_entities),
                hidden: [wide(), wide()],
                embedded: wide(),
                keys: wide(),
                values: wide(),
                queries: zeros(width),
                seen: zeros(width),
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
        assert_eq!(
            observations.len() * feature_dim,
            features.len() * obs_dim,
            "as many observations as features"
        );
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
        let &EgoAttention { n_entities, n_features, action_dim, width, .. } = &self.spec;
        let frame_dim = self.spec.frame_dim();
        let n = frames.len() / frame_dim;
        self.sort_entities(frames, n);
        self.embed(n);
        // The egos' embeddings still lie one behind the other.
        let Scratch {
            presence,
            hidden: [_, egos],
            embedded,
            keys,
            values,
            queries,
            seen,
            combined,
            shares,
            ..
        } = &mut self.scratch;
        let all = n * n_entities * width;
        self.key.forward(&embedded[..all], &mut keys[..all], Activation::Linear);
        self.value.forward(&embedded[..all], &mut values[..all], Activation::Linear);
        self.query.forward(&egos[..n * width], &mut queries[..n * width], Activation::Linear);
        for m in 0..n {
            let entities = m * n_entities * width..(m + 1) * n_entities * width;
            let one = m * width..(m + 1) * width;
            let presence = &presence[m * n_entities..][..n_entities];
            self.attention.shares(&queries[one.clone()], &keys[entities.clone()], presence, shares);
            self.attention.gather(shares, &values[entities], &mut seen[one]);
        }
        self.combine.forward(&seen[..n * width], &mut combined[..n * width], Activation::Linear);
        for m in 0..n {
            let (encoded, action) =
                out[m * (width + action_dim)..][..width + action_dim].split_at_mut(width);
            let sums = combined[m * width..].iter().zip(&egos[m * width..]);
            for (out, (seen, ego)) in encoded.iter_mut().zip(sums) {
                *out = (seen + ego) * 0.5;
            }
            let own = m * frame_dim + n_entities * n_features;
            action.copy_from_slice(&frames[own..][..action_dim]);
        }
    }

    /// Writes the egos of all frames one behind the other, then everybody else, frame by frame.
    fn sort_entities(&mut self, frames: &[f32], n: usize) {
        let &EgoAttention { n_entities, n_features, .. } = &self.spec;
        let (egos, others) = self.scratch.entities.split_at_mut(n * n_features);
        let others_dim = (n_entities - 1) * n_features;
        for (m, frame) in frames.chunks_exact(self.spec.frame_dim()).enumerate() {
            let (ego, rest) = frame.split_at(n_features);
            egos[m * n_features..][..n_features].copy_from_slice(ego);
            others[m * others_dim..][..others_dim].copy_from_slice(&rest[..others_dim]);
            let presence = &mut self.scratch.presence[m * n_entities..][..n_entities];
            for (presence, entity) in presence.iter_mut().zip(frame.chunks_exact(n_features)) {
                *presence = entity[0];
            }
        }
    }

    /// Embeds what is sorted, and lays the embeddings out frame by frame.
    fn embed(&mut self, n: usize) {
        let &EgoAttention { n_entities, n_features, width, .. } = &self.spec;
        let Scratch { entities, hidden: [first, second], embedded, .. } = &mut self.scratch;
        let n_others = n * (n_entities - 1);
        for (layers, start, count) in [(&self.ego, 0, n), (&self.others, n, n_others)] {
            let x = &entities[start * n_features..][..count * n_features];
            let place = start * width..(start + count) * width;
            layers[0].forward(x, &mut first[place.clone()], Activation::Relu);
            layers[1].forward(&first[place.clone()], &mut second[place], Activation::Relu);
        }
        let (egos, others) = second.split_at(n * width);
        let others_dim = (n_entities - 1) * width;
        for (m, frame) in embedded.chunks_exact_mut(n_entities * width).take(n).enumerate() {
            let (ego, rest) = frame.split_at_mut(width);
            ego.copy_from_slice(&egos[m * width..][..width]);
            rest.copy_from_slice(&others[m * others_dim..][..others_dim]);
        }
    }
}
