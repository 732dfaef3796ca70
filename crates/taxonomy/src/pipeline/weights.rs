//! Files of weights: read whole, and only if they are the ones that were named.

use std::path::Path;

use sha2::{Digest as _, Sha256};

use super::error::BackendError;

/// Reads a file whose sha256 is known; `expected` in hexadecimal.
///
/// # Errors
///
/// [`BackendError::WrongHash`] if it is another file, [`BackendError::Local`] if it cannot be read.
pub fn read(path: &Path, expected: &str) -> Result<Vec<u8>, BackendError> {
    use std::fmt::Write as _;
    let bytes = std::fs::read(path)
        .map_err(|error| BackendError::Local { message: format!("{}: {error}", path.display()) })?;
    let mut found = String::with_capacity(64);
    for byte in Sha256::digest(&bytes) {
        // Writing to a string cannot fail.
        let _written = write!(found, "{byte:02x}");
    }
    if found != expected {
        let (path, expected) = (path.to_owned(), expected.to_owned());
        return Err(BackendError::WrongHash { path, found, expected });
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_the_one_named_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("model.safetensors");
        std::fs::write(&path, "abc").unwrap();
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(read(&path, abc).unwrap(), b"abc");
        let error = read(&path, "0000").unwrap_err().to_string();
        assert!(error.ends_with(&format!("has sha256 {abc}; expected 0000")), "{error}");
        let error = read(&directory.path().join("none"), abc).unwrap_err().to_string();
        assert!(error.starts_with("the local model cannot be used: "), "{error}");
    }
}
