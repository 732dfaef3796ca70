//! Notes the commit that the program is built from, where there is one, and whether there are changes beyond it.

use std::process::Command;

/// What decides the program; the build script runs again when anything in it changes.
const SOURCES: [&str; 9] = [
    "../Cargo.toml",
    "../Cargo.lock",
    "../crates",
    "../examples",
    "../proto",
    "../sims",
    "../actor",
    "../learner",
    ".",
];

fn main() {
    for source in SOURCES {
        println!("cargo:rerun-if-changed={source}");
    }
    // A work tree of its own keeps its history elsewhere than in `../.git`.
    if let Some(history) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={history}");
    }
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else { return };
    let changes = git(&[&["status", "--porcelain", "--"], &SOURCES[..]].concat());
    let mark = if changes.is_some_and(|changes| !changes.is_empty()) { "-dirty" } else { "" };
    println!("cargo:rustc-env=LEADTIME_COMMIT={commit}{mark}");
}

fn git(args: &[&str]) -> Option<String> {
    let out = Command::new("git").args(args).output().ok().filter(|out| out.status.success())?;
    Some(String::from_utf8_lossy(&out.stdout).trim().to_owned())
}
