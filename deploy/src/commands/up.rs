//! `leadtime up`: learner and actors on this machine, supervised.

use leadtime_runs::Naming;
use leadtime_runs::launch::Launch;

use super::launch::launch;
use crate::cli::UpArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::shutdown::{Watch, watch};
use leadtime_runs::Tasks;

pub(super) async fn run(tasks: &Tasks, args: &UpArgs) -> Result<(), Failure> {
    let name = args.run.name.as_deref();
    let config = args.source.load(tasks, name).blame(ExitCode::WrongInput)?;
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    let what = Launch {
        listen: &args.listen,
        fork: args.run.fork.as_deref(),
        stop_after: args.run.stop_after,
        learner_stdout: true,
        ..Launch::new(Naming::Resume, args.actors)
    };
    launch(&config, &what, &shutdown).await.map(|_run| ())
}
