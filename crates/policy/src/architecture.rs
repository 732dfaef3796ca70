//! Which tensors an architecture has: names, shapes and how each starts.
//!
//! ```text
//! actor.0.weight  [64, D]   actor.1.weight [64, 64]   actor.head.weight  [C, 64]
//! critic.0.weight [64, D]   critic.1.weight [64, 64]  critic.head.weight [1, 64]     and a `bias` with each
//! ```
//!
//! D is the width of the features, C the number of choices over all heads, whose logits lie one behind the other.
//! What an encoder adds stands before them. With an LSTM of H units, its gates (input, forget, cell, output) one behind the
//! other, and a projection to P in front of it:
//!
//! ```text
//! encoder.projection.weight [P, obs]   encoder.input.weight [4 H, P]   encoder.state.weight [4 H, H]   and biases
//! ```
//!
//! With ego attention of width W to entities of F numbers:
//!
//! ```text
//! encoder.ego.0.weight    [W, F]  encoder.ego.1.weight    [W, W]  and a `bias` with each
//! encoder.others.0.weight [W, F]  encoder.others.1.weight [W, W]  and a `bias` with each
//! encoder.key.weight, encoder.value.weight, encoder.query.weight, encoder.combine.weight  [W, W]
//! ```

use leadtime_numerics::Activation;
use leadtime_numerics::lstm::N_GATES;
use leadtime_proto::{EgoAttention, Encoder, PolicySpec};

/// The two branches of an actor-critic, behind the encoder that they share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Branch {
    /// From features to logits, one per choice.
    Actor,
    /// From features to the value of the state.
    Critic,
}

/// One fully connected layer of an architecture.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// `actor.0`, `critic.head` and the like; `.weight` and `.bias` follow.
    pub name: String,
    /// Number of inputs, the columns of the weights.
    pub n_in: usize,
    /// Number of outputs, the rows of the weights.
    pub n_out: usize,
    /// Scale of the orthogonal initial weights.
    pub gain: f64,
    /// What is applied to the outputs; heads are linear.
    pub activation: Activation,
    /// Whether it has biases.
    pub biased: bool,
}

impl Layer {
    /// Returns the name of the weights, `[n_out, n_in]`.
    pub fn weight(&self) -> String {
        format!("{}.weight", self.name)
    }

    /// Returns the name of the biases, `[n_out]`, where there are any.
    pub fn bias(&self) -> String {
        format!("{}.bias", self.name)
    }
}

/// Returns the width of the features that both branches see.
pub fn feature_dim(spec: &PolicySpec) -> usize {
    match spec.encoder {
        Encoder::Identity => spec.obs_dim,
        Encoder::Lstm { state, .. } => state,
        Encoder::EgoAttention(attention) => attention.feature_dim(spec.obs_dim),
    }
}

/// The layers of a recurrent encoder.
#[derive(Clone, Debug, PartialEq)]
pub struct LstmLayers {
    /// In front of it, if there is one.
    pub projection: Option<Layer>,
    /// From the input to the gates.
    pub input: Layer,
    /// From the state of the step before to the gates.
    pub state: Layer,
}

impl LstmLayers {
    /// Lists names and shapes, for observations of `n_in` numbers.
    pub fn new(n_in: usize, projection: usize, state: usize) -> Self {
        let layer = |name: &str, n_in, n_out, gain, activation| {
            let name = format!("encoder.{name}");
            Layer { name, n_in, n_out, gain, activation, biased: true }
        };
        let gates = |name, n_in| layer(name, n_in, N_GATES * state, 1.0, Activation::Linear);
        let gain = std::f64::consts::SQRT_2;
        let first = layer("projection", n_in, projection, gain, Activation::Tanh);
        let has_first = projection > 0;
        Self {
            input: gates("input", if has_first { projection } else { n_in }),
            state: gates("state", state),
            projection: has_first.then_some(first),
        }
    }
}

/// The layers of ego attention.
#[derive(Clone, Debug, PartialEq)]
pub struct AttentionLayers {
    /// The two layers that embed the ego.
    pub ego: [Layer; 2],
    /// The embedding of everybody else.
    pub others: [Layer; 2],
    /// From an embedding to its key; no biases.
    pub key: Layer,
    /// From an embedding to its value; no biases.
    pub value: Layer,
    /// The ego's embedding to query.
    pub query: Layer,
    /// The heads' values to the output.
    pub combine: Layer,
}

impl AttentionLayers {
    /// Lists names and shapes.
    ///
    /// # Source
    ///
    /// rl-agents (84df15ea), `EgoAttentionNetwork` as configured for highway-env; the gain is that of highway-env's own
    /// attention script.
    pub fn new(attention: &EgoAttention) -> Self {
        let &EgoAttention { n_features, width: n_out, .. } = attention;
        let gain = std::f64::consts::SQRT_2;
        let layer = |name: &str, n_in, activation, biased| {
            let name = format!("encoder.{name}");
            Layer { name, n_in, n_out, gain, activation, biased }
        };
        let embedding = |who: &str| {
            let part = |i, n_in| layer(&format!("{who}.{i}"), n_in, Activation::Relu, true);
            [part(0, n_features), part(1, n_out)]
        };
        let (ego, others) = (embedding("ego"), embedding("others"));
        let [key, value, query, combine] = ["key", "value", "query", "combine"]
            .map(|name| layer(name, n_out, Activation::Linear, false));
        Self { ego, others, key, value, query, combine }
    }
}

/// Lists the layers of one branch, input first.
pub fn layers(spec: &PolicySpec, branch: Branch) -> Vec<Layer> {
    let (prefix, n_last, last_gain) = match branch {
        Branch::Actor => ("actor", spec.actions.n_choices(), 0.01),
        Branch::Critic => ("critic", 1, 1.0),
    };
    let mut n_in = feature_dim(spec);
    let mut layers = Vec::with_capacity(spec.hidden.len() + 1);
    for (i, &n_out) in spec.hidden.iter().enumerate() {
        let gain = std::f64::consts::SQRT_2;
        let (name, activation) = (format!("{prefix}.{i}"), Activation::Tanh);
        layers.push(Layer { name, n_in, n_out, gain, activation, biased: true });
        n_in = n_out;
    }
    let (name, activation) = (format!("{prefix}.head"), Activation::Linear);
    let (n_out, gain) = (n_last, last_gain);
    layers.push(Layer { name, n_in, n_out, gain, activation, biased: true });
    layers
}

fn encoder_layers(spec: &PolicySpec) -> Vec<Layer> {
    match &spec.encoder {
        Encoder::Identity => Vec::new(),
        &Encoder::Lstm { projection, state } => {
            let layers = LstmLayers::new(spec.obs_dim, projection, state);
            layers.projection.into_iter().chain([layers.input, layers.state]).collect()
        }
        Encoder::EgoAttention(attention) => {
            let layers = AttentionLayers::new(attention);
            let AttentionLayers { ego, others, key, value, query, combine } = layers;
            ego.into_iter().chain(others).chain([key, value, query, combine]).collect()
        }
    }
}

/// Lists all layers: the actor's, the critic's, then the encoder's. The order numbers the streams of initialisation.
pub(crate) fn all_layers(spec: &PolicySpec) -> Vec<Layer> {
    [layers(spec, Branch::Actor), layers(spec, Branch::Critic), encoder_layers(spec)].concat()
}
