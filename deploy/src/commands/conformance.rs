//! `leadtime conformance`: our worlds against recorded traces of their public originals.

use std::io::Read as _;
use std::path::Path;

use anyhow::Context as _;
use flate2::read::MultiGzDecoder;
use leadtime_sims::lander::conformance::{self, Report};

use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// The first bytes of a gzip file.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// The most text that is unpacked: many times any trace file of ours, and far from what memory holds.
const MAX_BYTES: u64 = 1 << 30;

pub(super) fn run(file: &Path, json: bool) -> Result<(), Failure> {
    let text = read(file).blame(ExitCode::WrongInput)?;
    let report = conformance::replay(&text)
        .with_context(|| format!("{} cannot be replayed", file.display()))
        .blame(ExitCode::WrongInput)?;
    if json {
        output::json(&report);
    } else {
        print(&report);
    }
    if report.passed { Ok(()) } else { Err(Failure::silent(ExitCode::Failed)) }
}

/// Reads a text file, unpacking it if it is gzip.
fn read(file: &Path) -> anyhow::Result<String> {
    let bytes = std::fs::read(file).with_context(|| format!("reading {}", file.display()))?;
    let text = if bytes.starts_with(&GZIP_MAGIC) {
        let mut text = String::new();
        MultiGzDecoder::new(bytes.as_slice())
            .take(MAX_BYTES)
            .read_to_string(&mut text)
            .with_context(|| format!("unpacking {}", file.display()))?;
        text
    } else {
        String::from_utf8(bytes).with_context(|| format!("{} is no text", file.display()))?
    };
    Ok(text)
}

fn print(report: &Report) {
    output::line(&format!("recorded by {}", report.source));
    for comparison in &report.comparisons {
        let wind = if comparison.wind { "with wind" } else { "without wind" };
        let (n, frames) = (comparison.n_episodes, comparison.n_frames);
        output::line(&format!("\n{wind}: {n} episodes, {frames} frames before first contact"));
        output::line(&format!(
            "{:<18} {:>10} {:>10} {:>10}",
            "component", "maximum", "median", "bound"
        ));
        let (reset, bound) = (comparison.reset_error, report.reset_bound);
        output::line(&format!("{:<18} {reset:>10.2e} {:>10} {bound:>10.2e}", "reset", "-"));
        for error in &comparison.components {
            let mark = if error.maximum <= error.bound { "" } else { "  beyond the bound" };
            output::line(&format!(
                "{:<18} {:>10.2e} {:>10.2e} {:>10.2e}{mark}",
                error.name, error.maximum, error.median, error.bound
            ));
        }
    }
    output::line(if report.passed { "\npassed" } else { "\nfailed" });
}
