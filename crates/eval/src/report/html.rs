//! The page around the sections.

use leadtime_table::escape;

use super::contents::Report;
use super::sections;
use crate::draw::Ink;

const STYLE: &str = include_str!("style.css");

impl Report {
    /// Writes the page.
    ///
    /// # Example
    ///
    /// ```
    /// let report = leadtime_eval::report::Report {
    ///     title: "A run".to_owned(),
    ///     lead: "Success <always>.".to_owned(),
    ///     ..Default::default()
    /// };
    /// let page = report.html();
    /// assert!(page.starts_with("<!DOCTYPE html>") && page.contains("Success &lt;always&gt;."));
    /// ```
    pub fn html(&self) -> String {
        let body = [
            sections::verdicts(self),
            sections::notes(self),
            sections::pictures(self),
            sections::comparison(self),
            sections::training(self),
            sections::system(self),
            sections::provenance(self),
            sections::settings(self),
        ];
        page(&self.title, &sections::prose(&self.lead), &body.concat())
    }
}

/// Writes a page that needs no other file; `lead` and `body` are markup.
pub(super) fn page(title: &str, lead: &str, body: &str) -> String {
    let title = escape(title);
    let lead =
        if lead.is_empty() { String::new() } else { format!("<p class=\"lead\">{lead}</p>\n") };
    let dark = format!("@media (prefers-color-scheme: dark) {{\n{}\n}}\n", Ink::dark_css());
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <title>{title}</title>\n<style>\n{STYLE}{dark}</style>\n</head>\n<body>\n<main>\n<header>\n\
         <h1>{title}</h1>\n{lead}</header>\n{body}</main>\n</body>\n</html>\n",
    )
}

#[cfg(test)]
#[path = "html_tests.rs"]
mod tests;
