//! Texts laid over each other, and where each value of the result was written.
//!
//! ```text
//! base of the base  <-  base  <-  the person's file  <-  --set, --seed, --name, --runs
//! ```
//!
//! The result is one table whose values remember their place: the [`Layer`] and the bytes in it. It is read into typed
//! structs once, and an error still shows the line of the file, or names the option, that it is about.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue, Deserializer, Error};
use toml::{Spanned, Table, Value};

use leadtime_proto::text::{escaped, printable, quoted};
use leadtime_proto::wording::{kind, worded};

use crate::error::{ConfigError, ensure};
use crate::nesting::{self, Refused};
use crate::overrides::Override;

/// Positions of the i-th layer begin at i times this, so that one number says layer and byte.
const STRIDE: usize = 1 << 40;
/// The one table inside a section that is a section itself: `[evaluation.world]`.
const SUBSECTION: &str = "world";
/// The section that [`SUBSECTION`] is in.
const EVALUATION: &str = "evaluation";
/// The table inside a section whose keys are a user's own, and no choices: `world.env`.
const OPEN: &str = "env";
/// The key that names what a file starts from.
pub(crate) const BASE: &str = "base";
/// The key that names what a configuration is about.
const DOMAIN: &str = "domain";
/// Characters of a line that are shown on each side of an error.
const SHOWN: usize = 60;

/// One text of a configuration: a file, a part of a study, or an option of the command line.
#[derive(Clone, Debug)]
pub struct Layer {
    pub(crate) place: String,
    pub(crate) text: String,
    /// An option is short enough to be named without its line.
    change: Option<Override>,
    /// Whole numbers that the text writes as fractions (`1e6`), by their position.
    whole: BTreeMap<usize, String>,
}

impl Layer {
    /// Makes a layer of a whole text; `place` names it in messages.
    pub fn text(place: impl Into<String>, text: impl Into<String>) -> Self {
        let (place, text) = (place.into(), text.into());
        Self { place, text, change: None, whole: BTreeMap::new() }
    }

    /// Makes a layer of a table.
    pub fn table(place: impl Into<String>, table: &Table) -> Self {
        Self::text(place, table.to_string())
    }

    /// Makes a layer of `--set section.key=value`, or of the option that gave the change.
    pub fn set(change: &Override) -> Self {
        Self::option(format!("{} {}", change.option, quoted(&change.key())), change)
    }

    /// Makes a layer of another option of the command line, which stands for a change of one key.
    pub fn option(option: impl Into<String>, change: &Override) -> Self {
        Self { change: Some(change.clone()), ..Self::text(option, change.to_string()) }
    }

    /// Returns the domain that an option of the command line asks for, if the layer is one that does.
    pub(crate) fn asked_domain(&self) -> Option<&Value> {
        let change = self.change.as_ref()?;
        (change.key() == DOMAIN).then_some(&change.value)
    }

    /// Reads the text on its own; refuses what is not TOML, or nested too deeply.
    pub(crate) fn parse(&self) -> Result<DeTable<'_>, ConfigError> {
        nesting::table(&self.text).map_err(|(span, message)| self.refuse(span, &message))
    }

    /// Describes an error in this text: for a file with its line and a caret.
    fn refuse(&self, span: Option<Range<usize>>, message: &str) -> ConfigError {
        let message = printable(message).replace('\n', ", ");
        let text = match span {
            Some(span) if self.change.is_none() => {
                format!("TOML parse error at {}{message}", pointed(&self.text, span))
            }
            _ => message,
        };
        ConfigError(text).at(&self.place)
    }
}

/// Shows the line of an error, with a caret below it.
fn pointed(text: &str, span: Range<usize>) -> String {
    let start = text.floor_char_boundary(span.start.min(text.len()));
    let end = text.floor_char_boundary(span.end.clamp(start, text.len()));
    let begin = text[..start].rfind('\n').map_or(0, |at| at + 1);
    let line = text[..start].matches('\n').count() + 1;
    let before: Vec<char> = text[begin..start].chars().collect();
    let rest = text[start..].lines().next().unwrap_or_default();
    let column = before.len() + 1;
    let shown: String = before[before.len().saturating_sub(SHOWN)..].iter().collect();
    let (shown, rest) = (escaped(&shown), escaped(&rest.chars().take(SHOWN).collect::<String>()));
    let n_marked = text[start..end].lines().next().unwrap_or_default().chars().count();
    let (gutter, indent) = (" ".repeat(line.to_string().len()), " ".repeat(shown.chars().count()));
    let marks = "^".repeat(n_marked.clamp(1, SHOWN));
    format!(
        "line {line}, column {column}\n{gutter} |\n{line} | {shown}{rest}\n{gutter} | {indent}{marks}\n"
    )
}

/// The result of laying texts over each other.
#[derive(Debug)]
pub(crate) struct Layers<'a> {
    layers: Vec<&'a Layer>,
    pub(crate) table: DeTable<'a>,
}

impl<'a> Layers<'a> {
    /// Lays every layer over those before it: sections are merged key by key, everything else is replaced.
    ///
    /// Inside a section a table with one key stands for a choice (`{ fixed = 2 }`), so another choice replaces it whole. What
    /// changes for the evaluation is a choice where the same table of the world has one key.
    /// Refuses what is not TOML, a number that no setting can have, a list in place of a section, and an option that names a base.
    pub(crate) fn merge(layers: &'a mut [Layer]) -> Result<Self, ConfigError> {
        let mut merged = Self { layers: Vec::new(), table: DeTable::new() };
        for (i, layer) in layers.iter_mut().enumerate() {
            if let Some(fitted) = layer.change.as_ref().and_then(|change| merged.fitted(change)) {
                layer.text = fitted.to_string();
            }
            if layer.change.is_some() && layer.parse()?.contains_key(BASE) {
                return Err(layer.refuse(
                    None,
                    "what a configuration starts from is named in its file, or by `-c`",
                ));
            }
            let mut whole = BTreeMap::new();
            whole_numbers(&merged.table, &layer.parse()?, &mut whole);
            layer.whole = whole;
            let layer: &'a Layer = layer;
            merged.layers.push(layer);
            let world = merged.table.get(SUBSECTION).cloned();
            let beside = beside_evaluation(world);
            let place = OverlayPlace { is_root: true, is_open: false, beside: Some(&beside) };
            let placed = placed_table(layer.parse()?, "", layer, i * STRIDE);
            let laid = placed.and_then(|table| overlay(&mut merged.table, table, place));
            laid.map_err(|(span, message)| merged.refuse(span, &message))?;
        }
        merged.table.remove(BASE);
        Ok(merged)
    }

    /// Returns whether one of the layers is a change that this option of the command line gave.
    pub(crate) fn are_changed_by(&self, option: &str) -> bool {
        let mut changes = self.layers.iter().filter_map(|layer| layer.change.as_ref());
        changes.any(|change| change.option == option)
    }

    /// Writes an option's number as the layers below do: `1` where they hold a fraction, `1e6` where a whole number.
    fn fitted(&self, change: &Override) -> Option<Override> {
        let (first, rest) = change.path.split_first()?;
        let first = self.table.get(first.as_str())?.get_ref();
        let mut rest = rest.iter();
        let below =
            rest.try_fold(first, |at, part| Some(at.as_table()?.get(part.as_str())?.get_ref()))?;
        let value = match (&change.value, below) {
            (Value::Integer(n), DeValue::Float(_)) => Value::Float(*n as f64),
            (Value::Float(x), DeValue::Integer(_)) if is_whole(*x) => Value::Integer(*x as i64),
            _ => return None,
        };
        Some(Override { value, ..change.clone() })
    }

    /// Lays one part of the result over another; refuses a list in place of a section. Both are changes of what lies beside
    /// them, if that is given.
    pub(crate) fn overlay(
        &self,
        base: &mut DeTable<'a>,
        over: DeTable<'a>,
        beside: Option<&DeTable<'a>>,
    ) -> Result<(), ConfigError> {
        let laid = overlay(base, over, OverlayPlace { is_root: false, is_open: false, beside });
        laid.map_err(|(span, message)| self.refuse(span, &message))
    }

    /// Reads a part of the result into its type; refuses an unknown key or a wrong type, with the place where it was
    /// written and what is allowed.
    pub(crate) fn read<T: DeserializeOwned>(&self, table: DeTable<'a>) -> Result<T, ConfigError> {
        // A section that is missing is one that the domain needs.
        let domain = self.table.get(DOMAIN).map_or(0..0, Spanned::span);
        T::deserialize(Deserializer::from(Spanned::new(domain, table)))
            .map_err(|error: Error| self.refuse(error.span(), &worded(error.message())))
    }

    /// Describes an error at a position of the result, in the layer where it was written.
    pub(crate) fn refuse(&self, span: Option<Range<usize>>, message: &str) -> ConfigError {
        let Some(span) = span else { return ConfigError(printable(message)) };
        let (layer, start) = (span.start / STRIDE, span.start % STRIDE);
        self.layers[layer].refuse(Some(start..start + span.len()), message)
    }
}

/// Reads a value of texts that are laid over each other.
///
/// # Errors
///
/// [`ConfigError`] with the place of what is unknown or of the wrong type, and what is allowed.
pub fn read<T: DeserializeOwned>(
    layers: impl IntoIterator<Item = Layer>,
) -> Result<T, ConfigError> {
    let mut layers: Vec<Layer> = layers.into_iter().collect();
    let layers = Layers::merge(&mut layers)?;
    layers.read(layers.table.clone())
}

/// Returns the value of a top-level key, if there is one; refuses what is not text.
pub(crate) fn word<'t>(table: &'t DeTable<'_>, key: &str) -> Result<Option<&'t str>, ConfigError> {
    let Some(value) = table.get(key).map(Spanned::get_ref) else { return Ok(None) };
    ensure(value.is_str(), key, kind(value.type_str()), "a name in quotes")?;
    Ok(value.as_str())
}

/// Tells whether a number is a whole one that no digit of was lost.
fn is_whole(x: f64) -> bool {
    x.fract() == 0.0 && x.abs() < 1e15
}

/// Finds the fractions of a text that are whole numbers, where the layers below hold a whole number.
fn whole_numbers(below: &DeTable<'_>, above: &DeTable<'_>, found: &mut BTreeMap<usize, String>) {
    for (key, value) in above {
        match (below.get(key.get_ref().as_ref()).map(Spanned::get_ref), value.get_ref()) {
            (Some(DeValue::Table(below)), DeValue::Table(above)) => {
                whole_numbers(below, above, found);
            }
            (Some(DeValue::Integer(_)), DeValue::Float(x)) => {
                let whole = x.as_str().parse().ok().filter(|x| is_whole(*x));
                found.extend(whole.map(|x| (value.span().start, (x as i64).to_string())));
            }
            _ => {}
        }
    }
}

/// Where one table is laid over another.
#[derive(Clone, Copy, Debug)]
struct OverlayPlace<'t, 'a> {
    is_root: bool,
    /// Whether its keys, and those of the tables in it, are a user's own.
    is_open: bool,
    /// The whole table of which both are changes, if there is one: how many keys these have tells nothing.
    beside: Option<&'t DeTable<'a>>,
}

impl OverlayPlace<'_, '_> {
    /// Returns the place of a table that has this name here.
    fn below(self, name: &str) -> Self {
        let beside = self.beside.and_then(|beside| beside.get(name)?.get_ref().as_table());
        Self { is_root: false, is_open: self.is_open || name == OPEN, beside }
    }

    /// Returns whether a table here that lies over another stands for another choice than it.
    fn is_other_choice(self, below: &DeTable<'_>, above: &DeTable<'_>) -> bool {
        let may_choose = !self.is_open && self.beside.is_none_or(|beside| beside.len() == 1);
        let is_other = below.keys().next() != above.keys().next();
        may_choose && below.len() == 1 && above.len() == 1 && is_other
    }
}

/// Puts the world that is trained in where its changes for the evaluation lie.
fn beside_evaluation(world: Option<Spanned<DeValue<'_>>>) -> DeTable<'_> {
    let mut table = DeTable::new();
    if let Some(world) = world {
        let section = DeTable::from_iter([(Spanned::new(0..0, SUBSECTION.into()), world)]);
        let section = Spanned::new(0..0, DeValue::Table(section));
        table.insert(Spanned::new(0..0, EVALUATION.into()), section);
    }
    table
}

fn overlay<'a>(
    base: &mut DeTable<'a>,
    over: DeTable<'a>,
    place: OverlayPlace<'_, 'a>,
) -> Result<(), Refused> {
    let is_root = place.is_root;
    for (key, value) in over {
        let (name, span) = (key.get_ref().clone(), value.span());
        let is_table = value.get_ref().is_table();
        let inside = place.below(&name);
        match (base.get_mut(name.as_ref()).map(Spanned::get_mut), value.into_inner()) {
            (Some(DeValue::Table(below)), DeValue::Table(above))
                if is_root
                    || name == SUBSECTION
                    || name == OPEN
                    || !inside.is_other_choice(below, &above) =>
            {
                overlay(below, above, inside)?;
                // An error of the merged section as a whole is blamed on the text that wrote to it last.
                let merged = DeValue::Table(std::mem::take(below));
                drop(base.insert(key, Spanned::new(span, merged)));
            }
            (Some(DeValue::Table(below)), above) if !is_table && (is_root || above.is_array()) => {
                // Not all of them: those that may be left out are not here.
                let key = below.keys().next();
                let such = key.map(|key| format!(", such as `{key}`")).unwrap_or_default();
                let kind = kind(above.type_str());
                let message = format!("`{name}` is a section, not {kind}: set its keys{such}");
                return Err((Some(span), message));
            }
            (_, above) => drop(base.insert(key, Spanned::new(span, above))),
        }
    }
    Ok(())
}

/// Moves every position of a table by the layer's, makes its whole numbers such, and checks what no type would.
fn placed_table<'a>(
    table: DeTable<'a>,
    path: &str,
    layer: &'a Layer,
    by: usize,
) -> Result<DeTable<'a>, Refused> {
    let entry = |(key, value): (Spanned<_>, _)| {
        let (span, name) = (key.span(), key.into_inner());
        let path = if path.is_empty() { format!("{name}") } else { format!("{path}.{name}") };
        let value = placed(value, &path, layer, by)?;
        Ok((Spanned::new(span.start + by..span.end + by, name), value))
    };
    table.into_iter().map(entry).collect()
}

fn placed<'a>(
    value: Spanned<DeValue<'a>>,
    path: &str,
    layer: &'a Layer,
    by: usize,
) -> Result<Spanned<DeValue<'a>>, Refused> {
    let whole = layer.whole.get(&value.span().start);
    let whole = whole.and_then(|text| DeValue::parse(text).ok()).map(Spanned::into_inner);
    let span = value.span().start + by..value.span().end + by;
    let refuse = |given: &str, allowed: &str| {
        Err((Some(span.clone()), format!("`{}` is {given}; allowed: {allowed}", quoted(path))))
    };
    let inner = match whole.unwrap_or(value.into_inner()) {
        DeValue::Table(table) => DeValue::Table(placed_table(table, path, layer, by)?),
        DeValue::Array(values) => DeValue::Array(
            values
                .into_iter()
                .map(|value| placed(value, path, layer, by))
                .collect::<Result<_, _>>()?,
        ),
        // JSON, in which actors get their task, has none of these.
        DeValue::Float(x) if !x.as_str().parse().is_ok_and(f64::is_finite) => {
            return refuse(x.as_str(), "a finite number");
        }
        DeValue::Datetime(date) => {
            return refuse(&date.to_string(), "a date as text in quotes only");
        }
        DeValue::Integer(n) if i64::from_str_radix(n.as_str(), n.radix()).is_err() => {
            return refuse(&quoted(n.as_str()), &format!("whole numbers up to {}", i64::MAX));
        }
        other => other,
    };
    Ok(Spanned::new(span, inner))
}
