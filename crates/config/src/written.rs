//! A configuration as written: sections with known keys and types, nothing cross-checked yet.
//!
//! No key has a default here: what a person leaves out comes from the built-in files ([`Catalog`](crate::Catalog)). The
//! sections about the task differ from domain to domain ([`sections`](crate::sections)).

use leadtime_episodes::Choice;
use leadtime_ppo::LearnerSettings;
use leadtime_proto::HeadCredit;
use serde::{Deserialize, Serialize};
use toml::Table;

/// The file, but for the sections about the task.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct WrittenConfig {
    /// What to train on.
    pub(crate) domain: String,
    /// Seed of every random stream.
    pub(crate) seed: u64,
    /// Where and how the run is carried out.
    pub(crate) run: RunSection,
    /// The networks.
    pub(crate) policy: PolicySection,
    /// The algorithm.
    pub(crate) learner: LearnerSettings,
    /// The actors.
    pub(crate) actor: ActorSection,
    /// How policies are evaluated afterwards.
    pub(crate) evaluation: EvaluationSection,
}

/// `[run]`: where and how, nothing that changes what is computed.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunSection {
    /// Name of the run; empty: the unfinished run of this configuration, or a new one.
    pub(crate) name: String,
    /// Directory that holds the runs.
    pub(crate) directory: String,
    /// Actors that must be there before the run starts.
    pub(crate) actors_min: u32,
    /// Updates between checkpoints.
    pub(crate) checkpoint_every: u64,
    /// Seconds between checkpoints.
    pub(crate) checkpoint_seconds: u64,
}

/// `[policy]`: the networks.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PolicySection {
    /// What stands between observation and tanh layers.
    pub(crate) encoder: EncoderKind,
    /// Width of the tanh layer in front of the LSTM; 0: none.
    pub(crate) lstm_projection: usize,
    /// Units of the LSTM.
    pub(crate) lstm_state: usize,
    /// Width of the embeddings of entities and of the attention to them.
    pub(crate) attention_width: usize,
    /// Heads of the attention, which share out its width.
    pub(crate) attention_heads: usize,
    /// Widths of the tanh layers.
    pub(crate) hidden: Vec<usize>,
    /// Which heads' log-probabilities count.
    pub(crate) head_credit: HeadCredit,
    /// Whether observations are normalised by running statistics.
    pub(crate) normalize_observations: bool,
    /// Initial bias of the choice "start a message".
    pub(crate) initiate_bias: f64,
    /// Initial bias of the choices of k and l, per choice beyond the shortest.
    pub(crate) length_bias: f64,
}

/// What stands between observation and tanh layers, without its widths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum EncoderKind {
    /// Nothing.
    None,
    /// One LSTM that actor and critic share.
    Lstm,
    /// An ego's attention to the entities of the observation, which actor and critic share.
    Attention,
}

/// `[actor]`: how actors send.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ActorSection {
    /// The most rollouts that one actor may have unacknowledged.
    pub(crate) window: u32,
}

/// `[evaluation]`: how policies are evaluated after training.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EvaluationSection {
    /// Episodes per policy.
    pub(crate) episodes: u32,
    /// Whether actions are drawn or the most likely one is taken.
    pub(crate) action: Choice,
    /// Keys of `[world]` that differ in evaluation.
    #[serde(default)]
    pub(crate) world: Table,
}
