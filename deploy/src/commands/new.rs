//! `leadtime new`: a crate for a world of one's own.

use std::path::Path;

use leadtime_runs::shell_argument;
use leadtime_worlds::{first_commands, new_crate};

use crate::cli::NewArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// The checkout that this program was built from, if it is still there.
const CHECKOUT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

pub(super) fn run(args: &NewArgs) -> Result<(), Failure> {
    let directory = &args.directory;
    let default = Path::new(CHECKOUT).join("deploy/Cargo.toml").is_file();
    let checkout = args.leadtime.as_deref().or(default.then_some(Path::new(CHECKOUT)));
    new_crate(directory, args.name.as_deref(), checkout).blame(ExitCode::WrongInput)?;
    output::line(&format!("{}: README.md explains the crate", directory.display()));
    if checkout.is_none() {
        output::line("Leadtime's source is not here: write its address into Cargo.toml first");
    }
    output::note(&first_commands(&shell_argument(directory.as_os_str())));
    Ok(())
}
