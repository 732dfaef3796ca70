//! `leadtime up`: learner and actors on this machine, supervised.

use super::launch::{Launch, launch};
use crate::Program;
use crate::cli::UpArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::run_dir;
use crate::shutdown::{Watch, watch};

pub(super) async fn run(program: &Program, args: &UpArgs) -> Result<(), Failure> {
    let name = args.run.name.as_deref();
    let config = program.configure(&args.source, name).blame(ExitCode::WrongInput)?;
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    let name = run_dir::choose_name(&config, &args.run).blame(ExitCode::WrongInput)?;
    let what = Launch {
        name: &name,
        n_actors: args.actors,
        listen: &args.listen,
        choice: &args.run,
        learner_talks: true,
        log: None,
    };
    launch(&config, &what, &shutdown).await
}
