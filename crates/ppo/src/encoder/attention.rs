//! Ego attention, forward and backward: what [`leadtime_policy::attention::AttentionEncoder`] computes, with the maps of
//! queries, keys, values and output multiplied out as [`leadtime_policy::attention`] says.

use std::collections::BTreeMap;

use candle_core::{Result, Var};
use leadtime_numerics::kernel::Activation;
use leadtime_policy::architecture::{AttentionLayers, Layer};
use leadtime_policy::attention::{Attention, PresentEntities};
use leadtime_proto::EgoAttention;

mod shares;

use shares::{AttentionSlopes, EgoShares};

use crate::dense::{Gradients, PackedLayer, PackedMatrix, resize};
use crate::encoder::EncoderInput;
use crate::storage::with_floats;

/// Two layers that embed entities, and what they leave behind.
#[derive(Debug)]
struct EntityEmbedding {
    layers: [PackedLayer; 2],
    /// The outputs of the two layers. `[n, W]`
    first: Vec<f32>,
    second: Vec<f32>,
    d_first: Vec<f32>,
}

impl EntityEmbedding {
    fn new(layers: [Layer; 2]) -> Self {
        let layers = layers.map(PackedLayer::new);
        Self { layers, first: Vec::new(), second: Vec::new(), d_first: Vec::new() }
    }

    fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        self.layers.iter_mut().try_for_each(|layer| layer.pack(vars))
    }

    /// Embeds entities `[n, F]`.
    fn forward(&mut self, entities: &[f32]) {
        self.layers[0].forward(entities, &mut self.first);
        self.layers[1].forward(&self.first, &mut self.second);
    }

    /// Computes gradients from the entities and the slopes in their embeddings.
    fn backward(&mut self, entities: &[f32], slopes: &mut [f32], gradients: &mut Gradients) {
        let Self { layers: [first, second], .. } = self;
        second.backward(&self.first, &self.second, slopes, gradients);
        second.d_input(slopes, &mut self.d_first);
        first.backward(entities, &self.first, &mut self.d_first, gradients);
    }
}

/// The product of two maps, head by head.
#[derive(Debug, Default)]
struct FoldedMap {
    /// Of each head, the map that is applied to the rows of the other: `[W, d]`.
    inner: Vec<PackedMatrix>,
    /// Of each head, the rows. `[W, d]`
    rows: Vec<Vec<f32>>,
    product: PackedMatrix,
}

/// The encoder, and the memory of its pass.
#[derive(Debug)]
pub(crate) struct AttentionPass {
    spec: EgoAttention,
    attention: Attention,
    names: [Layer; 4],
    /// Kᵀ Q, `[H W, W]`, heads one below the other.
    query: FoldedMap,
    /// C V, `[W, H W]`, heads side by side.
    output: FoldedMap,
    egos: EntityEmbedding,
    others: EntityEmbedding,
    n_rows: usize,
    /// Whether a block of the minibatch is in its gradients.
    has_gradients: bool,
    observations: Vec<f32>,
    present: PresentEntities,
    frames: Vec<f32>,
    queries: Vec<f32>,
    taken: Vec<f32>,
    combined: Vec<f32>,
    features: Vec<f32>,
    d_combined: Vec<f32>,
    d_taken: Vec<f32>,
    slopes: AttentionSlopes,
    d_by_query: Vec<f32>,
}

impl AttentionPass {
    pub(super) fn new(spec: &EgoAttention) -> Self {
        let AttentionLayers { ego, others, key, value, query, combine } =
            AttentionLayers::new(spec);
        Self {
            spec: *spec,
            attention: Attention { width: spec.width, n_heads: spec.n_heads },
            names: [key, query, value, combine],
            query: FoldedMap::default(),
            output: FoldedMap::default(),
            egos: EntityEmbedding::new(ego),
            others: EntityEmbedding::new(others),
            n_rows: 0,
            has_gradients: false,
            observations: Vec::new(),
            present: PresentEntities::default(),
            frames: Vec::new(),
            queries: Vec::new(),
            taken: Vec::new(),
            combined: Vec::new(),
            features: Vec::new(),
            d_combined: Vec::new(),
            d_taken: Vec::new(),
            slopes: AttentionSlopes::default(),
            d_by_query: Vec::new(),
        }
    }

    pub(super) fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        self.has_gradients = false;
        self.egos.pack(vars)?;
        self.others.pack(vars)?;
        let Attention { width, n_heads } = self.attention;
        let d = self.attention.head_width();
        let mut maps = Vec::with_capacity(4);
        for layer in &self.names {
            maps.push(with_floats(&vars[&layer.weight()], <[f32]>::to_vec)?);
        }
        let [key, query, value, combine] = maps.as_slice() else { return Ok(()) };
        let rows = |map: &[f32], head| self.attention.rows_of_head(map, head);
        let columns = |map: &[f32], head| self.attention.columns_of_head(map, head);
        let heads = 0..n_heads;
        let queries = heads.clone().map(|head| (rows(key, head), rows(query, head)));
        let asks = self.query.fold(queries, width, d).concat();
        self.query.product.pack(&asks, n_heads * width, width);
        let outputs = heads.map(|head| (columns(combine, head), rows(value, head)));
        let products = self.output.fold(outputs, width, d);
        let mut takes = Vec::with_capacity(width * n_heads * width);
        for row in 0..width {
            takes.extend(products.iter().flat_map(|product| &product[row * width..][..width]));
        }
        self.output.product.pack(&takes, width, n_heads * width);
        Ok(())
    }

    /// Encodes observations `[M, D]`; returns features `[M, feature_dim]`.
    pub(super) fn forward(&mut self, input: EncoderInput<'_>) -> &[f32] {
        let EgoAttention { n_frames, n_entities, n_features, width, .. } = self.spec;
        let (frame_dim, obs_dim) = (self.spec.frame_dim(), input.obs_dim);
        self.observations.clear();
        for &sample in input.samples {
            self.observations.extend_from_slice(input.row(sample));
        }
        let observations = &self.observations;
        self.n_rows = observations.len() / obs_dim;
        self.frames.clear();
        for observation in observations.chunks_exact(obs_dim) {
            self.frames.extend_from_slice(&observation[..n_frames * frame_dim]);
        }
        self.present.list(&self.frames, &self.spec);
        self.egos.forward(&self.present.egos);
        self.others.forward(&self.present.others);
        let egos = &self.egos.second;
        self.query.product.multiply(egos, &[], Activation::Linear, &mut self.queries);
        let shares = EgoShares { attention: self.attention, presence: &self.present.frames };
        shares.forward(&self.queries, egos, &self.others.second, &mut self.taken);
        self.output.product.multiply(&self.taken, &[], Activation::Linear, &mut self.combined);
        self.features.clear();
        let encoded = self.combined.chunks_exact(width).zip(egos.chunks_exact(width));
        let mut frames = encoded.zip(self.frames.chunks_exact(frame_dim));
        for observation in observations.chunks_exact(obs_dim) {
            for ((combined, ego), frame) in frames.by_ref().take(n_frames) {
                self.features.extend(combined.iter().zip(ego).map(|(c, e)| (c + e) * 0.5));
                self.features.extend_from_slice(&frame[n_entities * n_features..]);
            }
            self.features.extend_from_slice(&observation[n_frames * frame_dim..]);
        }
        &self.features
    }

    /// Computes the gradients of the last forward pass from the slopes in its features.
    pub(super) fn backward(&mut self, d_features: &[f32], sums: &mut Gradients) {
        let EgoAttention { n_frames, action_dim, width, .. } = self.spec;
        let mut gradients = Gradients::new();
        self.d_combined.clear();
        for row in d_features.chunks_exact(d_features.len() / self.n_rows) {
            for frame in row.chunks_exact(width + action_dim).take(n_frames) {
                self.d_combined.extend(frame[..width].iter().map(|d| d * 0.5));
            }
        }
        let egos = &self.egos.second;
        let d_output = self.output.product.d_weight(&self.taken, &self.d_combined);
        self.output.product.d_input(&self.d_combined, &mut self.d_taken);
        let shares = EgoShares { attention: self.attention, presence: &self.present.frames };
        let slopes = &mut self.slopes;
        shares.backward(&self.queries, egos, &self.others.second, &self.d_taken, slopes);
        let d_query = self.query.product.d_weight(egos, &slopes.queries);
        self.query.product.d_input(&slopes.queries, &mut self.d_by_query);
        // An ego's embedding is part of the encoding, is attended to, and asks: added up in this order.
        let d_egos = resize(&mut self.d_combined, egos.len());
        let ways = slopes.egos.iter().zip(&self.d_by_query);
        d_egos.iter_mut().zip(ways).for_each(|(d, (taken, asked))| *d = *d + taken + asked);
        self.egos.backward(&self.present.egos, d_egos, &mut gradients);
        self.others.backward(&self.present.others, &mut slopes.others, &mut gradients);
        self.unfold(&d_query, &d_output, &mut gradients);
        for (name, gradient) in gradients {
            match sums.get_mut(&name).filter(|_| self.has_gradients) {
                Some(sum) => sum.iter_mut().zip(&gradient).for_each(|(sum, x)| *sum += x),
                None => drop(sums.insert(name, gradient)),
            }
        }
        self.has_gradients = true;
    }

    /// Computes the gradients of the four maps from those of their products.
    fn unfold(&self, d_query: &[f32], d_output: &[f32], gradients: &mut Gradients) {
        let Attention { width, n_heads } = self.attention;
        let d = self.attention.head_width();
        let [mut d_key, mut d_asks, mut d_value, mut d_combine] =
            [(); 4].map(|()| vec![0.0; width * width]);
        let put_back = |map: &mut [f32], head: usize, slopes: &[f32]| {
            for (i, slope) in slopes.iter().enumerate() {
                map[(head * d + i % d) * width + i / d] = *slope;
            }
        };
        for head in 0..n_heads {
            let own = &d_query[head * width * width..][..width * width];
            let (d_rows, d_inner) = self.query.slopes(head, own);
            put_back(&mut d_key, head, &d_rows);
            put_back(&mut d_asks, head, &d_inner);
            let own = d_output.chunks_exact(n_heads * width);
            let own: Vec<f32> =
                own.flat_map(|row| &row[head * width..][..width]).copied().collect();
            let (d_rows, d_inner) = self.output.slopes(head, &own);
            put_back(&mut d_value, head, &d_inner);
            for (row, slopes) in d_combine.chunks_exact_mut(width).zip(d_rows.chunks_exact(d)) {
                row[head * d..][..d].copy_from_slice(slopes);
            }
        }
        let found = [d_key, d_asks, d_value, d_combine];
        gradients.extend(self.names.iter().map(Layer::weight).zip(found));
    }
}

impl FoldedMap {
    /// Multiplies maps out, each given by its rows `[W, d]` and its inner map `[W, d]`; returns `[W, W]` for each head.
    fn fold(
        &mut self,
        heads: impl Iterator<Item = (Vec<f32>, Vec<f32>)>,
        width: usize,
        d: usize,
    ) -> Vec<Vec<f32>> {
        self.rows.clear();
        self.inner.clear();
        let mut products = Vec::new();
        for (rows, inner) in heads {
            let mut matrix = PackedMatrix::default();
            matrix.pack(&inner, width, d);
            let mut product = Vec::new();
            matrix.multiply(&rows, &[], Activation::Linear, &mut product);
            products.push(product);
            self.rows.push(rows);
            self.inner.push(matrix);
        }
        products
    }

    /// Returns the slopes in one head's rows and in its inner map, from those in the product.
    fn slopes(&self, head: usize, slopes: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let mut d_rows = Vec::new();
        self.inner[head].d_input(slopes, &mut d_rows);
        (d_rows, self.inner[head].d_weight(&self.rows[head], slopes))
    }
}
