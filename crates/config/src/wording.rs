//! What a reader of TOML says of a wrong value, in words that a person knows who reads no Rust.

use leadtime_proto::phrase::did_you_mean;

/// Rewords a message of serde or of a reader of TOML; it keeps the value that it shows.
pub(crate) fn worded(message: &str) -> String {
    if message == "wanted string or table" {
        return "expected text or a table".to_owned();
    }
    // The value may hold any text.
    match message.strip_prefix("invalid ").and_then(|rest| rest.rsplit_once(", expected ")) {
        Some((given, expected)) => {
            format!("invalid {}, expected {}", shown(given), allowed(expected, given))
        }
        None => shortened(message),
    }
}

/// Names the type of a value, as TOML calls it, with its article.
pub(crate) fn kind(toml: &str) -> &str {
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
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" if given.starts_with("value: integer `-") => {
            "a whole number that is not negative"
        }
        "u8" | "u16" | "u32" | "u64" | "usize" | "i32" | "i64" if given.starts_with("value") => {
            "a whole number that is not as large"
        }
        "u8" | "u16" | "u32" | "u64" | "usize" | "i32" | "i64" => kind("integer"),
        "f32" | "f64" => kind("float"),
        "a boolean" => kind("boolean"),
        "a string" | "string" => kind("string"),
        "a sequence" => kind("array"),
        "a map" => kind("table"),
        of if of.starts_with("struct ") => kind("table"),
        other => match ["an array of ", "a tuple of ", "tuple "].map(|of| other.starts_with(of)) {
            [false, false, false] => other,
            _ => kind("array"),
        },
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
