//! Notes the commit that the program is built from, where there is one to note.

use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=../.git/logs/HEAD");
    println!("cargo:rerun-if-changed=build.rs");
    let commit = Command::new("git").args(["rev-parse", "--short=12", "HEAD"]).output();
    if let Some(commit) = commit.ok().filter(|out| out.status.success()) {
        let commit = String::from_utf8_lossy(&commit.stdout);
        println!("cargo:rustc-env=LEADTIME_COMMIT={}", commit.trim());
    }
}
