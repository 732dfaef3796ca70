//! Gradients of layers as sums of outer products, shared among threads by their outputs.
//!
//! An element of a gradient is one chain of additions over rows, in an order that its layer's rows are given in. Threads
//! share out the elements and not the rows, so who adds up what changes no bit, and neither does where the rows lie.

use leadtime_numerics::Panels;
use leadtime_numerics::kernel::{PANEL, RowPairs, add_left_rows, add_row_products};
use leadtime_policy::architecture::Layer;

use crate::dense::{Gradients, LayerGradient};
use crate::team::Team;

/// Panels of outputs that one thread takes at a time.
const PANELS: usize = 8;
/// Rows per pass: what one pass reads for its panels stays in the second-level cache. Not a power of two, with which
/// the panels of a row would share a cache set.
const DEPTH: usize = 248;

/// A layer's gradient, and the rows that it sums up: slopes in the outputs on the left, inputs on the right.
#[derive(Debug)]
pub(crate) struct LayerSum<'a> {
    /// In the order of the additions.
    pub(crate) rows: Vec<RowPairs<'a>>,
    gradient: LayerGradient,
    layer: &'a Layer,
}

impl<'a> LayerSum<'a> {
    /// Begins with zeros, in the memory of the gradient that was there before.
    pub(crate) fn new(
        layer: &'a Layer,
        rows: Vec<RowPairs<'a>>,
        gradients: &mut Gradients,
    ) -> Self {
        let mut memory = |name| gradients.remove(&name).unwrap_or_default();
        let (weights, biases) = (memory(layer.weight()), memory(layer.bias()));
        let mut gradient = LayerGradient { weights, biases };
        gradient.clear(layer);
        Self { rows, gradient, layer }
    }

    /// Puts the gradient among the others.
    pub(crate) fn put_into(self, gradients: &mut Gradients) {
        let LayerGradient { weights, biases } = self.gradient;
        gradients.insert(self.layer.weight(), weights);
        gradients.insert(self.layer.bias(), biases);
    }
}

/// Some outputs of one layer.
struct OutputsTask<'a> {
    rows: &'a [RowPairs<'a>],
    /// The first of their panels.
    first: usize,
    weights: &'a mut [f32],
    biases: &'a mut [f32],
}

/// Adds the rows of all layers up.
pub(crate) fn add_up(layers: &mut [LayerSum<'_>], team: &Team) {
    let mut tasks = Vec::new();
    for LayerSum { rows, gradient, .. } in layers {
        let Some(n_in) = rows.first().map(|rows| rows.right.n_columns()) else { continue };
        let mut biases = gradient.biases.chunks_mut(PANELS * PANEL);
        for (i, weights) in gradient.weights.chunks_mut(PANELS * PANEL * n_in).enumerate() {
            let biases = biases.next().unwrap_or_default();
            tasks.push(OutputsTask { rows, first: i * PANELS, weights, biases });
        }
    }
    team.for_each(tasks.into_iter(), OutputsTask::run);
}

impl OutputsTask<'_> {
    fn run(self) {
        let Self { mut rows, first, weights, biases } = self;
        let (mut left, mut right) = (Panels::default(), Panels::default());
        while !rows.is_empty() {
            let (now, later) = rows.split_at(pass_len(rows));
            let n_in = now[0].right.n_columns();
            // Single rows lie far from each other: they are brought together once for all panels.
            if now.iter().all(|rows| rows.len == 1) {
                let n_out = weights.len() / n_in;
                left.gather(now.iter().map(|rows| (rows.left, rows.first)), first, n_out);
                right.gather(now.iter().map(|rows| (rows.right, rows.first)), 0, n_in);
                let now = RowPairs { left: &left, right: &right, first: 0, len: now.len() };
                add_pass(&[now], 0, weights, biases);
            } else {
                add_pass(now, first, weights, biases);
            }
            rows = later;
        }
    }
}

/// Adds rows to the outputs from panel `first` on.
fn add_pass(rows: &[RowPairs<'_>], first: usize, weights: &mut [f32], biases: &mut [f32]) {
    let n_in = rows[0].right.n_columns();
    for (panel, weights) in weights.chunks_mut(PANEL * n_in).enumerate() {
        add_row_products(rows, first + panel, weights);
    }
    add_left_rows(rows, first, biases);
}

/// Returns how many entries, at least one, are as many rows as a pass has.
fn pass_len(rows: &[RowPairs<'_>]) -> usize {
    let mut n_rows = 0;
    let fits = |rows: &&RowPairs<'_>| {
        n_rows += rows.len;
        n_rows <= DEPTH
    };
    rows.iter().take_while(fits).count().max(1)
}
