//! Who computes a run: the builds of the program and the classes of CPU that have taken part.
//!
//! Equal seeds give equal bits only within one build and one class of CPU. So a run is reproducible only if there
//! was one of each from its first update on, however often it was interrupted: the sets are part of the checkpoint.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// The most fingerprints of a kind that are listed: actors send them, so their number needs a limit. A run with more
/// than one is not reproducible in any case.
const MAX_LISTED: usize = 64;

/// What computes: a build of the program on a class of CPU.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Build {
    /// Fingerprint of the program's build.
    pub program: String,
    /// Fingerprint of the class of CPU.
    pub cpu: String,
}

/// The builds and classes of CPU behind a run, its learners' and its actors'.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Builds {
    /// Fingerprints of the builds of the program.
    pub programs: BTreeSet<String>,
    /// Fingerprints of the classes of CPU.
    pub cpus: BTreeSet<String>,
}

impl Builds {
    /// Notes who takes part from now on. Returns whether that is another build or CPU than those before.
    pub(crate) fn note(&mut self, build: &Build) -> bool {
        // Both are noted, whether or not the first is news.
        note(&mut self.programs, &build.program) | note(&mut self.cpus, &build.cpu)
    }

    /// Returns whether one build on one class of CPU computed everything.
    pub fn is_uniform(&self) -> bool {
        self.programs.len() <= 1 && self.cpus.len() <= 1
    }
}

/// Notes a fingerprint. Returns whether it differs from all earlier ones.
fn note(known: &mut BTreeSet<String>, fingerprint: &str) -> bool {
    let differs = !known.is_empty() && !known.contains(fingerprint);
    known.len() < MAX_LISTED && known.insert(fingerprint.to_owned()) && differs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_build_is_noticed_once_and_strangers_fill_neither_the_list_nor_the_log() {
        let mut builds = Builds::default();
        let mut note = |program: &str, cpu: &str| {
            builds.note(&Build { program: program.to_owned(), cpu: cpu.to_owned() })
        };
        assert!(!note("a", "x") && !note("a", "x"));
        assert!(note("b", "x") && !note("b", "x") && note("b", "y"));
        let n_noticed = (0..10 * MAX_LISTED).filter(|i| note(&i.to_string(), "x")).count();
        assert_eq!(n_noticed, MAX_LISTED - 2);
        assert!(!builds.is_uniform() && Builds::default().is_uniform());
        assert_eq!(builds.programs.len(), MAX_LISTED);
    }
}
