//! From `leadtime taxonomy ...` to what is to be done.

use super::{build, look, rate};
use crate::Program;
use crate::cli::TaxonomyCommand;
use crate::exit::Failure;

pub(in crate::commands) fn run(
    program: &Program,
    command: &TaxonomyCommand,
) -> Result<(), Failure> {
    match command {
        TaxonomyCommand::Build(args) => build::run(args),
        TaxonomyCommand::Rate(args) => rate::run(args),
        TaxonomyCommand::Report(args) => look::report(args),
        TaxonomyCommand::Export(args) => look::export(args),
        TaxonomyCommand::Validate(args) => look::validate(program, args),
    }
}
