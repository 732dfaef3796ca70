//! The arguments of a notifier at work, and of what drives our own worlds with it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, FromArgMatches as _, ValueEnum};
use leadtime_config::Override;
use leadtime_eval::measure::Choice;
use leadtime_proto::{ClientName, ServiceName};
use leadtime_runs::evaluation;
use leadtime_serve::{MAX_SESSIONS, PolicyOrigin, SayForm, StepClock};
use leadtime_voice::VoiceChoice;
use leadtime_voice::loudspeaker::APLAY;

use super::{
    GuardArgs, RobotArgs, ShownArgs, TlsArgs, action, command, duration, n_episodes, seconds,
};

/// `leadtime serve`
#[derive(Debug, Args)]
pub(crate) struct ServeArgs {
    /// A policy file, a run directory or the name of a run.
    pub policy: PathBuf,
    /// Where to listen: `tcp/127.0.0.1:7448`; port 0 takes a free one; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Routers to connect to, instead of listening or beside it; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub guard: GuardArgs,
    #[command(flatten)]
    pub robot: RobotArgs,
    /// Name of the notifier: part of every key.
    #[arg(long, value_name = "NAME", default_value = "notifier")]
    pub service: ServiceName,
    /// The voice: `shipped`; `text`, words without times of their own; `none`, no words; `flite[:VOICE]` or `espeak` if installed;
    /// `recorded:DIR` of `leadtime taxonomy speak`; `pipe:COMMAND`, a helper of your own.
    #[arg(long, value_name = "VOICE", default_value_t)]
    pub voice: VoiceChoice,
    /// Play what is said on this machine: by aplay, or by a command that takes raw 16-bit samples, `{rate}` a second. One client.
    #[arg(long, value_name = "COMMAND", num_args = 0..=1, require_equals = true, default_missing_value = APLAY)]
    #[arg(value_parser = command)]
    pub play: Option<String>,
    /// Speak in these sentences: a database file, or a domain (default: those that come with the policy's domain).
    #[arg(long, value_name = "DATABASE")]
    pub words: Option<PathBuf>,
    /// Keep the state of every session in this directory once a second; a notifier that is started again goes on with them.
    /// What is kept of a client that stays away is removed after a day.
    #[arg(long, value_name = "DIR")]
    pub state: Option<PathBuf>,
    /// The most clients at once (default: 64; 1 with --play).
    #[arg(long, value_name = "N", conflicts_with = "play")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=MAX_SESSIONS as i64))]
    pub max_sessions: Option<u32>,
    /// Print what an observation consists of and what can be said, and end.
    #[arg(long, conflicts_with = "robot")]
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
    #[arg(long, default_value_t = evaluation::EVAL_SEED, allow_negative_numbers = true)]
    pub seed: u64,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
}

impl ServeArgs {
    /// Returns the arguments that put a policy to work as it was, or the sentence that says what is wrong with them.
    pub(crate) fn of_origin(
        policy: &Path,
        origin: &PolicyOrigin,
        voice: &VoiceChoice,
        runs: &Path,
    ) -> Result<Self, clap::Error> {
        let action = match origin.action {
            Choice::Sample => "sample",
            Choice::Greedy => "greedy",
        };
        let mut args: Vec<OsString> = vec!["serve".into(), "--describe".into()];
        args.extend(["--runs".into(), runs.into(), "--action".into(), action.into()]);
        for change in &origin.changes {
            args.extend([OsString::from("--set"), change.into()]);
        }
        args.extend([OsString::from("--voice"), voice.to_string().into()]);
        if ![NO_WORDS, SHIPPED_WORDS].contains(&origin.words.as_str()) {
            args.extend([OsString::from("--words"), (&origin.words).into()]);
        }
        args.extend(["--".into(), policy.into()]);
        let command = Self::augment_args(clap::Command::new("serve"));
        Self::from_arg_matches(&command.try_get_matches_from(args)?)
    }

    /// Returns the words as recordings name them.
    pub(crate) fn words_name(&self) -> String {
        match (&self.words, &self.voice) {
            (_, VoiceChoice::None) => NO_WORDS.to_owned(),
            (Some(name), _) => name.to_string_lossy().into_owned(),
            (None, _) => SHIPPED_WORDS.to_owned(),
        }
    }
}

/// How recordings call no words, and those that come with the domain.
const NO_WORDS: &str = "none";
const SHIPPED_WORDS: &str = "shipped";

/// Which notifier, and how it is reached.
#[derive(Clone, Debug, Args)]
pub(crate) struct NotifierArgs {
    #[command(flatten)]
    pub tls: TlsArgs,
    /// How long to look for the notifier.
    #[arg(long, value_name = "DURATION", default_value = "10s", value_parser = duration, requires = "connect")]
    pub connect_timeout: Duration,
    /// Name of the notifier.
    #[arg(long, value_name = "NAME", default_value = "notifier", requires = "connect")]
    pub service: ServiceName,
}

/// `leadtime drive`
#[derive(Debug, Args)]
pub(crate) struct DriveArgs {
    /// The world: a built-in configuration, a configuration file, a policy file or a run.
    #[arg(value_name = "TASK")]
    pub task: PathBuf,
    /// Where the notifier is; repeatable.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub notifier: NotifierArgs,
    /// Name of this client (default: that of its certificate, else `drive`).
    #[arg(long, value_name = "NAME")]
    pub client: Option<ClientName>,
    /// Episodes (default: the configuration's).
    #[arg(long, value_name = "N", value_parser = n_episodes())]
    pub episodes: Option<u32>,
    /// Seed of the episodes, and of the notifier's draws.
    #[arg(long, value_name = "SEED", default_value_t = evaluation::EVAL_SEED)]
    #[arg(allow_negative_numbers = true)]
    pub eval_seed: u64,
    /// When the notifier takes a step: by its own clock, or with every observation. The latter does not wait for anything,
    /// and its episodes are those of `eval`, message by message.
    #[arg(long, value_name = "CLOCK", value_parser = clock(), default_value = "timer")]
    pub clock: StepClock,
    /// As `--clock observation`.
    #[arg(long, conflicts_with = "clock")]
    pub max_speed: bool,
    /// How long a step (a word) takes by the clock, in seconds.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, default_value_t = 0.3)]
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

/// `leadtime record`
#[derive(Debug, Args)]
pub(crate) struct RecordArgs {
    /// Where the notifier is, or a router; repeatable.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub notifier: NotifierArgs,
    /// Record this client alone (default: every client).
    #[arg(long, value_name = "CLIENT")]
    pub live: Option<ClientName>,
    /// Record instead what learner and actors of this run tell of it, until it ends.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["service", "live"])]
    pub run: Option<String>,
    /// The recording, which must not be there yet.
    #[arg(short, long, alias = "out", value_name = "FILE.mcap")]
    pub output: PathBuf,
    /// End after this time (default: on Ctrl-C).
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    pub stop_after: Option<Duration>,
}

/// `leadtime replay`
#[derive(Clone, Debug, Args)]
pub(crate) struct ReplayArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// The policy: a file, a run directory or the name of a run. Another one than the recording's is compared with it
    /// (default: the recording's own, where it was).
    #[arg(long, value_name = "POLICY", conflicts_with = "connect")]
    pub policy: Option<PathBuf>,
    /// The voice, in whose time words end (default: the recording's; a `pipe:` or `recorded:` has to be given).
    #[arg(long, value_name = "VOICE", conflicts_with = "connect")]
    pub voice: Option<VoiceChoice>,
    /// Send the observations to this notifier instead of replaying them in this process; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub notifier: NotifierArgs,
    /// Name of this client (default: that of its certificate, else `replay`).
    #[arg(long, value_name = "NAME", requires = "connect")]
    pub client: Option<ClientName>,
    /// Replay this client alone (default: every client).
    #[arg(long, value_name = "CLIENT")]
    pub live: Option<ClientName>,
    /// As fast as it goes, or at the pace of the recording, with what was said when it was said.
    #[arg(long, value_enum, default_value_t)]
    pub speed: ReplaySpeed,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
}

/// How fast a recording is replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ReplaySpeed {
    /// As fast as it goes.
    #[default]
    Max,
    /// At the pace of the recording.
    #[value(name = "1")]
    AsRecorded,
}

/// Reads when steps are taken.
fn clock() -> impl clap::builder::TypedValueParser<Value = StepClock> {
    use clap::builder::{PossibleValuesParser, TypedValueParser as _};
    let clock = |name| if name == "timer" { StepClock::Timer } else { StepClock::Observation };
    PossibleValuesParser::new(["timer", "observation"]).map(clock)
}
