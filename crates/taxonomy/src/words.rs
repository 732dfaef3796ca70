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
    fn a_prefix_keeps_how_the_words_are_written() {
        assert_eq!(prefix("Zone ahead - go up.", 2), "Zone ahead");
        assert_eq!(prefix("Go up.", 9), "Go up.");
        assert_eq!(prefix("Go up.", 0), "");
    }
}
