//! `leadtime config`: the built-in configurations, comments and all.

use crate::cli::ConfigArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;
use leadtime_runs::Tasks;

pub(super) fn run(tasks: &Tasks, args: &ConfigArgs) -> Result<(), Failure> {
    let names: Vec<&str> = tasks.catalog.names().collect();
    let Some(domain) = &args.domain else {
        for name in names {
            output::line(name);
        }
        return Ok(());
    };
    match tasks.catalog.text(domain) {
        Some(text) => {
            output::line(text.blame(ExitCode::WrongInput)?.trim_end());
            Ok(())
        }
        None => Err(Failure::input(format!(
            "there is no configuration `{domain}`; built-in ones: {}",
            names.join(", ")
        ))),
    }
}
