//! Numbers that no setting can have: TOML can write `nan` and `inf`, and whole numbers longer than any type.
//!
//! They are refused before anything is made of them, because JSON, in which actors get their task, has no such number.

use anyhow::bail;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// Refuses a text with a number that is not finite, or a whole number that is too large.
///
/// # Errors
///
/// Line, key and value of the first one. A text that is no TOML is somebody else's to refuse.
pub fn check_text(text: &str) -> anyhow::Result<()> {
    let Ok(table) = DeTable::parse(text) else { return Ok(()) };
    let Some((key, value)) = in_text("", table.get_ref()) else { return Ok(()) };
    let before = text.get(..value.span().start).unwrap_or_default();
    let line = before.bytes().filter(|byte| *byte == b'\n').count() + 1;
    let number = text.get(value.span()).unwrap_or_default();
    if value.get_ref().is_integer() {
        bail!("line {line}: `{key}` is {number}; allowed: whole numbers up to {}", i64::MAX);
    }
    bail!("line {line}: `{key}` is {number}; allowed: a finite number")
}

/// Refuses a table with a number that is not finite.
///
/// # Errors
///
/// Key and value of the first one.
pub fn check(table: &Table) -> anyhow::Result<()> {
    match in_table("", table) {
        Some((key, number)) => bail!("`{key}` is {number}; allowed: a finite number"),
        None => Ok(()),
    }
}

/// A key and its value with its place in the text.
type Found<'a, 'i> = (String, &'a Spanned<DeValue<'i>>);

/// Finds the first such number in a text.
fn in_text<'a, 'i>(prefix: &str, table: &'a DeTable<'i>) -> Option<Found<'a, 'i>> {
    table.iter().find_map(|(name, value)| in_text_value(&join(prefix, name.get_ref()), value))
}

fn in_text_value<'a, 'i>(key: &str, value: &'a Spanned<DeValue<'i>>) -> Option<Found<'a, 'i>> {
    match value.get_ref() {
        DeValue::Float(number) => {
            let finite = number.as_str().parse::<f64>().is_ok_and(f64::is_finite);
            (!finite).then(|| (key.to_owned(), value))
        }
        DeValue::Integer(number) => {
            let fits = i64::from_str_radix(number.as_str(), number.radix()).is_ok();
            (!fits).then(|| (key.to_owned(), value))
        }
        DeValue::Array(values) => values.iter().find_map(|value| in_text_value(key, value)),
        DeValue::Table(table) => in_text(key, table),
        _ => None,
    }
}

/// Finds the first such number in a table: its key, and itself as TOML writes it.
fn in_table(prefix: &str, table: &Table) -> Option<(String, String)> {
    table.iter().find_map(|(name, value)| in_value(&join(prefix, name), value))
}

fn in_value(key: &str, value: &Value) -> Option<(String, String)> {
    match value {
        Value::Float(number) => (!number.is_finite()).then(|| (key.to_owned(), value.to_string())),
        Value::Array(values) => values.iter().find_map(|value| in_value(key, value)),
        Value::Table(table) => in_table(key, table),
        _ => None,
    }
}

fn join(prefix: &str, name: &str) -> String {
    if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_is_none_is_told_by_key_and_line_wherever_it_hides() {
        for (text, expected) in [
            ("a = 1.0\n[b]\nc = nan", "line 3: `b.c` is nan; allowed: a finite number"),
            ("[b]\nc = [1.0, -inf]", "line 2: `b.c` is -inf; allowed: a finite number"),
            ("[b]\n\nc = [{ d = inf }]", "line 3: `b.c.d` is inf; allowed: a finite number"),
        ] {
            assert_eq!(check_text(text).unwrap_err().to_string(), expected);
            let table = check(&text.parse().unwrap()).unwrap_err().to_string();
            assert_eq!(format!("{}: {table}", expected.split(':').next().unwrap()), expected);
        }
        let long = check_text("a = 9223372036854775808").unwrap_err().to_string();
        assert_eq!(
            long,
            "line 1: `a` is 9223372036854775808; allowed: whole numbers up to 9223372036854775807"
        );
        check_text("a = -9_000\nb = 0xff\nc = +1").unwrap();
        let fine = "a = 1.5e300\nb = \"nan\"\n[c]\ninf = [1, 2]";
        check_text(fine).unwrap();
        check(&fine.parse().unwrap()).unwrap();
    }
}
