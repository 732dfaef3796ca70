//! The graph of a recurrent encoder over whole sequences.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{Result, Tensor, Var};
use leadtime_policy::architecture::{Layer, LstmLayers};

use crate::dense_op::DenseOp;
use crate::lstm_op::{LstmOp, Sequences};

/// Projection, gates from the input, and the recurrent layer.
#[derive(Clone, Debug)]
pub(crate) struct LstmGraph {
    layers: LstmLayers,
    width: usize,
}

impl LstmGraph {
    pub(crate) fn new(obs_dim: usize, projection: usize, width: usize) -> Self {
        Self { layers: LstmLayers::new(obs_dim, projection, width), width }
    }

    /// Builds the graph from observations `[M, D]`, whole sequences one behind the other, to hidden states `[M, H]`.
    pub(crate) fn forward(
        &self,
        vars: &BTreeMap<String, Var>,
        observations: &Tensor,
        sequences: &Arc<Sequences>,
    ) -> Result<Tensor> {
        let LstmLayers { projection, input, state } = &self.layers;
        let layer = |x: &Tensor, layer: &Layer, input_gradient| {
            let op = DenseOp { activation: layer.activation, input_gradient };
            x.apply_op3(&vars[&layer.weight()], &vars[&layer.bias()], op)
        };
        let gates = match projection {
            None => layer(observations, input, false)?,
            Some(projection) => layer(&layer(observations, projection, false)?, input, true)?,
        };
        let op = LstmOp::new(Arc::clone(sequences), self.width);
        gates.apply_op3(&vars[&state.weight()], &vars[&state.bias()], op)
    }
}
