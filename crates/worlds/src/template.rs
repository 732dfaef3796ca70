//! What a world of your own starts from: the files of a crate that holds the example and builds outside the workspace.

use leadtime_sims::SettingError;
use leadtime_sims::check::require;

/// The longest name of a crate.
const MAX_NAME: usize = 64;
/// Names that Cargo or Rust have for something else, and the crates that this one depends on.
const TAKEN: [&str; 11] = [
    "test",
    "core",
    "std",
    "alloc",
    "proc_macro",
    "leadtime",
    "serde",
    "build",
    "deps",
    "examples",
    "incremental",
];
/// The words of Rust's own, of which Cargo makes no crate, or a world could not name its own.
const KEYWORDS: &str = "abstract as async await become box break const continue crate do dyn else enum extern false final fn \
                        for gen if impl in let loop macro match mod move mut override priv pub ref return self static struct \
                        super trait true try type typeof unsafe unsized use virtual where while yield";
/// What the names of Leadtime's own crates begin with, some of which this one depends on.
const OWN: [&str; 2] = ["leadtime-", "leadtime_"];

/// In the checkout's profiles, what only its optional features use: Cargo would warn of it in every build.
const ABSENT: &str = "candle-nn ";

/// Where the crate finds Leadtime.
#[derive(Clone, Copy, Debug)]
pub(crate) enum LeadtimeSource<'a> {
    /// In a checkout: its absolute path, and the text of its `Cargo.toml`.
    Checkout {
        /// The path of the checkout.
        path: &'a str,
        /// The text, whose profiles the crate repeats: dependencies that the checkout has compiled are then shared.
        manifest: &'a str,
    },
    /// Nowhere on this machine: the person writes the address of a repository.
    Repository,
}

/// Returns the files of a crate: path and text.
///
/// # Errors
///
/// [`SettingError`] if the name cannot be that of a crate.
pub(crate) fn template(
    name: &str,
    source: LeadtimeSource<'_>,
) -> Result<Vec<(&'static str, String)>, SettingError> {
    let starts = name.starts_with(|c: char| c.is_ascii_lowercase());
    let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-_".contains(c);
    let is_name = starts && name.len() <= MAX_NAME && name.chars().all(fits);
    let allowed = "a lower-case letter, then up to 63 of a-z, 0-9, - and _; no name that Rust or a crate \
                   that it uses has, such as `leadtime-...`";
    let is_keyword = KEYWORDS.split_whitespace().any(|word| word == name);
    let is_own = OWN.iter().any(|own| name.starts_with(own));
    let is_taken = TAKEN.contains(&name) || is_keyword || is_own;
    require(is_name && !is_taken, "name", name, allowed)?;
    let mut manifest = include_str!("../template/manifest.toml").replace("{name}", name);
    let readme = include_str!("../template/README.md").replace("{name}", name);
    let mut files = vec![
        ("src/main.rs", include_str!("../../../examples/corridor.rs").to_owned()),
        ("src/corridor.toml", include_str!("../../../examples/corridor.toml").to_owned()),
        ("README.md", readme),
        (".gitignore", "/target\n/runs\n".to_owned()),
    ];
    match source {
        LeadtimeSource::Checkout { path, manifest: theirs } => {
            manifest = manifest.replace("{place}\n", "");
            let folders =
                ["deploy", "crates/numerics", "sims", "vendor/zenoh", "vendor/zenoh-link-tls"];
            for folder in folders {
                let place = format!("path = {:?}", format!("{path}/{folder}"));
                manifest = manifest.replacen("{source}", &place, 1);
            }
            if let Some(at) = theirs.find("\n[profile.") {
                manifest += "\n# As in the checkout: what it has compiled is not compiled again.";
                let ours =
                    theirs[at..].split_inclusive('\n').filter(|line| !line.starts_with(ABSENT));
                manifest.extend(ours);
            }
            let shared = format!("[build]\ntarget-dir = {:?}\n", format!("{path}/target"));
            files.push((".cargo/config.toml", shared));
        }
        LeadtimeSource::Repository => {
            let says = "# Write the address of the repository that you build Leadtime from in place of those below.\n";
            manifest = manifest.replace("{place}\n", says);
            manifest = manifest.replace("{source}", "git = \"https://REPOSITORY\"");
        }
    }
    files.push(("Cargo.toml", manifest));
    Ok(files)
}

/// Returns the commands that are typed first in a crate that was made.
pub fn first_commands(directory: &str) -> String {
    let enter = if directory == "." { String::new() } else { format!("\n  cd {directory}") };
    format!(
        "\nNext:{enter}\n  cargo run --release -- check -c corridor\n      play its world, and say what is wrong with it\n  \
         cargo run --release -- smoke --domain corridor\n      train, evaluate, draw, and say whether it learned"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(files: &[(&str, String)], name: &str) -> String {
        let found = files.iter().find(|(path, _)| *path == name);
        found.map(|(_, text)| text.clone()).expect("the file is made")
    }

    #[test]
    fn a_crate_says_where_leadtime_is() {
        let manifest = "[workspace]\n\n[profile.dev]\nopt-level = 1\ncandle-nn = 1\n";
        let source = LeadtimeSource::Checkout { path: "/src/lead \"time\"", manifest };
        let files = template("my-world", source).unwrap();
        let text = file(&files, "Cargo.toml");
        for part in [
            "name = \"my-world\"",
            r#"leadtime = { path = "/src/lead \"time\"/deploy" }"#,
            r#"leadtime-numerics = { path = "/src/lead \"time\"/crates/numerics" }"#,
            r#"leadtime-sims = { path = "/src/lead \"time\"/sims" }"#,
            r#"zenoh = { path = "/src/lead \"time\"/vendor/zenoh" }"#,
            r#"zenoh-link-tls = { path = "/src/lead \"time\"/vendor/zenoh-link-tls" }"#,
            "\n[workspace]\n",
            "\n[profile.dev]\nopt-level = 1\n",
        ] {
            assert!(!text.contains("candle-nn"), "{text}");
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("{place}") && !file(&files, "README.md").contains("{name}"));
        let files = template("my-world", LeadtimeSource::Repository).unwrap();
        let text = file(&files, "Cargo.toml");
        assert_eq!(text.matches("git = \"https://REPOSITORY\"").count(), 5, "{text}");
        assert!(text.contains("# Write the address of the repository"), "{text}");
    }

    #[test]
    fn an_impossible_name_is_refused() {
        let long = "a".repeat(65);
        let used = ["leadtime", "leadtime-sims", "leadtime_numerics", "serde", "test", "deps"];
        let words = ["fn", "gen", "self", "yield"];
        for name in ["", "3d", "Grid", "a b", "../x", &long].into_iter().chain(used).chain(words) {
            let error = template(name, LeadtimeSource::Repository).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("`name` is {name}; allowed: a lower-case")),
                "{error}"
            );
        }
    }
}
