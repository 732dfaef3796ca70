//! Text inside XML and HTML.

use std::borrow::Cow;

/// Replaces the characters that mean something in XML and HTML, and drops those that XML forbids.
pub fn escape(text: &str) -> Cow<'_, str> {
    let special = |c: char| matches!(c, '&' | '<' | '>' | '"' | '\'') || forbidden(c);
    if !text.contains(special) {
        return Cow::Borrowed(text);
    }
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if forbidden(c) => {}
            c => out.push(c),
        }
    }
    Cow::Owned(out)
}

fn forbidden(c: char) -> bool {
    (c.is_control() && !matches!(c, '\n' | '\t')) || matches!(c, '\u{fffe}' | '\u{ffff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_means_something_in_markup_is_replaced() {
        assert_eq!(escape("a<b & \"c\" 'd'\u{1}>"), "a&lt;b &amp; &quot;c&quot; &#39;d&#39;&gt;");
        assert!(matches!(escape("plain"), Cow::Borrowed("plain")));
    }
}
