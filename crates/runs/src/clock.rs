//! The only file that reads the wall clock.

use std::path::Path;
use std::time::{Duration, SystemTime};

use jiff::Timestamp;
use jiff::tz::TimeZone;
use leadtime_proto::Incarnation;

/// Returns this moment by the wall clock.
#[expect(clippy::disallowed_methods, reason = "this is the one file that reads the wall clock")]
pub fn now() -> Timestamp {
    at(SystemTime::now())
}

/// Converts a system time; a clock beyond the last year that a timestamp can hold stands still there.
fn at(time: SystemTime) -> Timestamp {
    Timestamp::try_from(time).unwrap_or(Timestamp::MAX)
}

/// Returns seconds since the Unix epoch, as TensorBoard wants them.
pub fn unix_seconds() -> f64 {
    now().as_nanosecond() as f64 * 1e-9
}

/// Parses a timestamp of a record into seconds since the Unix epoch; `None` if it is malformed.
pub fn unix_seconds_of(text: &str) -> Option<f64> {
    text.parse::<Timestamp>().ok().map(|moment| moment.as_nanosecond() as f64 * 1e-9)
}

/// Returns this moment in UTC, as records keep it: `2026-01-31T12:00:00Z`.
pub fn utc_now() -> String {
    now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}

/// Returns how long ago a file was changed; nothing if that is in the future.
pub fn time_since(changed: SystemTime) -> Duration {
    let nanoseconds = now().as_nanosecond() - at(changed).as_nanosecond();
    Duration::from_nanos(u64::try_from(nanoseconds).unwrap_or(0))
}

/// Returns this moment in UTC, as a log for machines bears it: `2026-01-31T12:00:00.123Z`.
pub fn utc_millis() -> String {
    now().strftime("%Y-%m-%dT%H:%M:%S.%3fZ").to_string()
}

/// Returns today's date in UTC, as tables bear it: `2026-01-31`.
pub fn utc_date() -> String {
    now().strftime("%Y-%m-%d").to_string()
}

/// Returns local date and time as part of a run's name: `20260131-120000`.
pub fn name_stamp() -> String {
    now().to_zoned(TimeZone::system()).strftime("%Y%m%d-%H%M%S").to_string()
}

/// Returns the local time of day, as a log on a terminal bears it: `12:00:00`.
pub fn time_of_day() -> String {
    now().to_zoned(TimeZone::system()).strftime("%H:%M:%S").to_string()
}

/// Returns how long ago a file was written; `None` if it is not there.
pub fn age(path: &Path) -> Option<Duration> {
    let written = std::fs::metadata(path).and_then(|found| found.modified()).ok()?;
    // One from the future was written just now, by a clock that is ahead.
    Some(written.elapsed().unwrap_or_default())
}

/// Draws the number that distinguishes this start of a process from every other: nanoseconds and process id.
pub fn incarnation() -> Incarnation {
    let nanoseconds = now().as_nanosecond() as u64;
    Incarnation(nanoseconds ^ (u64::from(std::process::id()) << 48))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_beyond_the_last_year_stands_still() {
        let last = at(SystemTime::UNIX_EPOCH + Duration::from_hours(70_389_528));
        assert!(last.to_zoned(TimeZone::system()).strftime("%Y").to_string() == "9999");
    }
}
