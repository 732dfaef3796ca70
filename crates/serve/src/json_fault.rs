//! What is wrong with somebody's JSON, in one sentence: which field it is, and what is expected there.

use leadtime_proto::phrase::did_you_mean;
use leadtime_proto::text::quoted;
use serde_json::Value;
use thiserror::Error;

/// A field of a message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FieldRule {
    pub(crate) name: &'static str,
    /// What it has to be, as the end of a sentence.
    pub(crate) expected: &'static str,
    /// Describes a value that does not fit; `None` if it fits.
    pub(crate) misfit: fn(&Value) -> Option<String>,
    /// It may be left out.
    pub(crate) is_optional: bool,
}

impl FieldRule {
    /// Describes a field that may be left out.
    pub(crate) const fn optional(
        name: &'static str,
        expected: &'static str,
        misfit: fn(&Value) -> Option<String>,
    ) -> Self {
        Self { name, expected, misfit, is_optional: true }
    }

    /// Describes a field that has to be there.
    pub(crate) const fn required(
        name: &'static str,
        expected: &'static str,
        misfit: fn(&Value) -> Option<String>,
    ) -> Self {
        Self { is_optional: false, ..Self::optional(name, expected, misfit) }
    }
}

/// What is wrong with a client's JSON.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum JsonFault {
    #[error("it is no JSON: it ends in the middle, after {0} bytes")]
    Cut(usize),
    #[error("it is no JSON: `{found}` at line {line}, column {column} is out of place")]
    Syntax { found: String, line: usize, column: usize },
    #[error("it has to be a JSON object with {fields}; it is {found}")]
    NoObject { fields: String, found: String },
    #[error("`{}` is not known{meant} Known: {known}", quoted(.field))]
    Unknown { field: String, meant: String, known: String },
    #[error("`{field}` is missing: {expected}")]
    Missing { field: &'static str, expected: &'static str },
    #[error("`{field}` has to be {expected}; {found}")]
    Misfit { field: &'static str, expected: &'static str, found: String },
    #[error("`{0}` is there twice")]
    Twice(&'static str),
    #[error("{0}")]
    Other(String),
}

impl JsonFault {
    /// Finds what is wrong with a message of these fields that could not be read.
    pub(crate) fn find(bytes: &[u8], rules: &[FieldRule], error: &serde_json::Error) -> Self {
        let value = match serde_json::from_slice::<Value>(bytes) {
            Ok(value) => value,
            Err(error) if error.is_eof() => return Self::Cut(bytes.len()),
            Err(error) => return Self::syntax(bytes, &error),
        };
        let names = || rules.iter().map(|rule| rule.name);
        let known = || names().collect::<Vec<_>>().join(", ");
        let Some(fields) = value.as_object() else {
            let (fields, found) = (known(), described(&value));
            return Self::NoObject { fields, found };
        };
        if let Some(field) = fields.keys().find(|field| names().all(|name| name != field.as_str()))
        {
            let meant = match did_you_mean(field, names()) {
                meant if meant.is_empty() => ".".to_owned(),
                meant => meant,
            };
            return Self::Unknown { field: field.clone(), meant, known: known() };
        }
        for &FieldRule { name: field, expected, misfit, is_optional } in rules {
            match fields.get(field) {
                None if is_optional => {}
                None => return Self::Missing { field, expected },
                Some(value) => {
                    if let Some(found) = misfit(value) {
                        return Self::Misfit { field, expected, found };
                    }
                }
            }
        }
        let text = error.to_string();
        let twice = names().find(|name| text.starts_with(&format!("duplicate field `{name}`")));
        twice.map_or(Self::Other(text), Self::Twice)
    }

    fn syntax(bytes: &[u8], error: &serde_json::Error) -> Self {
        let (line, column) = (error.line(), error.column());
        let place = bytes.split(|byte| *byte == b'\n').nth(line.saturating_sub(1));
        let found = place.and_then(|line| line.get(column.saturating_sub(1)));
        let found: Vec<u8> = found.into_iter().copied().collect();
        Self::Syntax { found: quoted(&String::from_utf8_lossy(&found)), line, column }
    }
}

/// Describes a value, for the sentence that refuses it.
pub(crate) fn described(value: &Value) -> String {
    match value {
        Value::Array(list) => format!("a list of {}", list.len()),
        Value::Object(_) => "an object".to_owned(),
        other => quoted(&other.to_string()),
    }
}

/// Describes a value that is not a whole number from 0.
pub(crate) fn no_count(value: &Value) -> Option<String> {
    value.as_u64().is_none().then(|| format!("it is {}", described(value)))
}

/// Describes a value that is not a whole number from 0 of 32 bits.
pub(crate) fn no_small_count(value: &Value) -> Option<String> {
    let count = value.as_u64().and_then(|count| u32::try_from(count).ok());
    count.is_none().then(|| format!("it is {}", described(value)))
}

/// Describes a value that may be left out as null, too.
pub(crate) fn or_null(value: &Value, misfit: fn(&Value) -> Option<String>) -> Option<String> {
    if value.is_null() { None } else { misfit(value) }
}

/// Describes a value that is none of the texts that may be chosen.
pub(crate) fn no_choice(value: &Value, choices: &[&str]) -> Option<String> {
    let is_choice = value.as_str().is_some_and(|text| choices.contains(&text));
    (!is_choice).then(|| format!("it is {}", described(value)))
}

/// Describes a value that is not a number.
pub(crate) fn no_number(value: &Value) -> Option<String> {
    (!value.is_number()).then(|| format!("it is {}", described(value)))
}

/// Describes a value that is not a text.
pub(crate) fn no_text(value: &Value) -> Option<String> {
    (!value.is_string()).then(|| format!("it is {}", described(value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: [FieldRule; 2] = [
        FieldRule::required("n", "a count", no_count),
        FieldRule::optional("name", "a text", no_text),
    ];

    #[test]
    fn a_fault_is_one_sentence_about_the_field_that_has_it() {
        for (text, told) in [
            ("", "it is no JSON: it ends in the middle, after 0 bytes"),
            (r#"{"n":1"#, "it is no JSON: it ends in the middle, after 6 bytes"),
            ("{\n\"n\": x}", "it is no JSON: `x` at line 2, column 6 is out of place"),
            ("[1,2]", "it has to be a JSON object with n, name; it is a list of 2"),
            (r#"{"names":"a"}"#, "`names` is not known; did you mean `name`? Known: n, name"),
            (r#"{"zzz":"a"}"#, "`zzz` is not known. Known: n, name"),
            (r#"{"name":"a"}"#, "`n` is missing: a count"),
            (r#"{"n":-1.5}"#, "`n` has to be a count; it is -1.5"),
            (r#"{"n":1,"name":{}}"#, "`name` has to be a text; it is an object"),
        ] {
            let error = serde_json::from_str::<u8>(text).unwrap_err();
            assert_eq!(JsonFault::find(text.as_bytes(), &RULES, &error).to_string(), told);
        }
    }
}
