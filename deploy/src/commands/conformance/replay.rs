//! Reading traces, replaying them, and the exit code.

use std::io::Read as _;
use std::path::Path;

use anyhow::Context as _;
use flate2::read::MultiGzDecoder;
use leadtime_sims::{highway as road, lander as flight, steakhouse as kitchen};
use serde::Serialize;

use super::{highway, lander, steakhouse};
use crate::cli::{ConformanceArgs, ConformanceWorld};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// The first bytes of a gzip file.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// The most text that is unpacked: many times any trace file of ours, and far from what memory holds.
const MAX_BYTES: u64 = 1 << 30;

pub(in crate::commands) fn run(args: &ConformanceArgs) -> Result<(), Failure> {
    let passed = compare(args).blame(ExitCode::WrongInput)?;
    if passed { Ok(()) } else { Err(Failure::silent(ExitCode::Failed)) }
}

/// Replays, prints, and tells whether everything is within its bounds.
fn compare(args: &ConformanceArgs) -> anyhow::Result<bool> {
    let text = read(&args.file)?;
    let context = || format!("{} cannot be replayed", args.file.display());
    match args.world {
        ConformanceWorld::Lander => {
            let report = flight::conformance::replay(&text).with_context(context)?;
            show(args, &report, lander::print);
            Ok(report.passed)
        }
        ConformanceWorld::Highway => {
            let report = road::conformance::replay(&text).with_context(context)?;
            show(args, &report, highway::print);
            Ok(report.passed)
        }
        ConformanceWorld::Steakhouse => {
            let report = kitchen::conformance::replay(&text).with_context(context)?;
            show(args, &report, steakhouse::print);
            Ok(report.passed)
        }
    }
}

fn show<R: Serialize>(args: &ConformanceArgs, report: &R, print: fn(&R)) {
    if args.json { output::json(report) } else { print(report) }
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
