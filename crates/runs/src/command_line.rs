//! A command as text that can be copied into a shell.

use std::ffi::OsString;
use std::path::Path;

use leadtime_proto::text::shell_word;

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
    let args = args.into_iter().map(|arg| shell_word(&arg.to_string_lossy()));
    std::iter::once(shell_word(program)).chain(args).collect::<Vec<_>>().join(" ")
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
}
