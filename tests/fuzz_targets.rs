//! The fuzzers of `fuzz/` compile against what they call, and take a little noise.
//!
//! `fuzz/` is a workspace of its own, which needs a nightly compiler and compiles every dependency again: nobody would notice a
//! target that what it calls has left behind. So the targets are modules here, under a stand-in for the fuzzing library.

/// The targets import the macro below by this name.
extern crate self as libfuzzer_sys;

#[path = "../fuzz/fuzz_targets/cdr.rs"]
#[expect(unused_attributes, reason = "elsewhere a target is a program")]
mod cdr;
#[path = "../fuzz/fuzz_targets/certificate.rs"]
#[expect(unused_attributes, reason = "elsewhere a target is a program")]
mod certificate;
#[path = "../fuzz/fuzz_targets/observation.rs"]
#[expect(unused_attributes, reason = "elsewhere a target is a program")]
mod observation;
#[path = "../fuzz/fuzz_targets/questions.rs"]
#[expect(unused_attributes, reason = "elsewhere a target is a program")]
mod questions;
#[path = "../fuzz/fuzz_targets/receive.rs"]
#[expect(unused_attributes, reason = "elsewhere a target is a program")]
mod receive;
#[path = "../fuzz/fuzz_targets/worker.rs"]
#[expect(unused_attributes, reason = "elsewhere a target is a program")]
mod worker;

use std::fs;
use std::path::Path;

use leadtime_numerics::Pcg64;

/// Messages that a target gets, and the longest of them, in bytes.
const N_MESSAGES: usize = 2_000;
const LONGEST: usize = 300;

/// Makes a test of a target.
macro_rules! fuzz_target {
    (|$bytes:ident: &[u8]| $body:block) => {
        #[test]
        fn takes_whatever_comes() {
            crate::feed(|$bytes: &[u8]| $body);
        }
    };
}
pub(crate) use fuzz_target;

/// Feeds a target with noise: half of the bytes are small, as lengths and kinds are.
fn feed(target: impl Fn(&[u8])) {
    let mut draws = Pcg64::seed_from_u64(1);
    for _ in 0..N_MESSAGES {
        let mut message = vec![0; draws.below(LONGEST)];
        for byte in &mut message {
            let most = if draws.below(2) == 0 { 10 } else { 256 };
            *byte = draws.below(most) as u8;
        }
        target(&message);
    }
}

#[test]
fn every_fuzzer_is_compiled_here_and_has_its_program() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("deploy lies in it");
    let manifest = fs::read_to_string(root.join("fuzz/Cargo.toml")).expect("fuzz/ is there");
    let targets = fs::read_dir(root.join("fuzz/fuzz_targets")).expect("its targets are there");
    for target in targets {
        let name = target.expect("an entry").file_name().into_string().expect("a name is text");
        let path = format!("fuzz_targets/{name}");
        let is_here = include_str!("fuzz_targets.rs").contains(&format!("/{path}\"]"));
        assert!(is_here, "{name} is no module of tests/fuzz_targets.rs");
        assert!(manifest.contains(&format!("path = \"{path}\"")), "{name} is no program of fuzz/");
    }
}
