//! Which build of the program this is: equal fingerprints compute the same numbers from the same seed.
//!
//! The commit that it was built from decides, where it is known; builds without one are told apart by the bytes of
//! the executable.

use std::fs::File;
use std::io;

use sha2::{Digest as _, Sha256};

use crate::output;

/// The commit that the program was built from, if known.
pub const COMMIT: Option<&str> = option_env!("LEADTIME_COMMIT");
/// Bytes of the digest that are shown: enough to tell builds apart.
const SHOWN_BYTES: usize = 8;

/// Returns the fingerprint of this build, such as `leadtime 0.1.0 build 1f0c9d4b7a6e5d3c`.
///
/// Reads the whole executable if no commit is known, so a process asks once.
///
/// # Errors
///
/// Whatever the system says about the executable.
pub fn fingerprint() -> io::Result<String> {
    let version = env!("CARGO_PKG_VERSION");
    let digest = match COMMIT {
        Some(commit) => Sha256::digest(commit),
        None => executable()?,
    };
    let shown = digest.get(..SHOWN_BYTES).unwrap_or(&digest);
    Ok(format!("leadtime {version} build {}", output::hex(shown)))
}

/// Returns the digest of the executable's bytes, in hexadecimal: another one for every change of the program, also one
/// that is not committed, and for tasks of the user's own.
///
/// # Errors
///
/// Whatever the system says about the executable.
pub fn executable_digest() -> io::Result<String> {
    Ok(output::hex(&executable()?))
}

/// Digests the executable that runs, even if its file was replaced meanwhile.
fn executable() -> io::Result<sha2::digest::Output<Sha256>> {
    let running = File::open("/proc/self/exe");
    let mut file = running.or_else(|_| std::env::current_exe().and_then(File::open))?;
    let mut hash = Sha256::new();
    let mut bytes = vec![0; 1 << 20];
    loop {
        match io::Read::read(&mut file, &mut bytes)? {
            0 => return Ok(hash.finalize()),
            n => hash.update(&bytes[..n]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_build_has_one_fingerprint_with_or_without_a_commit() {
        assert_eq!(fingerprint().unwrap(), fingerprint().unwrap());
        let own = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        assert_eq!(executable().unwrap(), Sha256::digest(&own));
    }
}
