//! What stands between observation and stacks, as actors run it.
//!
//! ```text
//! Identity   x ───────────────────────────────────────────────────────► features = x
//! Lstm       x ─► tanh(encoder.projection) ─► encoder.input  ─┐
//!            h, of the step before ─────────► encoder.state ─ + ─► gates ─► h, c      features = h
//! ```
//!
//! The state that a row carries from step to step is `[h | c]`, zero when an episode starts.

use leadtime_numerics::{Activation, Dense, lstm};
use leadtime_proto::{Encoder, PolicySpec};

use crate::architecture::{Layer, encoder_layers};
use crate::{Error, Parameters};

/// An encoder with fixed weights.
#[derive(Clone, Debug)]
pub(crate) enum FastEncoder {
    Identity,
    Lstm(Box<Lstm>),
}

/// A recurrent encoder and room for a block of rows.
#[derive(Clone, Debug)]
pub(crate) struct Lstm {
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

impl FastEncoder {
    /// Packs an encoder's weights, with room for `block` rows at a time.
    pub(crate) fn new(
        spec: &PolicySpec,
        parameters: &Parameters,
        block: usize,
    ) -> Result<Self, Error> {
        let Encoder::Lstm { state: width, .. } = spec.encoder else { return Ok(Self::Identity) };
        let pack = |layer: &Layer| -> Result<Dense, Error> {
            let weight = parameters.values(&layer.weight())?;
            Ok(Dense::new(&weight, &parameters.values(&layer.bias())?)?)
        };
        let mut layers = encoder_layers(spec).iter().map(pack).collect::<Result<Vec<_>, _>>()?;
        let missing = |name: &str| Error::Missing { name: name.to_owned() };
        let state = layers.pop().ok_or_else(|| missing("encoder.state"))?;
        let input = layers.pop().ok_or_else(|| missing("encoder.input"))?;
        let projection = layers.pop();
        let n_projected = projection.as_ref().map_or(0, Dense::n_out);
        Ok(Self::Lstm(Box::new(Lstm {
            width,
            projected: vec![0.0; block * n_projected],
            gates: vec![0.0; block * lstm::N_GATES * width],
            from_state: vec![0.0; block * lstm::N_GATES * width],
            hidden: vec![0.0; block * width],
            cell: vec![0.0; block * width],
            projection,
            input,
            state,
        })))
    }

    /// Encodes a block of rows, and reads the rows' states without moving them on.
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
            Self::Lstm(lstm) => lstm.forward(x, recurrent, n),
        }
    }

    /// Writes the states after the rows that were encoded last.
    pub(crate) fn write_states(&self, recurrent: &mut [f32]) {
        let Self::Lstm(lstm) = self else { return };
        let width = lstm.width;
        for (row, state) in recurrent.chunks_exact_mut(2 * width).enumerate() {
            let place = row * width..(row + 1) * width;
            state[..width].copy_from_slice(&lstm.hidden[place.clone()]);
            state[width..].copy_from_slice(&lstm.cell[place]);
        }
    }
}

impl Lstm {
    fn forward<'a>(&'a mut self, x: &'a [f32], recurrent: &[f32], n: usize) -> &'a [f32] {
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
}
