//! Genuine certificates with flipped bits, cut or lengthened, as files and as a peer shows them: each is read or refused.
//!
//! ```console
//! cargo run --release -p leadtime-certs --example damaged_certificates -- 60
//! ```
//!
//! The number is the seconds that it goes on; the damage is the same every time. `fuzz/fuzz_targets/certificate.rs` has a guided
//! fuzzer, which needs a nightly compiler.

#![expect(clippy::print_stdout, clippy::expect_used, reason = "a program for people")]

use std::fs;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use leadtime_certs::{Authority, Certificate, Role};
use leadtime_numerics::Pcg64;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject as _;

/// The most hosts that a certificate is read with.
const MOST_HOSTS: usize = 256;
/// Certificates between two looks at the clock.
const AT_ONCE: usize = 256;

/// Flips bits, and now and then cuts, lengthens, or writes a length that is not there.
fn damaged(bytes: &[u8], draws: &mut Pcg64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    match draws.below(16) {
        0 => bytes.truncate(draws.below(bytes.len() + 1)),
        1 => bytes.extend((0..draws.below(64)).map(|i| i as u8)),
        2 => {
            let place = draws.below(bytes.len());
            bytes[place] = [0x80, 0x84, 0xff][draws.below(3)];
        }
        _ => {}
    }
    for _ in 0..=draws.below(4) {
        if !bytes.is_empty() {
            let place = draws.below(bytes.len());
            bytes[place] ^= 1 << draws.below(8);
        }
    }
    bytes
}

/// Makes an authority and certificates of several kinds; returns each as a file and as a peer shows it.
fn genuine() -> Vec<(Vec<u8>, Vec<u8>)> {
    let dir = tempfile::tempdir().expect("a temporary directory can be made");
    let now = Timestamp::from_second(1_700_000_000).expect("it is a moment");
    Authority::create(dir.path(), "Test", now).expect("an authority can be made");
    let mut authority = Authority::open(dir.path(), now).expect("it can be opened");
    let hosts = ["box.example", "10.0.0.1", "2001:db8::1"].map(str::to_owned);
    let mut files = vec![dir.path().join("ca.pem")];
    for (role, name, hosts) in [(Role::Learner, "l1", &hosts[..]), (Role::Actor, "a1", &[])] {
        let name = name.parse().expect("it is a name");
        let issued = authority.issue(role, &name, hosts, Duration::from_hours(24), now);
        files.push(issued.expect("a certificate can be made").path);
    }
    let read = |file: &std::path::PathBuf| {
        let der = CertificateDer::from_pem_file(file).expect("it is a certificate");
        (fs::read(file).expect("it can be read"), der.to_vec())
    };
    files.iter().map(read).collect()
}

/// Reads a damaged one; returns whether it can be read.
fn is_read((pem, der): &(Vec<u8>, Vec<u8>), draws: &mut Pcg64) -> bool {
    // Most damage to a file is noticed as such, so most is done to what it holds.
    let found = match draws.below(4) {
        0 => Certificate::parse(&damaged(pem, draws)),
        _ => Certificate::from_der(&damaged(der, draws)),
    };
    let Ok(read) = found else { return false };
    assert!(read.hosts.len() <= MOST_HOSTS);
    // As `leadtime certs show` prints it.
    drop(format!("{read:?} {}", read.ends.strftime("%Y-%m-%d %H:%M:%S UTC")));
    true
}

fn main() {
    let seconds = std::env::args().nth(1).map_or(Ok(5), |text| text.parse::<u64>());
    let patience = Duration::from_secs(seconds.expect("write for how many seconds"));
    let genuine = genuine();
    for (pem, der) in &genuine {
        assert!(Certificate::parse(pem).is_ok() && Certificate::from_der(der).is_ok());
    }
    let (started, mut draws) = (Instant::now(), Pcg64::seed_from_u64(7));
    let (mut n_read, mut n_refused) = (0_u64, 0_u64);
    while started.elapsed() < patience {
        for _ in 0..AT_ONCE {
            let one = &genuine[draws.below(genuine.len())];
            if is_read(one, &mut draws) {
                n_read += 1;
            } else {
                n_refused += 1;
            }
        }
    }
    println!("{} certificates, no panic: {n_read} read, {n_refused} refused", n_read + n_refused);
    assert!(n_read > 0 && n_refused > 0);
}
