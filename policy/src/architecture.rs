//! Which tensors an architecture has: names, shapes and how each starts.
//!
//! ```text
//! actor.0.weight  [64, D]   actor.1.weight [64, 64]   actor.head.weight  [C, 64]
//! critic.0.weight [64, D]   critic.1.weight [64, 64]  critic.head.weight [1, 64]     and a `bias` beside each
//! ```
//!
//! D is the width of the features, C the number of choices over all heads, whose logits lie one behind the other.
//!
//! A recurrent encoder stands before both, with H units and its gates (input, forget, cell, output) one behind the other:
//!
//! ```text
//! encoder.projection.weight [P, obs]   encoder.input.weight [4 H, P]   encoder.state.weight [4 H, H]
//! ```

use leadtime_numerics::lstm::N_GATES;
use leadtime_proto::{Encoder, PolicySpec};

/// The two networks of an actor-critic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Network {
    /// Features to logits.
    Actor,
    /// Features to the value.
    Critic,
}

impl Network {
    /// Returns the prefix of the network's tensor names.
    pub fn prefix(self) -> &'static str {
        match self {
            Self::Actor => "actor",
            Self::Critic => "critic",
        }
    }
}

/// One fully connected layer of an architecture.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// `actor.0`, `critic.head` and the like; `.weight` and `.bias` follow.
    pub name: String,
    /// Inputs.
    pub n_in: usize,
    /// Outputs.
    pub n_out: usize,
    /// Scale of the orthogonal initial weights.
    pub gain: f64,
    /// Whether tanh follows (heads: no).
    pub tanh: bool,
}

impl Layer {
    /// Returns the name of the weights, `[n_out, n_in]`.
    pub fn weight(&self) -> String {
        format!("{}.weight", self.name)
    }

    /// Returns the name of the biases, `[n_out]`.
    pub fn bias(&self) -> String {
        format!("{}.bias", self.name)
    }
}

/// Returns the width of what the two networks see.
pub fn feature_dim(spec: &PolicySpec) -> usize {
    match spec.encoder {
        Encoder::Identity => spec.obs_dim,
        Encoder::Lstm { state, .. } => state,
    }
}

/// Lists the layers of the encoder: none, or an LSTM's `projection` (if it has one), `input` and `state`.
pub fn encoder_layers(spec: &PolicySpec) -> Vec<Layer> {
    let Encoder::Lstm { projection, state } = spec.encoder else { return Vec::new() };
    let layer = |name: &str, n_in, n_out, gain, tanh| Layer {
        name: format!("encoder.{name}"),
        n_in,
        n_out,
        gain,
        tanh,
    };
    let mut layers = Vec::with_capacity(3);
    let mut n_in = spec.obs_dim;
    if projection > 0 {
        let gain = std::f64::consts::SQRT_2;
        layers.push(layer("projection", n_in, projection, gain, true));
        n_in = projection;
    }
    layers.push(layer("input", n_in, N_GATES * state, 1.0, false));
    layers.push(layer("state", state, N_GATES * state, 1.0, false));
    layers
}

/// Lists the layers of one network, input first.
pub fn layers(spec: &PolicySpec, network: Network) -> Vec<Layer> {
    let prefix = network.prefix();
    let mut n_in = feature_dim(spec);
    let mut layers = Vec::with_capacity(spec.hidden.len() + 1);
    for (i, &n_out) in spec.hidden.iter().enumerate() {
        let gain = std::f64::consts::SQRT_2;
        layers.push(Layer { name: format!("{prefix}.{i}"), n_in, n_out, gain, tanh: true });
        n_in = n_out;
    }
    let (n_out, gain) = match network {
        Network::Actor => (spec.actions.n_choices(), 0.01),
        Network::Critic => (1, 1.0),
    };
    layers.push(Layer { name: format!("{prefix}.head"), n_in, n_out, gain, tanh: false });
    layers
}

/// Lists all layers: the encoder's, the actor's, then the critic's. The order numbers the streams of initialisation.
pub fn all_layers(spec: &PolicySpec) -> Vec<Layer> {
    let mut all = encoder_layers(spec);
    all.extend(layers(spec, Network::Actor));
    all.extend(layers(spec, Network::Critic));
    all
}
