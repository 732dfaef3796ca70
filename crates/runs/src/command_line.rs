//! A command as text that can be copied into a shell.

use std::ffi::OsString;

use leadtime_proto::text::shell_word;

/// Writes a command with its arguments so that a shell reads the same ones.
pub fn command_line(args: impl IntoIterator<Item = OsString>) -> String {
    let args = args.into_iter().map(|arg| shell_word(&arg.to_string_lossy()));
    std::iter::once("leadtime".to_owned()).chain(args).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_a_command_back() {
        let args = ["eval", "it's", "--set=human.d={fixed=3}", "", "a b"];
        let command = command_line(args.into_iter().map(OsString::from));
        assert_eq!(command, r"leadtime eval 'it'\''s' '--set=human.d={fixed=3}' '' 'a b'");
    }
}
