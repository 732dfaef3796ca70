//! How messages count, name times, and guess what was meant.

use std::error::Error;
use std::fmt::Display;
use std::time::Duration;

use crate::text::quoted;

/// How similar two names must be for one to be taken for a misspelling of the other: between 0 and 1, as Jaro counts.
const SIMILAR: f64 = 0.8;

/// Writes a number of things: `1 actor`, `2 actors`.
pub fn counted(n: impl Display, thing: &str) -> String {
    let n = n.to_string();
    let ending = if n == "1" { "" } else { "s" };
    format!("{n} {thing}{ending}")
}

/// Writes a time in its two largest units: `2d 03h`, `1h 02m`, `1m 10s`, `9s`; whole days as they are given, `30d`; below a second in
/// tenths, rounded up: `0.5s`.
pub fn duration(time: Duration) -> String {
    if time > Duration::ZERO && time < Duration::from_secs(1) {
        return format!("{}s", (10.0 * time.as_secs_f64()).ceil() / 10.0);
    }
    let seconds = time.as_secs();
    let (days, hours) = (seconds / 86_400, seconds / 3_600 % 24);
    match (days, hours, seconds / 60 % 60, seconds % 60) {
        (0, 0, 0, seconds) => format!("{seconds}s"),
        (0, 0, minutes, seconds) => format!("{minutes}m {seconds:02}s"),
        (0, hours, minutes, _) => format!("{hours}h {minutes:02}m"),
        (days, 0, ..) => format!("{days}d"),
        (days, hours, ..) => format!("{days}d {hours:02}h"),
    }
}

/// Reckons how long the rest takes, in whole seconds, at the pace of what was done in `spent`; `None` before anything was.
pub fn time_left(spent: Duration, n_done: u64, n_left: u64) -> Option<Duration> {
    let seconds = spent.as_secs_f64() * n_left as f64 / n_done as f64;
    if n_done == 0 { None } else { Duration::try_from_secs_f64(seconds.round()).ok() }
}

/// Writes an error and its causes as one sentence.
pub fn with_causes(error: &dyn Error) -> String {
    let causes = std::iter::successors(Some(error), |&error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// Finds the known name that is most similar to a misspelt one; `None` if none is similar.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let rated = known.into_iter().map(|known| (strsim::jaro(name, known), known));
    let similar = rated.filter(|(similarity, _)| *similarity > SIMILAR);
    similar.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, known)| known)
}

/// Asks whether a known name was meant: `; did you mean `clip`?`, or nothing if none is similar.
pub fn did_you_mean<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    nearest(name, known).map_or(String::new(), |known| format!("; did you mean `{known}`?"))
}

/// Says in two sentences that there is no such thing, which one was meant, and which there are; the second one has no full stop.
pub fn no_such<'a>(
    thing: &str,
    name: &str,
    known: impl IntoIterator<Item = &'a str> + Clone,
) -> String {
    let end = match did_you_mean(name, known.clone()) {
        meant if meant.is_empty() => ".".to_owned(),
        meant => meant,
    };
    let known = known.into_iter().collect::<Vec<_>>().join(", ");
    format!("there is no {thing} `{}`{end} Known: {known}", quoted(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_name_is_guessed_in_a_sentence_of_its_own() {
        let known = ["lander", "highway"];
        let guessed = "there is no plan `landr`; did you mean `lander`? Known: lander, highway";
        assert_eq!(no_such("plan", "landr", known), guessed);
        assert_eq!(no_such("plan", "x", known), "there is no plan `x`. Known: lander, highway");
    }

    #[test]
    fn one_thing_is_singular() {
        let counts = [counted(0, "actor"), counted(1, "actor"), counted(2_u64, "actor")];
        assert_eq!(counts, ["0 actors", "1 actor", "2 actors"]);
    }

    #[test]
    fn times_have_two_units_at_most() {
        let text = |seconds| duration(Duration::from_secs(seconds));
        let texts = [0, 9, 60, 70, 3_599, 3_720, 360_000].map(text);
        assert_eq!(texts, ["0s", "9s", "1m 00s", "1m 10s", "59m 59s", "1h 02m", "4d 04h"]);
        let hours = [1, 23, 24, 36, 720].map(|hours| duration(Duration::from_hours(hours)));
        assert_eq!(hours, ["1h 00m", "23h 00m", "1d", "1d 12h", "30d"]);
        assert_eq!(duration(Duration::from_millis(500)), "0.5s");
        assert_eq!(duration(Duration::from_secs_f64(0.186_181_818)), "0.2s");
    }

    #[test]
    fn the_time_left_is_that_of_the_pace_so_far() {
        let left = |n_done| time_left(Duration::from_secs(10), n_done, 471);
        assert_eq!((left(10), left(0)), (Some(Duration::from_secs(471)), None));
    }

    #[test]
    fn a_misspelt_name_is_recognised_and_another_name_is_not() {
        let known = ["lander-1", "lander-2", "cartpole"];
        assert_eq!(nearest("landr-1", known), Some("lander-1"));
        assert_eq!(did_you_mean("cart-pole", known), "; did you mean `cartpole`?");
        assert_eq!(did_you_mean("moon", known), "");
    }
}
