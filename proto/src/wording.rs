//! What a reader of TOML says of a wrong value, in words that a person knows who reads no Rust.

use crate::phrase::did_you_mean;

/// Rewords a message of serde or of a reader of TOML; it keeps the value that it shows.
pub fn worded(message: &str) -> String {
    match message {
        "wanted string or table" => return "expected text or a table".to_owned(),
        "wanted exactly 1 element, found 0 elements"
        | "wanted exactly 1 element, more than 1 element" => {
            return "expected a table with one key".to_owned();
        }
        _ => {}
    }
    if let Some(given) = message.strip_prefix("expected table, found ") {
        return format!("expected a table, found {}", kind(given));
    }
    // The value may hold any text.
    match message.strip_prefix("invalid ").and_then(|rest| rest.rsplit_once(", expected ")) {
        Some((given, expected)) if given.starts_with("length ") => wrong_length(given, expected),
        Some((given, expected)) => {
            format!("invalid {}, expected {}", shown(given), allowed(expected, given))
        }
        None => shortened(&keyed(message)),
    }
}

/// Names the type of a value, as TOML calls it, with its article.
pub fn kind(toml: &str) -> &str {
    match toml {
        "string" => "text",
        "integer" => "a whole number",
        "float" => "a number",
        "boolean" => "true or false",
        "datetime" => "a date",
        "array" => "a list",
        "table" => "a table",
        other => other,
    }
}

/// Rewords that a list has too few or too many values.
fn wrong_length(given: &str, expected: &str) -> String {
    if expected.starts_with("struct ") {
        return "invalid type: a list, expected a table".to_owned();
    }
    // As in `a tuple of size 2` or `tuple variant Delay::Uniform with 2 elements`.
    match expected.split(' ').rfind(|word| word.parse::<usize>().is_ok()) {
        Some(n) => format!("invalid {given}, expected a list of length {n}"),
        None => format!("invalid {given}, expected {expected}"),
    }
}

/// Rewords what was given: the type, and the value where one is shown.
fn shown(given: &str) -> String {
    let words = [
        ("integer `", "whole number `"),
        ("floating point `", "number `"),
        ("string \"", "text \""),
        ("boolean `", "`"),
        ("sequence", "a list"),
        ("map", "a table"),
    ];
    let Some((what, value)) = given.split_once(": ") else { return given.to_owned() };
    let plain = words.iter().find_map(|(from, to)| Some([to, value.strip_prefix(from)?].concat()));
    format!("{what}: {}", plain.as_deref().unwrap_or(value))
}

/// Rewords what is allowed instead.
fn allowed<'m>(expected: &'m str, given: &str) -> &'m str {
    let is_negative = given.starts_with("value: integer `-");
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" if is_negative => {
            "a whole number that is not negative"
        }
        "u8" | "u16" | "u32" | "u64" | "usize" | "i32" | "i64"
            if given.starts_with("value") && !is_negative =>
        {
            "a whole number that is not as large"
        }
        "u8" | "u16" | "u32" | "u64" | "usize" | "i32" | "i64" => kind("integer"),
        "f32" | "f64" => kind("float"),
        "a boolean" => kind("boolean"),
        "a string" | "string" | "path string" => kind("string"),
        "a sequence" => kind("array"),
        "a map" => kind("table"),
        of if of.starts_with("struct ") => kind("table"),
        other => match ["an array of ", "a tuple of ", "tuple "].map(|of| other.starts_with(of)) {
            [false, false, false] => other,
            _ => kind("array"),
        },
    }
}

/// Calls keys and choices what the documentation calls them.
fn keyed(message: &str) -> String {
    let words = [
        ("unknown field `", "unknown key `"),
        ("missing field `", "missing key `"),
        ("unknown variant `", "unknown choice `"),
    ];
    let plain =
        words.iter().find_map(|(from, to)| Some([to, message.strip_prefix(from)?].concat()));
    let plain = plain.unwrap_or_else(|| message.to_owned());
    match plain.strip_suffix("there are no fields") {
        Some(begin) => format!("{begin}there are no keys"),
        None => plain,
    }
}

/// Asks whether the most similar name was meant, where a message about an unknown one lists all that are known.
fn shortened(message: &str) -> String {
    let mut names = message.split('`').skip(1).step_by(2);
    match (message.starts_with("unknown "), names.next()) {
        (true, Some(given)) => match did_you_mean(given, names) {
            meant if meant.is_empty() => message.to_owned(),
            meant => format!("{}{meant}", message.split(", expected").next().unwrap_or(message)),
        },
        _ => message.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_said_in_plain_words_that_are_true() {
        for (message, words) in [
            ("wanted exactly 1 element, found 0 elements", "expected a table with one key"),
            ("expected table, found integer", "expected a table, found a whole number"),
            (
                "invalid length 1, expected an array of length 2",
                "invalid length 1, expected a list of length 2",
            ),
            (
                "invalid length 1, expected tuple struct Span with 3 elements",
                "invalid length 1, expected a list of length 3",
            ),
            (
                "invalid length 1, expected struct variant Delay::Uniform with 2 elements",
                "invalid type: a list, expected a table",
            ),
            ("invalid length 3, expected fewer", "invalid length 3, expected fewer"),
            (
                "invalid value: integer `-5000000000`, expected i32",
                "invalid value: whole number `-5000000000`, expected a whole number",
            ),
            (
                "invalid type: integer `3`, expected path string",
                "invalid type: whole number `3`, expected text",
            ),
            ("missing field `high`", "missing key `high`"),
            ("unknown field `a`, there are no fields", "unknown key `a`, there are no keys"),
            (
                "unknown field `clp`, expected `clip` or `lag`",
                "unknown key `clp`; did you mean `clip`?",
            ),
            (
                "unknown variant `x`, expected `restart` or `continue`",
                "unknown choice `x`, expected `restart` or `continue`",
            ),
            ("its text is no field", "its text is no field"),
        ] {
            assert_eq!(worded(message), words);
        }
    }
}
