//! A trace in a few numbers: what share of its time a thread waited, and for what.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, BufRead};
use std::time::Duration;

use serde::Deserialize;

use crate::span::SpanCategory;
use crate::writer::FULL;

/// What the processes of a trace did.
#[derive(Clone, Debug, Default)]
pub struct TraceSummary {
    /// From the first span to the end of the last.
    pub duration: Duration,
    /// Roles, in the order of their names.
    pub roles: Vec<RoleSummary>,
    /// Whether spans were left out because the file had reached its limit.
    pub is_full: bool,
}

/// What the processes of one role did.
#[derive(Clone, Debug)]
pub struct RoleSummary {
    /// What the processes do in the run.
    pub role: String,
    /// How many processes had it, one after the other or side by side.
    pub n_processes: usize,
    /// Their threads, in the order of their names.
    pub tracks: Vec<TrackSummary>,
}

/// What threads of one name did.
#[derive(Clone, Debug)]
pub struct TrackSummary {
    /// Name that these threads share.
    pub name: String,
    /// The names of waits and work with their shares of the time of their processes, the largest first.
    pub shares: Vec<(String, f64)>,
}

/// An event, as far as it is needed here.
#[derive(Debug, Deserialize)]
struct TraceEvent<'a> {
    #[serde(borrow)]
    name: Cow<'a, str>,
    #[serde(borrow, default)]
    cat: Cow<'a, str>,
    #[serde(borrow)]
    ph: Cow<'a, str>,
    pid: u32,
    tid: u32,
    #[serde(default)]
    ts: f64,
    #[serde(default)]
    dur: f64,
    #[serde(borrow, default)]
    args: EventArgs<'a>,
}

#[derive(Debug, Default, Deserialize)]
struct EventArgs<'a> {
    #[serde(borrow, default)]
    name: Cow<'a, str>,
    #[serde(borrow, default)]
    role: Cow<'a, str>,
}

/// What one process did; times in microseconds.
#[derive(Debug, Default)]
struct ProcessTotals {
    role: String,
    /// Each thread's name and the time of everything it did, by its name.
    threads: BTreeMap<u32, (String, BTreeMap<String, f64>)>,
    /// When its first span began and its last one ended.
    life: Option<(f64, f64)>,
}

impl ProcessTotals {
    fn take(&mut self, event: &TraceEvent<'_>) {
        match &*event.ph {
            "M" if event.name == "process_name" => self.role = event.args.role.to_string(),
            "M" => self.threads.entry(event.tid).or_default().0 = event.args.name.to_string(),
            "X" => {
                let end = event.ts + event.dur;
                let (first, last) = self.life.unwrap_or((event.ts, end));
                self.life = Some((first.min(event.ts), last.max(end)));
                if event.cat != SpanCategory::Detail.name() {
                    let times = &mut self.threads.entry(event.tid).or_default().1;
                    match times.get_mut(&*event.name) {
                        Some(time) => *time += event.dur,
                        None => drop(times.insert(event.name.to_string(), event.dur)),
                    }
                }
            }
            _ => {}
        }
    }
}

impl TraceSummary {
    /// Reads a trace; a line that is no event of ours, such as one that is torn, is passed over.
    ///
    /// # Errors
    ///
    /// What the reader reports if the trace cannot be read or is no text. A line that is no event of ours is no error.
    pub fn read(mut trace: impl BufRead) -> io::Result<Self> {
        let mut processes: BTreeMap<u32, ProcessTotals> = BTreeMap::new();
        let (mut line, mut is_full) = (String::new(), false);
        while trace.read_line(&mut line)? > 0 {
            if let Ok(event) = serde_json::from_str::<TraceEvent<'_>>(line.trim_start_matches(','))
            {
                is_full |= event.name == FULL;
                processes.entry(event.pid).or_default().take(&event);
            }
            line.clear();
        }
        processes.retain(|_, process| process.life.is_some());
        let lives = || processes.values().filter_map(|process| process.life);
        let first = lives().map(|life| life.0).fold(f64::INFINITY, f64::min);
        let last = lives().map(|life| life.1).fold(f64::NEG_INFINITY, f64::max);
        let mut roles: BTreeMap<String, Vec<ProcessTotals>> = BTreeMap::new();
        for process in processes.into_values() {
            roles.entry(process.role.clone()).or_default().push(process);
        }
        Ok(Self {
            duration: Duration::from_secs_f64((last - first).max(0.0) * 1e-6),
            roles: roles.into_iter().map(RoleSummary::of).collect(),
            is_full,
        })
    }
}

impl TraceSummary {
    /// Returns the share of their time that the threads of this name spent on these; `None` if no process has that role.
    pub fn share(&self, role: &str, thread: &str, names: &[&str]) -> Option<f64> {
        let role = self.roles.iter().find(|it| it.role == role)?;
        let shares = role.tracks.iter().filter(|it| it.name == thread).flat_map(|it| &it.shares);
        Some(shares.filter(|(name, _)| names.contains(&&**name)).map(|(_, share)| share).sum())
    }
}

impl RoleSummary {
    fn of((role, processes): (String, Vec<ProcessTotals>)) -> Self {
        let n_processes = processes.len();
        let lives = processes.iter().filter_map(|process| process.life);
        let time: f64 = lives.map(|(first, last)| last - first).sum();
        let mut tracks: BTreeMap<String, BTreeMap<String, f64>> = BTreeMap::new();
        for (track, times) in processes.into_iter().flat_map(|it| it.threads.into_values()) {
            let sums = tracks.entry(track).or_default();
            for (name, took) in times {
                *sums.entry(name).or_default() += took;
            }
        }
        let tracks = tracks.into_iter().map(|(name, sums)| {
            let mut shares: Vec<(String, f64)> =
                sums.into_iter().map(|(name, took)| (name, took / time)).collect();
            shares.sort_by(|a, b| b.1.total_cmp(&a.1));
            TrackSummary { name, shares }
        });
        Self { role, n_processes, tracks: tracks.collect() }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::time::Instant;

    use super::*;
    use crate::span::{TraceSpan, TraceTrack};
    use crate::timed::Timed;
    use crate::writer::{CLOSING, TraceProcess, TraceWriter, opening};

    type Told = (&'static str, SpanCategory, &'static str, u64, u64);

    /// Writes spans of a process: thread, category, name, start and duration in milliseconds.
    fn process(id: u32, role: &str, origin: Instant, spans: &[Told]) -> String {
        let process = TraceProcess { id, role: role.to_owned(), name: format!("{role}-{id}") };
        let mut bytes = Vec::new();
        let mut writer = TraceWriter::new(Cursor::new(&mut bytes), &process);
        for &(thread, category, name, start_ms, duration_ms) in spans {
            let [start, duration] = [start_ms, duration_ms].map(Duration::from_millis);
            let timed = Timed { value: (), start: origin + start, duration };
            let span = TraceSpan::of(TraceTrack::Thread(thread), category, name, &timed);
            writer.span(&span).unwrap();
        }
        writer.flush().unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn shares_are_of_the_time_of_all_processes_of_a_role() {
        use SpanCategory::{Detail, Wait, Work};
        let now = Instant::now();
        let learner = [
            ("train", Wait, "wait for rollouts", 0, 250),
            ("train", Work, "update", 250, 750),
            ("train", Detail, "epochs", 300, 600),
            ("loop", Work, "weights", 100, 10),
        ];
        let first = [("collect", Work, "simulate", 0, 400)];
        let second = [("collect", Work, "simulate", 500, 200), ("collect", Wait, "wait", 700, 400)];
        let mut text = opening(1, 0);
        text += &process(1, "learner", now, &learner);
        text += &process(2, "actor", now, &first);
        text += &process(3, "actor", now, &second);
        let torn = format!("{text},{{\"name\":\"update\",\"cat\":\"wo");
        for text in [text + CLOSING, torn] {
            let summary = TraceSummary::read(text.as_bytes()).unwrap();
            assert!(!summary.is_full);
            // Times are in whole microseconds, cut at both ends.
            let duration = summary.duration.as_secs_f64();
            assert!((duration - 1.1).abs() < 1e-5, "{duration}");
            let found: Vec<String> = summary
                .roles
                .iter()
                .flat_map(|role| role.tracks.iter().map(move |track| (role, track)))
                .map(|(RoleSummary { role, n_processes, .. }, TrackSummary { name, shares })| {
                    let share = |(name, share): &(String, f64)| format!("{name} {share:.2}");
                    let shares: Vec<String> = shares.iter().map(share).collect();
                    format!("{n_processes} {role}, {name}: {}", shares.join(", "))
                })
                .collect();
            assert_eq!(
                found,
                [
                    "2 actor, collect: simulate 0.60, wait 0.40",
                    "1 learner, loop: weights 0.01",
                    "1 learner, train: update 0.75, wait for rollouts 0.25",
                ]
            );
            let share = summary.share("actor", "collect", &["wait", "simulate"]).unwrap();
            assert!((share - 1.0).abs() < 1e-9);
            assert_eq!(summary.share("router", "collect", &["wait"]), None);
        }
    }

    #[test]
    fn nothing_is_an_empty_summary() {
        let summary = TraceSummary::read((opening(1, 0) + CLOSING).as_bytes()).unwrap();
        assert!(summary.roles.is_empty() && summary.duration.is_zero());
    }
}
