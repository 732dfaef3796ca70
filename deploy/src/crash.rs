//! A bug in any thread ends the process: one sentence, exit code 1. So does a limit of the system that a thread cannot go on with;
//! that of open files is what was given to the process, exit code 2.
//!
//! A thread that panics takes with it what it alone does, such as answering the network; the others would wait for it
//! for ever. What a run has on the disk is whole at every moment, so ending at once loses little.

use std::panic;
use std::process;

use crate::exit::ExitCode;
use crate::output;

/// Where a person asks for the stack.
const BACKTRACE: &str = "RUST_BACKTRACE";
/// What the system says when a process may not open another file, and what to do about it.
const OPEN_FILES: (&str, &str) =
    ("Too many open files", "the limit on open files is too small: see `ulimit -n`");
/// What is said when a limit of the system is reached, and what to do about it.
const LIMITS: [(&str, &str); 5] = [
    OPEN_FILES,
    // The network library, which keeps what the system says to itself.
    (
        "Failed to init ",
        "the limit on open files or processes is too small: see `ulimit -n`, `ulimit -u`",
    ),
    (
        "Resource temporarily unavailable",
        "the limit on memory or processes is too small: see `ulimit -v`, `ulimit -u`",
    ),
    ("Cannot allocate memory", "there is not enough memory: see `ulimit -v`"),
    ("failed to spawn thread", "no thread can be started: see `ulimit -v`, `ulimit -u`"),
];

/// Makes every panic end the process.
pub(crate) fn end_on_panic() {
    let default = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        if std::env::var_os(BACKTRACE).is_some_and(|value| value != "0") {
            default(panic);
        }
        let message = panic.payload_as_str().unwrap_or("a panic without a message");
        let place = panic.location().map_or("an unknown place".to_owned(), ToString::to_string);
        output::error(&sentence(&message.replace('\n', " "), &place));
        end(if is_about_files(message) { ExitCode::WrongInput } else { ExitCode::Failed });
    }));
}

#[expect(clippy::exit, reason = "the panicking thread may be any, and nothing else would notice")]
fn end(code: ExitCode) {
    process::exit(code as i32);
}

/// Returns whether a message says that this process may not open another file.
pub(crate) fn is_about_files(message: &str) -> bool {
    message.contains(OPEN_FILES.0)
}

/// Says what to do, if a message says that this process may not open another file, and not that.
pub(crate) fn with_remedy(message: String) -> String {
    let (_, help) = OPEN_FILES;
    let lacks_it = is_about_files(&message) && !message.contains("ulimit");
    if lacks_it { format!("{message}: {help}") } else { message }
}

fn sentence(message: &str, place: &str) -> String {
    match LIMITS.iter().find(|(sign, _)| message.contains(sign)) {
        Some((_, help)) => format!("the system refuses what the program needs ({message}): {help}"),
        None => format!("a bug of the program: {message} (at {place}; {BACKTRACE}=1 shows more)"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_of_the_system_is_not_called_a_bug() {
        let limit = "failed to spawn thread: Os { code: 11, message: \"Resource temporarily unavailable\" }";
        assert!(sentence(limit, "a.rs:1").contains("ulimit -v"));
        for limit in ["Failed to init app", "a: Too many open files (os error 24)"] {
            let told = sentence(limit, "a.rs:1");
            assert!(told.contains("ulimit -n") && !told.contains("a bug"), "{told}");
        }
        let told = with_remedy("cannot read a: Too many open files (os error 24)".to_owned());
        assert!(told.ends_with("see `ulimit -n`"), "{told}");
        assert_eq!(with_remedy(told.clone()), told);
        assert_eq!(with_remedy("no such file".to_owned()), "no such file");
        assert!(sentence("index out", "a.rs:1").starts_with("a bug of the program: index out"));
    }
}
