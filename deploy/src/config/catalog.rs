//! The built-in configurations: one complete, commented TOML file per domain and variant.

use std::collections::BTreeMap;

use anyhow::Context as _;
use toml::Table;

use super::table::overlay;

/// Files that come with the program: name and text.
const BUILT_IN: [(&str, &str); 11] = [
    ("cartpole", include_str!("../../configs/cartpole.toml")),
    ("cue_recall", include_str!("../../configs/cue_recall.toml")),
    ("highway", include_str!("../../configs/highway.toml")),
    ("lander", include_str!("../../configs/lander.toml")),
    ("lander_hard", include_str!("../../configs/lander_hard.toml")),
    ("paper_highway", include_str!("../../configs/paper_highway.toml")),
    ("paper_lander", include_str!("../../configs/paper_lander.toml")),
    ("paper_lander_hard", include_str!("../../configs/paper_lander_hard.toml")),
    ("pilot", include_str!("../../configs/pilot.toml")),
    ("steakhouse", include_str!("../../configs/steakhouse.toml")),
    ("steakhouse_timing", include_str!("../../configs/steakhouse_timing.toml")),
];

/// What a domain of the user's own starts from.
const OWN: &str = include_str!("../../configs/own.toml");

/// One named configuration.
#[derive(Clone, Debug)]
struct Entry {
    /// As its author wrote it.
    text: String,
    /// Whether keys that it leaves out come from [`OWN`].
    over_general: bool,
}

/// The configurations that this program knows by name.
#[derive(Clone, Debug)]
pub struct Catalog {
    entries: BTreeMap<String, Entry>,
}

impl Catalog {
    /// Returns the built-in configurations.
    pub fn built_in() -> Self {
        let entry = |(name, text): (&str, &str)| {
            (name.to_owned(), Entry { text: text.to_owned(), over_general: false })
        };
        Self { entries: BUILT_IN.into_iter().map(entry).collect() }
    }

    /// Adds a domain of the user's own; what `defaults` leaves out comes from the general ones.
    pub fn add(&mut self, domain: &str, defaults: &str) {
        let text = defaults.to_owned();
        self.entries.insert(domain.to_owned(), Entry { text, over_general: true });
    }

    /// Lists the names.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// Returns a configuration as a file of its own: complete, with comments.
    pub fn text(&self, name: &str) -> Option<String> {
        let entry = self.entries.get(name)?;
        if !entry.over_general {
            return Some(entry.text.clone());
        }
        let commented: Vec<String> = OWN.lines().map(|line| format!("# {line}")).collect();
        let rest = "# What is not set above comes from the general defaults:\n#";
        Some(format!("{}\n{rest}\n{}\n", entry.text, commented.join("\n")))
    }

    /// Returns a configuration as its author wrote it, to be read like a person's file.
    pub fn own_text(&self, name: &str) -> Option<&str> {
        self.entries.get(name).map(|entry| entry.text.as_str())
    }

    /// Returns the complete defaults of a domain; `None` if there is no such domain.
    ///
    /// # Errors
    ///
    /// If the defaults of a user's own domain are no TOML.
    pub fn defaults(&self, domain: &str) -> Option<anyhow::Result<Table>> {
        let entry = self.entries.get(domain)?;
        Some(entry.table().with_context(|| format!("the defaults of domain `{domain}`")))
    }
}

impl Entry {
    fn table(&self) -> anyhow::Result<Table> {
        let own: Table = self.text.parse()?;
        if !self.over_general {
            return Ok(own);
        }
        let mut table: Table = OWN.parse()?;
        overlay(&mut table, &own);
        Ok(table)
    }
}

#[cfg(test)]
pub(super) fn built_in_texts() -> Vec<(&'static str, &'static str)> {
    BUILT_IN.to_vec()
}

#[cfg(test)]
pub(super) const GENERAL: &str = OWN;
