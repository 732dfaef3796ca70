//! The command line, as clap reads it; every command's arguments are one struct.

use std::ffi::OsString;
use std::ops::Range;
use std::path::PathBuf;
use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{
    ArgGroup, Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum,
};
use leadtime_config::{Alternatives, Config, ConfigSource, MAX_EPISODES, Override};
use leadtime_eval::measure::Choice;
use leadtime_link::Endpoint;
use leadtime_proto::ClientName;
use leadtime_runs::tasks::ConfigureError;
use leadtime_runs::{Tasks, evaluation};
use leadtime_studies::{EPISODES, EVAL_SEED};

use crate::exit::EXIT_CODE_HELP;

mod changes;
mod durations;
mod live;
mod logs;
mod network;
mod operations;
mod robot;
mod taxonomy;
mod training;
mod worker;

use durations::duration;
pub(crate) use live::{DriveArgs, NotifierArgs, RecordArgs, ReplayArgs, ReplaySpeed, ServeArgs};
pub(crate) use logs::{LogArgs, LogFormat, Verbosity};
pub(crate) use network::{
    CertsAclArgs, CertsCommand, CertsInitArgs, CertsIssueArgs, CertsRenewArgs, CertsShowArgs,
    GuardArgs, RouterArgs, TlsArgs,
};
pub(crate) use operations::{
    HealthArgs, PAGE_ADDRESS, PruneArgs, STATUS_ADDRESS, TraceArgs, VersionArgs,
};
pub(crate) use robot::{DistroName, ObsForm, RobotArgs, SayKeyForm};
pub(crate) use taxonomy::{
    BackendArgs, BackendName, Claim, ExportFormat, PlanArgs, TaxonomyBuildArgs, TaxonomyCommand,
    TaxonomyExportArgs, TaxonomyRateArgs, TaxonomyReportArgs, TaxonomySpeakArgs,
    TaxonomyValidateArgs,
};
pub(crate) use training::{ActorArgs, LearnerArgs, RaceArgs, SmokeArgs, StopAfter, UpArgs};
pub(crate) use worker::WorkerArgs;

/// Trains notifiers: policies that decide when and what to say to a listener who reacts late.
#[derive(Debug, Parser)]
#[command(name = "leadtime", version, propagate_version = true, max_term_width = 100)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub command: Command,
    #[command(flatten)]
    pub verbosity: Verbosity,
    #[command(flatten)]
    pub logs: LogArgs,
}

const VARIABLES_HELP: &str = "Environment variables:\n  \
    RUST_LOG  what to log: a level (`debug`), or `module=level,...`\n  \
    NO_COLOR  if set, no colours";

/// What the help of each command ends with: sections that begin with the command's name.
const EXAMPLES: &str = include_str!("cli/examples.txt");

impl Cli {
    /// Returns the command line with the examples in its help.
    pub(crate) fn documented() -> clap::Command {
        let mut command = Self::command();
        for section in EXAMPLES.split("\n\n") {
            let (name, examples) = section.split_once('\n').unwrap_or_default();
            let help = format!("Examples:\n{}", examples.trim_end());
            command = match name {
                "leadtime" => {
                    command.after_help(format!("{help}\n\n{VARIABLES_HELP}\n\n{EXIT_CODE_HELP}"))
                }
                path => explained(command, path, help),
            };
        }
        command
    }

    /// Reads the arguments of this process.
    pub(crate) fn read() -> Result<Self, clap::Error> {
        Self::from_arg_matches(&Self::documented().try_get_matches()?)
    }
}

/// Ends the help of a command, which may be nested, with a text.
fn explained(command: clap::Command, path: &str, help: String) -> clap::Command {
    match path.split_once(' ') {
        Some((first, rest)) => command.mut_subcommand(first, |it| explained(it, rest, help)),
        None => command.mut_subcommand(path, |it| it.after_help(help)),
    }
}

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train, evaluate and draw once, end to end, and check that it learned.
    Smoke(SmokeArgs),
    /// Run a learner and actors on this machine, supervised.
    #[command(visible_alias = "train")]
    Up(UpArgs),
    /// Race several seeds: stop the hopeless at a quarter of the steps, train the others to the end, name the best.
    ///
    /// Every racer is an ordinary run, and learns what it would learn alone. The same command goes on with a race that was
    /// interrupted; a racer that was stopped can be resumed by its name.
    Race(RaceArgs),
    /// Run a learner: assign environments, collect rollouts, train, publish weights.
    Learner(LearnerArgs),
    /// Run an actor: step environments for a learner; it may join and leave at any time.
    Actor(ActorArgs),
    /// Watch a run in a browser: one that trains anywhere, or one on this disk; as text with --once.
    Watch(WatchArgs),
    /// Run a router: it passes on what others send, where the learner cannot be dialled by everybody.
    Router(RouterArgs),
    /// Let a policy work: it speaks to robots, cars and simulators over the network, word by word.
    ///
    /// A client sends observations and receives what is said, or why nothing is. Nothing is said on stale observations.
    Serve(ServeArgs),
    /// Let one of the worlds, its listener included, hear a notifier at work, and evaluate that.
    Drive(DriveArgs),
    /// Record what a notifier at work sees and says: an MCAP file for Foxglove, Python and `replay`.
    ///
    /// It reads and touches nothing. The file is readable up to the last second, whenever the recorder is killed; a file that
    /// is there is never overwritten.
    Record(RecordArgs),
    /// Replay a recording: does the same policy say the same, what would another one have said?
    ///
    /// Every event is compared, bit for bit; a difference ends with exit code 1. With --policy of another policy, what both
    /// say stands side by side.
    Replay(ReplayArgs),
    /// Make and renew the certificates by which processes on several machines know each other.
    Certs {
        #[command(subcommand)]
        command: CertsCommand,
    },
    /// Evaluate a policy over many episodes, with 95 % intervals.
    Eval(EvalArgs),
    /// Probe a policy: how well can the reaction delay be decoded from its activations?
    Probe(ProbeArgs),
    /// Draw one episode of a policy as PNG, SVG, GIF, HTML or MP4, or what a recording holds.
    Play(PlayArgs),
    /// Make the report of a run again, with an evaluation of its policy, or one of several runs side by side.
    Report(ReportArgs),
    /// Reproduce the paper's tables: train missing runs, evaluate every policy on every listener, write tables and figures.
    Compare(CompareArgs),
    /// Evaluate a pilot of the lander.
    Pilot {
        #[command(subcommand)]
        command: PilotCommand,
    },
    /// Build, show and check the sentences that a notifier's messages are spoken in.
    Taxonomy {
        #[command(subcommand)]
        command: TaxonomyCommand,
    },
    /// Search a script: a few rules on what can be observed, found with as many steps as a training takes.
    ///
    /// Candidates are drawn at random and changed a little where they are good; the best is evaluated on episodes that did not
    /// choose it. A trained notifier that does not beat it has learned nothing that a person could not write down.
    ScriptSearch(ScriptSearchArgs),
    /// Compare a world with recorded traces of its public original.
    Conformance(ConformanceArgs),
    /// Print a built-in configuration as one complete file, every key with its comment.
    ///
    /// A file of your own writes only what differs: `base = "paper_lander"` names the built-in configuration that it starts
    /// from, and `domain = "lander"` the one of that domain; without either it is the lander's.
    Config(ConfigArgs),
    /// Say what a task shows, offers and pays: every number of its observation, every choice, every reward.
    Describe(DescribeArgs),
    /// List runs, or compare their configurations and results.
    Runs(RunsArgs),
    /// Check a configuration, its world, this machine and, with --connect, the connection to a learner.
    ///
    /// The world is played: the same seed must give the same episode, a restored episode must go on as the first did, and
    /// every number must be finite. A defect ends with exit code 1.
    Check(CheckArgs),
    /// Make a crate for a world of your own, which builds outside of Leadtime's source.
    New(NewArgs),
    /// Ask a learner or an actor with --status whether it is well: exit code 0 if so, 1 if not, 3 if nobody answers.
    Health(HealthArgs),
    /// Print the versions of the program, of its protocol and of its checkpoints.
    Version(VersionArgs),
    /// Print shell completions.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

/// Where the configuration comes from, and what to change in it.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct SourceArgs {
    /// Configuration file, or the name of a built-in one (`leadtime config` lists them; default: lander). A file writes only
    /// what differs from its `base = "NAME"`.
    #[arg(short, long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Change one key: `--set learner.learning_rate=1e-4`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Environment steps of the whole run, such as 1e6 (as `--set learner.total_steps=STEPS`).
    #[arg(long, value_parser = n_steps)]
    pub steps: Option<u64>,
    /// Seed of every random stream (as `--set seed=N`).
    #[arg(long, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Directory that holds the runs (as `--set run.directory=DIR`).
    #[arg(long, value_name = "DIR")]
    pub runs: Option<PathBuf>,
}

impl SourceArgs {
    /// Returns the same with further changes.
    pub(crate) fn changed(&self, changes: &[Override]) -> Self {
        let mut changed = self.clone();
        changed.set.extend_from_slice(changes);
        changed
    }

    pub(crate) fn load(&self, tasks: &Tasks, name: Option<&str>) -> Result<Config, ConfigureError> {
        let Self { config, set, steps, seed, runs } = self.clone();
        let name = name.map(str::to_owned);
        let source = ConfigSource { file: None, set, seed, steps, runs, name };
        // The file and the command line are this user's own.
        tasks.workers.permit_configured();
        tasks.configure(config.as_deref(), source)
    }
}

/// How a comparison of players is printed.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct ShownArgs {
    /// Show every measure, not only the main ones.
    #[arg(long)]
    pub all: bool,
    /// Print the results as JSON, every measure included.
    #[arg(long)]
    pub json: bool,
}

/// Who may see a page.
#[derive(Clone, Debug, Args)]
pub(crate) struct AccessArgs {
    /// Ask for this token; `auto` makes one. Needed where others can reach the address.
    #[arg(long, value_name = "auto|TEXT")]
    pub token: Option<String>,
}

/// `leadtime watch`
#[derive(Debug, Args)]
pub(crate) struct WatchArgs {
    /// A run on this disk, by name or directory.
    #[arg(value_name = "RUN", conflicts_with_all = ["connect", "run"])]
    pub directory: Option<PathBuf>,
    /// Address of a learner (or of a router): `tcp/HOST:7447`; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// The run, where several share the address.
    #[arg(long, value_name = "NAME")]
    pub run: Option<String>,
    #[command(flatten)]
    pub tls: TlsArgs,
    /// Where to serve the page; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS", default_value = PAGE_ADDRESS)]
    pub http: String,
    #[command(flatten)]
    pub access: AccessArgs,
    /// Whether the newest policy plays beside the curves.
    #[arg(long, value_name = "on|off", default_value = "on", value_parser = ["on", "off"])]
    pub play: String,
    /// Print one screen of text, and serve nothing.
    #[arg(long, conflicts_with_all = ["token", "http"])]
    pub once: bool,
    /// With --once print everything as JSON; else print the page's address as JSON.
    #[arg(long)]
    pub json: bool,
    /// How long to look for the run.
    #[arg(long, value_name = "DURATION", default_value = "30s", value_parser = duration)]
    pub connect_timeout: Duration,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
}

/// `leadtime eval`
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("spoken").args(["transcript", "truth"]))]
pub(crate) struct EvalArgs {
    /// A policy file, a run directory or the name of a run.
    pub policy: PathBuf,
    /// Episodes per policy (default: the configuration's; 1 with --transcript).
    #[arg(long, value_name = "N", value_parser = n_episodes())]
    pub episodes: Option<u32>,
    /// Print the episodes as the listener hears them, word by word, instead of evaluating them.
    #[arg(long, conflicts_with = "json")]
    pub transcript: bool,
    /// Count the sentences that are false when they are begun, instead of evaluating the policy.
    #[arg(long, conflicts_with_all = ["transcript", "each", "save", "episodes_to", "measure"])]
    pub truth: bool,
    /// With --transcript or --truth, speak in these sentences: a database file, or a domain (default: those that come with
    /// the policy's domain).
    #[arg(long, value_name = "DATABASE", requires = "spoken")]
    pub words: Option<PathBuf>,
    /// Also evaluate this scripted policy: one of the task's, such as `unaided` or `heuristic`, a script in a file
    /// (`script.toml`), or `oracle`, which plans on the episode itself; repeatable.
    #[arg(long, value_name = "NAME")]
    pub baseline: Vec<PathBuf>,
    /// Also write every step of the policy's episodes to this file, a line of JSON each: observation, logits, action,
    /// reward.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["transcript", "each"])]
    pub episodes_to: Option<PathBuf>,
    /// Also write the results into the run's directory: eval.json, and `eval/...` in TensorBoard.
    #[arg(long, conflicts_with_all = ["transcript", "each", "set"])]
    pub save: bool,
    /// Also compare the policy with the others in this measure, such as `steps_to_deliver`; repeatable.
    #[arg(long, value_name = "NAME", conflicts_with = "transcript")]
    pub measure: Vec<String>,
    /// Evaluate once with each of these values: `--each 'human.reaction_delay=[0, 2]'`.
    #[arg(long, value_name = "KEY=[VALUES]", value_parser = Alternatives::parse)]
    #[arg(conflicts_with = "transcript")]
    pub each: Option<Alternatives>,
    #[command(flatten)]
    pub acting: ActingArgs,
    #[command(flatten)]
    pub shown: ShownArgs,
}

/// How a policy acts in an evaluation.
#[derive(Debug, Args)]
pub(crate) struct ChoosingArgs {
    /// Seed of the episodes; not the one of training.
    #[arg(long, value_name = "SEED", default_value_t = evaluation::EVAL_SEED)]
    #[arg(allow_negative_numbers = true)]
    pub eval_seed: u64,
    /// How the policy chooses (default: the configuration's).
    #[arg(long, value_parser = action())]
    pub action: Option<Choice>,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
    #[command(flatten)]
    pub worker: WorkerArgs,
}

/// How a policy acts in an evaluation, and in which task.
#[derive(Debug, Args)]
pub(crate) struct ActingArgs {
    #[command(flatten)]
    pub choosing: ChoosingArgs,
    /// Change one key of the task: `--set human.reaction_delay=3`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
}

/// `leadtime report`
#[derive(Debug, Args)]
pub(crate) struct ReportArgs {
    /// Runs, by name or directory; one is reported in full, several are compared.
    #[arg(value_name = "RUN", required = true, num_args = 1..=8)]
    pub names: Vec<PathBuf>,
    /// Write the page here, and leave the run's directory as it is (default: report.html there, beside the evaluation in
    /// eval.json; several runs have none).
    #[arg(short, long, alias = "output", value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Episodes per policy (default: the configuration's).
    #[arg(long, value_name = "N", value_parser = n_episodes())]
    pub episodes: Option<u32>,
    #[command(flatten)]
    pub choosing: ChoosingArgs,
}

/// `leadtime probe`
#[derive(Debug, Args)]
pub(crate) struct ProbeArgs {
    /// A policy file, a run directory or the name of a run.
    pub policy: PathBuf,
    /// Episodes; the probe is fitted on the first half and scored on the other.
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = n_episodes())]
    pub episodes: u32,
    #[command(flatten)]
    pub acting: ActingArgs,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
    /// Also write the results to this file, as a section of a page that says where they are from.
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
}

/// `leadtime play`
#[derive(Debug, Args)]
#[command(mut_arg("eval_seed", |seed| seed.help("Seed of the episode")))]
pub(crate) struct PlayArgs {
    /// A policy file, a run directory or the name of a run; or a recording of `leadtime record`, FILE.mcap.
    #[arg(required_unless_present = "demonstration")]
    pub policy: Option<PathBuf>,
    /// Draw the paper's cooking demonstration instead: "Go down, all stations occupied", word by word.
    #[arg(long, conflicts_with_all = ["policy", "words", "baseline", "action", "set", "eval_seed"])]
    pub demonstration: bool,
    /// Draw these steps side by side (B excluded), instead of the whole episode in one picture. Of a recording: these seconds.
    #[arg(long, value_name = "A..B", value_parser = number_range)]
    pub frames: Option<Range<u64>>,
    /// Of a recording: this client alone (default: every client in text, the first one with something to show in a picture).
    #[arg(long, value_name = "CLIENT", conflicts_with = "demonstration")]
    pub live: Option<ClientName>,
    /// The picture; its extension decides: png, svg, gif, html with a slider over the moments, or mp4 (needs ffmpeg). Of a
    /// recording: png, svg, or txt for what was said when.
    #[arg(short, long, alias = "out", value_name = "FILE", default_value = "playthrough.png")]
    pub output: PathBuf,
    /// Quote these sentences: a database file, or a domain (default: those that come with the policy's domain).
    #[arg(long, value_name = "DATABASE")]
    pub words: Option<PathBuf>,
    /// Draw this scripted policy instead: `unaided`, `heuristic`, a script in a file, or `oracle`.
    #[arg(long, value_name = "NAME")]
    pub baseline: Option<PathBuf>,
    #[command(flatten)]
    pub acting: ActingArgs,
}

/// `leadtime compare`
#[derive(Debug, Args)]
pub(crate) struct CompareArgs {
    /// Name of a study, `all`, or a file of your own; without one, the studies are listed with their rows.
    pub study: Option<PathBuf>,
    /// One training seed and few steps: shows that everything works, and is labelled so.
    #[arg(long, requires = "study")]
    pub quick: bool,
    /// Only these rows: `convey_react`, or `piloting/convey_react` where parts share names; repeatable.
    #[arg(long = "row", requires = "study", value_name = "ROW")]
    pub rows: Vec<String>,
    /// Only these parts; repeatable.
    #[arg(long = "part", requires = "study", value_name = "PART")]
    pub parts: Vec<String>,
    /// Change one key of what is trained: `--set human.reaction_delay.fixed=3`; repeatable.
    #[arg(long = "set", requires = "study", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Start from this configuration, in the parts of its domain, instead of the study's own; repeatable.
    #[arg(long, requires = "study", value_name = "FILE")]
    pub profile: Vec<PathBuf>,
    /// Training seeds, half open, instead of those of each row (with --quick only the first).
    #[arg(long, requires = "study", value_name = "A..B", value_parser = number_range)]
    pub seeds: Option<Range<u64>>,
    /// Environment steps of every training, instead of the study's or the profile's.
    #[arg(long, requires = "study", value_name = "STEPS", value_parser = n_steps)]
    pub steps: Option<u64>,
    /// Evaluation episodes per training seed.
    #[arg(long, requires = "study", value_name = "N", default_value_t = EPISODES, value_parser = n_episodes())]
    pub episodes: u32,
    /// Seed of the evaluations; the training seed is added, so that no two policies of a row meet the same worlds.
    #[arg(long, requires = "study", value_name = "SEED", default_value_t = EVAL_SEED, allow_negative_numbers = true)]
    #[arg(value_parser = clap::value_parser!(u64).range(1..1 << 62))]
    pub eval_seed: u64,
    /// Trainings at a time (default: one per core).
    #[arg(long, requires = "study", value_name = "N", value_parser = n_processes())]
    pub jobs: Option<u32>,
    /// Actor processes per training.
    #[arg(long, requires = "study", value_name = "N", default_value_t = 1, value_parser = n_processes())]
    pub actors: u32,
    /// Directory that holds the runs.
    #[arg(long, requires = "study", value_name = "DIR", default_value = "runs/compare")]
    pub runs: PathBuf,
    /// Directory for tables and figures (default: docs/results; a study of your own, and one that is not carried out
    /// whole and as it is, is printed, and written only where --out says).
    #[arg(short, long, alias = "output", requires = "study", value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// List the trainings, how far they are and how long they will take, and do nothing.
    #[arg(long, requires = "study")]
    pub plan: bool,
}

/// `leadtime pilot ...`
#[derive(Debug, Subcommand)]
pub(crate) enum PilotCommand {
    /// Fly without zones and messages: mean return, and how the episodes end.
    Eval(PilotEvalArgs),
}

/// `leadtime pilot eval`
#[derive(Debug, Args)]
pub(crate) struct PilotEvalArgs {
    /// `heuristic`, `embedded`, or a policy file.
    #[arg(long, default_value = "embedded")]
    pub pilot: PathBuf,
    /// Seeds of the episodes, B excluded: each gives the terrain and start that it gives in Gymnasium.
    #[arg(long, value_name = "A..B", default_value = "0..100", value_parser = number_range)]
    pub seeds: Range<u64>,
    /// With wind and turbulence.
    #[arg(long)]
    pub wind: bool,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `leadtime conformance`
#[derive(Debug, Args)]
pub(crate) struct ConformanceArgs {
    /// The world.
    #[arg(value_enum)]
    pub world: ConformanceWorld,
    /// The traces: JSON, plain or gzip.
    pub file: PathBuf,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A world that has a public original.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ConformanceWorld {
    /// `LunarLander-v3`: actions replayed open loop, every observation before first contact compared.
    Lander,
    /// highway-env: every car's state, command, observation and reward compared.
    Highway,
    /// The public kitchen, and recorded episodes of its cook: every value compared.
    Steakhouse,
}

/// `leadtime config`
#[derive(Debug, Args)]
pub(crate) struct ConfigArgs {
    /// The configuration; without one, the names are listed.
    pub name: Option<OsString>,
}

/// `leadtime describe`
#[derive(Debug, Args)]
pub(crate) struct DescribeArgs {
    /// A built-in configuration, a configuration file, a policy file or a run.
    pub task: PathBuf,
    /// Change one key: `--set notifier.history=1`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
    /// Print one JSON object: every number of the observation by its place.
    #[arg(long, conflicts_with = "markdown")]
    pub json: bool,
    /// Print Markdown, as the pages of the worlds have it.
    #[arg(long)]
    pub markdown: bool,
}

/// `leadtime script-search`
#[derive(Debug, Args)]
pub(crate) struct ScriptSearchArgs {
    /// A built-in configuration, a configuration file, a policy file or a run.
    pub task: PathBuf,
    /// Change one key: `--set human.reaction_delay=3`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Environment steps of the search (default: those of the configuration's training).
    #[arg(long, value_parser = n_steps)]
    pub steps: Option<u64>,
    /// Seed of the search (default: the configuration's).
    #[arg(long, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Episodes on which the script is evaluated (default: the configuration's).
    #[arg(long, value_name = "N", value_parser = n_episodes())]
    pub episodes: Option<u32>,
    /// Seed of those episodes; not the one of the search.
    #[arg(long, value_name = "SEED", default_value_t = evaluation::EVAL_SEED)]
    #[arg(allow_negative_numbers = true)]
    pub eval_seed: u64,
    /// Also let an oracle play those episodes: it plans on the episode itself, its random draws included.
    #[arg(long)]
    pub oracle: bool,
    /// The script's file (default: TASK-script.toml).
    #[arg(short, long, alias = "output", value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
    #[command(flatten)]
    pub shown: ShownArgs,
}

/// `leadtime runs`
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct RunsArgs {
    #[command(subcommand)]
    pub command: Option<RunsCommand>,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs", global = true)]
    pub runs: PathBuf,
    /// Print the results as JSON.
    #[arg(long, global = true)]
    pub json: bool,
    /// Show every column, however wide the table becomes.
    #[arg(long, global = true)]
    pub all: bool,
}

/// `leadtime runs ...`
#[derive(Debug, Subcommand)]
pub(crate) enum RunsCommand {
    /// List every run: domain, state, steps, success.
    List,
    /// Show what differs between two runs: configuration and results.
    Compare {
        /// A run.
        first: PathBuf,
        /// Another run.
        second: PathBuf,
    },
    /// List the old runs, and with --yes remove them; never one that is in use.
    Prune(PruneArgs),
}

/// `leadtime check`
#[derive(Debug, Args)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    pub source: SourceArgs,
    /// For a world in Python: start this command to step environments (as `--set world.worker=COMMAND`).
    #[arg(long, value_name = "COMMAND")]
    pub worker: Option<String>,
    /// Also connect to the learner at this address; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub tls: TlsArgs,
    /// How long to look for it.
    #[arg(long, value_name = "DURATION", default_value = "5s", value_parser = duration)]
    pub connect_timeout: Duration,
}

/// `leadtime new`
#[derive(Debug, Args)]
pub(crate) struct NewArgs {
    /// The directory to make; it may be there if it is empty.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Name of the crate (default: the directory's).
    #[arg(long)]
    pub name: Option<String>,
    /// Leadtime's source (default: where this program was built from, if that is still there).
    #[arg(long, value_name = "PATH")]
    pub leadtime: Option<PathBuf>,
}

/// Reads a time in seconds: `nan` would count as left out where it is written as JSON.
fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| "write a number of seconds, as 0.3".to_owned())
}

/// Reads a command, which does something.
fn command(text: &str) -> Result<String, String> {
    let command = Some(text).filter(|text| !text.trim().is_empty()).map(str::to_owned);
    command.ok_or_else(|| "the command is empty".to_owned())
}

/// Reads a number of steps: `200000` or `1e6`.
fn n_steps(text: &str) -> Result<u64, String> {
    let number = text.parse::<f64>().ok().filter(|x| x.fract() == 0.0 && (1.0..=1e15).contains(x));
    number
        .map(|x| x as u64)
        .ok_or_else(|| "write a whole number of steps, 1 to 1e15: 200000 or 1e6".to_owned())
}

/// Reads how a policy chooses.
fn action() -> impl TypedValueParser<Value = Choice> {
    let choice = |name| if name == "greedy" { Choice::Greedy } else { Choice::Sample };
    PossibleValuesParser::new(["sample", "greedy"]).map(choice)
}

/// Reads a number of processes.
fn n_processes() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=256)
}

/// Reads a number of episodes.
fn n_episodes() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=i64::from(MAX_EPISODES))
}

/// Reads addresses.
pub(crate) fn endpoints(texts: &[String]) -> Result<Vec<Endpoint>, leadtime_link::Error> {
    texts.iter().map(|text| text.parse()).collect()
}

/// Reads `A..B`, half open.
fn number_range(text: &str) -> Result<Range<u64>, String> {
    let (from, to) = text.split_once("..").ok_or("write A..B, B excluded")?;
    let number = |text: &str| text.trim().parse::<u64>().map_err(|error| error.to_string());
    let range = number(from)?..number(to)?;
    if range.is_empty() {
        return Err("the range is empty: A must be below B".to_owned());
    }
    match range.end - range.start {
        n if n <= u64::from(MAX_EPISODES) => Ok(range),
        n => Err(format!("these are {n} numbers; allowed: 1 to {MAX_EPISODES}")),
    }
}

#[cfg(test)]
mod tests;
