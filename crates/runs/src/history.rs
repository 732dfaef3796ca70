//! What observers receive about a run: its description, its history, and each of its updates.
//!
//! The history is `metrics.jsonl`, thinned to the number of points asked for and compressed:
//!
//! ```text
//! {"schema": 1, "from": 0, "to": 412, "started": 1769860800.0, "x": [1, 2, ...], "stride": 1,
//!  "scalars": {"train/entropy": {"min": [...], "max": [...]}, "elapsed": ..., ...},
//!  "staleness": [[313, {"0": 3, "1": 29}], ...], "last": {the newest line}, "skipped": 0}
//! ```
//!
//! `elapsed` is the time since the first update, in seconds; `staleness` has the last hundred updates; `skipped` counts
//! lines that cannot be read, such as a torn last one.

use std::collections::{BTreeMap, VecDeque};
use std::fs::{File, Metadata};
use std::io::{self, BufRead as _, BufReader, Seek as _, SeekFrom, Write as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use flate2::Compression;
use flate2::write::GzEncoder;
use leadtime_config::Config;
use leadtime_link::Archive;
use leadtime_numerics::thin::{Extremes, ThinSeries};
use leadtime_proto::Schedule;
use leadtime_proto::limits::MAX_METRICS_BYTES;
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::journal::JOURNAL;
use crate::{RunRecord, clock, regular};

/// The version of the layout of the messages to observers.
pub const SCHEMA: u32 = 1;
/// How many of the last updates have their staleness listed one by one.
const N_STALENESS: usize = 100;
/// The name under which the time since the first update is plotted.
const ELAPSED: &str = "elapsed";

/// Says what a run is.
pub fn about(config: &Config, run: &str, directory: &Path) -> Value {
    let schedule = match config.learner.schedule() {
        Schedule::Lag(0) => json!({"mode": "sync"}),
        Schedule::Lag(lag) => json!({"mode": "lag", "lag": lag}),
        Schedule::Async { staleness_max } => {
            json!({"mode": "async", "staleness_max": staleness_max})
        }
    };
    let record = RunRecord::read(directory).ok();
    json!({
        "schema": SCHEMA,
        "run": run,
        "domain": config.domain.as_str(),
        "seed": config.seed,
        "config": config.table.to_string(),
        "total_updates": config.learner.n_updates(),
        "steps_per_update": config.steps_per_update(),
        "n_envs": config.learner.n_envs,
        "schedule": schedule,
        "knows_success": config.env.metrics.iter().any(|name| name == "success"),
        "version": env!("CARGO_PKG_VERSION"),
        "started": record.map(|record| record.started),
    })
}

/// Converts an update's line into the message for observers.
pub(crate) fn bulletin(line: &Value) -> Vec<u8> {
    let mut told = line.clone();
    told["kind"] = "update".into();
    told["made"] = clock::unix_seconds().into();
    told.to_string().into_bytes()
}

/// Returns what a learner's observers may ask for.
pub(crate) fn archive(about: &Value, directory: &Path) -> Archive {
    let directory = PathBuf::from(directory);
    let history = move |from, n_points| {
        compressed(&directory, from, n_points)
            .map_err(|error| format!("the metrics cannot be read: {error}"))
    };
    Archive { about: about.to_string().into_bytes(), history: Arc::new(history) }
}

/// Compresses a run's history; one that would be too large gets fewer points.
fn compressed(directory: &Path, from: u64, n_points: usize) -> io::Result<Vec<u8>> {
    let mut n_points = n_points;
    loop {
        // As text, not as values: there a number has the digits of one twice as precise.
        let text = serde_json::to_vec(&told(directory, from, n_points)?)?;
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(&text)?;
        let bytes = encoder.finish()?;
        if bytes.len() <= MAX_METRICS_BYTES || n_points <= 2 {
            return Ok(bytes);
        }
        n_points /= 2;
    }
}

/// Reads a run's history from an update on, in at most `n_points` points; empty before the first update.
///
/// # Errors
///
/// If the file is there and cannot be read.
pub fn read(directory: &Path, from: u64, n_points: usize) -> io::Result<Value> {
    Ok(json!(told(directory, from, n_points)?))
}

fn told(directory: &Path, from: u64, n_points: usize) -> io::Result<ToldHistory> {
    let series = ThinSeries::new(n_points);
    let mut history = ThinHistory { series, ..ThinHistory::default() };
    if let Some(file) = regular::if_there(regular::open(&directory.join(JOURNAL)))? {
        history.read(BufReader::new(file), from)?;
    }
    Ok(history.told(from))
}

/// Reads what is appended to a run's metrics.
#[derive(Debug)]
pub struct JournalTail {
    path: PathBuf,
    offset: u64,
    /// The file that was read last, by its device and number: a rewind puts another one in its place.
    file: Option<(u64, u64)>,
}

impl JournalTail {
    /// Begins at the beginning.
    pub fn new(directory: &Path) -> Self {
        Self { path: directory.join(JOURNAL), offset: 0, file: None }
    }

    /// Skips everything that is in the file now.
    pub fn skip_to_end(&mut self) {
        let found = std::fs::metadata(&self.path).ok();
        self.offset = found.as_ref().map_or(0, Metadata::len);
        self.file = found.map(|found| (found.dev(), found.ino()));
    }

    /// Returns the whole lines that were appended since the last call; `None` if the file was rewound.
    ///
    /// # Errors
    ///
    /// If the file is there and cannot be read.
    pub fn new_lines(&mut self) -> io::Result<Option<Vec<Map<String, Value>>>> {
        let Some(mut file) = regular::if_there(regular::open(&self.path))? else {
            return Ok(Some(Vec::new()));
        };
        let metadata = file.metadata()?;
        let (length, found) = (metadata.len(), (metadata.dev(), metadata.ino()));
        let is_another = self.file.replace(found).is_some_and(|before| before != found);
        if is_another || length < self.offset {
            self.offset = length;
            return Ok(None);
        }
        file.seek(SeekFrom::Start(self.offset))?;
        let (mut lines, mut line, mut file) = (Vec::new(), Vec::new(), BufReader::new(file));
        while file.read_until(b'\n', &mut line)? > 0 && line.ends_with(b"\n") {
            self.offset += line.len() as u64;
            lines.extend(serde_json::from_slice(&line).ok());
            line.clear();
        }
        Ok(Some(lines))
    }
}

/// A history in the making.
#[derive(Debug, Default)]
struct ThinHistory {
    series: ThinSeries,
    /// When the first update was made, in seconds since the Unix epoch.
    started: Option<f64>,
    staleness: VecDeque<(u64, Value)>,
    last: Map<String, Value>,
    n_skipped: u64,
}

impl ThinHistory {
    fn read(&mut self, mut file: BufReader<File>, from: u64) -> io::Result<()> {
        let mut line = Vec::new();
        while file.read_until(b'\n', &mut line)? > 0 {
            let parsed = serde_json::from_slice::<Map<String, Value>>(&line).ok();
            let update = parsed.as_ref().and_then(|line| line.get("update")?.as_u64());
            match parsed.zip(update) {
                Some((parsed, update)) => self.take_in(parsed, update, from),
                None => self.n_skipped += 1,
            }
            line.clear();
        }
        Ok(())
    }

    fn take_in(&mut self, line: Map<String, Value>, update: u64, from: u64) {
        let time = line.get("time").and_then(|time| clock::unix_seconds_of(time.as_str()?));
        self.started = self.started.or(time);
        if update >= from {
            let elapsed = time.zip(self.started).map(|(now, started)| (ELAPSED, now - started));
            let plotted = line.iter().filter(|(name, _)| name.contains('/'));
            let numbers =
                plotted.filter_map(|(name, value)| Some((name.as_str(), value.as_f64()?)));
            self.series.push(update, numbers.chain(elapsed));
            if let Some(staleness) = line.get("staleness") {
                self.staleness.push_back((update, staleness.clone()));
            }
            if self.staleness.len() > N_STALENESS {
                self.staleness.pop_front();
            }
        }
        self.last = line;
    }

    fn told(self, from: u64) -> ToldHistory {
        let Self { series, started, staleness, last, n_skipped } = self;
        ToldHistory {
            schema: SCHEMA,
            from,
            to: series.last(),
            started,
            stride: series.stride(),
            x: series.x,
            scalars: series.scalars,
            staleness,
            last,
            skipped: n_skipped,
        }
    }
}

/// A history as it is told.
#[derive(Debug, Serialize)]
struct ToldHistory {
    schema: u32,
    from: u64,
    to: u64,
    started: Option<f64>,
    x: Vec<u64>,
    stride: u64,
    scalars: BTreeMap<String, Extremes>,
    staleness: VecDeque<(u64, Value)>,
    last: Map<String, Value>,
    skipped: u64,
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Read as _;

    use flate2::read::GzDecoder;
    use serde::Deserialize as _;

    use super::*;

    fn line(update: u64) -> String {
        let time = format!("2026-01-31T12:{:02}:{:02}Z", update / 60 % 60, update % 60);
        let line = json!({
            "update": update, "steps": update * 64, "time": time, "staleness": {"0": 1, "1": 7},
            "refusals": {}, "train/entropy": 1.0 / update as f64, "system/actors": 2,
        });
        format!("{line}\n")
    }

    fn written(n: u64) -> tempfile::TempDir {
        let run = tempfile::tempdir().unwrap();
        let text: String = (1..=n).map(line).collect();
        fs::write(run.path().join("metrics.jsonl"), text + "{\"update\": 9999, \"ste").unwrap();
        run
    }

    #[test]
    fn a_history_is_thinned_and_a_torn_line_is_counted() {
        let run = written(300);
        let told = read(run.path(), 0, 100).unwrap();
        let x = told["x"].as_array().unwrap();
        assert!((50..=100).contains(&x.len()), "{}", x.len());
        assert_eq!((&told["to"], &told["skipped"]), (&json!(300), &json!(1)));
        assert_eq!(told["scalars"]["train/entropy"]["max"][0], 1.0);
        assert_eq!(told["scalars"]["elapsed"]["max"][x.len() - 1], 299.0);
        assert_eq!(told["staleness"].as_array().unwrap().len(), N_STALENESS);
        assert_eq!(told["last"]["steps"], 300 * 64);
        let end = read(run.path(), 290, 100).unwrap();
        assert_eq!(end["x"].as_array().unwrap().len(), 11);
        assert_eq!(end["scalars"]["elapsed"]["min"][0], 289.0, "since the run's first update");
    }

    #[test]
    fn appended_lines_are_read_once_and_a_rewound_file_is_noticed() {
        let run = tempfile::tempdir().unwrap();
        let path = run.path().join("metrics.jsonl");
        let mut tail = JournalTail::new(run.path());
        assert_eq!(tail.new_lines().unwrap(), Some(Vec::new()));
        fs::write(&path, line(1) + &line(2)).unwrap();
        tail.skip_to_end();
        let torn = line(4);
        fs::write(&path, line(1) + &line(2) + &line(3) + &torn[..9]).unwrap();
        let new = tail.new_lines().unwrap().unwrap();
        assert_eq!((new.len(), &new[0]["update"]), (1, &json!(3)));
        fs::write(&path, line(1) + &line(2) + &line(3) + &torn).unwrap();
        assert_eq!(tail.new_lines().unwrap().unwrap()[0]["update"], 4, "the rest of the torn line");
        fs::write(&path, line(1)).unwrap();
        assert_eq!(tail.new_lines().unwrap(), None);
        // Rewound, and longer again before anybody looked.
        leadtime_learner::write_atomically(&path, (1..9).map(line).collect::<String>().as_bytes())
            .unwrap();
        assert_eq!(tail.new_lines().unwrap(), None);
        assert_eq!(tail.new_lines().unwrap(), Some(Vec::new()));
    }

    #[test]
    fn a_run_without_updates_has_an_empty_history() {
        let run = tempfile::tempdir().unwrap();
        let told = read(run.path(), 0, 100).unwrap();
        assert_eq!((&told["x"], &told["to"], &told["last"]), (&json!([]), &json!(0), &json!({})));
    }

    #[test]
    fn a_compressed_history_can_be_read() {
        let run = written(50);
        let bytes = compressed(run.path(), 0, 100).unwrap();
        let mut text = String::new();
        GzDecoder::new(bytes.as_slice()).read_to_string(&mut text).unwrap();
        let told = serde_json::from_str::<ThinSeries>(&text).unwrap();
        assert_eq!(told, ThinSeries::deserialize(&read(run.path(), 0, 100).unwrap()).unwrap());
        assert!(text.contains("[1.0,0.5,0.33333,0.25,"), "no more digits than there are: {text}");
    }
}
