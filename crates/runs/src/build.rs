//! Which build of the program this is: equal fingerprints compute the same numbers from the same seed.
//!
//! The bytes of the executable decide, and not the commit: two builds of one commit differ where uncommitted changes,
//! features or the compiler do. So a copy of the program is the same build on every machine.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::thread::available_parallelism;

use leadtime_proto::hex;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::clock;

/// The executable of this process as the system names it, even if its file was replaced or removed meanwhile.
const RUNNING: &str = "/proc/self/exe";
/// Bytes of the executable's digest in a fingerprint: enough to distinguish builds.
const SHOWN_BYTES: usize = 8;

/// A build of the program on a class of CPU: what a run's bits depend on besides its configuration.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProgramBuild {
    /// When it first worked on the run, UTC.
    pub since: String,
    /// Its fingerprint, such as `leadtime 0.1.0 build 1f0c9d4b7a6e5d3c`.
    pub program: String,
    /// The commit that it was built from, if known; `-dirty` at its end says that there were uncommitted changes.
    pub commit: Option<String>,
    /// Class of the CPU: equal classes give equal bits.
    pub cpu: String,
    /// How many threads the numeric libraries were told to use. They multiply nothing that a run consists of: it changes no bit.
    pub threads: String,
}

impl ProgramBuild {
    /// Describes this process; reads the whole executable, so a process asks once.
    ///
    /// # Errors
    ///
    /// If the executable cannot be read.
    pub fn of_this_process(commit: Option<&str>, threads: String) -> io::Result<Self> {
        Ok(Self {
            since: clock::utc_now(),
            program: fingerprint()?,
            commit: commit.map(str::to_owned),
            cpu: cpu_class(),
            threads,
        })
    }

    /// Tells whether another build computes the same numbers.
    pub fn computes_like(&self, other: &Self) -> bool {
        (&self.program, &self.cpu) == (&other.program, &other.cpu)
    }
}

/// Returns how many cores this process may use, at least one. As many threads play episodes, for the results do not depend on it.
pub fn n_cores() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// Returns the class of this machine's CPU, such as `x86_64+avx+avx2+fma`: equal classes give equal bits.
///
/// The numeric kernels choose their code by what the CPU can do, so the architecture and the vector extensions decide,
/// and not the model's name.
pub fn cpu_class() -> String {
    #[cfg(target_arch = "x86_64")]
    let extensions = [
        ("+avx", std::is_x86_feature_detected!("avx")),
        ("+avx2", std::is_x86_feature_detected!("avx2")),
        ("+fma", std::is_x86_feature_detected!("fma")),
        ("+avx512f", std::is_x86_feature_detected!("avx512f")),
    ];
    #[cfg(not(target_arch = "x86_64"))]
    let extensions: [(&str, bool); 0] = [];
    let present = extensions.iter().filter(|(_, present)| *present).map(|(name, _)| *name);
    [std::env::consts::ARCH].into_iter().chain(present).collect()
}

fn fingerprint() -> io::Result<String> {
    let shown = hex::encode(&executable()?[..SHOWN_BYTES]);
    Ok(format!("leadtime {} build {shown}", env!("CARGO_PKG_VERSION")))
}

fn executable() -> io::Result<sha2::digest::Output<Sha256>> {
    let mut file = File::open(RUNNING).or_else(|_| File::open(std::env::current_exe()?))?;
    let mut hash = Sha256::new();
    let mut bytes = vec![0; 1 << 20];
    loop {
        match file.read(&mut bytes)? {
            0 => return Ok(hash.finalize()),
            n => hash.update(&bytes[..n]),
        }
    }
}

/// Returns a path by which this program can be started again, also after its file was replaced or removed.
///
/// # Errors
///
/// If the system does not tell where the program is.
pub fn running_program() -> io::Result<PathBuf> {
    let named = std::env::current_exe();
    // By its own name where that is still the same file: `ps` and `pgrep` then show that name.
    match named {
        Ok(path) if is_same_file(&path, Path::new(RUNNING)) => Ok(path),
        _ if Path::new(RUNNING).exists() => Ok(PathBuf::from(RUNNING)),
        named => named,
    }
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    let place = |path: &Path| path.metadata().map(|file| (file.dev(), file.ino()));
    matches!((place(a), place(b)), (Ok(a), Ok(b)) if a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_of_the_executable_decide_its_fingerprint() {
        let own = std::fs::read(running_program().unwrap()).unwrap();
        assert_eq!(executable().unwrap(), Sha256::digest(&own));
        let start = hex::encode(&Sha256::digest(&own)[..SHOWN_BYTES]);
        assert!(fingerprint().unwrap().ends_with(&start));
    }
}
