//! Arguments of the commands for keeping runs going.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

/// Where a status is looked for if nothing else is said.
pub(crate) const STATUS_ADDRESS: &str = "127.0.0.1:9464";
/// Where the page of a run is served if nothing else is said.
pub(crate) const PAGE_ADDRESS: &str = "127.0.0.1:8080";

/// `leadtime health`
#[derive(Debug, Args)]
pub(crate) struct HealthArgs {
    /// The status address of a learner or an actor (`--status`).
    #[arg(value_name = "ADDRESS", default_value = STATUS_ADDRESS)]
    pub address: String,
    /// Ask only whether it is alive, not whether it is ready.
    #[arg(long)]
    pub live: bool,
}

/// What a run's processes did when.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct TraceArgs {
    /// Write a timeline to this file, which must not be there: who waits for whom, thread by thread. Open it in
    /// Perfetto (`ui.perfetto.dev`) or `chrome://tracing`.
    #[arg(long = "trace", value_name = "FILE")]
    pub file: Option<PathBuf>,
}

/// `leadtime version`
#[derive(Debug, Args)]
pub(crate) struct VersionArgs {
    /// Print only the version of the protocol between processes: two programs can work together if it is the same.
    #[arg(long)]
    pub protocol: bool,
    /// Print the versions as JSON.
    #[arg(long, conflicts_with = "protocol")]
    pub json: bool,
}

/// `leadtime runs prune`
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct PruneArgs {
    /// Only runs in which nothing has happened for so long: 30d.
    #[arg(long, value_name = "DURATION", value_parser = super::network::duration_or_days)]
    pub older: Duration,
    /// Keep the best run of each configuration, whatever its seed.
    #[arg(long)]
    pub keep_best: bool,
    /// Remove them; without this they are only listed.
    #[arg(long)]
    pub yes: bool,
}
