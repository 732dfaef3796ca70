//! The first stage of a configuration: what a person wrote, key by key, unknown ones refused.
//!
//! Every section is typed, so that an unknown or wrong-typed key is reported with its line and with what is allowed.
//! The sections about the task differ from domain to domain ([`sections`](super::sections)); nothing is cross-checked here.

use leadtime_learner::LearnerSettings;
use leadtime_proto::HeadCredit;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use toml::Table;

/// The whole file; `W`, `H` and `N` are the domain's world, human and notifier sections.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[serde(bound(
    serialize = "W: Serialize, H: Serialize, N: Serialize",
    deserialize = "W: DeserializeOwned + Default, H: DeserializeOwned + Default, \
                   N: DeserializeOwned + Default"
))]
pub struct RawConfig<W, H, N> {
    /// What to train on.
    #[serde(default)]
    pub domain: String,
    /// Seed of every random stream.
    #[serde(default)]
    pub seed: u64,
    /// Where and how the run is carried out.
    #[serde(default)]
    pub run: RunSection,
    /// The world.
    #[serde(default)]
    pub world: W,
    /// The person.
    #[serde(default)]
    pub human: H,
    /// The notifier problem.
    #[serde(default)]
    pub notifier: N,
    /// The networks.
    #[serde(default)]
    pub policy: PolicySection,
    /// The algorithm.
    #[serde(default)]
    pub learner: LearnerSettings,
    /// The actors.
    #[serde(default)]
    pub actor: ActorSection,
    /// How policies are judged afterwards.
    #[serde(default)]
    pub evaluation: EvaluationSection,
}

/// `[run]`: where and how, nothing that changes what is computed.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunSection {
    /// Name of the run; empty: the unfinished run of this configuration, or a new one.
    pub name: String,
    /// Directory that holds the runs.
    pub directory: String,
    /// Actors that must be there before the run starts.
    pub actors_min: u32,
    /// Updates between checkpoints.
    pub checkpoint_every: u64,
    /// Seconds between checkpoints.
    pub checkpoint_seconds: u64,
}

impl Default for RunSection {
    fn default() -> Self {
        Self {
            name: String::new(),
            directory: "runs".to_owned(),
            actors_min: 1,
            checkpoint_every: 10,
            checkpoint_seconds: 30,
        }
    }
}

/// `[policy]`: the networks.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PolicySection {
    /// What stands between observation and tanh layers.
    pub encoder: EncoderKind,
    /// Width of the tanh layer in front of the LSTM; 0: none.
    pub lstm_projection: usize,
    /// Units of the LSTM.
    pub lstm_state: usize,
    /// Width of the embeddings of entities and of the attention to them.
    pub attention_width: usize,
    /// Heads of the attention, which share out its width.
    pub attention_heads: usize,
    /// Widths of the tanh layers.
    pub hidden: Vec<usize>,
    /// Which heads' log-probabilities count.
    pub head_credit: HeadCredit,
    /// Whether observations are normalised by running statistics.
    pub normalize_observations: bool,
    /// Initial bias of the choice "start a message".
    pub initiate_bias: f64,
    /// Initial bias of the choices of k and l, per choice beyond the shortest.
    pub length_bias: f64,
}

impl Default for PolicySection {
    fn default() -> Self {
        Self {
            encoder: EncoderKind::None,
            lstm_projection: 32,
            lstm_state: 128,
            attention_width: 64,
            attention_heads: 2,
            hidden: vec![64, 64],
            head_credit: HeadCredit::Active,
            normalize_observations: false,
            initiate_bias: 0.0,
            length_bias: 0.0,
        }
    }
}

/// What stands between observation and tanh layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EncoderKind {
    /// Nothing.
    #[default]
    None,
    /// One LSTM that actor and critic share.
    Lstm,
    /// An ego's attention to the entities of the observation, which actor and critic share.
    Attention,
}

/// `[actor]`: how actors send.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActorSection {
    /// The most rollouts that one actor may have unacknowledged.
    pub window: u32,
}

impl Default for ActorSection {
    fn default() -> Self {
        Self { window: 64 }
    }
}

/// `[evaluation]`: how policies are judged after training.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationSection {
    /// Episodes per policy.
    pub episodes: u32,
    /// Whether actions are drawn or the most likely one is taken.
    pub action: EvaluationAction,
    /// Keys of `[world]` that differ in evaluation.
    pub world: Table,
}

/// How an evaluated policy chooses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum EvaluationAction {
    /// Draw from the policy's distribution.
    #[default]
    Sample,
    /// Take the most likely choice of every head.
    Greedy,
}

/// A section that a domain does not have: every key in it is unknown.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Absent {}
