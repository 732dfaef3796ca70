//! The file of `--trace`: who makes it, who writes to it, and what is said of it at the end.
//!
//! `up` makes the file and ends it; its learner and actors write to its end, also those that are started again. A learner or an actor of
//! its own does both. A file that cannot be written ends no run.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;
use std::process;

use leadtime_proto::phrase::{counted, duration};
use leadtime_runs::clock;
use leadtime_trace::{
    CLOSING, RoleSummary, TraceProcess, TraceSpan, TraceSummary, TraceWriter, TrackSummary, opening,
};

use crate::error::Error;
use crate::new_file::NewFile;

/// How many shares of a thread's time are listed at most.
const N_SHARES: usize = 4;
/// The smallest share that is listed.
const MIN_SHARE: f64 = 0.01;
/// The share of its time from which on somebody waits much.
const MUCH: f64 = 0.1;

/// The file, in the process that makes it. One without any span is removed again.
#[derive(Debug)]
pub struct TraceFile(NewFile);

impl TraceFile {
    /// Makes the file if one is asked for.
    ///
    /// # Errors
    ///
    /// [`Error::Trace`] if it is there already, or the system refuses it.
    pub fn create(path: Option<&Path>) -> Result<Option<Self>, Error> {
        let Some(path) = path else { return Ok(None) };
        let refused = |source| Error::Trace { path: path.to_owned(), source };
        let file = NewFile::create(path).map_err(refused)?;
        let head = opening(process::id(), clock::now().as_microsecond());
        append(path, &head).map_err(refused)?;
        Ok(Some(Self(file)))
    }

    /// Ends the file, once nobody else writes to it, and returns what is to be said of what it shows.
    pub fn finish(mut self) -> Option<String> {
        let path = self.0.path();
        let read = || TraceSummary::read(BufReader::new(File::open(path)?));
        let summary = append(path, CLOSING).and_then(|()| read());
        let told = match summary {
            Ok(summary) if summary.roles.is_empty() => return None,
            Ok(summary) => Some(describe(path, &summary)),
            Err(error) => {
                warn_of(path, &error);
                None
            }
        };
        self.0.keep();
        told
    }
}

/// Says that a trace cannot be written, which ends no run.
fn warn_of(path: &Path, error: &io::Error) {
    tracing::warn!("cannot write a trace to {}: {error}", path.display());
}

fn append(path: &Path, text: &str) -> io::Result<()> {
    io::Write::write_all(&mut File::options().append(true).open(path)?, text.as_bytes())
}

/// Says who waited for whom, in a few lines.
fn describe(path: &Path, summary: &TraceSummary) -> String {
    let (shown, lasted) = (path.display(), duration(summary.duration));
    let head = format!("\nTrace: {shown} has {lasted}; open it at https://ui.perfetto.dev");
    let full = summary.is_full.then(|| "  It is full: what came later is not in it.".to_owned());
    // The learner first: what it waits for is what the others are to be asked about.
    let tracks = summary.roles.iter().rev().flat_map(|role| {
        let RoleSummary { role, n_processes, tracks } = role;
        let who = if *n_processes == 1 { role.clone() } else { counted(n_processes, role) };
        tracks.iter().filter_map(move |track| Some(format!("  {who:<9} {}", shares(track)?)))
    });
    let limit = limit(summary).map(|limit| format!("  {limit}"));
    let lines: Vec<String> = [head].into_iter().chain(full).chain(tracks).chain(limit).collect();
    lines.join("\n")
}

/// Says what keeps the run from being faster, if learner and actors are both in the trace.
fn limit(summary: &TraceSummary) -> Option<&'static str> {
    let learner = summary.share("learner", "train", &["wait for rollouts"])?;
    let actors = summary.share("actor", "collect", &["wait for weights", "wait for credit"])?;
    Some(match (learner >= MUCH, actors >= MUCH) {
        (false, true) => "Learning is the limit: more actors would change little.",
        (true, false) => "Acting is the limit: more actors would help, on cores that are free.",
        (true, true) => {
            "Both wait, in turn: a larger learner.lag (mode \"lag\") lets acting run further ahead."
        }
        (false, false) => "Nobody waits much: acting and learning are in balance.",
    })
}

/// Lists the largest shares of a thread's time; `None` if all are small.
fn shares(track: &TrackSummary) -> Option<String> {
    let shares = track.shares.iter().filter(|(_, share)| *share >= MIN_SHARE).take(N_SHARES);
    let shares: Vec<String> =
        shares.map(|(name, share)| format!("{name} {:.0} %", 100.0 * share)).collect();
    (!shares.is_empty()).then(|| format!("{:<9} {}", track.name, shares.join(", ")))
}

/// What one process writes to the file.
#[derive(Debug)]
pub struct ProcessTrace {
    /// `None` once it could not be written.
    writer: Option<TraceWriter<File>>,
    has_told_full: bool,
}

impl ProcessTrace {
    /// Opens the file to write to its end, if a trace is asked for.
    pub fn join(path: Option<&Path>, role: &str, name: &str) -> Option<Self> {
        let path = path?;
        match File::options().append(true).open(path) {
            Ok(file) => {
                let (role, name) = (role.to_owned(), name.to_owned());
                let process = TraceProcess { id: process::id(), role, name };
                let writer = Some(TraceWriter::new(file, &process));
                Some(Self { writer, has_told_full: false })
            }
            Err(error) => {
                warn_of(path, &error);
                None
            }
        }
    }

    /// Takes a span in.
    pub fn span(&mut self, span: &TraceSpan<'_>) {
        self.write(|writer| writer.span(span));
    }

    /// Writes what was taken in, so that it is there if the process is killed.
    pub fn flush(&mut self) {
        self.write(TraceWriter::flush);
    }

    fn write(&mut self, write: impl FnOnce(&mut TraceWriter<File>) -> io::Result<()>) {
        let Some(writer) = &mut self.writer else { return };
        if let Err(error) = write(writer) {
            tracing::warn!("the trace ends here, as it cannot be written: {error}");
            self.writer = None;
        } else if writer.is_full() && !std::mem::replace(&mut self.has_told_full, true) {
            tracing::info!("the trace is full: what comes now is not in it");
        }
    }
}

impl Drop for ProcessTrace {
    fn drop(&mut self) {
        self.flush();
    }
}
