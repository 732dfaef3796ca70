//! The built-in configurations: a complete, commented TOML file per world, and what variants change in one.

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
/// What every domain without a complete file of its own starts from.
pub(crate) const GENERAL: &str = "general";
pub(crate) const GENERAL_TEXT: &str = include_str!("../configs/general.toml");
/// What a file starts from that names neither a base nor a domain.
const DEFAULT: &str = "lander";
/// Where the sections `[human]` and `[notifier]` are written with their comments. Its listener and its notifier are the general
/// ones, so this is what a world of one's own starts from.
const SPOKEN: &str = include_str!("../configs/lander.toml");
/// How long a chain of bases may be.
const MAX_BASES: usize = 8;

/// The configurations that this program knows by name.
#[derive(Clone, Debug)]
pub struct Catalog {
    texts: BTreeMap<String, String>,
    /// Below the texts of worlds of the user's own: the defaults that their code has, as commented sections.
    defaults: BTreeMap<String, Result<String, ConfigError>>,
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
        let text = defaults_text(domain, &without_null(sections));
        self.defaults.insert(domain.to_owned(), text);
    }

    /// Lists the names.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.texts.keys().map(String::as_str)
    }

    /// Finds the full key of a setting by its last part: `learner.learning_rate` for `learning_rate`.
    pub fn key(&self, name: &str) -> Option<String> {
        let texts = std::iter::once(GENERAL_TEXT).chain(self.texts.values().map(String::as_str));
        let holds = |(section, keys): (String, Value)| {
            let is_there = keys.as_table().is_some_and(|keys| keys.contains_key(name));
            is_there.then(|| format!("{section}.{name}"))
        };
        let mut tables = texts.filter_map(|text| text.parse::<Table>().ok());
        tables.find_map(|table| table.into_iter().find_map(holds))
    }

    /// Returns a configuration as it is written, to be read like a person's file.
    pub fn file(&self, name: &str) -> Option<Layer> {
        let text = if name == GENERAL { GENERAL_TEXT } else { self.texts.get(name)? };
        Some(Layer::text(format!("built-in configuration `{name}`"), text))
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
        if let (Some(base), Some(domain)) = (base.filter(|base| *base != GENERAL), domain) {
            let about = domain_of(&layers)?;
            let allowed = format!("\"{about}\", which `base` \"{base}\" is about");
            ensure(domain == about, "domain", format!("\"{domain}\""), allowed).map_err(at)?;
        }
        layers.push(file.clone());
        Ok(layers)
    }

    /// Returns a configuration of this catalog with everything that it starts from, the most general first.
    fn chain(&self, name: &str, key: &'static str) -> Result<Vec<Layer>, ConfigError> {
        let mut layers: Vec<Layer> = Vec::new();
        let mut next = Some(name.to_owned());
        while let Some(name) = next {
            let Some(layer) = self.file(&name) else {
                let (name, known) = (quoted(&name), self.names().collect::<Vec<_>>().join(", "));
                return Err(ConfigError(format!("`{key}` is \"{name}\"; allowed: {known}")));
            };
            let base = word(&layer.parse()?, "base")?.map(str::to_owned);
            let is_complete = name == GENERAL || BUILT_IN.iter().any(|(known, _)| *known == name);
            layers.push(layer);
            if let Some(defaults) = self.defaults.get(&name).filter(|_| base.is_none()) {
                layers.push(Layer::text(format!("defaults of `{name}`"), defaults.clone()?));
            }
            next = base.or_else(|| (!is_complete).then(|| GENERAL.to_owned()));
            let n = layers.len();
            ensure(n <= MAX_BASES, "base", format!("the {n}th"), format!("at most {MAX_BASES}"))?;
        }
        layers.reverse();
        Ok(layers)
    }
}

/// Writes a domain's defaults, by section, as commented TOML.
fn defaults_text(domain: &str, sections: &serde_json::Value) -> Result<String, ConfigError> {
    let mut text = String::new();
    for (name, section) in sections.as_object().into_iter().flatten() {
        text.extend(["\n[", name, "]\n"]);
        // One line per key, so that each finds its comment.
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
    let below = if sections.get("human").is_some() { spoken() } else { String::new() };
    Ok(edited(&below, &text))
}

/// Returns the sections of the listener and of the notifier, with topics that every domain has.
fn spoken() -> String {
    let sections =
        SPOKEN.split_once("\n[human]\n").and_then(|(_, rest)| rest.split_once("\n[policy]\n"));
    let lines = sections.map_or("", |(sections, _)| sections).lines().map(|line| match line {
        line if line.starts_with("# topics = ") => {
            "# topics = [\"TOPIC\", \"OTHER_TOPIC\"]\n".to_owned()
        }
        line if line.starts_with("# cells = ") => {
            "# cells = [[\"TOPIC\", 2, 2], [\"TOPIC\", 2, 4]]\n".to_owned()
        }
        line if line.starts_with("# reasons = ") => {
            "# reasons = [[\"TOPIC\", 2, 4, 0.5]]\n".to_owned()
        }
        line => format!("{line}\n"),
    });
    format!("\n[human]\n{}", lines.collect::<String>())
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
fn domain_of(layers: &[Layer]) -> Result<String, ConfigError> {
    for layer in layers.iter().rev() {
        if let Some(domain) = word(&layer.parse()?, "domain")? {
            return Ok(domain.to_owned());
        }
    }
    Ok(DEFAULT.to_owned())
}
