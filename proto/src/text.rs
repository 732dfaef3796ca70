//! Text of other people on a terminal: control characters escaped, long lines cut.
//!
//! File names, keys and values come from anywhere. Printed raw, an escape sequence in one of them would be carried out
//! by the terminal, and a line of a megabyte would bury the message that quotes it.

/// The most characters of quoted text that a message holds.
const QUOTED: usize = 120;
/// The most characters of a sentence that is taken from a peer.
const SENTENCE: usize = 1_000;
/// The most characters of one printed line.
const LINE: usize = 500;
/// The same of a message of our own: its quotations are short, and it says at its end what to do.
const OWN_LINE: usize = 4_000;
/// The most lines of one printed message.
const LINES: usize = 50;

/// Returns text as a message can quote it: on one line, without control characters, at most 120 characters.
///
/// # Example
///
/// ```
/// use leadtime_proto::text::quoted;
///
/// assert_eq!(quoted("a\u{1b}[31mb\n"), "a\\u{1b}[31mb\\n");
/// assert!(quoted(&"[".repeat(1_000_000)).len() < 200);
/// ```
pub fn quoted(text: &str) -> String {
    cut(text, QUOTED)
}

/// Returns a peer's sentence as a message can repeat it: on one line, without control characters, of limited length.
pub fn sentence(text: &str) -> String {
    cut(text, SENTENCE)
}

/// Returns a whole message as a terminal can print it: its lines stay lines, each is escaped and cut.
pub fn printable(message: &str) -> String {
    cut_lines(message, LINE)
}

/// As [`printable`], for a message of our own in which other people's text is cut already.
pub fn own_message(message: &str) -> String {
    cut_lines(message, OWN_LINE)
}

/// Returns an argument as a shell has to read it: in quotes if need be.
///
/// # Example
///
/// ```
/// use leadtime_proto::text::shell_word;
///
/// let words = ["eval", "it's", "--set=human.d={fixed=3}", ""].map(shell_word);
/// assert_eq!(words, ["eval", r"'it'\''s'", "'--set=human.d={fixed=3}'", "''"]);
/// ```
pub fn shell_word(argument: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-+=.,:/@%".contains(c);
    let plain = !argument.is_empty() && argument.chars().all(is_plain);
    if plain { argument.to_owned() } else { format!("'{}'", argument.replace('\'', r"'\''")) }
}

fn cut_lines(message: &str, most: usize) -> String {
    let mut lines: Vec<String> = message.lines().take(LINES).map(|line| cut(line, most)).collect();
    if message.lines().nth(LINES).is_some() {
        lines.push("…".to_owned());
    }
    lines.join("\n")
}

/// Returns text with every control character escaped.
pub fn escaped(text: &str) -> String {
    cut(text, usize::MAX)
}

fn cut(text: &str, most: usize) -> String {
    let mut out = String::new();
    for (i, character) in text.chars().enumerate() {
        if i == most {
            out.push('…');
            break;
        }
        match character {
            // Marks that turn the direction of writing can make a line read as another one.
            '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
                out.extend(character.escape_unicode());
            }
            _ if character.is_control() => out.extend(character.escape_default()),
            _ => out.push(character),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_keep_their_lines_and_lose_their_control_characters() {
        assert_eq!(printable("a\tb\nc\r\u{7}"), "a\\tb\nc\\r\\u{7}");
        assert_eq!(escaped("\u{202e}x"), "\\u{202e}x");
        let long = printable(&["x".repeat(10_000), "y\n".repeat(1_000)].join("\n"));
        assert!(long.len() < 1_000 && long.ends_with("y\n…"), "{long}");
        let remedy = format!("{} give the old values", "x".repeat(3_000));
        assert_eq!(own_message(&remedy), remedy);
        assert!(own_message(&"x".repeat(1_000_000)).len() < 5_000);
    }

    #[test]
    fn a_peers_sentence_cannot_move_the_cursor_or_fill_the_screen() {
        assert_eq!(sentence("a\u{1b}[2Jb\n"), "a\\u{1b}[2Jb\\n");
        let long = sentence(&"x".repeat(5_000));
        assert_eq!(long.trim_end_matches('…').len(), SENTENCE);
    }
}
