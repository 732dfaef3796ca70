//! What the options of a command name to be written: never a file that a run keeps.

use std::path::Path;

use leadtime_proto::text::quoted;
use leadtime_runs::{REPORT_PAGE, run_that_keeps};

use crate::cli::{CertsCommand, Cli, Command, TaxonomyCommand};
use crate::exit::Failure;

/// A file or directory that an option names to be written.
#[derive(Debug)]
struct Target<'a> {
    option: &'static str,
    path: &'a Path,
}

/// Makes a target of an option that may have been left out.
fn target<'a, P: AsRef<Path>>(option: &'static str, path: Option<&'a P>) -> Option<Target<'a>> {
    path.map(|path| Target { option, path: path.as_ref() })
}

/// Refuses a command line that would write over what a run keeps, before anything is done.
pub(crate) fn check(cli: &Cli) -> Result<(), Failure> {
    let log = target("--log-file", cli.logs.log_file.as_ref());
    for Target { option, path } in log.into_iter().chain(of_command(&cli.command)) {
        let Some(run) = run_that_keeps(path) else { continue };
        let run = quoted(&run.file_name().unwrap_or_default().to_string_lossy());
        return Err(Failure::input(format!(
            "{option} {}: the run `{run}` keeps its own data there, which would be lost; choose another path",
            path.display()
        )));
    }
    Ok(())
}

/// Returns what a command is to write beside its log and the files of its run.
fn of_command(command: &Command) -> Option<Target<'_>> {
    match command {
        Command::Up(args) => target("--trace", args.run.trace.file.as_ref()),
        Command::Learner(args) => target("--trace", args.run.trace.file.as_ref()),
        Command::Actor(args) => target("--trace", args.trace.file.as_ref()),
        Command::Serve(args) => target("--state", args.state.as_ref()),
        Command::Drive(args) => target("--messages-to", args.messages_to.as_ref()),
        Command::Record(args) => target("--output", Some(&args.output)),
        Command::Certs { command: CertsCommand::Acl(args) } => target("--out", args.out.as_ref()),
        Command::Eval(args) => target("--episodes-to", args.episodes_to.as_ref()),
        Command::Probe(args) => target("--markdown", args.markdown.as_ref()),
        Command::Play(args) => target("--output", Some(&args.output)),
        // The page itself can be made again.
        Command::Report(args) => {
            let out = args.out.as_ref().filter(|out| !out.ends_with(REPORT_PAGE));
            target("--out", out)
        }
        Command::Compare(args) => target("--out", args.out.as_ref()),
        Command::ScriptSearch(args) => target("--out", args.out.as_ref()),
        Command::Taxonomy { command } => match command {
            TaxonomyCommand::Build(args) => target("--output", Some(&args.output)),
            TaxonomyCommand::Rate(args) => target("--log", args.log.as_ref()),
            TaxonomyCommand::Report(args) => target("--output", args.output.as_ref()),
            TaxonomyCommand::Export(args) => target("--output", args.output.as_ref()),
            TaxonomyCommand::Speak(args) => target("--output", Some(&args.output)),
            TaxonomyCommand::Validate(_) => None,
        },
        _ => None,
    }
}
