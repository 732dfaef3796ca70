//! `leadtime config`: the built-in configurations, comments and all.

use crate::cli::ConfigArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::{Program, output};

pub(super) fn run(program: &Program, args: &ConfigArgs) -> Result<(), Failure> {
    let names: Vec<&str> = program.catalog.names().collect();
    let Some(domain) = &args.domain else {
        for name in names {
            output::line(name);
        }
        return Ok(());
    };
    match program.catalog.text(domain) {
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
