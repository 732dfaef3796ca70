//! Under which licences others let us have what is built into the program and the Python package.

use std::collections::BTreeSet;
use std::fs;

use crate::cargo;
use crate::code::root;

/// Licences that bind nobody who builds on Leadtime; `MPL-2.0` binds who changes the files that are under it.
const PERMISSIVE: [&str; 14] = [
    "0BSD",
    "Apache-2.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "CDLA-Permissive-2.0",
    "ISC",
    "MIT",
    "MIT-0",
    "MPL-2.0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Packages that are not even an option: two are not free to be built on, the others bring a second TLS stack.
const BANNED: [&str; 6] =
    ["kmedoids", "gifski", "openssl", "openssl-sys", "native-tls", "aws-lc-rs"];

/// Returns whether the licence that a package states leaves a choice that is permissive.
fn is_permissive(stated: &str) -> bool {
    let stated = stated.replace(['(', ')'], "").replace('/', " OR ");
    let is_listed = |licence: &str| {
        let licence = licence.trim();
        PERMISSIVE.contains(&licence.strip_suffix(" WITH LLVM-exception").unwrap_or(licence))
    };
    // Whatever the brackets were, this is never less strict.
    stated.split(" AND ").all(|all| all.split(" OR ").any(is_listed))
}

#[test]
fn licences_are_permissive() {
    let tree = "tree --locked --workspace --edges=normal,build --prefix=none --format={l}|{p}";
    let tree = cargo(tree);
    // A package that was listed before has a mark at its end.
    let lines = tree.lines().map(|line| line.strip_suffix(" (*)").unwrap_or(line));
    let packages: BTreeSet<(&str, &str)> = lines.filter_map(|line| line.split_once('|')).collect();
    assert!(packages.len() > 100, "{} packages are no program", packages.len());
    let mut binding = packages;
    binding.retain(|(licence, _)| !is_permissive(licence));
    assert_eq!(binding, BTreeSet::new(), "licences that are not known as permissive");
}

#[test]
fn banned_packages_are_not_there() {
    let lock = fs::read_to_string(root().join("Cargo.lock")).expect("Cargo.lock is there");
    let names: BTreeSet<&str> =
        lock.lines().filter_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"')).collect();
    assert_eq!(BANNED.into_iter().find(|name| names.contains(name)), None, "it is banned");
}

#[test]
fn a_licence_is_read_as_packages_state_it() {
    for stated in [
        "MIT",
        "EPL-2.0 OR Apache-2.0",
        "Apache-2.0/MIT",
        "(MIT OR Apache-2.0) AND Unicode-3.0",
        "Apache-2.0 WITH LLVM-exception",
    ] {
        assert!(is_permissive(stated), "{stated}");
    }
    for stated in ["", "GPL-3.0-only", "EPL-2.0", "MIT AND LGPL-3.0-or-later", "GPL-2.0 OR EPL-2.0"]
    {
        assert!(!is_permissive(stated), "{stated}");
    }
}
