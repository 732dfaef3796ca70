//! Everything that goes to standard output (data) and the last words on standard error.
//!
//! A closed pipe (`leadtime runs | head -1`) is no error: whoever stopped reading has what they wanted.

use std::io::{self, Write as _};

use serde::Serialize;

/// Writes text and a line end to standard output.
pub fn line(text: &str) {
    drop(writeln!(io::stdout().lock(), "{text}"));
}

/// Writes a value as one line of JSON to standard output.
///
/// # Panics
///
/// If the value has no JSON form, which no result of ours lacks.
pub fn json<T: Serialize>(value: &T) {
    line(&serde_json::to_string(value).expect("results are plain data"));
}

/// Writes a line of talk to standard error, whatever `RUST_LOG` says.
pub fn say(text: &str) {
    drop(writeln!(io::stderr().lock(), "{text}"));
}

/// Writes a command with its arguments so that a shell reads the same ones.
pub fn command_line(args: impl Iterator<Item = String>) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-+=.,:/@%".contains(c);
    let quoted = args.map(|arg| {
        let plain = !arg.is_empty() && arg.chars().all(is_plain);
        if plain { arg } else { format!("'{}'", arg.replace('\'', r"'\''")) }
    });
    std::iter::once("leadtime".to_owned()).chain(quoted).collect::<Vec<_>>().join(" ")
}

/// Writes bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        text.push(char::from_digit(u32::from(byte >> 4), 16).unwrap_or_default());
        text.push(char::from_digit(u32::from(byte & 15), 16).unwrap_or_default());
        text
    })
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_shell_reads_a_command_back() {
        let args = ["eval", "it's", "--set=human.d={fixed=3}", "", "a b"];
        let command = super::command_line(args.into_iter().map(str::to_owned));
        assert_eq!(command, r"leadtime eval 'it'\''s' '--set=human.d={fixed=3}' '' 'a b'");
    }

    #[test]
    fn bytes_have_two_digits_each() {
        assert_eq!(super::hex(&[0, 10, 255]), "000aff");
    }
}
