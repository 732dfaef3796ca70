//! Numbers that are none: TOML can write `nan` and `inf`, and no setting has a use for them.
//!
//! They are refused before anything is made of them, because JSON, in which actors get their task, has no such number.

use anyhow::bail;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// Refuses a text with a number that is not finite.
///
/// # Errors
///
/// Line, key and value of the first one. A text that is no TOML is somebody else's to refuse.
pub fn check_text(text: &str) -> anyhow::Result<()> {
    let Ok(table) = DeTable::parse(text) else { return Ok(()) };
    let Some((key, at, number)) = in_text("", table.get_ref()) else { return Ok(()) };
    let before = text.get(..at).unwrap_or_default();
    let line = before.bytes().filter(|byte| *byte == b'\n').count() + 1;
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

/// Finds the first such number in a text: its key, the byte it begins at, itself.
fn in_text(prefix: &str, table: &DeTable<'_>) -> Option<(String, usize, String)> {
    table.iter().find_map(|(name, value)| in_text_value(&join(prefix, name.get_ref()), value))
}

fn in_text_value(key: &str, value: &Spanned<DeValue<'_>>) -> Option<(String, usize, String)> {
    match value.get_ref() {
        DeValue::Float(number) => {
            let text = number.as_str();
            let finite = text.parse::<f64>().is_ok_and(f64::is_finite);
            (!finite).then(|| (key.to_owned(), value.span().start, text.to_owned()))
        }
        DeValue::Array(values) => values.iter().find_map(|value| in_text_value(key, value)),
        DeValue::Table(table) => in_text(key, table),
        _ => None,
    }
}

fn in_table(prefix: &str, table: &Table) -> Option<(String, f64)> {
    table.iter().find_map(|(name, value)| in_value(&join(prefix, name), value))
}

fn in_value(key: &str, value: &Value) -> Option<(String, f64)> {
    match value {
        Value::Float(number) => (!number.is_finite()).then(|| (key.to_owned(), *number)),
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
        let fine = "a = 1.5e300\nb = \"nan\"\n[c]\ninf = [1, 2]";
        check_text(fine).unwrap();
        check(&fine.parse().unwrap()).unwrap();
    }
}
