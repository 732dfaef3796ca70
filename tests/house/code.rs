//! Our sources, and what of them is neither comment nor test.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Folders that hold our Rust sources.
const FOLDERS: &[&str] = &[
    "crates", "python", "proto", "sims", "actor", "learner", "deploy", "tests", "examples", "bench",
];
/// What stands before something that only tests have.
const TEST: &str = "#[cfg(test)]";

/// A source file, and what of it is neither comment nor test.
pub(crate) struct Source {
    pub(crate) path: PathBuf,
    pub(crate) text: String,
    pub(crate) code: String,
}

impl Source {
    pub(crate) fn is_test(&self) -> bool {
        let name = self.path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        name.ends_with("tests") || self.path.iter().any(|part| part == "tests")
    }

    /// Returns whether it is part of a library or of the program: no test, bench or example.
    pub(crate) fn is_product(&self) -> bool {
        !self.is_test() && self.path.iter().any(|part| part == "src")
    }

    /// Returns whether a script wrote it: its first line says which.
    pub(crate) fn is_generated(&self) -> bool {
        let first = self.text.lines().next().unwrap_or_default();
        !first.starts_with("//!") && first.contains(".py")
    }
}

pub(crate) fn root() -> PathBuf {
    let deploy = Path::new(env!("CARGO_MANIFEST_DIR"));
    deploy.parent().expect("deploy lies in the repository").to_owned()
}

/// Returns all of our sources, which are read once.
pub(crate) fn all_sources() -> &'static [Source] {
    static ALL: LazyLock<Vec<Source>> =
        LazyLock::new(|| FOLDERS.iter().flat_map(|folder| read(&root().join(folder))).collect());
    &ALL
}

/// Lists the sources below a folder.
pub(crate) fn sources(folder: &Path) -> impl Iterator<Item = &'static Source> + use<> {
    let folder = folder.to_owned();
    all_sources().iter().filter(move |source| source.path.starts_with(&folder))
}

fn read(folder: &Path) -> Vec<Source> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(directory) = open.pop() {
        let Ok(entries) = fs::read_dir(&directory) else { continue };
        for entry in entries {
            let path = entry.expect("directory can be listed").path();
            if path.is_dir() && !path.ends_with("target") {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("sources are text");
                let code = code_of(&text);
                found.push(Source { path, text, code });
            }
        }
    }
    found
}

/// Drops comments and whatever only tests have, wherever it stands.
fn code_of(text: &str) -> String {
    let (mut code, mut rest) = (String::with_capacity(text.len()), text);
    while !rest.is_empty() {
        if let Some(item) = rest.strip_prefix(TEST) {
            rest = after_item(item);
            continue;
        }
        let (piece, after) = rest.split_at(piece_len(rest));
        if !piece.starts_with("//") && !piece.starts_with("/*") {
            code += piece;
        }
        rest = after;
    }
    code
}

/// Returns what follows an item, attributes before it included: it ends with its body or with a semicolon.
fn after_item(text: &str) -> &str {
    let (mut rest, mut depth) = (text, 0_i32);
    while !rest.is_empty() {
        let (piece, after) = rest.split_at(piece_len(rest));
        depth += match piece {
            "{" | "(" | "[" => 1,
            "}" | ")" | "]" => -1,
            _ => 0,
        };
        match (depth, piece) {
            // What is inside of something ends with it.
            (..0, _) => return rest,
            (0, "}" | ";") => return after,
            _ => rest = after,
        }
    }
    rest
}

/// Returns the length of the comment, literal, word or character that a text begins with.
fn piece_len(text: &str) -> usize {
    let from = |start: usize, end: &str| {
        text[start..].find(end).map_or(text.len(), |at| start + at + end.len())
    };
    let first = text.chars().next().expect("there is text");
    let word = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    match first {
        '/' if text.starts_with("//") => text.find('\n').unwrap_or(text.len()),
        '/' if text.starts_with("/*") => from(2, "*/"),
        '"' => string_len(text),
        // A character, unless it is a lifetime.
        '\'' if text.starts_with("'\\") => from(3, "'"),
        '\'' => {
            let inside = text[1..].chars().next().map_or(0, char::len_utf8);
            if text[1 + inside..].starts_with('\'') { inside + 2 } else { 1 }
        }
        _ if word == 0 => first.len_utf8(),
        _ => {
            let (prefix, after) = text.split_at(word);
            let hashes = after.len() - after.trim_start_matches('#').len();
            let is_raw = prefix.ends_with('r') && prefix.len() <= 2;
            if is_raw && after[hashes..].starts_with('"') {
                from(word + hashes + 1, &format!("\"{}", &after[..hashes]))
            } else {
                word
            }
        }
    }
}

/// Returns the length of the string that a text begins with.
fn string_len(text: &str) -> usize {
    let mut is_escaped = false;
    let end = text[1..].find(|c: char| {
        let is_end = c == '"' && !is_escaped;
        is_escaped = c == '\\' && !is_escaped;
        is_end
    });
    end.map_or(text.len(), |at| at + 2)
}

#[test]
fn code_is_what_is_neither_comment_nor_test_wherever_that_stands() {
    let text = r##"
//! Head.
use a::B; // why
#[cfg(test)]
pub(super) const C: [u8; 3] = [1, 2, 3];
fn d<'a>(x: &'a str) -> char { /* } */ '}' }
impl E {
    #[cfg(test)]
    fn f(&self) -> String { format!("}}{}", r#"}"#) }
    fn g(&self) -> &str { "// no comment" }
}
#[cfg(test)]
#[path = "h.rs"]
mod h;
#[cfg(test)]
mod tests {
    const I: &str = "}";
}
fn j() { '\'' }
"##;
    let code = code_of(text);
    for kept in ["use a::B; ", "fn d<'a>(x: &'a str)", "fn g(&self) -> &str { \"// no", "fn j()"] {
        assert!(code.contains(kept), "{kept}: {code}");
    }
    for gone in ["Head", "why", "const C", "fn f", "mod h", "const I", "cfg(test)"] {
        assert!(!code.contains(gone), "{gone}: {code}");
    }
}
