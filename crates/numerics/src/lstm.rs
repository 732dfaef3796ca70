//! The pointwise half of an LSTM step: gates and states, given the products of weights and inputs.
//!
//! ```text
//! i, f, o = sigmoid of their pre-activations      c' = f c + i g
//! g       = tanh of its pre-activation            h' = o tanh(c')
//! ```
//!
//! The matrix products are [`crate::dense`]'s. Rows are independent: a row's bits do not depend on its batch.
//!
//! # Source
//!
//! Hochreiter and Schmidhuber, *Long short-term memory*, 1997, with the forget gate of Gers et al., 2000; gates in
//! `PyTorch`'s order.

#![expect(
    clippy::inline_always,
    reason = "kernels must be compiled inside the dispatched target features"
)]
#![expect(
    clippy::needless_range_loop,
    reason = "arrays of registers are unrolled where they are indexed"
)]

use pulp::{Arch, Simd, WithSimd};

use crate::elementary::tanh_vector;

/// Gates per unit: input, forget, cell, output.
pub const N_GATES: usize = 4;

/// One row of a step forward, in learning: of each unit what the step makes of it is kept.
#[derive(Debug)]
pub struct ForwardRow<'a> {
    /// Pre-activations of input, forget, cell and output gate from the states; becomes the activated gates. `[4 H]`
    pub gates: &'a mut [f32],
    /// Pre-activations from the inputs. `[4 H]`
    pub from_input: &'a [f32],
    /// Cell states before the step. `[H]`
    pub cell_before: &'a [f32],
    /// Cell states after the step, written. `[H]`
    pub cell: &'a mut [f32],
    /// tanh of the cell states after the step, written. `[H]`
    pub squashed: &'a mut [f32],
    /// Hidden states after the step, written. `[H]`
    pub hidden: &'a mut [f32],
}

/// One row of a step backward: what it reads is what [`forward`] left.
#[derive(Debug)]
pub struct BackwardRow<'a> {
    /// Activated gates. `[4 H]`
    pub gates: &'a [f32],
    /// Cell states before the step. `[H]`
    pub cell_before: &'a [f32],
    /// tanh of the cell states after the step. `[H]`
    pub squashed: &'a [f32],
    /// Slopes in the hidden states after the step, from the steps behind it. `[H]`
    pub d_hidden: &'a [f32],
    /// The same from what else reads the hidden states. `[H]`
    pub d_out: &'a [f32],
    /// Slopes in the cell states after the step; becomes those before it. `[H]`
    pub d_cell: &'a mut [f32],
    /// Slopes before the gates' activations, written. `[4 H]`
    pub d_gates: &'a mut [f32],
}

/// Moves hidden and cell states on by a step.
///
/// # Shapes
///
/// `gates`: `[N, 4 H]`, pre-activations of input, forget, cell and output gate, replaced by the activated gates;
/// `hidden`: `[N, H]`, written; `cell`: `[N, H]`, replaced by the new cell states.
///
/// # Panics
///
/// If the shapes do not hold.
///
/// # Example
///
/// ```
/// let (mut gates, mut hidden, mut cell) = ([0.0; 4], [0.0], [2.0]);
/// leadtime_numerics::lstm::step(&mut gates, &mut hidden, &mut cell, 1);
/// assert_eq!((gates, cell), ([0.5, 0.5, 0.0, 0.5], [1.0]));
/// assert!((hidden[0] - 0.5 * 1.0_f32.tanh()).abs() < 1e-6);
/// ```
pub fn step(gates: &mut [f32], hidden: &mut [f32], cell: &mut [f32], width: usize) {
    assert_eq!(gates.len(), N_GATES * cell.len(), "`gates` must be [N, 4 H]");
    assert_eq!(hidden.len(), cell.len(), "`hidden` and `cell` must be [N, H]");
    let gates = gates.chunks_exact_mut(N_GATES * width);
    let rows = gates.zip(hidden.chunks_exact_mut(width)).zip(cell.chunks_exact_mut(width));
    Arch::new().dispatch(LstmSteps { rows, width });
}

/// Moves rows on by a step, with the bits of [`step`], and keeps what their slopes need.
///
/// # Panics
///
/// If the shapes of a row do not hold.
pub fn forward<'a>(rows: impl Iterator<Item = ForwardRow<'a>>) {
    Arch::new().dispatch(Forward(rows));
}

/// Goes back by a step.
///
/// # Panics
///
/// If the shapes of a row do not hold.
pub fn backward<'a>(rows: impl Iterator<Item = BackwardRow<'a>>) {
    Arch::new().dispatch(Backward(rows));
}

/// The rows of a step: gates, hidden and cell states of each.
struct LstmSteps<R> {
    rows: R,
    width: usize,
}

impl<'a, R> WithSimd for LstmSteps<R>
where
    R: Iterator<Item = ((&'a mut [f32], &'a mut [f32]), &'a mut [f32])>,
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let width = self.width;
        for ((gates, hidden), cell) in self.rows {
            let gates = split_gates_mut(gates, width);
            for first in (0..width).step_by(S::F32_LANES) {
                let own = UnitLanes { first, end: width.min(first + S::F32_LANES) };
                let before = own.load_units(simd, [&*gates[0], &*gates[1], &*gates[2], &*gates[3]]);
                let (Units(units), after) = before.step(simd, own.load(simd, cell));
                for gate in 0..N_GATES {
                    own.store(simd, units[gate], gates[gate]);
                }
                own.store(simd, after.cell, cell);
                own.store(simd, after.hidden, hidden);
            }
        }
    }
}

struct Forward<R>(R);

impl<'a, R: Iterator<Item = ForwardRow<'a>>> WithSimd for Forward<R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for row in self.0 {
            let width = row.hidden.len();
            let gates = split_gates_mut(row.gates, width);
            let from_input = split_gates(row.from_input, width);
            for first in (0..width).step_by(S::F32_LANES) {
                let own = UnitLanes { first, end: width.min(first + S::F32_LANES) };
                let mut before =
                    own.load_units(simd, [&*gates[0], &*gates[1], &*gates[2], &*gates[3]]);
                let Units(added) = own.load_units(simd, from_input);
                for gate in 0..N_GATES {
                    before.0[gate] = simd.add_f32s(before.0[gate], added[gate]);
                }
                let (Units(units), after) = before.step(simd, own.load(simd, row.cell_before));
                for gate in 0..N_GATES {
                    own.store(simd, units[gate], gates[gate]);
                }
                own.store(simd, after.cell, row.cell);
                own.store(simd, after.squashed, row.squashed);
                own.store(simd, after.hidden, row.hidden);
            }
        }
    }
}

struct Backward<R>(R);

impl<'a, R: Iterator<Item = BackwardRow<'a>>> WithSimd for Backward<R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for row in self.0 {
            let width = row.d_cell.len();
            let gates = split_gates(row.gates, width);
            let d_gates = split_gates_mut(row.d_gates, width);
            for first in (0..width).step_by(S::F32_LANES) {
                let own = UnitLanes { first, end: width.min(first + S::F32_LANES) };
                let units = own.load_units(simd, gates);
                let from_behind = own.load(simd, row.d_hidden);
                let d_hidden = simd.add_f32s(from_behind, own.load(simd, row.d_out));
                let squashed = own.load(simd, row.squashed);
                let cells = [own.load(simd, row.d_cell), own.load(simd, row.cell_before)];
                let (Units(slopes), d_before) = units.back(simd, d_hidden, squashed, cells);
                for gate in 0..N_GATES {
                    own.store(simd, slopes[gate], d_gates[gate]);
                }
                own.store(simd, d_before, row.d_cell);
            }
        }
    }
}

/// At most one vector of units.
#[derive(Clone, Copy)]
struct UnitLanes {
    first: usize,
    end: usize,
}

impl UnitLanes {
    #[inline(always)]
    fn load<S: Simd>(self, simd: S, values: &[f32]) -> S::f32s {
        let values = &values[self.first..self.end];
        match S::as_simd_f32s(values) {
            ([vector], _) => *vector,
            _ => simd.partial_load_f32s(values),
        }
    }

    #[inline(always)]
    fn load_units<S: Simd>(self, simd: S, gates: [&[f32]; N_GATES]) -> Units<S::f32s> {
        let [input, forget, candidate, output] = gates;
        Units([
            self.load(simd, input),
            self.load(simd, forget),
            self.load(simd, candidate),
            self.load(simd, output),
        ])
    }

    #[inline(always)]
    fn store<S: Simd>(self, simd: S, vector: S::f32s, values: &mut [f32]) {
        let values = &mut values[self.first..self.end];
        if let ([slot], _) = S::as_mut_simd_f32s(values) {
            *slot = vector;
        } else {
            simd.partial_store_f32s(values, vector);
        }
    }
}

#[inline(always)]
fn split_gates(gates: &[f32], width: usize) -> [&[f32]; N_GATES] {
    let (input, rest) = gates.split_at(width);
    let (forget, rest) = rest.split_at(width);
    let (candidate, output) = rest.split_at(width);
    [input, forget, candidate, &output[..width]]
}

#[inline(always)]
fn split_gates_mut(gates: &mut [f32], width: usize) -> [&mut [f32]; N_GATES] {
    let (input, rest) = gates.split_at_mut(width);
    let (forget, rest) = rest.split_at_mut(width);
    let (candidate, output) = rest.split_at_mut(width);
    [input, forget, candidate, &mut output[..width]]
}

/// One vector of units: their input, forget, candidate and output gates, or the slopes in them.
#[derive(Clone, Copy)]
struct Units<V>([V; N_GATES]);

/// The states of one vector of units after a step.
#[derive(Clone, Copy)]
struct UnitStates<V> {
    cell: V,
    /// tanh of the cell states.
    squashed: V,
    hidden: V,
}

impl<V: Copy> Units<V> {
    /// Activates pre-activations and moves the states on.
    #[inline(always)]
    fn step<S: Simd<f32s = V>>(self, simd: S, cell: V) -> (Self, UnitStates<V>) {
        let Self([input, forget, candidate, output]) = self;
        let (input, forget) = (sigmoid(simd, input), sigmoid(simd, forget));
        let (candidate, output) = (tanh_vector(simd, candidate), sigmoid(simd, output));
        let cell = simd.add_f32s(simd.mul_f32s(forget, cell), simd.mul_f32s(input, candidate));
        let squashed = tanh_vector(simd, cell);
        let hidden = simd.mul_f32s(squashed, output);
        (Self([input, forget, candidate, output]), UnitStates { cell, squashed, hidden })
    }

    /// From activated gates, slopes in h and c after the step (`cells[0]`), tanh of c and c before the step
    /// (`cells[1]`): slopes before the gates' activations, and those in c before the step.
    #[inline(always)]
    fn back<S: Simd<f32s = V>>(
        self,
        simd: S,
        d_hidden: V,
        squashed: V,
        cells: [V; 2],
    ) -> (Self, V) {
        let Self([input, forget, candidate, output]) = self;
        let [d_cell, cell_before] = cells;
        let through = simd.mul_f32s(simd.mul_f32s(d_hidden, output), slope_of_tanh(simd, squashed));
        let d = simd.add_f32s(d_cell, through);
        let d_input = back_through_sigmoid(simd, d, candidate, input);
        let d_forget = back_through_sigmoid(simd, d, cell_before, forget);
        let d_candidate = simd.mul_f32s(simd.mul_f32s(d, input), slope_of_tanh(simd, candidate));
        let d_output = back_through_sigmoid(simd, d_hidden, squashed, output);
        (Self([d_input, d_forget, d_candidate, d_output]), simd.mul_f32s(d, forget))
    }
}

/// `1 - y²` of an output y.
#[inline(always)]
fn slope_of_tanh<S: Simd>(simd: S, y: S::f32s) -> S::f32s {
    simd.sub_f32s(simd.splat_f32s(1.0), simd.mul_f32s(y, y))
}

/// The slope before a gate y that multiplies `factor`, from the one in their product: `slope factor y (1 - y)`
#[inline(always)]
fn back_through_sigmoid<S: Simd>(simd: S, slope: S::f32s, factor: S::f32s, y: S::f32s) -> S::f32s {
    let d = simd.mul_f32s(simd.mul_f32s(slope, factor), y);
    simd.mul_f32s(d, simd.sub_f32s(simd.splat_f32s(1.0), y))
}

/// `sigmoid(x) = (1 + tanh(x / 2)) / 2`
#[inline(always)]
fn sigmoid<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let half = simd.splat_f32s(0.5);
    let tanh = tanh_vector(simd, simd.mul_f32s(x, half));
    simd.add_f32s(simd.mul_f32s(half, tanh), half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Activation, Dense};

    fn sigmoid(x: f32) -> f32 {
        1.0 / (1.0 + (-x).exp())
    }

    #[test]
    fn a_step_is_the_textbooks() {
        let width = 3;
        let before: Vec<f32> = (0..24).map(|i| (i as f32 * 0.7).sin() * 3.0).collect();
        let old_cell: Vec<f32> = (0..6).map(|i| (i as f32).cos()).collect();
        let (mut gates, mut cell, mut hidden) = (before.clone(), old_cell.clone(), vec![0.0; 6]);
        step(&mut gates, &mut hidden, &mut cell, width);
        for row in 0..2 {
            for i in 0..width {
                let x = |gate: usize| before[row * 12 + gate * width + i];
                let c = sigmoid(x(1)) * old_cell[row * width + i] + sigmoid(x(0)) * x(2).tanh();
                let h = sigmoid(x(3)) * c.tanh();
                assert!((cell[row * width + i] - c).abs() < 1e-6, "{row} {i}");
                assert!((hidden[row * width + i] - h).abs() < 1e-6, "{row} {i}");
            }
        }
        let (mut alone, mut alone_hidden) = (before[12..].to_vec(), vec![0.0; 3]);
        step(&mut alone, &mut alone_hidden, &mut old_cell[3..].to_vec(), width);
        assert_eq!(alone_hidden, hidden[3..], "a row's bits depend on its batch");
    }

    /// Numbers from -1 to 1.
    fn draws(n: usize, seed: u64) -> Vec<f32> {
        let mut generator = crate::Pcg64::seed_from_u64(seed);
        (0..n).map(|_| generator.uniform(-1.0, 1.0) as f32).collect()
    }

    #[test]
    fn learning_takes_the_same_step() {
        // Whole vectors and a rest.
        let width = 21;
        let (state, input) = (draws(4 * width, 1), draws(4 * width, 2));
        let cell_before = draws(width, 3);
        let mut expected: Vec<f32> = state.iter().zip(&input).map(|(s, x)| s + x).collect();
        let (mut hidden_after, mut cell_after) = (vec![0.0; width], cell_before.clone());
        step(&mut expected, &mut hidden_after, &mut cell_after, width);
        let mut gates = state;
        let [mut cell, mut squashed, mut hidden] = [(); 3].map(|()| vec![f32::NAN; width]);
        forward(std::iter::once(ForwardRow {
            gates: &mut gates,
            from_input: &input,
            cell_before: &cell_before,
            cell: &mut cell,
            squashed: &mut squashed,
            hidden: &mut hidden,
        }));
        assert_eq!((gates, &hidden, &cell), (expected, &hidden_after, &cell_after));
        let (tanh, mut tangents) = (Dense::new(&[1.0], &[-0.0]).unwrap(), vec![f32::NAN; width]);
        tanh.forward(&cell, &mut tangents, Activation::Tanh);
        assert_eq!(squashed, tangents);
    }

    #[test]
    fn a_step_back_is_the_definition_bit_for_bit() {
        let width = 21;
        let (gates, cell_before, squashed) =
            (draws(4 * width, 1), draws(width, 2), draws(width, 3));
        let (d_hidden, d_out, before) = (draws(width, 4), draws(width, 5), draws(width, 6));
        let (mut d_cell, mut d_gates) = (before.clone(), vec![f32::NAN; 4 * width]);
        backward(std::iter::once(BackwardRow {
            gates: &gates,
            cell_before: &cell_before,
            squashed: &squashed,
            d_hidden: &d_hidden,
            d_out: &d_out,
            d_cell: &mut d_cell,
            d_gates: &mut d_gates,
        }));
        for i in 0..width {
            let [input, forget, candidate, output] = [0, 1, 2, 3].map(|g| gates[g * width + i]);
            let dh = d_hidden[i] + d_out[i];
            let d = before[i] + dh * output * (1.0 - squashed[i] * squashed[i]);
            let expected = [
                d * candidate * input * (1.0 - input),
                d * cell_before[i] * forget * (1.0 - forget),
                d * input * (1.0 - candidate * candidate),
                dh * squashed[i] * output * (1.0 - output),
            ];
            assert_eq!([0, 1, 2, 3].map(|g| d_gates[g * width + i]), expected, "{i}");
            assert_eq!(d_cell[i], d * forget, "{i}");
        }
    }
}
