//! The built-in configurations: files of commented TOML, each with what differs from its base.
//!
//! ```text
//! general  <-  cartpole, cue_recall, pilot, python, worlds of one's own
//! general  <-  notifier  <-  lander, highway, steakhouse and their variants, notifier tasks of one's own
//! ```

use std::collections::BTreeMap;

use leadtime_proto::text::quoted;
use toml::{Table, Value};

use crate::edit::edited;
use crate::error::{ConfigError, ensure};
use crate::layers::{Layer, word};

/// Files that come with the program: name and text.
const BUILT_IN: [(&str, &str); 17] = [
    ("cartpole", include_str!("../configs/cartpole.toml")),
    ("cue_recall", include_str!("../configs/cue_recall.toml")),
    ("highway", include_str!("../configs/highway.toml")),
    ("highway_conflict", include_str!("../configs/highway_conflict.toml")),
    ("lander", include_str!("../configs/lander.toml")),
    ("lander_hard", include_str!("../configs/lander_hard.toml")),
    ("paper_highway", include_str!("../configs/paper_highway.toml")),
    ("paper_lander", include_str!("../configs/paper_lander.toml")),
    ("paper_lander_hard", include_str!("../configs/paper_lander_hard.toml")),
    ("paper_letter_highway", include_str!("../configs/paper_letter_highway.toml")),
    ("paper_letter_lander", include_str!("../configs/paper_letter_lander.toml")),
    ("paper_letter_lander_hard", include_str!("../configs/paper_letter_lander_hard.toml")),
    ("paper_letter_steakhouse", include_str!("../configs/paper_letter_steakhouse.toml")),
    ("pilot", include_str!("../configs/pilot.toml")),
    ("python", include_str!("../configs/python.toml")),
    ("steakhouse", include_str!("../configs/steakhouse.toml")),
    ("steakhouse_timing", include_str!("../configs/steakhouse_timing.toml")),
];
/// What every configuration starts from.
pub(crate) const GENERAL: &str = "general";
pub(crate) const GENERAL_TEXT: &str = include_str!("../configs/general.toml");
/// What every world with a listener starts from: `general` with the sections `[human]` and `[notifier]`.
const NOTIFIER: &str = "notifier";
const NOTIFIER_TEXT: &str = include_str!("../configs/notifier.toml");
/// Files that are about no domain: bases that cannot be trained on.
const BASES: [(&str, &str); 2] = [(GENERAL, GENERAL_TEXT), (NOTIFIER, NOTIFIER_TEXT)];
/// What a file starts from that names neither a base nor a domain.
const DEFAULT: &str = "lander";
/// How long a chain of bases may be.
const MAX_BASES: usize = 8;

/// The configurations that this program knows by name.
#[derive(Clone, Debug)]
pub struct Catalog {
    texts: BTreeMap<String, String>,
    /// Below the texts of worlds of the user's own: the defaults that their code has.
    defaults: BTreeMap<String, CodeDefaults>,
}

/// The defaults that the code of a domain has.
#[derive(Clone, Debug)]
struct CodeDefaults {
    /// What they stand on.
    base: &'static str,
    text: Result<String, ConfigError>,
}

impl Catalog {
    /// Returns the built-in configurations.
    pub fn built_in() -> Self {
        let texts = BUILT_IN.map(|(name, text)| (name.to_owned(), text.to_owned()));
        Self { texts: texts.into(), defaults: BTreeMap::new() }
    }

    /// Adds a domain of the user's own; what `text` leaves out comes from the general defaults.
    pub fn add(&mut self, domain: &str, text: &str) {
        self.texts.insert(domain.to_owned(), text.to_owned());
    }

    /// Adds the defaults that the code of a domain of the user's own has, by section: they stand between the general ones
    /// and the text of [`Catalog::add`], and are printed with the comments of the keys that every notifier task has.
    ///
    /// A key without a value is left to the domain's builder. A value that TOML cannot write is refused, with its key, where
    /// the domain's configuration is asked for.
    pub fn add_defaults(&mut self, domain: &str, sections: &serde_json::Value) {
        let base = if sections.get("human").is_some() { NOTIFIER } else { GENERAL };
        let text = defaults_text(domain, &without_null(sections));
        self.defaults.insert(domain.to_owned(), CodeDefaults { base, text });
    }

    /// Lists the names of the configurations.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.texts.keys().map(String::as_str)
    }

    /// Finds the full key of a setting by its last part: `learner.learning_rate` for `learning_rate`.
    pub fn key(&self, name: &str) -> Option<String> {
        let bases = BASES.iter().map(|(_, text)| *text);
        let texts = bases.chain(self.texts.values().map(String::as_str));
        let holds = |(section, keys): (String, Value)| {
            let is_there = keys.as_table().is_some_and(|keys| keys.contains_key(name));
            is_there.then(|| format!("{section}.{name}"))
        };
        let mut tables = texts.filter_map(|text| text.parse::<Table>().ok());
        tables.find_map(|table| table.into_iter().find_map(holds))
    }

    /// Returns a configuration as it is written, to be read like a person's file.
    pub fn file(&self, name: &str) -> Option<Layer> {
        let text = self.texts.get(name).map(String::as_str).or_else(|| shared(name))?;
        Some(named(name, text))
    }

    /// Returns the domain that a configuration is about; `None` if there is none of that name.
    pub fn domain(&self, name: &str) -> Option<String> {
        domain_of(&self.chain(name, "domain").ok()?).ok()
    }

    /// Returns a configuration as one complete file, with comments; `None` if there is none of that name.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] if the text of a domain of the user's own is not TOML.
    pub fn text(&self, name: &str) -> Option<Result<String, ConfigError>> {
        self.texts.contains_key(name).then(|| {
            let texts = self.chain(name, "domain")?.into_iter().map(|layer| layer.text);
            Ok(texts.reduce(|below, above| edited(&below, &above)).unwrap_or_default())
        })
    }

    /// Returns a file with everything that it starts from, the most general first; refuses what is not TOML, and an
    /// unknown `base` or `domain`.
    pub(crate) fn with_bases(&self, file: &Layer) -> Result<Vec<Layer>, ConfigError> {
        let table = file.parse()?;
        let at = |error: ConfigError| error.at(&file.place);
        let (base, domain) = (word(&table, "base"), word(&table, "domain"));
        let (base, domain) = (base.map_err(at)?, domain.map_err(at)?);
        let (key, name) = match (base, domain) {
            (Some(base), _) => ("base", base),
            (None, Some(domain)) => ("domain", domain),
            (None, None) => ("domain", DEFAULT),
        };
        let mut layers = self.chain(name, key).map_err(at)?;
        if let (Some(base), Some(domain)) = (base, domain) {
            let about = domain_of(&layers)?;
            let allowed = format!("\"{about}\", which `base` \"{base}\" is about");
            let fits = about == GENERAL || about == domain;
            ensure(fits, "domain", format!("\"{domain}\""), allowed).map_err(at)?;
        }
        layers.push(file.clone());
        Ok(layers)
    }

    /// Returns what a file starts from that names it as its base.
    fn base(&self, name: &str) -> Option<Layer> {
        shared(name).map(|text| named(name, text)).or_else(|| self.file(name))
    }

    /// Returns a configuration of this catalog with everything that it starts from, the most general first.
    ///
    /// A domain of the user's own may have the name of a shared base: what others start from is then still the base.
    fn chain(&self, name: &str, key: &'static str) -> Result<Vec<Layer>, ConfigError> {
        let mut layers: Vec<Layer> = Vec::new();
        let mut next = Some(name.to_owned());
        while let Some(name) = next {
            let is_own = layers.is_empty() && self.texts.contains_key(&name);
            let is_shared = !is_own && shared(&name).is_some();
            let layer = if is_own { self.file(&name) } else { self.base(&name) };
            let Some(layer) = layer else {
                let (name, known) = (quoted(&name), self.names().collect::<Vec<_>>().join(", "));
                return Err(ConfigError(format!("`{key}` is \"{name}\"; allowed: {known}")));
            };
            let base = word(&layer.parse()?, "base")?.map(str::to_owned);
            layers.push(layer);
            let defaults = self.defaults.get(&name).filter(|_| base.is_none() && !is_shared);
            if let Some(CodeDefaults { text, .. }) = defaults {
                layers.push(Layer::text(format!("defaults of `{name}`"), text.clone()?));
            }
            let below = defaults.map_or(GENERAL, |defaults| defaults.base);
            next = base.or_else(|| (!is_shared).then(|| below.to_owned()));
            let n = layers.len();
            ensure(n <= MAX_BASES, "base", format!("the {n}th"), format!("at most {MAX_BASES}"))?;
        }
        layers.reverse();
        Ok(layers)
    }
}

/// Returns the text of a base that is about no domain.
fn shared(name: &str) -> Option<&'static str> {
    BASES.iter().find(|(base, _)| *base == name).map(|(_, text)| *text)
}

/// Makes a layer of a configuration that has a name.
fn named(name: &str, text: &str) -> Layer {
    Layer::text(format!("built-in configuration `{name}`"), text)
}

/// Writes a domain's defaults, by section, as TOML.
fn defaults_text(domain: &str, sections: &serde_json::Value) -> Result<String, ConfigError> {
    let mut text = String::new();
    for (name, section) in sections.as_object().into_iter().flatten() {
        text.extend(["\n[", name, "]\n"]);
        // One line per key, as in the files that it is printed over.
        for (key, value) in section.as_object().into_iter().flatten() {
            let written = Value::try_from(value).map_err(|_unspecific| {
                let (key, value) = (format!("{name}.{key}"), quoted(&value.to_string()));
                let allowed = format!("numbers up to {} and values without null", i64::MAX);
                let place = format!("the code's defaults of `{domain}`");
                ConfigError(format!("`{key}` is {value}; allowed: {allowed}")).at(place)
            })?;
            text.extend([key, " = ", &written.to_string(), "\n"]);
        }
    }
    Ok(text)
}

/// Drops keys without a value, which TOML cannot write.
fn without_null(value: &serde_json::Value) -> serde_json::Value {
    match value {
        serde_json::Value::Object(entries) => {
            let kept = entries.iter().filter(|(_, value)| !value.is_null());
            kept.map(|(key, value)| (key.clone(), without_null(value))).collect()
        }
        serde_json::Value::Array(values) => values.iter().map(without_null).collect(),
        value => value.clone(),
    }
}

/// Returns the domain of the topmost text that names one.
pub(crate) fn domain_of(layers: &[Layer]) -> Result<String, ConfigError> {
    for layer in layers.iter().rev() {
        if let Some(domain) = word(&layer.parse()?, "domain")? {
            return Ok(domain.to_owned());
        }
    }
    Ok(DEFAULT.to_owned())
}
