//! The only place that reads the wall clock.

use jiff::{Timestamp, Zoned};
use leadtime_proto::Incarnation;

/// Returns seconds since the Unix epoch, as TensorBoard wants them.
pub fn unix_seconds() -> f64 {
    Timestamp::now().as_nanosecond() as f64 * 1e-9
}

/// Returns this moment in UTC, as records keep it: `2026-01-31T12:00:00Z`.
pub fn utc_now() -> String {
    Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}

/// Returns today's date in UTC, as tables bear it: `2026-01-31`.
pub fn utc_date() -> String {
    Timestamp::now().strftime("%Y-%m-%d").to_string()
}

/// Returns local date and time as part of a run's name: `20260131-120000`.
pub fn name_stamp() -> String {
    Zoned::now().strftime("%Y%m%d-%H%M%S").to_string()
}

/// Draws the number that tells this start of a process from every other: nanoseconds and process id.
pub fn incarnation() -> Incarnation {
    let nanoseconds = Timestamp::now().as_nanosecond() as u64;
    Incarnation(nanoseconds ^ (u64::from(std::process::id()) << 48))
}
