//! House rules that no compiler knows: the arrows between crates, and who may name what.
//!
//! Each rule is an absence that ARCHITECTURE.md promises. They read the sources, the manifests and `cargo metadata`, so a rule
//! that is broken is named with the file that breaks it. `house/` has how sources are read, and the rules that need more than a
//! search: `circles` between files, what crates `reach`, the `licences` of what is built in, and what the `glossary` and other
//! `pages` name.

#[path = "house/circles.rs"]
mod circles;
#[path = "house/code.rs"]
mod code;
#[path = "house/glossary.rs"]
mod glossary;
#[path = "house/licences.rs"]
mod licences;
#[path = "house/pages.rs"]
mod pages;
#[path = "house/reach.rs"]
mod reach;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use code::{all_sources, root, sources};

/// Crates by layer, lowest first. A crate may depend only on crates of a lower layer.
const LAYERS: &[&[&str]] = &[
    &["leadtime-numerics", "leadtime-table", "leadtime-trace"],
    &["leadtime-proto", "leadtime-certs"],
    &["leadtime-taxonomy", "leadtime-link", "leadtime-policy"],
    &["leadtime-sims", "leadtime-ppo", "leadtime-voice"],
    &["leadtime-lander", "leadtime-highway", "leadtime-steakhouse"],
    &["leadtime-worlds", "leadtime-conformance", "leadtime-worker"],
    &["leadtime-episodes"],
    &["leadtime-actor", "leadtime-learner", "leadtime-eval", "leadtime-scripts", "leadtime-serve"],
    &["leadtime-config", "leadtime-web", "leadtime-recording"],
    &["leadtime-runs", "leadtime-watch", "leadtime-status", "leadtime-python"],
    &["leadtime-studies", "leadtime-process"],
    &["leadtime"],
];

/// Crates that are pure functions of their arguments: no clock, file, environment, thread or network.
const PURE: &str = "crates/numerics crates/table proto crates/policy crates/ppo sims sims/lander sims/highway \
                    sims/steakhouse crates/worlds crates/conformance crates/config";

/// Returns what cargo prints; it may not ask the network.
fn cargo(args: &str) -> String {
    let mut command = Command::new(env!("CARGO"));
    let out = command.current_dir(root()).args(args.split(' ')).arg("--offline").output();
    let out = out.expect("cargo runs");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).expect("cargo prints text")
}

/// Returns the packages of the workspace, each with its name and the names of its dependencies.
fn packages() -> Vec<(Value, String, Vec<String>)> {
    let metadata: Value = serde_json::from_str(&cargo("metadata --no-deps --format-version=1"))
        .expect("cargo metadata prints JSON");
    let name = |of: &Value| of["name"].as_str().expect("name").to_owned();
    let package = |package: &Value| {
        let dependencies = package["dependencies"].as_array().expect("dependencies");
        (package.clone(), name(package), dependencies.iter().map(name).collect())
    };
    metadata["packages"].as_array().expect("packages").iter().map(package).collect()
}

/// Lists files (relative) whose code holds one of `words`, except those under the allowed paths.
fn offenders(words: &[&str], allowed: &[&str]) -> Vec<String> {
    let root = root();
    all_sources()
        .iter()
        .filter(|source| words.iter().any(|word| source.code.contains(word)))
        .map(|source| source.path.strip_prefix(&root).expect("inside").display().to_string())
        .filter(|path| !allowed.iter().any(|prefix| path.starts_with(prefix)))
        .collect()
}

/// Returns the layer of a crate; `None` of a crate from elsewhere.
fn layer(name: &str) -> Option<usize> {
    LAYERS.iter().position(|names| names.contains(&name))
}

#[test]
fn dependency_arrows_point_down() {
    for (_, from, dependencies) in packages() {
        let above = layer(&from).unwrap_or_else(|| panic!("`{from}` has no layer"));
        // Its tests may ask for what a crate offers to the tests of others.
        for to in dependencies.into_iter().filter(|to| *to != from) {
            let Some(below) = layer(&to) else { continue };
            assert!(below < above, "`{from}` (layer {above}) depends on `{to}` (layer {below})");
        }
    }
}

#[test]
fn the_map_shows_every_crate_in_its_layer() {
    let listed: BTreeSet<(usize, String)> = packages()
        .iter()
        .map(|(package, name, _)| (layer(name).expect("it has a layer"), folder(package)))
        .collect();
    let is_crate = |word: &str| listed.iter().any(|(_, folder)| folder == word);
    let map = fs::read_to_string(root().join("ARCHITECTURE.md")).expect("the page is there");
    let mut shown = BTreeSet::new();
    for line in map.lines() {
        let mut cells = line.strip_prefix("| ").unwrap_or_default().split(" | ");
        let (Some(Ok(layer)), Some(crates)) = (cells.next().map(str::parse::<usize>), cells.next())
        else {
            continue;
        };
        // The name of a package may stand beside its folder.
        let folders = crates.split('`').skip(1).step_by(2).filter(|word| is_crate(word));
        shown.extend(folders.map(|folder| (layer, folder.to_owned())));
    }
    assert_eq!(shown, listed, "layers and crates in ARCHITECTURE.md, and those of this test");
}

#[test]
fn heavy_dependencies_belong_to_few_crates() {
    let rules: &[(&str, &[&str])] = &[
        ("zenoh", &["leadtime-link"]),
        ("ed25519-dalek", &["leadtime-link"]),
        ("blake3", &["leadtime-link"]),
        ("bincode", &["leadtime-proto"]),
        ("pyo3", &["leadtime-python"]),
        ("rapier2d", &["leadtime-lander"]),
        ("candle-core", &["leadtime-policy", "leadtime-ppo", "leadtime-taxonomy"]),
        ("candle-nn", &["leadtime-policy", "leadtime-ppo", "leadtime-taxonomy"]),
        ("rcgen", &["leadtime-certs"]),
        ("rustls", &["leadtime-certs"]),
        ("x509-parser", &["leadtime-certs"]),
        ("anyhow", &["leadtime"]),
        ("clap", &["leadtime"]),
        ("sd-notify", &["leadtime"]),
        ("tracing-subscriber", &["leadtime-process"]),
        ("axum", &["leadtime-web"]),
        ("hyper", &["leadtime-web"]),
        ("hyper-util", &["leadtime-web"]),
        ("mcap", &["leadtime-recording"]),
        ("prometheus-client", &["leadtime-status"]),
        ("symphonia-core", &["leadtime-voice"]),
        ("symphonia-codec-vorbis", &["leadtime-voice"]),
        ("symphonia-format-ogg", &["leadtime-voice"]),
    ];
    let packages = packages();
    for (crate_name, owners) in rules {
        for (_, name, dependencies) in &packages {
            let names_it = dependencies.iter().any(|dependency| dependency == crate_name);
            assert!(!names_it || owners.contains(&&**name), "`{name}` depends on `{crate_name}`");
        }
    }
}

#[test]
fn the_program_brings_no_language_model_unless_asked() {
    let tree = cargo("tree --locked --package=leadtime --edges=normal --prefix=none --format={p}");
    assert!(tree.contains("leadtime-taxonomy"), "{tree}");
    let found = tree.lines().any(|line| line.starts_with("candle-transformers "));
    assert!(!found, "the program depends on `candle-transformers`");
}

#[test]
fn what_a_library_is_needed_for_is_known_in_one_place() {
    let tensors = ["crates/policy/", "crates/ppo/", "crates/taxonomy/src/pipeline/minilm.rs"];
    let rules: [(&[&str], &[&str]); 5] = [
        (&["bincode"], &["proto/src/codec.rs"]),
        (&["zenoh::", "use zenoh"], &["crates/link/"]),
        (&["rapier2d::", "use rapier2d"], &["sims/lander/"]),
        (&["candle_core", "candle_nn"], &tensors),
        (&["SystemTime", "Timestamp::now", "Zoned::now"], &["crates/runs/src/clock.rs"]),
    ];
    for (words, allowed) in rules {
        let allowed = [allowed, &["tests/house"]].concat();
        assert_eq!(offenders(words, &allowed), [""; 0], "{words:?}");
    }
}

#[test]
fn pure_crates_touch_no_clock_file_environment_or_thread() {
    let impure = "std::fs std::env std::net std::thread std::process Instant SystemTime tokio std::io::stdin thread_rng \
                  rand::rng env::var";
    for source in PURE.split(' ').flat_map(|folder| sources(&root().join(folder).join("src"))) {
        let found = impure.split(' ').find(|word| source.code.contains(word));
        assert_eq!(found, None, "{} names it", source.path.display());
    }
}

#[test]
fn only_deploy_prints_exits_and_reads_the_environment() {
    let words = ["println!", "print!(", "process::exit", "env::args", "env::var"];
    let allowed = ["deploy/", "tests/", "examples/", "bench/"];
    // Benches, tests and examples of a crate may talk; its library may not.
    let found: Vec<String> =
        offenders(&words, &allowed).into_iter().filter(|path| path.contains("/src/")).collect();
    assert_eq!(found, [""; 0]);
}

/// Lines that no file may exceed, tests included: nobody finds their way in more.
const STOP: usize = 1_000;

#[test]
fn no_source_file_is_endless() {
    for source in all_sources() {
        let n_lines = source.text.lines().count();
        assert!(n_lines <= STOP, "{} has {n_lines} lines", source.path.display());
    }
}

/// Type names that two product types share, and why that does not mislead.
const SHARED_NAMES: &[(&str, &str)] = &[
    ("Error", "each library's own error, always written with its crate: `link::Error`"),
    ("Result", "each library's own, with its own error"),
    ("Layer", "of a network and of a configuration: the standard word of either field"),
];

#[test]
fn a_type_name_means_one_thing() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for source in all_sources().iter().filter(|source| source.is_product()) {
        for name in source.code.lines().filter_map(type_name) {
            places.entry(name.to_owned()).or_default().push(source.path.display().to_string());
        }
    }
    places.retain(|_, files| files.len() > 1);
    let shared: BTreeSet<&str> = places.keys().map(String::as_str).collect();
    let listed: BTreeSet<&str> = SHARED_NAMES.iter().map(|(name, _)| *name).collect();
    assert_eq!(shared, listed, "types that share a name, and those listed: {places:#?}");
    assert!(listed.len() <= 15, "{} names mean two things", listed.len());
}

/// Returns the name that a line defines as a type; a `type` inside a trait is not one.
fn type_name(line: &str) -> Option<&str> {
    let mut rest = line.trim_start();
    let is_indented = rest.len() < line.len();
    if let Some(after) = rest.strip_prefix("pub") {
        rest = match after.strip_prefix('(') {
            Some(inside) => inside.split_once(')')?.1,
            None => after,
        };
    }
    let (keyword, rest) = rest.trim_start().split_once(' ')?;
    let is_type =
        matches!(keyword, "struct" | "enum" | "trait") || (keyword == "type" && !is_indented);
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    (is_type && end > 0).then_some(&rest[..end])
}

#[test]
fn type_names_are_read_off_their_definitions() {
    assert_eq!(type_name("pub(crate) struct Lane {"), Some("Lane"));
    assert_eq!(type_name("    enum Wake<T> {"), Some("Wake"));
    assert_eq!(type_name("pub type Key = (u8, u8);"), Some("Key"));
    assert_eq!(type_name("    type Error = Never;"), None);
    assert_eq!(type_name("let structure = 1;"), None);
}

/// Returns the folder of a package, relative to the root.
fn folder(package: &Value) -> String {
    let manifest = Path::new(package["manifest_path"].as_str().expect("path"));
    let folder = manifest.parent().expect("a manifest lies in a folder");
    folder.strip_prefix(root()).expect("inside").display().to_string()
}

/// Lists the folders of the workspace's crates, relative to its root.
fn crate_folders() -> Vec<String> {
    packages().iter().map(|(package, ..)| folder(package)).collect()
}

#[test]
fn every_source_file_says_what_it_is_for() {
    for source in all_sources() {
        // A file of unit tests belongs to the module that names it, and is explained there.
        let belongs = source.path.to_string_lossy().ends_with("tests.rs");
        let explained = source.text.starts_with("//!") || source.is_generated() || belongs;
        assert!(explained, "{} has no header", source.path.display());
    }
}

#[test]
fn crate_roots_hold_only_docs_modules_and_re_exports() {
    for source in all_sources() {
        let is_root = source.path.ends_with("lib.rs") || source.path.ends_with("mod.rs");
        let is_inside = source.path.iter().any(|part| part == "src");
        let has_function = source.code.contains("fn ");
        assert!(!(is_root && is_inside && has_function), "{}", source.path.display());
    }
}

#[test]
fn nothing_unfinished_is_left_in_the_sources() {
    let marks =
        [concat!("TO", "DO"), concat!("FIX", "ME"), concat!("todo", "!("), concat!("#[", "ignore")];
    for source in all_sources() {
        let found = marks.iter().find(|mark| source.text.contains(**mark));
        assert_eq!(found, None, "{} contains it", source.path.display());
    }
}

#[test]
fn the_readme_has_the_verdicts_of_the_results() {
    let read = |path: &str| fs::read_to_string(root().join(path)).expect("the page is there");
    let verdict = read("docs/results/verdict.md");
    for page in ["README.md", "docs/results/README.md"] {
        assert!(read(page).contains(verdict.trim_end()), "{page} has other verdicts");
    }
}
