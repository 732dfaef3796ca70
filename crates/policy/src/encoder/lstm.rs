//! A recurrent layer for acting.
//!
//! ```text
//! x ─► tanh(encoder.projection) ─► encoder.input ─┐
//! h, of the step before ─────────► encoder.state ─ + ─► gates ─► h, c        features = h
//! ```
//!
//! The state that a row carries from step to step is `[h | c]`, zero when an episode starts.

use leadtime_numerics::{Activation, Dense, lstm};

use crate::architecture::LstmLayers;
use crate::{Error, Parameters};

/// An LSTM with fixed weights and room for a block of rows.
#[derive(Clone, Debug)]
pub(crate) struct LstmEncoder {
    width: usize,
    projection: Option<Dense>,
    input: Dense,
    state: Dense,
    projected: Vec<f32>,
    gates: Vec<f32>,
    from_state: Vec<f32>,
    hidden: Vec<f32>,
    cell: Vec<f32>,
}

impl LstmEncoder {
    /// Packs an LSTM's parameters, with room for `block` rows at a time.
    pub(super) fn new(
        layers: &LstmLayers,
        parameters: &Parameters,
        block: usize,
    ) -> Result<Self, Error> {
        let width = layers.state.n_in;
        let projection = layers.projection.as_ref().map_or(0, |layer| layer.n_out);
        let pack = |layer| parameters.dense(layer);
        Ok(Self {
            width,
            projection: layers.projection.as_ref().map(pack).transpose()?,
            input: pack(&layers.input)?,
            state: pack(&layers.state)?,
            projected: vec![0.0; block * projection],
            gates: vec![0.0; block * lstm::N_GATES * width],
            from_state: vec![0.0; block * lstm::N_GATES * width],
            hidden: vec![0.0; block * width],
            cell: vec![0.0; block * width],
        })
    }

    /// Encodes `n` rows from their states before the step.
    ///
    /// # Shapes
    ///
    /// `x`: `[n, D]`; `recurrent`: `[n, 2 H]`. Returns `[n, H]`.
    pub(super) fn encode<'a>(&'a mut self, x: &'a [f32], recurrent: &[f32], n: usize) -> &'a [f32] {
        let width = self.width;
        let (hidden, cell) = (&mut self.hidden[..n * width], &mut self.cell[..n * width]);
        for (row, state) in recurrent.chunks_exact(2 * width).enumerate() {
            let place = row * width..(row + 1) * width;
            hidden[place.clone()].copy_from_slice(&state[..width]);
            cell[place].copy_from_slice(&state[width..]);
        }
        let x = match &self.projection {
            None => x,
            Some(projection) => {
                let projected = &mut self.projected[..n * projection.n_out()];
                projection.forward(x, projected, Activation::Tanh);
                projected
            }
        };
        let gates = &mut self.gates[..n * lstm::N_GATES * width];
        let from_state = &mut self.from_state[..gates.len()];
        self.input.forward(x, gates, Activation::Linear);
        self.state.forward(hidden, from_state, Activation::Linear);
        gates.iter_mut().zip(from_state).for_each(|(gate, s)| *gate += *s);
        lstm::step(gates, hidden, cell, width);
        hidden
    }

    /// Writes the states after the rows that were encoded last. Shape `[n, 2 H]`.
    pub(super) fn write_states(&self, recurrent: &mut [f32]) {
        let width = self.width;
        for (row, state) in recurrent.chunks_exact_mut(2 * width).enumerate() {
            let place = row * width..(row + 1) * width;
            state[..width].copy_from_slice(&self.hidden[place.clone()]);
            state[width..].copy_from_slice(&self.cell[place]);
        }
    }
}
