//! `leadtime new`: a crate for a world of one's own.

use std::path::Path;
use std::{fs, io};

use anyhow::{Context as _, ensure};
use leadtime_proto::text::shell_word;
use leadtime_worlds::{LeadtimeSource, first_commands, template};

use crate::cli::NewArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// The checkout that this program was built from, if it is still there.
const CHECKOUT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
/// Files of the checkout that the crate takes over: the same dependencies, the same compiler.
const SHARED: [&str; 2] = ["Cargo.lock", "rust-toolchain.toml"];

pub(super) fn run(args: &NewArgs) -> Result<(), Failure> {
    make(args).blame(ExitCode::WrongInput)
}

fn make(args: &NewArgs) -> anyhow::Result<()> {
    let directory = &args.directory;
    let is_free = match fs::read_dir(directory) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) => error.kind() == io::ErrorKind::NotFound,
    };
    ensure!(is_free, "{} is not an empty directory", directory.display());
    // `.` has no name of its own.
    let place = directory.canonicalize().unwrap_or_else(|_not_there| directory.clone());
    let last = directory.file_name().or(place.file_name()).and_then(|name| name.to_str());
    let name = args.name.as_deref().or(last).unwrap_or_default();
    let default = Path::new(CHECKOUT).join("deploy/Cargo.toml").is_file();
    let checkout = args.leadtime.as_deref().or(default.then_some(Path::new(CHECKOUT)));
    let Some(checkout) = checkout else {
        write(directory, &template(name, LeadtimeSource::Repository)?)?;
        output::line("Leadtime's source is not here: write its address into Cargo.toml");
        return Ok(());
    };
    let no_source = || format!("--leadtime {}: no source of Leadtime", checkout.display());
    let checkout = checkout.canonicalize().with_context(no_source)?;
    let manifest = fs::read_to_string(checkout.join("Cargo.toml")).with_context(no_source)?;
    ensure!(checkout.join("deploy/Cargo.toml").is_file(), no_source());
    let path = checkout.to_str().context("the path of Leadtime's source is not UTF-8")?;
    write(directory, &template(name, LeadtimeSource::Checkout { path, manifest: &manifest })?)?;
    for file in SHARED {
        fs::copy(checkout.join(file), directory.join(file)).with_context(|| file.to_owned())?;
    }
    output::line(&format!("{}: README.md explains the crate", directory.display()));
    output::note(&first_commands(&shell_word(&directory.to_string_lossy())));
    Ok(())
}

fn write(directory: &Path, files: &[(&str, String)]) -> anyhow::Result<()> {
    for (name, text) in files {
        let path = directory.join(name);
        let folder = path.parent().unwrap_or(directory);
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        output::file(&path, text.as_bytes())?;
    }
    Ok(())
}
