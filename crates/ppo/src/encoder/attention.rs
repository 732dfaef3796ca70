//! Ego attention, forward and backward: what [`leadtime_policy::attention::AttentionEncoder`] computes, with the maps of
//! queries, keys, values and output multiplied out as [`leadtime_policy::attention`] says.
//!
//! Samples do not depend on each other: threads share them out in parts. Gradients are sums over all of them, in an order
//! that no part changes.

use std::collections::BTreeMap;

use candle_core::{Result, Var};
use leadtime_numerics::Panels;
use leadtime_numerics::kernel::{Activation, RowPairs};
use leadtime_policy::architecture::{AttentionLayers, Layer};
use leadtime_policy::attention::{Attention, PresentEntities};
use leadtime_proto::EgoAttention;

mod shares;

use shares::{AttentionSlopes, EgoShares};

use crate::dense::{Gradients, PackedLayer, PackedMatrix, resize};
use crate::encoder::EncoderInput;
use crate::outer::{LayerSum, add_up};
use crate::storage::with_floats;
use crate::team::Team;

/// Samples that one thread takes at a time: many enough for the products' tiles, few enough for the second-level cache.
const PART: usize = 32;

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
    weights: AttentionWeights,
    /// Those in use first.
    parts: Vec<SamplesPart>,
    n_parts: usize,
    features: Vec<f32>,
    /// The gradients of the last block, with those of the two products.
    block: Gradients,
    /// Whether a block of the minibatch is in its gradients.
    has_gradients: bool,
}

#[derive(Debug)]
struct AttentionWeights {
    spec: EgoAttention,
    attention: Attention,
    names: [Layer; 4],
    /// Kᵀ Q, `[H W, W]`, heads one below the other.
    query: FoldedMap,
    /// C V, `[W, H W]`, heads side by side.
    output: FoldedMap,
    /// The layers that embed entities.
    egos: [PackedLayer; 2],
    others: [PackedLayer; 2],
    /// The two products as layers.
    products: [Layer; 2],
}

/// What two layers that embed entities leave behind.
#[derive(Debug, Default)]
struct EmbeddingMemory {
    /// The outputs of the two layers. `[n, W]`
    first: Vec<f32>,
    second: Vec<f32>,
    d_first: Vec<f32>,
}

/// A layer's slopes and inputs, whose outer products are its gradient.
#[derive(Debug, Default)]
struct LayerRows {
    slopes: Panels,
    inputs: Panels,
}

/// Some samples, and the memory of their pass.
#[derive(Debug, Default)]
struct SamplesPart {
    n_samples: usize,
    present: PresentEntities,
    frames: Vec<f32>,
    egos: EmbeddingMemory,
    others: EmbeddingMemory,
    queries: Vec<f32>,
    taken: Vec<f32>,
    combined: Vec<f32>,
    d_combined: Vec<f32>,
    d_taken: Vec<f32>,
    slopes: AttentionSlopes,
    d_by_query: Vec<f32>,
    /// Of the two products, of the layers of egos and of others.
    rows: [LayerRows; 6],
}

impl AttentionPass {
    pub(super) fn new(spec: &EgoAttention) -> Self {
        let AttentionLayers { ego, others, key, value, query, combine } =
            AttentionLayers::new(spec);
        let wide = spec.n_heads * spec.width;
        let product = |like: &Layer, n_in, n_out| Layer { n_in, n_out, ..like.clone() };
        let products = [product(&query, spec.width, wide), product(&combine, wide, spec.width)];
        let weights = AttentionWeights {
            spec: *spec,
            attention: Attention { width: spec.width, n_heads: spec.n_heads },
            names: [key, query, value, combine],
            query: FoldedMap::default(),
            output: FoldedMap::default(),
            egos: ego.map(PackedLayer::new),
            others: others.map(PackedLayer::new),
            products,
        };
        let (features, block) = (Vec::new(), Gradients::new());
        Self { weights, parts: Vec::new(), n_parts: 0, features, block, has_gradients: false }
    }

    pub(super) fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        self.has_gradients = false;
        self.weights.pack(vars)
    }

    /// Encodes samples; returns features `[M, feature_dim]`.
    pub(super) fn forward(&mut self, input: EncoderInput<'_>, team: &Team) -> &[f32] {
        let weights = &self.weights;
        let feature_dim = weights.spec.feature_dim(input.obs_dim);
        self.n_parts = input.samples.len().div_ceil(PART);
        let n_memories = self.parts.len().max(self.n_parts);
        self.parts.resize_with(n_memories, SamplesPart::default);
        let features = resize(&mut self.features, input.samples.len() * feature_dim);
        let samples = input.samples.chunks(PART).zip(features.chunks_mut(PART * feature_dim));
        let tasks: Vec<_> = samples.zip(&mut self.parts).collect();
        team.for_each(tasks.into_iter(), |((samples, features), part)| {
            part.forward(weights, EncoderInput { samples, ..input }, features);
        });
        &self.features
    }

    /// Computes the gradients of the last forward pass from the slopes in its features, and adds them up by minibatch.
    pub(super) fn backward(&mut self, d_features: &[f32], sums: &mut Gradients, team: &Team) {
        let (weights, parts) = (&self.weights, &mut self.parts[..self.n_parts]);
        let n_samples: usize = parts.iter().map(|part| part.n_samples).sum();
        let feature_dim = d_features.len() / n_samples;
        let tasks: Vec<_> = parts.iter_mut().zip(d_features.chunks(PART * feature_dim)).collect();
        team.for_each(tasks.into_iter(), |(part, slopes)| part.backward(weights, slopes));
        let block = &mut self.block;
        let [query, output] = &weights.products;
        let embeddings = weights.egos.iter().chain(&weights.others).map(|packed| &packed.layer);
        let layers = [query, output].into_iter().chain(embeddings).enumerate();
        let mut found: Vec<_> = layers
            .map(|(i, layer)| {
                let rows = parts.iter().map(|part| part.rows[i].pairs()).collect();
                LayerSum::new(layer, rows, block)
            })
            .collect();
        add_up(&mut found, team);
        for sum in found {
            sum.put_into(block);
        }
        let of_product = |layer: &Layer| block.remove(&layer.weight()).unwrap_or_default();
        let [d_query, d_output] = [query, output].map(of_product);
        weights.unfold(&d_query, &d_output, block);
        for (name, gradient) in block {
            match sums.get_mut(name).filter(|_| self.has_gradients) {
                Some(sum) => sum.iter_mut().zip(gradient).for_each(|(sum, x)| *sum += *x),
                None => drop(sums.insert(name.clone(), gradient.clone())),
            }
        }
        self.has_gradients = true;
    }
}

impl AttentionWeights {
    fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        self.egos.iter_mut().chain(&mut self.others).try_for_each(|layer| layer.pack(vars))?;
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

impl LayerRows {
    fn take(&mut self, slopes: &[f32], inputs: &[f32], n: usize, layer: [usize; 2]) {
        let [n_out, n_in] = layer;
        self.slopes.pack_rows(slopes, n, n_out);
        self.inputs.pack_rows(inputs, n, n_in);
    }

    fn pairs(&self) -> RowPairs<'_> {
        let Self { slopes, inputs } = self;
        RowPairs { left: slopes, right: inputs, first: 0, len: slopes.depth() }
    }
}

impl EmbeddingMemory {
    /// Embeds entities `[n, F]`.
    fn forward(&mut self, layers: &[PackedLayer; 2], entities: &[f32]) {
        layers[0].forward(entities, &mut self.first);
        layers[1].forward(&self.first, &mut self.second);
    }

    /// Goes back from the slopes in the embeddings, and takes over what both layers' gradients are made of.
    fn backward(
        &mut self,
        layers: &[PackedLayer; 2],
        entities: &[f32],
        slopes: &mut [f32],
        rows: &mut [LayerRows],
    ) {
        let Self { first, second, d_first } = self;
        let [below, above] = layers;
        let n = slopes.len() / above.layer.n_out;
        above.layer.activation.backward(second, slopes);
        above.matrix.d_input(slopes, d_first);
        below.layer.activation.backward(first, d_first);
        rows[0].take(d_first, entities, n, [below.layer.n_out, below.layer.n_in]);
        rows[1].take(slopes, first, n, [above.layer.n_out, above.layer.n_in]);
    }
}

impl SamplesPart {
    /// Encodes the samples to features `[M, feature_dim]`.
    fn forward(
        &mut self,
        weights: &AttentionWeights,
        input: EncoderInput<'_>,
        features: &mut [f32],
    ) {
        let EgoAttention { n_frames, n_entities, n_features, width, action_dim, .. } = weights.spec;
        let frame_dim = weights.spec.frame_dim();
        self.n_samples = input.samples.len();
        self.frames.clear();
        for &sample in input.samples {
            self.frames.extend_from_slice(&input.row(sample)[..n_frames * frame_dim]);
        }
        self.present.list(&self.frames, &weights.spec);
        self.egos.forward(&weights.egos, &self.present.egos);
        self.others.forward(&weights.others, &self.present.others);
        let egos = &self.egos.second;
        weights.query.product.multiply(egos, &[], Activation::Linear, &mut self.queries);
        let shares = EgoShares { attention: weights.attention, presence: &self.present.frames };
        shares.forward(&self.queries, egos, &self.others.second, &mut self.taken);
        let (output, combined) = (&weights.output.product, &mut self.combined);
        output.multiply(&self.taken, &[], Activation::Linear, combined);
        let encoded = self.combined.chunks_exact(width).zip(egos.chunks_exact(width));
        let mut frames = encoded.zip(self.frames.chunks_exact(frame_dim));
        let feature_dim = features.len() / self.n_samples;
        for (&sample, features) in input.samples.iter().zip(features.chunks_exact_mut(feature_dim))
        {
            let (of_frames, rest) = features.split_at_mut(n_frames * (width + action_dim));
            let of_frames = of_frames.chunks_exact_mut(width + action_dim);
            for (out, ((combined, ego), frame)) in of_frames.zip(frames.by_ref()) {
                let (encoded, action) = out.split_at_mut(width);
                let sums = combined.iter().zip(ego);
                encoded.iter_mut().zip(sums).for_each(|(out, (c, e))| *out = (c + e) * 0.5);
                action.copy_from_slice(&frame[n_entities * n_features..]);
            }
            rest.copy_from_slice(&input.row(sample)[n_frames * frame_dim..]);
        }
    }

    /// Goes back from the slopes in the features, and takes over what the gradients are made of.
    fn backward(&mut self, weights: &AttentionWeights, d_features: &[f32]) {
        let EgoAttention { n_frames, action_dim, width, n_heads, .. } = weights.spec;
        self.d_combined.clear();
        for row in d_features.chunks_exact(d_features.len() / self.n_samples) {
            for frame in row.chunks_exact(width + action_dim).take(n_frames) {
                self.d_combined.extend(frame[..width].iter().map(|d| d * 0.5));
            }
        }
        let [of_query, of_output, embeddings @ ..] = &mut self.rows;
        let (egos, wide, n) = (&self.egos.second, n_heads * width, self.present.frames.len());
        of_output.take(&self.d_combined, &self.taken, n, [width, wide]);
        weights.output.product.d_input(&self.d_combined, &mut self.d_taken);
        let shares = EgoShares { attention: weights.attention, presence: &self.present.frames };
        let slopes = &mut self.slopes;
        shares.backward(&self.queries, egos, &self.others.second, &self.d_taken, slopes);
        of_query.take(&slopes.queries, egos, n, [wide, width]);
        weights.query.product.d_input(&slopes.queries, &mut self.d_by_query);
        // An ego's embedding is part of the encoding, is attended to, and asks: added up in this order.
        let d_egos = &mut self.d_combined;
        let ways = slopes.egos.iter().zip(&self.d_by_query);
        d_egos.iter_mut().zip(ways).for_each(|(d, (taken, asked))| *d = *d + taken + asked);
        let (of_egos, of_others) = embeddings.split_at_mut(2);
        self.egos.backward(&weights.egos, &self.present.egos, d_egos, of_egos);
        let d_others = &mut slopes.others;
        self.others.backward(&weights.others, &self.present.others, d_others, of_others);
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
