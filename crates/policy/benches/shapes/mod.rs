//! Policies of the shapes that are trained, for the benches of inference and of the update.

use leadtime_proto::{ActionSpec, EgoAttention, Encoder, EnvSpec, Head, PolicySpec};

fn actions(n_topics: usize) -> ActionSpec {
    let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
    let heads = vec![head("initiate", 2), head("topic", n_topics), head("k", 4), head("l", 4)];
    ActionSpec { heads, gate: None, conditionals: Vec::new() }
}

/// 60 inputs, two hidden layers of 64.
pub(crate) fn plain() -> PolicySpec {
    let env = EnvSpec { obs_dim: 60, actions: actions(4), metrics: Vec::new() };
    PolicySpec::dense(&env, &[64, 64])
}

/// Ego attention to four frames of ten entities of seven numbers.
pub(crate) fn attentive() -> PolicySpec {
    let attention = EgoAttention {
        n_frames: 4,
        n_entities: 10,
        n_features: 7,
        action_dim: 13,
        width: 64,
        n_heads: 2,
    };
    let obs_dim = 4 * attention.frame_dim() + 5;
    PolicySpec { obs_dim, encoder: Encoder::EgoAttention(attention), ..plain() }
}

/// The steakhouse notifier: an LSTM of 128 shared by actor and critic.
pub(crate) fn recurrent() -> PolicySpec {
    let encoder = Encoder::Lstm { projection: 32, state: 128 };
    PolicySpec { obs_dim: 242, encoder, hidden: Vec::new(), actions: actions(5), ..plain() }
}
