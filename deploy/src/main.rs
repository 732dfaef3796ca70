//! The program `leadtime`; everything is in the library of this package.

use std::process::ExitCode;

fn main() -> ExitCode {
    leadtime::Program::new().run()
}
