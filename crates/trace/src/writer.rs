//! The format: Chrome's trace events as a JSON array, written by several processes into one file.
//!
//! ```text
//! [
//! {"name":"clock_sync", ...}            opening(): who made the file
//! ,{"name":"update","ph":"X", ...}      one event per line, comma first, from any process
//! ]                                     CLOSING: who made the file, when all others are done
//! ```
//!
//! Every process appends whole events with one write at a time, so the file is readable whenever a process is killed: viewers do
//! without the end of the array.
//!
//! The format: *Trace Event Format*, Google (chromium.org); Perfetto reads the same.

use std::fmt::{self, Write as _};
use std::io::{self, Seek, Write};
use std::time::Instant;

use serde_json::{Value, json};

use crate::arrow::TraceArrow;
use crate::clock::TraceClock;
use crate::span::{ArrowEnd, TraceSpan, TraceTrack};

/// The longest file of a trace, of all processes together, in bytes: some 900,000 spans. What comes later is left out, and the file
/// says so. Viewers become slow, or run out of memory, beyond.
pub const MAX_BYTES: u64 = 128 << 20;
/// Bytes that a process keeps before it writes them.
const BUFFER: usize = 64 << 10;
/// The name of the event that says that the file has reached its limit.
pub(crate) const FULL: &str = "the trace is full";
/// The end of a file that is whole.
pub const CLOSING: &str = "]\n";

/// Returns the beginning of a file: what the wall clock shows now, in microseconds since 1970, with the clock of the
/// events.
///
/// With it the files of several machines can be laid over each other.
pub fn opening(process: u32, unix_us: i64) -> String {
    let clock = TraceClock::start();
    let ts = Micros(clock.ns(Instant::now()));
    format!(
        "[\n{{\"name\":\"clock_sync\",\"ph\":\"c\",\"pid\":{process},\"tid\":0,\"ts\":{ts},\"args\":{{\"sync_id\":\"unix\",\
         \"unix_us\":{unix_us}}}}}\n"
    )
}

/// The process that writes a trace.
#[derive(Clone, Debug)]
pub struct TraceProcess {
    /// The system's number of it.
    pub id: u32,
    /// What it does in the run: processes of one role are summed up together.
    pub role: String,
    /// The name that viewers show.
    pub name: String,
}

/// Writes the spans of one process to the end of a file.
#[derive(Debug)]
pub struct TraceWriter<W> {
    out: W,
    clock: TraceClock,
    process: u32,
    /// The threads that have been named, in the order of their numbers.
    threads: Vec<&'static str>,
    n_tasks: u64,
    buffer: String,
    max_bytes: u64,
    is_full: bool,
}

impl<W: Write + Seek> TraceWriter<W> {
    /// Starts with what a process is called; `out` writes to the end of the file.
    pub fn new(out: W, process: &TraceProcess) -> Self {
        let mut writer = Self {
            out,
            clock: TraceClock::start(),
            process: process.id,
            threads: Vec::new(),
            n_tasks: 0,
            buffer: String::with_capacity(BUFFER),
            max_bytes: MAX_BYTES,
            is_full: false,
        };
        let args = json!({"name": process.name, "role": process.role});
        writer.metadata("process_name", 0, &args);
        writer
    }

    /// Returns whether the file has reached its limit: spans are left out from then on.
    pub fn is_full(&self) -> bool {
        self.is_full
    }

    /// Takes a span in; it is written with later ones, or by [`Self::flush`].
    ///
    /// # Errors
    ///
    /// What the file reports if the spans taken in so far cannot be written.
    pub fn span(&mut self, span: &TraceSpan<'_>) -> io::Result<()> {
        if self.is_full {
            return Ok(());
        }
        match span.track {
            TraceTrack::Thread(name) => self.on_thread(name, span),
            TraceTrack::Tasks(_) => self.as_task(span),
        }
        if self.buffer.len() < BUFFER { Ok(()) } else { self.flush() }
    }

    /// Writes what was taken in.
    ///
    /// # Errors
    ///
    /// What the file reports if it cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        self.out.write_all(self.buffer.as_bytes())?;
        self.buffer.clear();
        // Of all processes together, as everyone writes to the end.
        if self.out.stream_position()? < self.max_bytes || self.is_full {
            return Ok(());
        }
        self.is_full = true;
        let (process, now) = (self.process, Micros(self.clock.ns(Instant::now())));
        self.write(format_args!(
            ",{{\"name\":\"{FULL}\",\"ph\":\"i\",\"s\":\"p\",\"pid\":{process},\"tid\":0,\"ts\":{now}}}\n"
        ));
        self.flush()
    }

    /// Returns the number of a thread, which is named the first time.
    fn thread(&mut self, name: &'static str) -> usize {
        if let Some(index) = self.threads.iter().position(|known| *known == name) {
            return index + 1;
        }
        self.threads.push(name);
        let number = self.threads.len();
        self.metadata("thread_name", number, &json!({"name": name}));
        number
    }

    fn metadata(&mut self, name: &str, thread: usize, args: &Value) {
        let process = self.process;
        self.write(format_args!(
            ",{{\"name\":\"{name}\",\"ph\":\"M\",\"pid\":{process},\"tid\":{thread},\"args\":{args}}}\n"
        ));
    }

    fn on_thread(&mut self, thread: &'static str, span: &TraceSpan<'_>) {
        let (number, process) = (self.thread(thread), self.process);
        let (name, category) = (span.name, span.category.name());
        let start = Micros(self.clock.ns(span.start));
        let duration = Micros(span.duration.as_nanos() as u64);
        self.write(format_args!(
            ",{{\"name\":\"{name}\",\"cat\":\"{category}\",\"ph\":\"X\",\"pid\":{process},\"tid\":{number},\"ts\":{start},\
             \"dur\":{duration}"
        ));
        self.details(span);
    }

    /// Writes a task as its begin and its end: so tasks may overlap.
    fn as_task(&mut self, span: &TraceSpan<'_>) {
        self.n_tasks += 1;
        let start = self.clock.ns(span.start);
        self.edge('b', start, span);
        self.details(span);
        self.edge('e', start + span.duration.as_nanos() as u64, span);
        self.buffer.push_str("}\n");
    }

    fn edge(&mut self, phase: char, at: u64, span: &TraceSpan<'_>) {
        let (process, number, ts) = (self.process, self.n_tasks, Micros(at));
        let (name, category) = (span.name, span.category.name());
        self.write(format_args!(
            ",{{\"name\":\"{name}\",\"cat\":\"{category}\",\"ph\":\"{phase}\",\"id\":\"{process}.{number}\",\"pid\":{process},\
             \"tid\":0,\"ts\":{ts}"
        ));
    }

    /// Ends an event with its span's arrow and numbers.
    fn details(&mut self, span: &TraceSpan<'_>) {
        if let Some(arrow) = span.arrow {
            let (end, TraceArrow(name)) = match arrow {
                ArrowEnd::From(arrow) => ("flow_out", arrow),
                ArrowEnd::To(arrow) => ("flow_in", arrow),
            };
            self.write(format_args!(",\"bind_id\":{name},\"{end}\":true"));
        }
        if !span.args.is_empty() {
            self.buffer.push_str(",\"args\":");
            for (index, (name, number)) in span.args.iter().enumerate() {
                let before = if index == 0 { '{' } else { ',' };
                self.write(format_args!("{before}\"{name}\":{number}"));
            }
            self.buffer.push('}');
        }
        self.buffer.push_str("}\n");
    }

    fn write(&mut self, text: fmt::Arguments<'_>) {
        self.buffer.write_fmt(text).expect("memory can be written");
    }
}

/// Nanoseconds, shown as microseconds, the unit of the format.
struct Micros(u64);

impl fmt::Display for Micros {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:03}", self.0 / 1_000, self.0 % 1_000)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::time::Duration;

    use super::*;
    use crate::span::SpanCategory;
    use crate::timed::Timed;

    const TRAIN: TraceTrack = TraceTrack::Thread("train");

    fn writer() -> (TraceWriter<Cursor<Vec<u8>>>, Instant) {
        let process = TraceProcess { id: 12, role: "learner".into(), name: "a \"run\"".into() };
        let mut writer = TraceWriter::new(Cursor::new(Vec::new()), &process);
        let now = Instant::now();
        writer.clock = TraceClock::at(now, 5_000_000_000);
        (writer, now)
    }

    fn span(track: TraceTrack, start: Instant, duration_ns: u64) -> TraceSpan<'static> {
        let duration = Duration::from_nanos(duration_ns);
        let timed = Timed { value: (), start, duration };
        TraceSpan::of(track, SpanCategory::Work, "update", &timed)
    }

    fn text(mut writer: TraceWriter<Cursor<Vec<u8>>>) -> String {
        writer.flush().unwrap();
        String::from_utf8(writer.out.into_inner()).unwrap()
    }

    #[test]
    fn every_line_is_an_event_as_viewers_read_it() {
        let (mut writer, now) = writer();
        let (args, arrow) = ([("version", 3), ("rollouts", 8)], TraceArrow::of_rollout(1, 2));
        let update = span(TRAIN, now + Duration::from_nanos(1_234), 5_006);
        writer.span(&update.with(&args).linked(Some(ArrowEnd::To(arrow)))).unwrap();
        writer.span(&span(TraceTrack::Tasks("pull"), now, 2_000).with(&[("version", 4)])).unwrap();
        let bind = arrow.0;
        let expected = [
            r#",{"name":"process_name","ph":"M","pid":12,"tid":0,"args":{"name":"a \"run\"","role":"learner"}}"#,
            r#",{"name":"thread_name","ph":"M","pid":12,"tid":1,"args":{"name":"train"}}"#,
            &format!(
                r#",{{"name":"update","cat":"work","ph":"X","pid":12,"tid":1,"ts":5000001.234,"dur":5.006,"bind_id":{bind},"flow_in":true,"args":{{"version":3,"rollouts":8}}}}"#
            ),
            r#",{"name":"update","cat":"work","ph":"b","id":"12.1","pid":12,"tid":0,"ts":5000000.000,"args":{"version":4}}"#,
            r#",{"name":"update","cat":"work","ph":"e","id":"12.1","pid":12,"tid":0,"ts":5000002.000}"#,
        ];
        let written = text(writer);
        assert_eq!(written.lines().collect::<Vec<_>>(), expected);
        let whole = format!("{}{written}{CLOSING}", opening(12, 1_800_000_000_000_000));
        let events: Vec<Value> = serde_json::from_str(&whole).unwrap();
        assert_eq!(events.len(), 6);
    }

    #[test]
    fn a_full_file_says_so_once_and_takes_no_more() {
        let (mut writer, now) = writer();
        writer.max_bytes = 3 * BUFFER as u64;
        let mut n_spans = 0;
        while !writer.is_full() {
            writer.span(&span(TRAIN, now, 1)).unwrap();
            n_spans += 1;
            assert!(n_spans < 10_000, "it never gets full");
        }
        writer.span(&span(TRAIN, now, 1)).unwrap();
        let written = text(writer);
        assert_eq!(written.matches("\"X\"").count(), n_spans);
        assert_eq!(written.matches(FULL).count(), 1);
        assert!((3 * BUFFER..4 * BUFFER + 500).contains(&written.len()), "{}", written.len());
    }
}
