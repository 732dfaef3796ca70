//! TOML that is not nested too deeply: reading or dropping what is exhausts the stack.

use std::mem::ManuallyDrop;
use std::ops::Range;

use toml::de::{DeTable, DeValue, Error};

/// How deep tables and lists may be nested; no setting needs more than five levels.
const MAX_DEPTH: usize = 32;

/// A refused text: the bytes that it is about, and why.
pub(crate) type Refused = (Option<Range<usize>>, String);

/// Parses a text that is TOML and not nested too deeply.
pub(crate) fn table(text: &str) -> Result<DeTable<'_>, Refused> {
    let (table, errors) = DeTable::parse_recoverable(text);
    let table = ManuallyDrop::new(table.into_inner());
    let mut entries = table.iter();
    if let Some((key, _)) = entries.find(|(_, value)| is_deep(value.get_ref(), MAX_DEPTH - 1)) {
        return Err((Some(key.span()), too_deep()));
    }
    let table = ManuallyDrop::into_inner(table);
    let refused = |error: &Error| Err((error.span(), error.message().to_owned()));
    errors.first().map_or(Ok(table), refused)
}

/// Refuses a single value that is nested too deeply, whether it is TOML or not.
pub(crate) fn check_value(text: &str) -> Result<(), String> {
    let (value, _errors) = DeValue::parse_recoverable(text);
    let value = ManuallyDrop::new(value);
    if is_deep(value.get_ref(), MAX_DEPTH) {
        return Err(too_deep());
    }
    drop(ManuallyDrop::into_inner(value));
    Ok(())
}

fn too_deep() -> String {
    format!("nested too deeply; allowed: at most {MAX_DEPTH} levels")
}

/// Tells whether a value has more than `levels` levels, without going deeper than these.
fn is_deep(value: &DeValue<'_>, levels: usize) -> bool {
    let deeper = |value: &DeValue<'_>| levels == 0 || is_deep(value, levels - 1);
    match value {
        DeValue::Table(table) => table.values().any(|value| deeper(value.get_ref())),
        DeValue::Array(values) => values.iter().any(|value| deeper(value.get_ref())),
        _ => false,
    }
}
