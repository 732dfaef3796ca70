//! The arguments that say what may be executed for a world in Python.

use std::path::Path;

use clap::Args;
use leadtime_runs::Tasks;
use leadtime_worker::{Permission, WorkerRules};

/// What is executed to step the environments of a world in Python.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct WorkerArgs {
    /// For a world in Python: start this command to step environments, instead of the configuration's.
    #[arg(long, value_name = "COMMAND")]
    pub worker: Option<String>,
    /// Start the command that somebody else's configuration names, and read their pickles.
    #[arg(long)]
    pub trust_worker: bool,
}

impl WorkerArgs {
    /// Returns which command is executed; `is_own` tells whether the configuration is this user's.
    pub(crate) fn permission(&self, is_own: bool) -> Permission {
        match &self.worker {
            Some(command) => Permission::Own(command.clone()),
            None if self.trust_worker || is_own => Permission::Configured,
            None => Permission::Refused,
        }
    }

    /// Allows what a policy needs to be played: the command of a run on this disk, but not that of a file that may come from
    /// anywhere.
    pub(crate) fn permit(&self, tasks: &Tasks, policy: &Path) {
        let permission = self.permission(!policy.is_file());
        tasks.workers.follow(WorkerRules { permission, ..WorkerRules::default() });
    }
}
