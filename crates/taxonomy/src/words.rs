//! What a word is: the one rule that generation, validation and run time share.
//!
//! A text is cut at white space; punctuation around a word is dropped, a hyphen or an apostrophe inside it stays.
//! So `"Avoid top-left danger zone, ascend."` has five words.

/// Lists the words of a text, in lower case, without the punctuation around them.
///
/// # Example
///
/// ```
/// use leadtime_taxonomy::words::words;
///
/// assert_eq!(words("Danger, don't - wait!"), ["danger", "don't", "wait"]);
/// ```
pub fn words(text: &str) -> Vec<String> {
    text.split_whitespace()
        .map(|word| word.trim_matches(|c: char| !c.is_alphanumeric()).to_lowercase())
        .filter(|word| !word.is_empty())
        .collect()
}

/// Counts the words of a text.
pub fn count(text: &str) -> u32 {
    text.split_whitespace().filter(|word| word.chars().any(char::is_alphanumeric)).count() as u32
}

/// Writes a text as it is compared: its words, one space apart.
pub fn normalised(text: &str) -> String {
    words(text).join(" ")
}

/// Cuts a text after its first `n` words, as it is written.
pub fn prefix(text: &str, n: usize) -> String {
    let mut left = n;
    let mut kept = Vec::new();
    for word in text.split_whitespace() {
        if left == 0 {
            break;
        }
        left -= usize::from(word.chars().any(char::is_alphanumeric));
        kept.push(word);
    }
    kept.join(" ")
}

/// Cuts a sentence into the pieces in which it is spoken, one a word.
///
/// # Example
///
/// ```
/// use leadtime_taxonomy::words::spoken;
///
/// assert_eq!(spoken("Zone ahead - go up!").collect::<Vec<_>>(), ["Zone", "ahead -", "go", "up!"]);
/// ```
pub fn spoken(text: &str) -> impl Iterator<Item = &str> {
    let mut rest = text.trim();
    std::iter::from_fn(move || {
        let mut end = next_gap(rest, 0)?;
        // A mark that stands alone belongs to the word before it.
        while let Some(further) = next_gap(rest, end) {
            if rest[end..further].chars().any(char::is_alphanumeric) {
                break;
            }
            end = further;
        }
        let piece = rest[..end].trim();
        rest = rest[end..].trim_start();
        Some(piece)
    })
}

/// Returns where the word ends that begins at or after `from`; `None` if there is none.
fn next_gap(text: &str, from: usize) -> Option<usize> {
    let begin = from + text[from..].find(|c: char| !c.is_whitespace())?;
    let length = text[begin..].find(char::is_whitespace).unwrap_or(text.len() - begin);
    Some(begin + length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hyphenated_word_is_one_word() {
        assert_eq!(count("Avoid top-left danger zone, ascend."), 5);
        assert_eq!(words("top-left")[0], "top-left");
    }

    #[test]
    fn punctuation_alone_is_no_word() {
        assert_eq!(count("Zone ahead - go up !"), 4);
        assert_eq!(words("Zone ahead - go up !").len(), 4);
        assert_eq!(normalised("  Go   UP!! "), "go up");
        assert_eq!(count(""), 0);
    }

    #[test]
    fn a_sentence_has_as_many_pieces_as_words() {
        assert_eq!(spoken("  ").collect::<Vec<_>>(), [""; 0]);
        for domain in crate::shipped::domains() {
            let taxonomy = crate::shipped(domain).unwrap();
            for utterance in taxonomy.topics().iter().flat_map(crate::Topic::utterances) {
                assert_eq!(spoken(&utterance.text).count() as u32, count(&utterance.text));
            }
        }
    }

    #[test]
    fn a_prefix_keeps_how_the_words_are_written() {
        assert_eq!(prefix("Zone ahead - go up.", 2), "Zone ahead");
        assert_eq!(prefix("Go up.", 9), "Go up.");
        assert_eq!(prefix("Go up.", 0), "");
    }
}
