//! `leadtime config`: the built-in configurations, comments and all.

use std::ffi::OsStr;

use leadtime_proto::phrase::no_such;
use leadtime_runs::Tasks;

use crate::cli::ConfigArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(super) fn run(tasks: &Tasks, args: &ConfigArgs) -> Result<(), Failure> {
    let names: Vec<&str> = tasks.catalog.names().collect();
    let Some(name) = args.name.as_deref().map(OsStr::to_string_lossy) else {
        names.into_iter().for_each(output::line);
        return Ok(());
    };
    let Some(text) = tasks.catalog.text(&name) else {
        return Err(Failure::input(no_such("configuration", &name, names)));
    };
    output::data(text.blame(ExitCode::WrongInput)?.trim_end());
    Ok(())
}
