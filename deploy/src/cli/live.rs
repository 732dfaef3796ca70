//! The arguments of a notifier at work, and of what drives our own worlds with it.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use leadtime_config::Override;
use leadtime_eval::measure::Choice;
use leadtime_proto::{ClientName, ServiceName};
use leadtime_runs::evaluation;
use leadtime_serve::{MAX_SESSIONS, SayForm, StepClock};
use leadtime_voice::VoiceChoice;
use leadtime_voice::loudspeaker::APLAY;

use super::{GuardArgs, ShownArgs, TlsArgs, action, duration, n_episodes};

/// `leadtime serve`
#[derive(Debug, Args)]
pub(crate) struct ServeArgs {
    /// A policy file, a run directory or the name of a run.
    pub policy: PathBuf,
    /// Where to listen: `tcp/127.0.0.1:7448`; port 0 takes a free one; repeatable.
    #[arg(long, value_name = "ENDPOINT", required_unless_present_any = ["connect", "describe"])]
    pub listen: Vec<String>,
    /// Routers to connect to, instead of listening or beside it.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub guard: GuardArgs,
    /// Name of the notifier: part of every key.
    #[arg(long, value_name = "NAME", default_value = "notifier")]
    pub service: ServiceName,
    /// The voice: `shipped`; `text`, words without times of their own; `none`, no words; `flite[:VOICE]` or `espeak` if installed;
    /// `recorded:DIR` of `leadtime taxonomy speak`; `pipe:COMMAND`, a helper of your own.
    #[arg(long, value_name = "VOICE", default_value_t)]
    pub voice: VoiceChoice,
    /// Play what is said on this machine: by aplay, or by a command that takes raw 16-bit samples, `{rate}` a second. One client.
    #[arg(long, value_name = "COMMAND", num_args = 0..=1, require_equals = true, default_missing_value = APLAY)]
    pub play: Option<String>,
    /// Speak in these sentences: a database file, or a domain (default: those that come with the policy's domain).
    #[arg(long, value_name = "DATABASE")]
    pub words: Option<String>,
    /// Keep the state of every session in this directory once a second; a notifier that is started again goes on with them.
    #[arg(long, value_name = "DIR")]
    pub state: Option<PathBuf>,
    /// The most clients at once (default: 64; 1 with --play).
    #[arg(long, value_name = "N", conflicts_with = "play")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=MAX_SESSIONS as i64))]
    pub max_sessions: Option<u32>,
    /// Print what an observation consists of and what can be said, and end.
    #[arg(long)]
    pub describe: bool,
    /// Print it as a JSON Schema of observations.
    #[arg(long, requires = "describe")]
    pub json: bool,
    /// Sleep until a step is due instead of waiting awake for its last fraction of a millisecond.
    #[arg(long)]
    pub no_spin: bool,
    /// Change one key of the task: `--set human.interrupt=replace`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// How the policy chooses (default: the configuration's).
    #[arg(long, value_parser = action())]
    pub action: Option<Choice>,
    /// Seed of the draws of sessions whose client names none.
    #[arg(long, default_value_t = evaluation::EVAL_SEED)]
    pub seed: u64,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
}

/// `leadtime drive`
#[derive(Debug, Args)]
pub(crate) struct DriveArgs {
    /// The world: a built-in configuration, a configuration file, a policy file or a run.
    #[arg(value_name = "DOMAIN")]
    pub task: PathBuf,
    /// Where the notifier is.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub tls: TlsArgs,
    /// How long to look for the notifier.
    #[arg(long, value_name = "DURATION", default_value = "10s", value_parser = duration)]
    pub connect_timeout: Duration,
    /// Name of the notifier.
    #[arg(long, value_name = "NAME", default_value = "notifier")]
    pub service: ServiceName,
    /// Name of this client (default: that of its certificate, else `drive`).
    #[arg(long, value_name = "NAME")]
    pub client: Option<ClientName>,
    /// Episodes (default: the configuration's).
    #[arg(long, value_parser = n_episodes())]
    pub episodes: Option<u32>,
    /// Seed of the episodes, and of the notifier's draws.
    #[arg(long, default_value_t = evaluation::EVAL_SEED)]
    pub eval_seed: u64,
    /// When the notifier takes a step: by its own clock, or with every observation. The latter does not wait for anything,
    /// and its episodes are those of `eval`, message by message.
    #[arg(long, value_name = "CLOCK", value_parser = clock(), default_value = "timer")]
    pub clock: StepClock,
    /// As `--clock observation`.
    #[arg(long, conflicts_with = "clock")]
    pub max_speed: bool,
    /// How long a step (a word) takes by the clock, in seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.3)]
    pub seconds_per_step: f64,
    /// Send raw numbers and take 24 bytes per event instead of JSON.
    #[arg(long)]
    pub binary: bool,
    /// Also write everything that is said to this file, a line of JSON per message.
    #[arg(long, value_name = "FILE")]
    pub messages_to: Option<PathBuf>,
    /// Change one key of the task: `--set human.reaction_delay=3`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
    #[command(flatten)]
    pub shown: ShownArgs,
}

impl DriveArgs {
    /// Returns when the notifier takes a step.
    pub(crate) fn clock(&self) -> StepClock {
        if self.max_speed { StepClock::Observation } else { self.clock }
    }

    /// Returns in which form messages go.
    pub(crate) fn form(&self) -> SayForm {
        if self.binary { SayForm::Binary } else { SayForm::Json }
    }
}

/// Reads when steps are taken.
fn clock() -> impl clap::builder::TypedValueParser<Value = StepClock> {
    use clap::builder::{PossibleValuesParser, TypedValueParser as _};
    let clock = |name| if name == "timer" { StepClock::Timer } else { StepClock::Observation };
    PossibleValuesParser::new(["timer", "observation"]).map(clock)
}
