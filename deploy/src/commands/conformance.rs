//! `leadtime conformance`: our worlds against recorded traces of their public originals.

use std::io::Read as _;
use std::path::Path;

use anyhow::Context as _;
use flate2::read::MultiGzDecoder;
use leadtime_conformance::{Original, Replay};
use leadtime_runs::regular;
use leadtime_table::Table;

use crate::cli::{ConformanceArgs, ConformanceWorld};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, WIDTH};

/// The first bytes of a gzip file.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// The most text that is unpacked: many times any trace file of ours, and far from what memory holds.
const MAX_BYTES: u64 = 1 << 30;

pub(super) fn run(args: &ConformanceArgs) -> Result<(), Failure> {
    let replay = replay(args).blame(ExitCode::WrongInput)?;
    if args.json {
        output::data(&replay.json);
    } else {
        print(&replay);
    }
    if replay.passed { Ok(()) } else { Err(Failure::silent(ExitCode::Failed)) }
}

fn replay(args: &ConformanceArgs) -> anyhow::Result<Replay> {
    let text = read(&args.file)?;
    let original = match args.world {
        ConformanceWorld::Lander => Original::Lander,
        ConformanceWorld::Highway => Original::Highway,
        ConformanceWorld::Steakhouse => Original::Steakhouse,
    };
    original.replay(&text).with_context(|| format!("{} cannot be replayed", args.file.display()))
}

fn print(replay: &Replay) {
    output::line(&format!("recorded by {}", replay.source));
    for section in &replay.sections {
        let mut table = Table::new(section.head.iter().map(|&title| title.to_owned()));
        section.rows.iter().for_each(|row| table.push(row.iter().cloned()));
        output::line(&format!("\n{}\n{}", section.title, table.text_within(WIDTH).trim_end()));
        section.notes.iter().for_each(|note| output::line(note));
    }
    output::line(if replay.passed { "\npassed" } else { "\nfailed" });
}

/// Reads a text file, unpacking it if it is gzip.
fn read(file: &Path) -> anyhow::Result<String> {
    let bytes = regular::read(file).with_context(|| format!("reading {}", file.display()))?;
    if !bytes.starts_with(&GZIP_MAGIC) {
        let text = String::from_utf8(bytes);
        return text.with_context(|| format!("{} is no text", file.display()));
    }
    let mut text = String::new();
    let unpacked = MultiGzDecoder::new(bytes.as_slice()).take(MAX_BYTES).read_to_string(&mut text);
    unpacked.with_context(|| format!("unpacking {}", file.display()))?;
    Ok(text)
}
