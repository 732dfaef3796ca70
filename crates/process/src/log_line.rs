//! A line of the log as one JSON object, for machines.
//!
//! ```text
//! {"time":"2026-01-31T12:00:00.123Z","level":"info","target":"leadtime::sink","message":"...","run":"a","fields":{}}
//! ```

use std::fmt;
use std::sync::OnceLock;

use leadtime_runs::clock;
use serde_json::{Map, Value, json};
use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

/// The run and the actor that every line of this process is about, once they are known.
static RUN: OnceLock<String> = OnceLock::new();
static ACTOR: OnceLock<String> = OnceLock::new();

/// Says which run this process works for; the first one counts.
pub fn is_about_run(name: &str) {
    RUN.get_or_init(|| name.to_owned());
}

/// Says which actor this process is; the first one counts.
pub fn is_about_actor(id: &str) {
    ACTOR.get_or_init(|| id.to_owned());
}

/// Writes events as lines of JSON.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JsonLine;

impl<S, N> FormatEvent<S, N> for JsonLine
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        _context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let mut fields = EventFields::default();
        event.record(&mut fields);
        let metadata = event.metadata();
        let level = metadata.level().as_str().to_lowercase();
        let line = json_line(&level, metadata.target(), &fields.message, fields.others);
        writeln!(writer, "{line}")
    }
}

/// Returns a line of the log as JSON, of now and of this process.
pub(crate) fn json_line(
    level: &str,
    target: &str,
    message: &str,
    fields: Map<String, Value>,
) -> Value {
    let mut line = json!({
        "time": clock::utc_millis(),
        "level": level,
        "target": target,
        "message": message,
    });
    for (key, value) in [("run", &RUN), ("actor", &ACTOR)] {
        if let Some(value) = value.get() {
            line[key] = value.as_str().into();
        }
    }
    line["fields"] = Value::Object(fields);
    line
}

/// What an event says, and with which values.
#[derive(Debug, Default)]
struct EventFields {
    message: String,
    others: Map<String, Value>,
}

impl EventFields {
    fn keep(&mut self, field: &Field, value: Value) {
        match (field.name(), value) {
            ("message", Value::String(text)) => self.message = text,
            (name, value) => drop(self.others.insert(name.to_owned(), value)),
        }
    }
}

impl Visit for EventFields {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.keep(field, format!("{value:?}").into());
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.keep(field, value.into());
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.keep(field, value.into());
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.keep(field, value.into());
    }

    fn record_f64(&mut self, field: &Field, value: f64) {
        self.keep(field, value.into());
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.keep(field, value.into());
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Kept {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn every_event_is_one_object_on_one_line() {
        let kept = Kept::default();
        let writer = kept.clone();
        let subscriber = tracing_subscriber::fmt()
            .event_format(JsonLine)
            .with_writer(move || writer.clone())
            .finish();
        tracing::subscriber::with_default(subscriber, || {
            tracing::warn!(n = 3, who = %"a\nb", ok = true, "two\nlines {}", 7);
            tracing::info!("plain");
        });
        let text = String::from_utf8(kept.0.lock().unwrap().clone()).unwrap();
        let lines: Vec<Value> =
            text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines.len(), 2, "{text}");
        assert_eq!(lines[0]["message"], "two\nlines 7");
        assert_eq!(lines[0]["level"], "warn");
        assert_eq!(lines[0]["fields"], json!({"n": 3, "who": "a\nb", "ok": true}));
        assert_eq!(lines[1]["fields"], json!({}));
        let time = lines[1]["time"].as_str().unwrap();
        assert!(time.len() == 24 && time.ends_with('Z'), "{time}");
        assert_eq!(lines[1]["target"], "leadtime_process::log_line::tests");
    }
}
