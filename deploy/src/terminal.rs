//! The terminal: how wide it is, and standard error with at most one progress bar on its last line. What cannot be written there
//! is dropped.

use std::io::{self, IsTerminal as _, Write as _};
use std::sync::{Mutex, MutexGuard, PoisonError};

use terminal_size::{Width, terminal_size_of};

/// Clears the line: the bar of this process or of another one may stand there.
const CLEAR: &str = "\r\u{1b}[2K";
/// Columns of a terminal that does not tell its width.
const COLUMNS: usize = 80;
/// Columns that stay empty: what a terminal shows of Ctrl-C would make a full line wrap.
const SPARE: usize = 4;

/// The bar that is shown; empty if there is none.
static BAR: Mutex<String> = Mutex::new(String::new());

fn bar() -> MutexGuard<'static, String> {
    BAR.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns whether a person watches.
pub(crate) fn is_watched() -> bool {
    io::stderr().is_terminal()
}

/// Returns how many columns the terminal has to which standard output goes.
pub(crate) fn columns() -> usize {
    terminal_size_of(io::stdout()).map_or(COLUMNS, |(Width(n), _)| n.into())
}

/// Writes lines, above the bar if there is one.
pub(crate) fn print(text: &str) {
    let (text, bar) = (text.trim_end_matches('\n'), bar());
    let lines = if is_watched() { format!("{CLEAR}{text}\n{bar}") } else { format!("{text}\n") };
    let mut stderr = io::stderr().lock();
    // At once: another process of ours may write there as well, and not in the middle of a line.
    drop(stderr.write_all(lines.as_bytes()).and_then(|()| stderr.flush()));
}

/// Shows how far something is, from 0 to 1, and what `message` says of it in a number of columns; call it where a person
/// watches.
pub(crate) fn show_bar(share: f64, message: impl FnOnce(usize) -> String) {
    const WIDTH: usize = 16;
    let columns = terminal_size_of(io::stderr()).map_or(COLUMNS, |(Width(n), _)| n.into());
    let n_full = (share.clamp(0.0, 1.0) * WIDTH as f64) as usize;
    let (full, rest) = ("\u{2588}".repeat(n_full), "\u{2591}".repeat(WIDTH - n_full));
    let room = columns.saturating_sub(WIDTH + 1 + SPARE);
    set_bar(format!("{full}{rest} {}", message(room)));
}

/// Removes the bar.
pub(crate) fn hide_bar() {
    if !bar().is_empty() {
        set_bar(String::new());
    }
}

fn set_bar(line: String) {
    let mut bar = bar();
    *bar = line;
    let mut stderr = io::stderr().lock();
    drop(write!(stderr, "{CLEAR}{bar}").and_then(|()| stderr.flush()));
}
