//! From `leadtime taxonomy ...` to what is to be done.

use super::{build, look, rate};
use crate::cli::TaxonomyCommand;
use crate::exit::Failure;
use leadtime_runs::Tasks;

pub(in crate::commands) fn run(tasks: &Tasks, command: &TaxonomyCommand) -> Result<(), Failure> {
    match command {
        TaxonomyCommand::Build(args) => build::run(args),
        TaxonomyCommand::Rate(args) => rate::run(args),
        TaxonomyCommand::Report(args) => look::report(args),
        TaxonomyCommand::Export(args) => look::export(args),
        TaxonomyCommand::Validate(args) => look::validate(tasks, args),
    }
}
