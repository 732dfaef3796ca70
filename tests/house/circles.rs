//! Which file of a crate needs which, through re-exports too, and that none needs itself.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::code::{root, sources};

/// A module's path inside its crate; the crate's root is empty.
type Module = Vec<String>;

/// The files of a crate, and the names that each brings in.
#[derive(Default)]
struct Crate {
    modules: BTreeSet<Module>,
    /// What a name means that a file imports, for itself or for others.
    imported: BTreeMap<(Module, String), Module>,
}

#[test]
fn no_file_of_a_crate_needs_itself_through_others() {
    let mut circles = Vec::new();
    for folder in crate::crate_folders() {
        let src = root().join(&folder).join("src");
        let files: Vec<(Module, bool, &str)> = sources(&src)
            .filter(|source| !source.is_test())
            .map(|source| (module_of(&source.path, &src), is_door(&source.path), &*source.code))
            .collect();
        let found = circles_among(&arrows(&files));
        circles.extend(found.iter().map(|circle| format!("{folder}: {}", circle.join(", "))));
    }
    assert_eq!(circles, [""; 0], "files that need each other");
}

/// Returns whether a file is the door of its folder: `lib.rs`, `mod.rs`.
fn is_door(path: &Path) -> bool {
    path.ends_with("lib.rs") || path.ends_with("mod.rs")
}

/// Returns the module that a file holds: `a/b.rs` and `a/b/mod.rs` are `a::b`.
fn module_of(path: &Path, src: &Path) -> Module {
    let inside = path.strip_prefix(src).expect("inside").with_extension("");
    let mut module: Module =
        inside.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if module.last().is_some_and(|last| matches!(last.as_str(), "mod" | "lib" | "main")) {
        module.pop();
    }
    module
}

/// Returns which file needs which.
fn arrows(files: &[(Module, bool, &str)]) -> BTreeSet<(Module, Module)> {
    let modules = files.iter().map(|(module, ..)| module.clone()).collect();
    let mut known = Crate { modules, imported: BTreeMap::new() };
    for (from, _, code) in files {
        for (name, path, _) in known.uses(code, from) {
            known.imported.insert((from.clone(), name), path);
        }
    }
    let mut arrows = BTreeSet::new();
    for (from, is_door, code) in files {
        for path in known.paths(code, from, *is_door) {
            let to = known.home(&path, 0);
            if to != *from {
                arrows.insert((from.clone(), to));
            }
        }
    }
    arrows
}

impl Crate {
    /// Lists the names of this crate that a file imports: each with its path, and whether it is handed on.
    fn uses(&self, code: &str, from: &Module) -> Vec<(String, Module, bool)> {
        let mut found = Vec::new();
        for (statement, is_handed_on) in use_statements(code) {
            let mut leaves = Vec::new();
            expand(&statement["use ".len()..], &Vec::new(), &mut leaves);
            for (path, name) in leaves {
                let path = self.absolute(&path, from);
                found.extend(path.map(|path| (name, path, is_handed_on)));
            }
        }
        found
    }

    /// Lists the paths inside this crate that a file names. What a door only hands on, it does not need.
    fn paths(&self, code: &str, from: &Module, is_door: bool) -> Vec<Module> {
        let is_needed = |(_, path, is_handed_on): &(String, Module, bool)| {
            !(is_door && *is_handed_on && path.starts_with(from))
        };
        let imports = self.uses(code, from).into_iter().filter(is_needed);
        let mut found: Vec<Module> = imports.map(|(_, path, _)| path).collect();
        let statements = use_statements(code);
        let body =
            statements.iter().fold(code.to_owned(), |code, (use_, _)| code.replace(use_, ""));
        for (start, _) in body.match_indices("::") {
            let head = body[..start].trim_end_matches(is_word).len();
            // Where a path begins.
            if head < start && !body[..head].ends_with("::") {
                let mut leaves = Vec::new();
                expand(&body[head..], &Vec::new(), &mut leaves);
                found.extend(leaves.iter().filter_map(|(path, _)| self.absolute(path, from)));
            }
        }
        found
    }

    /// Returns a path from the crate's root on; `None` if it leads into another crate.
    fn absolute(&self, path: &[String], from: &Module) -> Option<Module> {
        let (first, rest) = path.split_first()?;
        let mut base = match first.as_str() {
            "crate" => Vec::new(),
            "self" => from.clone(),
            "super" => from.split_last()?.1.to_vec(),
            child => {
                let child = [&from[..], &[child.to_owned()]].concat();
                return self.modules.contains(&child).then(|| [&child[..], rest].concat());
            }
        };
        for part in rest {
            if part == "super" { drop(base.pop()) } else { base.push(part.clone()) }
        }
        Some(base)
    }

    /// Returns the module in which something is defined, where it may be re-exported by others.
    fn home(&self, path: &[String], n_followed: usize) -> Module {
        let n_known = (0..=path.len()).rev().find(|&n| self.modules.contains(&path[..n]));
        let (module, rest) = path.split_at(n_known.unwrap_or(0));
        let Some((name, rest)) = rest.split_first() else { return module.to_vec() };
        match self.imported.get(&(module.to_vec(), name.clone())) {
            Some(path) if n_followed < 8 => self.home(&[path, rest].concat(), n_followed + 1),
            _ => module.to_vec(),
        }
    }
}

/// Lists the circles, as sorted names: files that need each other, except a parent and what lies in its folder.
fn circles_among(arrows: &BTreeSet<(Module, Module)>) -> Vec<Vec<String>> {
    let is_kin = |(a, b): &&(Module, Module)| a.starts_with(b) || b.starts_with(a);
    let strangers: BTreeSet<_> = arrows.iter().filter(|arrow| !is_kin(arrow)).cloned().collect();
    let is_family = |group: &Vec<Module>| {
        let eldest = group.iter().min_by_key(|module| module.len()).expect("a group has members");
        !eldest.is_empty() && group.iter().all(|module| module.starts_with(eldest))
    };
    let families = groups(arrows).into_iter().filter(|group| !is_family(group));
    let all: BTreeSet<Vec<Module>> = groups(&strangers).into_iter().chain(families).collect();
    let name = |module: &Module| match module.join("::") {
        name if name.is_empty() => "the root".to_owned(),
        name => name,
    };
    all.iter().map(|group| group.iter().map(name).collect()).collect()
}

/// Returns the strongly connected components of two or more.
fn groups(arrows: &BTreeSet<(Module, Module)>) -> Vec<Vec<Module>> {
    let reachable = |start: &Module| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![start.clone()]);
        while let Some(from) = open.pop() {
            let next = arrows.iter().filter(|(a, _)| *a == from).map(|(_, to)| to);
            open.extend(next.filter(|to| seen.insert((*to).clone())).cloned());
        }
        seen
    };
    let all: BTreeSet<&Module> = arrows.iter().flat_map(|(from, to)| [from, to]).collect();
    let reach: BTreeMap<&Module, BTreeSet<Module>> =
        all.iter().map(|module| (*module, reachable(module))).collect();
    let mut found = Vec::new();
    for (module, reached) in &reach {
        let group: Vec<Module> =
            reached.iter().filter(|other| reach[other].contains(*module)).cloned().collect();
        if group.len() > 1 && group.first() == Some(module) {
            found.push(group);
        }
    }
    found
}

/// Lists the imports of a file, and whether each is handed on to others.
fn use_statements(code: &str) -> Vec<(&str, bool)> {
    let statement = |(start, _): (usize, &str)| {
        let before = code[..start].trim_end_matches(' ');
        let is_handed_on = before.ends_with("pub") || before.ends_with(')');
        let is_first = before.is_empty() || before.ends_with(['\n', ';', '{', '}', ']']);
        let end = code[start..].find(';').map_or(code.len(), |at| start + at);
        (is_first || is_handed_on).then_some((&code[start..end], is_handed_on))
    };
    code.match_indices("use ").filter_map(statement).collect()
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Reads one path, or a braced list of paths, and adds each with `base` in front and its name here; returns what follows.
fn expand<'a>(text: &'a str, base: &Module, paths: &mut Vec<(Module, String)>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        loop {
            rest = rest.trim_start().trim_start_matches(',').trim_start();
            if let Some(after) = rest.strip_prefix('}') {
                return after;
            }
            let after = expand(rest, base, paths);
            if after.len() == rest.len() {
                return rest;
            }
            rest = after;
        }
    }
    let (name, rest) = text.split_at(text.find(|c| !is_word(c)).unwrap_or(text.len()));
    let mut path = base.clone();
    match name {
        "" => return text,
        // `a::{self}` is `a`.
        "self" if !base.is_empty() => {}
        _ => path.push(name.to_owned()),
    }
    if let Some(rest) = rest.strip_prefix("::") {
        let n_before = paths.len();
        let after = expand(rest, &path, paths);
        if paths.len() == n_before {
            // A type's parameters, or everything that is in there.
            paths.push((path, name.to_owned()));
        }
        return after;
    }
    let mut here = path.last().cloned().unwrap_or_default();
    let mut after = rest;
    // A renamed import: ` as name` is no part of the path.
    if let Some(renamed) = rest.trim_start().strip_prefix("as ") {
        let end = renamed.find(|c| !is_word(c)).unwrap_or(renamed.len());
        renamed[..end].clone_into(&mut here);
        after = &renamed[end..];
    }
    paths.push((path, here));
    after
}

fn module(path: &str) -> Module {
    path.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect()
}

fn files<'a>(texts: &[(&str, &'a str)]) -> Vec<(Module, bool, &'a str)> {
    texts.iter().map(|(path, code)| (module(path), path.is_empty(), *code)).collect()
}

#[test]
fn imports_are_read_through_braces_parents_and_re_exports() {
    let from = "use crate::{a::{self, c::Thing as Other}, d};\nlet x = super::c::make();\nuse super::super::e::{f::G};\
                \nuse crate::H;\nuse std::fmt;\nlet y = i::J::<u8>::new();";
    let found = arrows(&files(&[
        ("", "mod a;\npub use e::{k::H, f};"),
        ("a", "pub use b::X;"),
        ("a::b", from),
        ("a::b::i", ""),
        ("a::c", ""),
        ("d", ""),
        ("e", ""),
        ("e::f", ""),
        ("e::k", ""),
    ]));
    let to = |(from, to): &(Module, Module)| (*from == module("a::b")).then(|| to.join("::"));
    let found: Vec<String> = found.iter().filter_map(to).collect();
    assert_eq!(found, ["a", "a::b::i", "a::c", "d", "e::f", "e::k"]);
}

#[test]
fn a_circle_of_any_length_is_found_and_a_family_is_not_one() {
    let circles = |texts: &[(&str, &str)]| circles_among(&arrows(&files(texts)));
    let two = [("a", "use crate::b::X;"), ("b", "use crate::a::Y;")];
    assert_eq!(circles(&two), [["a", "b"]]);
    let root = ("", "pub use c::Z;");
    let long = [root, ("a", "use crate::b::X;"), ("b", "use crate::Z;"), ("c", "use crate::a::Y;")];
    assert_eq!(circles(&long), [["a", "b", "c"]]);
    let family = [("a", "let x = b::X;"), ("a::b", "use super::c::Z;"), ("a::c", "use super::Y;")];
    assert!(circles(&family).is_empty());
    let siblings = [("a", "b::X;"), ("a::b", "use super::c::Z;"), ("a::c", "use super::b::X;")];
    assert_eq!(circles(&siblings), [["a::b", "a::c"]]);
    let line = [("a", "use crate::b::X;"), ("b", "use crate::c::Z;"), ("c", "")];
    assert!(circles(&line).is_empty());
}
