//! House rules that no compiler knows: the arrows between crates, and who may name what.
//!
//! Each rule is an absence that ARCHITECTURE.md promises. They read the sources and `cargo metadata`, so a rule that
//! is broken is named with the file that breaks it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// Crates by layer, lowest first. A crate may depend only on crates of a lower layer.
const LAYERS: &[&[&str]] = &[
    &["leadtime-numerics"],
    &["leadtime-proto"],
    &["leadtime-taxonomy", "leadtime-link", "leadtime-policy"],
    &["leadtime-sims"],
    &["leadtime-episodes"],
    &["leadtime-actor", "leadtime-learner", "leadtime-eval"],
    &["leadtime-config"],
    &["leadtime-runs"],
    &["leadtime"],
];

/// Crates that are pure functions of their arguments: no clock, file, environment, thread or network.
const PURE: &[&str] = &["crates/numerics", "proto", "crates/policy", "sims", "crates/config"];

/// Folders that hold our Rust sources.
const FOLDERS: &[&str] =
    &["crates", "proto", "sims", "actor", "learner", "deploy", "tests", "examples", "bench"];

fn root() -> PathBuf {
    let deploy = Path::new(env!("CARGO_MANIFEST_DIR"));
    deploy.parent().expect("deploy lies in the repository").to_owned()
}

fn metadata() -> Value {
    let out = Command::new(env!("CARGO"))
        .current_dir(root())
        .args(["metadata", "--no-deps", "--offline", "--format-version=1"])
        .output()
        .expect("cargo runs");
    serde_json::from_slice(&out.stdout).expect("cargo metadata prints JSON")
}

/// A source file, and what of it is neither comment nor test.
struct Source {
    path: PathBuf,
    text: String,
    code: String,
}

impl Source {
    fn is_test(&self) -> bool {
        let name = self.path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        name.ends_with("tests") || self.path.iter().any(|part| part == "tests")
    }

    /// Tells whether a script wrote it: its first line says which.
    fn is_generated(&self) -> bool {
        let first = self.text.lines().next().unwrap_or_default();
        !first.starts_with("//!") && first.contains(".py")
    }
}

fn sources(folder: &Path) -> Vec<Source> {
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

/// Drops comments and everything from the file's test module on.
fn code_of(text: &str) -> String {
    let product = text.split("\n#[cfg(test)]").next().unwrap_or_default();
    let lines = product.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines.map(|line| line.split(" // ").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

fn all_sources() -> Vec<Source> {
    FOLDERS.iter().flat_map(|folder| sources(&root().join(folder))).collect()
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

#[test]
fn dependency_arrows_point_down() {
    let metadata = metadata();
    let layer = |name: &str| LAYERS.iter().position(|names| names.contains(&name));
    for package in metadata["packages"].as_array().expect("packages") {
        let from = package["name"].as_str().expect("name");
        let above = layer(from).unwrap_or_else(|| panic!("`{from}` has no layer"));
        for dependency in package["dependencies"].as_array().expect("dependencies") {
            let to = dependency["name"].as_str().expect("name");
            let Some(below) = layer(to) else { continue };
            assert!(below < above, "`{from}` (layer {above}) depends on `{to}` (layer {below})");
        }
    }
}

#[test]
fn heavy_dependencies_belong_to_few_crates() {
    let rules: &[(&str, &[&str])] = &[
        ("zenoh", &["leadtime-link"]),
        ("bincode", &["leadtime-proto"]),
        ("rapier2d", &["leadtime-sims"]),
        ("candle-core", &["leadtime-policy", "leadtime-learner", "leadtime-taxonomy"]),
        ("candle-nn", &["leadtime-policy", "leadtime-learner", "leadtime-taxonomy"]),
        ("anyhow", &["leadtime"]),
        ("clap", &["leadtime"]),
        ("tracing-subscriber", &["leadtime"]),
    ];
    let metadata = metadata();
    for (crate_name, owners) in rules {
        for package in metadata["packages"].as_array().expect("packages") {
            let name = package["name"].as_str().expect("name");
            let dependencies = package["dependencies"].as_array().expect("dependencies");
            let names_it = dependencies.iter().any(|dependency| dependency["name"] == *crate_name);
            assert!(!names_it || owners.contains(&name), "`{name}` depends on `{crate_name}`");
        }
    }
}

#[test]
fn the_program_brings_no_language_model_unless_asked() {
    let out = Command::new(env!("CARGO"))
        .current_dir(root())
        .args(["tree", "--offline", "--locked", "--package=leadtime", "--edges=normal"])
        .args(["--prefix=none", "--format={p}"])
        .output()
        .expect("cargo runs");
    let tree = String::from_utf8(out.stdout).expect("package names are text");
    assert!(tree.contains("leadtime-taxonomy"), "{}", String::from_utf8_lossy(&out.stderr));
    let found = tree.lines().any(|line| line.starts_with("candle-transformers "));
    assert!(!found, "the program depends on `candle-transformers`");
}

#[test]
fn only_one_file_names_the_wire_encoding() {
    assert_eq!(offenders(&["bincode"], &["proto/src/codec.rs", "tests/house.rs"]), [""; 0]);
}

#[test]
fn only_link_names_the_network_library() {
    let allowed = ["crates/link/", "tests/house.rs", "deploy/src/logging.rs"];
    assert_eq!(offenders(&["zenoh::", "use zenoh"], &allowed), [""; 0]);
}

#[test]
fn only_sims_names_the_physics_engine() {
    assert_eq!(offenders(&["rapier2d::", "use rapier2d"], &["sims/", "tests/house.rs"]), [""; 0]);
}

#[test]
fn only_policy_learner_and_local_models_name_the_tensor_library() {
    let allowed =
        ["crates/policy/", "learner/", "crates/taxonomy/src/pipeline/local/", "tests/house.rs"];
    assert_eq!(offenders(&["candle_core", "candle_nn"], &allowed), [""; 0]);
}

#[test]
fn pure_crates_touch_no_clock_file_environment_or_thread() {
    let impure = [
        "std::fs",
        "std::env",
        "std::net",
        "std::thread",
        "std::process",
        "Instant",
        "SystemTime",
        "tokio",
        "std::io::stdin",
        "thread_rng",
        "rand::rng",
        "env::var",
    ];
    for folder in PURE {
        for source in sources(&root().join(folder).join("src")) {
            for word in impure {
                let found = source.code.contains(word);
                assert!(!found, "{} names `{word}`", source.path.display());
            }
        }
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

#[test]
fn only_one_file_reads_the_wall_clock() {
    let words = ["SystemTime", "Timestamp::now", "Zoned::now"];
    assert_eq!(offenders(&words, &["crates/runs/src/clock.rs", "tests/house.rs"]), [""; 0]);
}

/// Product files that may be longer than most, up to [`STOP`], and why they stay whole.
const LONG: &[(&str, &str)] = &[
    ("learner/src/coordinator.rs", "one state machine, whose transitions read best side by side"),
    ("learner/src/run.rs", "one loop, and what each thing that wakes it sets off"),
];
/// Lines before its tests that a product file may have.
const WARN: usize = 500;
/// Lines that no file may exceed; a file of tests may be this long, for its parts do not depend on each other.
const STOP: usize = 800;

#[test]
fn source_files_stay_readable() {
    for source in all_sources() {
        let n_lines =
            source.text.split("\n#[cfg(test)]").next().unwrap_or_default().lines().count();
        let may_be_long =
            source.is_test() || LONG.iter().any(|(path, _)| source.path.ends_with(path));
        let limit = if may_be_long { STOP } else { WARN };
        assert!(n_lines <= limit, "{} has {n_lines} lines", source.path.display());
    }
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
        let name = source.path.file_name().and_then(|name| name.to_str());
        let is_root = matches!(name, Some("lib.rs" | "mod.rs"));
        let inside_src = source.path.components().any(|part| part.as_os_str() == "src");
        if is_root && inside_src {
            let has_function = source.code.lines().any(|line| line.trim_start().contains("fn "));
            assert!(!has_function, "{} holds a function", source.path.display());
        }
    }
}

#[test]
fn nothing_unfinished_is_left_in_the_sources() {
    let marks =
        [concat!("TO", "DO"), concat!("FIX", "ME"), concat!("todo", "!("), concat!("#[", "ignore")];
    for source in all_sources() {
        for mark in marks {
            let found = source.text.contains(mark);
            assert!(!found, "{} contains `{mark}`", source.path.display());
        }
    }
}

#[test]
fn licences_are_permissive() {
    // Packages whose licence would bind whoever builds on Leadtime, or that bring a second TLS stack.
    let banned = ["kmedoids", "gifski", "openssl", "openssl-sys", "native-tls"];
    let lock = fs::read_to_string(root().join("Cargo.lock")).expect("Cargo.lock is there");
    let names: BTreeSet<&str> =
        lock.lines().filter_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"')).collect();
    for name in banned {
        assert!(!names.contains(name), "`{name}` is banned");
    }
}
