//! The databases that come with the crate, one per domain.

use crate::database::Taxonomy;
use crate::error::TaxonomyError;

/// The shipped databases: domain, and the file's text.
const FILES: [(&str, &str); 3] = [
    ("highway", include_str!("../data/highway/taxonomy.toml")),
    ("lander", include_str!("../data/lander/taxonomy.toml")),
    ("steakhouse", include_str!("../data/steakhouse/taxonomy.toml")),
];

/// Names the domains that have a database.
pub fn domains() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(domain, _)| *domain)
}

/// Returns a shipped database as the text that it is.
pub fn text(domain: &str) -> Option<&'static str> {
    FILES.iter().find(|(name, _)| *name == domain).map(|(_, text)| *text)
}

/// Reads the shipped database of a domain.
///
/// # Errors
///
/// [`TaxonomyError`] if no database is shipped for the domain.
pub fn shipped(domain: &str) -> Result<Taxonomy, TaxonomyError> {
    let missing = || {
        let known = domains().collect::<Vec<_>>().join(", ");
        TaxonomyError(format!("there are no shipped utterances for `{domain}`; shipped: {known}"))
    };
    Taxonomy::from_toml(text(domain).ok_or_else(missing)?)
}
