//! Actor-critic policies: architecture, parameters, fast inference and the distribution over actions.
//!
//! It holds what acting and learning must share to agree: the same weights give the same logits, the same mask the
//! same support, the same action the same log-probability, bit for bit.
//!
//! ```text
//! PolicySpec ──► architecture (names, shapes) ──► Parameters ⇄ safetensors
//!                                                   │
//!                                raw observation ──► Policy ──► logits ──► ActionDistribution ──► action, log π
//!                                                      └──────► value
//! ```
//!
//! # What it does not know
//!
//! How a policy is trained, and what it acts in: no gradients, environments, networks, files or clocks.
//!
//! # Where to start
//!
//! [`Parameters::initialize`], [`Policy::evaluate`], [`ActionDistribution::sample`].

pub mod architecture;
pub mod attention;
pub mod distribution;
mod encoder;
pub mod error;
pub mod file;
pub mod inference;
pub mod normalizer;
pub mod parameters;

pub use distribution::{ActionDistribution, ActionTerms};
pub use error::Error;
pub use file::read_metadata;
pub use inference::Policy;
pub use normalizer::{FrozenNormalizer, ObservationMoments, ObservationNormalizer};
pub use parameters::Parameters;

#[cfg(test)]
mod tests {
    use leadtime_proto::{ActionSpec, Conditional, EnvSpec, Gate, Head, HeadCredit, PolicySpec};

    /// The notifier's heads: initiate 2, topic 4, k 4, l 4 with l >= k.
    pub(crate) fn notifier(obs_dim: usize) -> PolicySpec {
        let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
        let allowed = vec![0b1111, 0b1110, 0b1100, 0b1000];
        let actions = ActionSpec {
            heads: vec![head("initiate", 2), head("topic", 4), head("k", 4), head("l", 4)],
            gate: Some(Gate { head: 0, choice: 1 }),
            conditionals: vec![Conditional { head: 3, given: 2, allowed }],
        };
        let plain = PolicySpec::dense(&EnvSpec { obs_dim, actions, metrics: vec![] }, &[64, 64]);
        PolicySpec { head_credit: HeadCredit::Active, ..plain }
    }
}
