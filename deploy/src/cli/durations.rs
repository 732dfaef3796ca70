//! Times on the command line.

use std::time::Duration;

/// The longest time that an option may give.
const LONGEST: Duration = Duration::from_hours(87_600);
/// What is said of a longer one.
pub(super) const TOO_LONG: &str = "at most 87600h, ten years";

/// Reads `60s`, `2m` or `500ms`, up to [`LONGEST`].
pub(super) fn duration(text: &str) -> Result<Duration, String> {
    let span = text.parse::<jiff::SignedDuration>().and_then(Duration::try_from);
    let span = span.map_err(|_unspecific| "write a number with its unit: 60s or 2m".to_owned())?;
    // A moment that the clock cannot count to is no deadline.
    if span > LONGEST { Err(TOO_LONG.to_owned()) } else { Ok(span) }
}
