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
        if self.layer.biased {
            gradients.insert(self.layer.bias(), biases);
        }
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

#[cfg(test)]
mod tests {
    use leadtime_numerics::kernel::Activation;

    use super::*;
    use crate::dense::PackedLayer;
    use crate::test_support::{Plain, close, draw};

    #[test]
    fn a_layer_has_the_engines_own_values_and_gradients() {
        let shapes = [(1, 60, 64), (130, 64, 14), (77, 5, 1)];
        let activations = [Activation::Linear, Activation::Tanh, Activation::Relu];
        for ((n, n_in, n_out), activation) in
            shapes.into_iter().flat_map(|shape| activations.map(|activation| (shape, activation)))
        {
            let (x, weight) = (draw((n, n_in), 1), draw((n_out, n_in), 2));
            let bias = draw(n_out, 3);
            let sum = x.matmul(&weight.t().unwrap()).unwrap().broadcast_add(&bias).unwrap();
            let y = match activation {
                Activation::Linear => sum,
                Activation::Tanh => sum.tanh().unwrap(),
                Activation::Relu => sum.relu().unwrap(),
            };
            let plain = Plain::of(&y, &[&x, &weight, &bias]);
            let (name, gain, biased) = ("layer".to_owned(), 1.0, true);
            let mut layer = PackedLayer::new(Layer { name, n_in, n_out, gain, activation, biased });
            let vars = [("layer.weight", weight), ("layer.bias", bias)];
            layer
                .pack(&vars.into_iter().map(|(name, var)| (name.to_owned(), var)).collect())
                .unwrap();
            let x: Vec<f32> = x.flatten_all().unwrap().to_vec1().unwrap();
            let (mut y, mut d_x) = (Vec::new(), Vec::new());
            layer.forward(&x, &mut y);
            let mut slopes = plain.target.clone();
            activation.backward(&y, &mut slopes);
            layer.matrix.d_input(&slopes, &mut d_x);
            let (left, right) =
                (Panels::from_rows(&slopes, n, n_out), Panels::from_rows(&x, n, n_in));
            // In one piece, and row by row.
            let rows = |first, len| RowPairs { left: &left, right: &right, first, len };
            for rows in [vec![rows(0, n)], (0..n).map(|row| rows(row, 1)).collect()] {
                let mut gradients = Gradients::new();
                let mut sums = [LayerSum::new(&layer.layer, rows, &mut gradients)];
                add_up(&mut sums, &Team::new(3).unwrap());
                let [sum] = sums;
                sum.put_into(&mut gradients);
                close(&gradients["layer.weight"], &plain.gradients[1], 5e-5);
                close(&gradients["layer.bias"], &plain.gradients[2], 5e-5);
            }
            close(&y, &plain.values, 1e-5);
            close(&d_x, &plain.gradients[0], 5e-5);
        }
    }
}
