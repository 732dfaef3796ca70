//! A crate for a world of one's own, written into a directory.

use std::path::{Path, PathBuf};
use std::{fs, io};

use leadtime_sims::SettingError;
use thiserror::Error;

use crate::template::{LeadtimeSource, template};

/// Files of a checkout that the crate takes over: the same dependencies, the same compiler.
const SHARED: [&str; 2] = ["Cargo.lock", "rust-toolchain.toml"];

/// Why a crate cannot be made.
#[derive(Debug, Error)]
pub enum NewCrateError {
    /// There is something in the directory.
    #[error("{} is not an empty directory", .0.display())]
    NotEmpty(PathBuf),
    /// The name cannot be that of a crate.
    #[error("{from}: `{}` is not a crate's name; allowed: {}", refused.given, refused.allowed)]
    Name {
        /// Whose name it is: the option that gave it, or the directory.
        from: &'static str,
        /// The name, and what is allowed.
        refused: SettingError,
    },
    /// Leadtime's source is not where it should be.
    #[error("--leadtime {}: no source of Leadtime", .0.display())]
    NoSource(PathBuf),
    /// A file or a directory cannot be written.
    #[error("{}", path.display())]
    Write {
        /// The path that cannot be written.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// Makes a crate in a directory that is empty or not there yet; its name is the directory's unless another is given.
///
/// `checkout` is Leadtime's source; without it the person writes the address of a repository.
///
/// # Errors
///
/// [`NewCrateError`] if the name, the directory or the source is wrong, which is found before anything is written, or
/// if a file cannot be written.
pub fn new_crate(
    directory: &Path,
    name: Option<&str>,
    checkout: Option<&Path>,
) -> Result<(), NewCrateError> {
    let is_free = match fs::read_dir(directory) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) => error.kind() == io::ErrorKind::NotFound,
    };
    if !is_free {
        return Err(NewCrateError::NotEmpty(directory.to_owned()));
    }
    // `.` has no name of its own.
    let place = directory.canonicalize().unwrap_or_else(|_not_there| directory.to_owned());
    let last = directory.file_name().or(place.file_name()).and_then(|name| name.to_str());
    let from = if name.is_some() { "--name" } else { "the directory (--name gives another)" };
    let name = name.or(last).unwrap_or_default();
    let made = |source: LeadtimeSource<'_>| {
        template(name, source).map_err(|refused| NewCrateError::Name { from, refused })
    };
    let Some(checkout) = checkout else {
        return write(directory, &made(LeadtimeSource::Repository)?);
    };
    let no_source = || NewCrateError::NoSource(checkout.to_owned());
    let source = checkout.canonicalize().map_err(|_unspecific| no_source())?;
    let manifest =
        fs::read_to_string(source.join("Cargo.toml")).map_err(|_unspecific| no_source())?;
    // A path that is not UTF-8 cannot stand in a manifest.
    let path = source.to_str().filter(|_| source.join("deploy/Cargo.toml").is_file());
    let path = path.ok_or_else(no_source)?;
    write(directory, &made(LeadtimeSource::Checkout { path, manifest: &manifest })?)?;
    for file in SHARED {
        let path = directory.join(file);
        let copied = fs::copy(source.join(file), &path);
        copied.map_err(|source| NewCrateError::Write { path, source })?;
    }
    Ok(())
}

fn write(directory: &Path, files: &[(&str, String)]) -> Result<(), NewCrateError> {
    for (name, text) in files {
        let path = directory.join(name);
        let made = fs::create_dir_all(path.parent().unwrap_or(directory));
        let written = made.and_then(|()| fs::write(&path, text));
        written.map_err(|source| NewCrateError::Write { path, source })?;
    }
    Ok(())
}
