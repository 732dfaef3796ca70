//! The arguments of the commands that train: which run, how it is shared among processes, when it stops.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use leadtime_config::{Config, Override};
use leadtime_link::ListenSettings;
use leadtime_runs::{Tasks, check_place};

use super::durations::{TOO_LONG, duration};
use super::{
    AccessArgs, GuardArgs, ShownArgs, SourceArgs, TlsArgs, TraceArgs, WorkerArgs, changes, command,
    n_episodes, n_processes, n_steps,
};

/// Which run to work on.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct RunChoice {
    /// Name of the run (as `--set run.name=NAME`); without one, an unfinished run of the same configuration is resumed,
    /// or a new one begins.
    #[arg(long)]
    pub name: Option<String>,
    /// Start a new run from the weights of this one (a name, a directory or a policy file).
    #[arg(long, value_name = "RUN")]
    pub fork: Option<PathBuf>,
    /// Stop with a checkpoint once the run has made this many updates (200) or environment steps (1e6steps), or after this
    /// time (90m, 2h); it can be resumed.
    #[arg(long, value_name = "AMOUNT", value_parser = stop_after)]
    pub stop_after: Option<StopAfter>,
    /// Go on with another value of a setting of the learner: `--change learner.learning_rate=1e-4`; repeatable. Optimiser,
    /// normalisers and steps are kept, and the change is recorded.
    #[arg(long, value_name = "KEY=VALUE", value_parser = changes::parse, requires = "name", conflicts_with = "fork")]
    pub change: Vec<Override>,
    /// Start this command, and write the metrics of every update to its standard input, a line of JSON each.
    #[arg(long, value_name = "COMMAND", value_parser = command)]
    pub metrics_to: Option<String>,
    #[command(flatten)]
    pub trace: TraceArgs,
}

impl RunChoice {
    /// Returns the keys that change in a run that goes on.
    pub(crate) fn changed_keys(&self) -> Vec<String> {
        self.change.iter().map(Override::key).collect()
    }

    /// Loads the configuration with what changes in a run that goes on.
    ///
    /// # Errors
    ///
    /// A sentence about a key that is changed twice or cannot change, about the configuration of a run that was moved, or what
    /// [`SourceArgs::load`] says.
    pub(crate) fn load(&self, tasks: &Tasks, source: &SourceArgs) -> anyhow::Result<Config> {
        changes::check_given_once(&self.change)?;
        // First: it knows which key was meant by an unknown one.
        let config = source.changed(&self.change).load(tasks, self.name.as_deref())?;
        changes::check_changeable(&self.change)?;
        if let Some(file) = &source.config {
            let is_set = |key: &str| source.set.iter().any(|change| change.key() == key);
            let is_named = self.name.is_some() || is_set("run.name");
            // Who says where the run lies means what they say.
            if source.runs.is_none() && !is_set("run.directory") {
                check_place(file, &config, is_named)?;
            }
        }
        Ok(config)
    }
}

/// After how much a run stops, although it is not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StopAfter {
    /// Once the run has made so many updates in all.
    Updates(u64),
    /// Once the run has trained on so many environment steps in all.
    Steps(u64),
    /// Once this start has lasted so long.
    Time(Duration),
}

impl StopAfter {
    /// Returns the updates of the whole run after which it stops; `None` where time decides.
    pub(crate) fn n_updates(self, steps_per_update: u64) -> Option<u64> {
        match self {
            Self::Updates(updates) => Some(updates),
            Self::Steps(steps) => Some(steps.div_ceil(steps_per_update.max(1))),
            Self::Time(_) => None,
        }
    }

    /// Returns the updates or steps as a learner's option has them; `None` where time decides.
    pub(crate) fn amount(self) -> Option<String> {
        match self {
            Self::Updates(updates) => Some(updates.to_string()),
            Self::Steps(steps) => Some(format!("{steps}steps")),
            Self::Time(_) => None,
        }
    }

    /// Returns the time after which it stops; `None` where updates or steps decide.
    pub(crate) fn time(self) -> Option<Duration> {
        match self {
            Self::Time(time) => Some(time),
            Self::Updates(_) | Self::Steps(_) => None,
        }
    }
}

/// `leadtime smoke`
#[derive(Clone, Debug, Args)]
pub(crate) struct SmokeArgs {
    /// Check the mechanics only, in seconds; says nothing about what is learned.
    #[arg(long, conflicts_with = "steps")]
    pub quick: bool,
    /// What to train on: as `-c`.
    #[arg(long, value_name = "NAME", conflicts_with = "config")]
    pub domain: Option<PathBuf>,
    /// Actor processes.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = n_processes())]
    pub actors: u32,
    /// Episodes per evaluated policy (default: the configuration's; 10 with --quick).
    #[arg(long, value_name = "N", value_parser = n_episodes())]
    pub episodes: Option<u32>,
    #[command(flatten)]
    pub shown: ShownArgs,
    #[command(flatten)]
    pub source: SourceArgs,
}

/// `leadtime up`
#[derive(Debug, Args)]
pub(crate) struct UpArgs {
    #[command(flatten)]
    pub source: SourceArgs,
    #[command(flatten)]
    pub run: RunChoice,
    /// Actor processes.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = n_processes())]
    pub actors: u32,
    /// Try `learner.lag` 1, 2, 4 and 8 for four seconds each, and train with the smallest that is nearly as fast as the best.
    /// For a new run, which keeps what was chosen; leave this out to go on with it.
    #[arg(long, conflicts_with = "change")]
    pub choose_lag: bool,
    /// Give learner and actors CPUs of their own: the learner as many as `learner.threads`, each actor one of the others, by
    /// turns. Changes no bit.
    #[arg(long)]
    pub pin: bool,
    /// Also listen here, so that actors elsewhere can join: `tls/0.0.0.0:7447`; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Serve the learner's /metrics, /live, /ready and /version here: `127.0.0.1:9464`.
    #[arg(long, value_name = "ADDRESS")]
    pub status: Option<String>,
    /// Also serve a live page of the run here: `127.0.0.1:8080`; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS")]
    pub watch: Option<String>,
    /// Print the page's address, the lags that `--choose-lag` has tried and how the run ended as JSON, one object a line.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub access: AccessArgs,
    #[command(flatten)]
    pub guard: GuardArgs,
}

/// `leadtime race`
#[derive(Debug, Args)]
#[command(mut_arg("steps", |steps| steps.help(STEPS_OF_A_RACER)))]
#[command(mut_arg("seed", |seed| seed.help(SEED_OF_THE_FIRST)))]
pub(crate) struct RaceArgs {
    #[command(flatten)]
    pub source: SourceArgs,
    /// Racers: the seed of the configuration and those after it.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(2..=64))]
    pub racers: u32,
    /// How many go on after a quarter, at most (default: half of them). One whose success is more than 0.1 behind the
    /// leader's does not go on either.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub keep: Option<u32>,
    /// What the names of the runs begin with; the seed follows (default: one for this configuration).
    #[arg(long)]
    pub name: Option<String>,
    /// Actor processes; one racer is trained at a time.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = n_processes())]
    pub actors: u32,
    /// Held-out episodes by which the winner is found; a fifth as many at a quarter.
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = n_episodes())]
    pub episodes: u32,
    /// Say what the race costs, and do nothing.
    #[arg(long)]
    pub plan: bool,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
}

const STEPS_OF_A_RACER: &str =
    "Environment steps of each racer, such as 1e6 (as `--set learner.total_steps=STEPS`)";
const SEED_OF_THE_FIRST: &str = "Seed of the first racer (as `--set seed=N`)";

/// `leadtime learner`
#[derive(Debug, Args)]
pub(crate) struct LearnerArgs {
    #[command(flatten)]
    pub source: SourceArgs,
    #[command(flatten)]
    pub run: RunChoice,
    /// Where to listen: `tls/0.0.0.0:7447`, `unixsock-stream//tmp/learner.sock`; repeatable (default: 127.0.0.1:7447, unless
    /// --connect is given).
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Routers to connect to: `tls/HOST:7447`; repeatable.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub guard: GuardArgs,
    /// Keep room for the rollouts of so many actors, 1 to 1000. Half of 256 MiB is shared out among them; rollouts that find no
    /// room are sent again.
    #[arg(long, value_name = "N", default_value_t = ListenSettings::DEFAULT_MAX_ACTORS, value_parser = n_actors())]
    pub max_actors: u32,
    /// Serve /metrics, /live, /ready and /version here: `127.0.0.1:9464`.
    #[arg(long, value_name = "ADDRESS")]
    pub status: Option<String>,
    /// Print how the run ended as JSON.
    #[arg(long)]
    pub json: bool,
    /// Stop when standard input closes: the process that started this one holds the other end.
    #[arg(long, hide = true)]
    pub supervised: bool,
    /// How many actors share the learner's cores.
    #[arg(long, hide = true, value_name = "N", default_value_t = 1)]
    pub local_actors: usize,
    /// The supervisor's own files, removed if it is gone when this process ends.
    #[arg(long, hide = true, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
}

/// `leadtime actor`
#[derive(Debug, Args)]
pub(crate) struct ActorArgs {
    /// Address of the learner (or of a router): `tls/HOST:7447`, `tcp/HOST:7447`; repeatable.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub tls: TlsArgs,
    /// The run, where several share the address.
    #[arg(long, value_name = "NAME")]
    pub run: Option<String>,
    /// Name of this actor (default: its certificate's, or host and process id).
    #[arg(long)]
    pub id: Option<String>,
    /// Pull weights from the router of this region, which pulls each version once for all its actors.
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    /// How long to look for a learner at the start.
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = duration)]
    pub connect_timeout: Duration,
    /// How long to look for a learner that was lost: networks fail for longer than typing errors last.
    #[arg(long, value_name = "DURATION", default_value = "30m", value_parser = duration)]
    pub reconnect_timeout: Duration,
    /// Serve /metrics, /live, /ready and /version here: `127.0.0.1:9464`.
    #[arg(long, value_name = "ADDRESS")]
    pub status: Option<String>,
    #[command(flatten)]
    pub trace: TraceArgs,
    #[command(flatten)]
    pub worker: WorkerArgs,
    /// For a world in Python: workers that this actor starts, at least.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = n_processes())]
    pub workers: u32,
    /// Stop when standard input closes: the process that started this one holds the other end.
    #[arg(long, hide = true)]
    pub supervised: bool,
    /// Let the learner go first on the cores that they share.
    #[arg(long, hide = true)]
    pub yields_to_learner: bool,
    /// Print what it did as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Reads after how much a run stops.
pub(super) fn stop_after(text: &str) -> Result<StopAfter, String> {
    let says = "write a number of updates (200), steps (1e6steps) or a time (90m, 2h)";
    let number = |text: &str| n_steps(text).map_err(|_unspecific| says.to_owned());
    let without = |word| text.strip_suffix(word).map(str::trim_end);
    if let Some(steps) = without("steps") {
        return number(steps).map(StopAfter::Steps);
    }
    match number(without("updates").unwrap_or(text)) {
        Ok(updates) => Ok(StopAfter::Updates(updates)),
        Err(says) => duration(text).map(StopAfter::Time).map_err(|why| {
            // The other sentence would ask for what was given.
            if why == TOO_LONG { why } else { says }
        }),
    }
}

/// Reads for how many actors a learner keeps room.
fn n_actors() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=i64::from(ListenSettings::MOST_ACTORS))
}
