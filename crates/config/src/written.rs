//! A configuration as written: sections with known keys and types, nothing cross-checked yet.
//!
//! No key has a default here: what a person leaves out comes from the built-in files ([`Catalog`](crate::Catalog)), and
//! `configs/general.toml` says what each key means. The sections about the task differ from domain to domain
//! ([`sections`](crate::sections)).

use leadtime_episodes::Choice;
use leadtime_ppo::LearnerSettings;
use leadtime_ppo::checkpoints::Retention;
use leadtime_proto::HeadCredit;
use serde::{Deserialize, Serialize};
use toml::Table;

/// The file, but for the sections about the task.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct WrittenConfig {
    pub(crate) domain: String,
    pub(crate) seed: u64,
    pub(crate) run: RunSection,
    pub(crate) policy: PolicySection,
    pub(crate) learner: LearnerSettings,
    pub(crate) actor: ActorSection,
    pub(crate) evaluation: EvaluationSection,
}

/// `[run]`: where and how, nothing that changes what is computed.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunSection {
    pub(crate) name: String,
    pub(crate) directory: String,
    pub(crate) actors_min: u32,
    pub(crate) checkpoint_every: u64,
    pub(crate) checkpoint_seconds: u64,
    pub(crate) checkpoint_patience: u64,
    pub(crate) keep: Retention,
}

/// `[policy]`: the networks.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PolicySection {
    pub(crate) encoder: EncoderKind,
    pub(crate) lstm_projection: usize,
    pub(crate) lstm_state: usize,
    pub(crate) attention_width: usize,
    pub(crate) attention_heads: usize,
    pub(crate) hidden: Vec<usize>,
    pub(crate) head_credit: HeadCredit,
    pub(crate) normalize_observations: bool,
    pub(crate) initiate_bias: f64,
    pub(crate) length_bias: f64,
}

/// What stands between observation and tanh layers, without its widths: those are keys of their own, so that a layer can change
/// one of them and `none` needs none. An [`Encoder`](leadtime_proto::Encoder) also has the shape of the environment's entities,
/// which nobody writes; `checked.rs` puts it together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum EncoderKind {
    None,
    Lstm,
    Attention,
}

/// `[actor]`: how actors send.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ActorSection {
    pub(crate) window: u32,
}

/// `[evaluation]`: how policies are evaluated, after training and on the way.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EvaluationSection {
    pub(crate) episodes: u32,
    pub(crate) action: Choice,
    pub(crate) during_training: u32,
    pub(crate) held_out_episodes: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) stop_at: Option<f64>,
    #[serde(default)]
    pub(crate) world: Table,
}
