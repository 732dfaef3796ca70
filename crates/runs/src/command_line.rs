//! A command as text that can be copied into a shell.

use std::ffi::{OsStr, OsString};
use std::fmt::Write as _;
use std::path::Path;

use leadtime_proto::text::{escaped, shell_word};

/// The program of the repository, which is expected to be on the path.
const LEADTIME: &str = "leadtime";

/// Names a program by what it was started as: `leadtime` wherever that lies, any other one as it was typed.
pub fn program_name(started_as: Option<OsString>) -> String {
    let typed = started_as.unwrap_or_else(|| LEADTIME.into());
    let is_ours = Path::new(&typed).file_name().is_some_and(|name| name == LEADTIME);
    if is_ours { LEADTIME.to_owned() } else { typed.to_string_lossy().into_owned() }
}

/// Writes a program's command with its arguments so that a shell reads the same ones.
pub fn command_line(program: &str, args: impl IntoIterator<Item = OsString>) -> String {
    let args = args.into_iter().map(|arg| shell_argument(&arg));
    std::iter::once(shell_argument(program.as_ref())).chain(args).collect::<Vec<_>>().join(" ")
}

/// Writes an argument so that a shell reads it, whatever bytes it has: control characters, and what is not text, as `$'\033'`.
pub fn shell_argument(argument: &OsStr) -> String {
    if let Some(text) = argument.to_str()
        && escaped(text) == text
    {
        return shell_word(text);
    }
    let mut word = "$'".to_owned();
    for &byte in argument.as_encoded_bytes() {
        match byte {
            b'\\' | b'\'' => word.extend(['\\', byte.into()]),
            b' '..=b'~' => word.push(byte.into()),
            // Three octal digits: a digit that follows is no part of them.
            _ => _ = write!(word, "\\{byte:03o}"),
        }
    }
    word + "'"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_a_command_back() {
        let args = ["eval", "it's", "--set=human.d={fixed=3}", "", "a b"];
        let command = command_line("leadtime", args.into_iter().map(OsString::from));
        assert_eq!(command, r"leadtime eval 'it'\''s' '--set=human.d={fixed=3}' '' 'a b'");
    }

    #[test]
    fn a_program_with_worlds_of_its_own_is_named_as_it_was_started() {
        let name = |typed: &str| program_name(Some(typed.into()));
        assert_eq!([name("leadtime"), name("target/debug/leadtime")], ["leadtime"; 2]);
        assert_eq!(name("target/debug/my-world"), "target/debug/my-world");
        assert_eq!(command_line("my worlds/leadtime-b", []), "'my worlds/leadtime-b'");
        assert_eq!(program_name(None), "leadtime");
    }

    #[test]
    fn a_shell_reads_back_an_argument_of_any_bytes() {
        use std::os::unix::ffi::{OsStrExt as _, OsStringExt as _};
        let every_byte: Vec<u8> = (1..=u8::MAX).collect();
        for bytes in
            [&every_byte[..], b"a\x1b1", b"odd-\xff", b"it's \x07\\", "\u{202e}x".as_bytes()]
        {
            let word = shell_argument(OsStr::from_bytes(bytes));
            assert!(!word.contains(|c: char| c.is_control()), "{word}");
            let mut bash = std::process::Command::new("bash");
            let printed = bash.arg("-c").arg(format!("printf %s {word}")).output().unwrap();
            assert_eq!(OsString::from_vec(printed.stdout), OsStr::from_bytes(bytes), "{word}");
        }
    }
}
