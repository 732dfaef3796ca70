//! Reads what arrives on a robot's own key, and gives it the number and the time that it does not bring.
//!
//! | what is with or in it | number | time |
//! |---|---|---|
//! | `seq` and `t` of our JSON | its own, counted on after a restart | the same |
//! | the attachment of `rmw_zenoh` | its source's | its source's |
//! | nothing | one more than the last: the order of arrival | that of its arrival |
//!
//! Without a time of its own, an observation that waited somewhere on its way cannot be distinguished from a new one.
//!
//! Sources come and go: a robot's program is started again and counts from 1. So numbers and times are counted on from the
//! last observation whenever another source begins. That may be once the one before has been silent; two at once would tear what
//! is observed, so the second one is refused.

use crate::observation::{BadObservation, LiveObservation, ObservationHead};
use crate::robot::form::RobotForm;
use crate::robot::ros2::SourceMark;

/// By how much the number of a robot that counts itself, or of a source, may rise at once.
const MAX_LEAP: i128 = 1 << 53;
/// The latest time of a source, which counts from its first observation, in seconds: some thirty years.
const MAX_CLOCK_LEAP: f64 = 1e9;

/// What a session knows of the observation before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrived {
    /// Its number; `None` before the first.
    pub(crate) seq: Option<u64>,
    /// Its time, in seconds.
    pub(crate) t: f64,
    /// When it arrived, in nanoseconds; `None` before the first of this process.
    pub(crate) at: Option<u64>,
}

/// A source whose observations are taken.
#[derive(Clone, Copy, Debug)]
struct KnownSource {
    gid: Option<[u8; 16]>,
    /// What its own numbers have to be raised by.
    raise: i128,
    /// A moment of its clock in nanoseconds, and what it is in the session's time in seconds.
    moment: (i64, f64),
}

/// Reads a robot's observations.
#[derive(Clone, Debug)]
pub(crate) struct RobotReader {
    form: RobotForm,
    /// After which silence another source may begin, in nanoseconds.
    patience: u64,
    source: Option<KnownSource>,
    /// What the numbers and times of a robot that counts itself are raised by.
    raise: (i128, f64),
}

impl RobotReader {
    pub(crate) fn new(form: RobotForm, patience: u64) -> Self {
        Self { form, patience, source: None, raise: (0, 0.0) }
    }

    /// Reads an observation that arrived at `at`, in nanoseconds; returns whether it is the first of a source, with
    /// whose clock nothing before can be compared.
    ///
    /// # Errors
    ///
    /// [`BadObservation`] if the form cannot be read, if the attachment is not that of `rmw_zenoh`, if a second
    /// source sends while the first one is not silent, or if the number leaps while its source is not silent.
    pub(crate) fn read(
        &mut self,
        into: &mut LiveObservation,
        payload: &[u8],
        beside: Option<&[u8]>,
        at: u64,
        last: Arrived,
    ) -> Result<bool, BadObservation> {
        let is_numbered = self.form.read(into, payload)?;
        let is_quiet = last.at.is_none_or(|before| at.saturating_sub(before) > self.patience);
        if is_numbered {
            return self.count_on(&mut into.head, last, is_quiet);
        }
        let mark = match (self.form, beside) {
            (RobotForm::Ros2, Some(beside)) => {
                let mark = SourceMark::read(beside);
                Some(mark.ok_or(BadObservation::SourceMark(beside.len()))?)
            }
            _ => None,
        };
        let gid = mark.map(|mark| mark.gid);
        let next = last.seq.map_or(1, |seq| seq.saturating_add(1));
        let number = mark.map_or(i128::from(next), |mark| i128::from(mark.number));
        let clock = mark.map_or(i64::try_from(at).unwrap_or(i64::MAX), |mark| mark.time);
        let source = match self.source {
            Some(source) if source.gid != gid && !is_quiet => {
                return Err(BadObservation::TwoSources);
            }
            Some(source) if source.gid == gid => Some(source),
            _ => None,
        };
        let leap = source.zip(mark).zip(last.seq).and_then(|((source, mark), before)| {
            let ahead = number + source.raise - i128::from(before);
            (ahead > MAX_LEAP).then_some(mark.number)
        });
        if let Some(leap) = leap.filter(|_| !is_quiet) {
            return Err(BadObservation::SourceLeap(leap));
        }
        // One that goes on counting there after a silence begins anew.
        let known = source.filter(|_| leap.is_none()).and_then(|source| {
            let raise = if mark.is_some() { source.raise } else { 0 };
            let seq = u64::try_from(number + raise).unwrap_or(0);
            let (moment, t) = source.moment;
            let t = t + clock.saturating_sub(moment) as f64 * 1e-9;
            // A clock that was set back begins anew, and so does a source that was silent and counts from where it was before.
            // So does one that leaps by decades: one without a battery is set, or a time is damaged.
            let is_anew = if seq < next { is_quiet } else { t < last.t || t > MAX_CLOCK_LEAP };
            (!is_anew).then_some((seq, t))
        });
        let is_first = known.is_none();
        let (seq, t) = known.unwrap_or_else(|| {
            let raise = i128::from(next) - number;
            self.source = Some(KnownSource { gid, raise, moment: (clock, last.t) });
            (next, last.t)
        });
        (into.head.seq, into.head.t) = (seq, t);
        Ok(is_first)
    }

    /// Raises the number and the time of a robot that counts itself. Once it was silent and is behind where it was, it has begun
    /// anew; returns whether that is so. A leap is no count: after it nothing would be new any more.
    fn count_on(
        &mut self,
        head: &mut ObservationHead,
        last: Arrived,
        is_quiet: bool,
    ) -> Result<bool, BadObservation> {
        let own = (i128::from(head.seq), head.t);
        let ahead = last.seq.map(|before| own.0 + self.raise.0 - i128::from(before));
        let is_leap = ahead.is_some_and(|ahead| ahead > MAX_LEAP);
        if is_leap && !is_quiet {
            return Err(BadObservation::Leap(head.seq));
        }
        let is_behind = ahead.is_some_and(|ahead| ahead <= 0 || own.1 + self.raise.1 < last.t);
        let is_first = is_quiet && (is_behind || is_leap);
        if is_first {
            let next = last.seq.map_or(1, |before| before.saturating_add(1));
            self.raise = (i128::from(next) - own.0, last.t - own.1);
        }
        head.seq = u64::try_from((own.0 + self.raise.0).max(0)).unwrap_or(u64::MAX);
        head.t = if is_first { last.t } else { own.1 + self.raise.1 };
        Ok(is_first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const OLD: [u8; 16] = [1; 16];
    const NEW: [u8; 16] = [2; 16];

    /// Everything after an empty array of two numbers.
    fn message() -> Vec<u8> {
        [&[0, 1, 0, 0][..], &[0; 8], &[2, 0, 0, 0], &[0; 8]].concat()
    }

    struct Bench {
        reader: RobotReader,
        observation: LiveObservation,
        last: Arrived,
    }

    impl Bench {
        fn new(form: RobotForm) -> Self {
            let reader = RobotReader::new(form, 1_000 * MS);
            let last = Arrived { seq: None, t: 0.0, at: None };
            Self { reader, observation: LiveObservation::new(2), last }
        }

        /// Reads a message and takes it, if it is newer than the last one, as a session does.
        fn arrive(
            &mut self,
            ms: u64,
            payload: &[u8],
            beside: Option<&[u8]>,
        ) -> Result<(u64, f64, bool), String> {
            let at = 3_600_000 * MS + ms * MS;
            let read = self.reader.read(&mut self.observation, payload, beside, at, self.last);
            let is_first = read.map_err(|error| error.to_string())?;
            let head = self.observation.head;
            if self.last.seq.is_none_or(|last| head.seq > last) {
                self.last = Arrived { seq: Some(head.seq), t: head.t, at: Some(at) };
            }
            Ok((head.seq, (head.t * 1e3).round() / 1e3, is_first))
        }

        fn ros(
            &mut self,
            ms: u64,
            gid: [u8; 16],
            number: i64,
            time_ms: i64,
        ) -> Result<(u64, f64, bool), String> {
            let time = 1_796_000_000_000_000_000 + time_ms * MS as i64;
            let mark = SourceMark { number, time, gid };
            self.arrive(ms, &message(), Some(&mark.write()))
        }
    }

    #[test]
    fn without_numbers_order_and_time_are_those_of_arrival() {
        let numbers = [0_u8; 8];
        let mut bench = Bench::new(RobotForm::F32);
        assert_eq!(bench.arrive(0, &numbers, None), Ok((1, 0.0, true)));
        assert_eq!(bench.arrive(50, &numbers, None), Ok((2, 0.05, false)));
        assert_eq!(bench.arrive(9_000, &numbers, None), Ok((3, 9.0, false)));
        // After a restart the numbers go on.
        let mut bench = Bench::new(RobotForm::Cdr);
        bench.last = Arrived { seq: Some(40), t: 12.5, at: None };
        assert_eq!(bench.arrive(10, &message(), None), Ok((41, 12.5, true)));
        assert_eq!(bench.arrive(20, &message(), None), Ok((42, 12.51, false)));
        // JSON may bring its own.
        let mut bench = Bench::new(RobotForm::Json);
        assert_eq!(bench.arrive(0, br#"{"obs":[1,2]}"#, None), Ok((1, 0.0, true)));
        let own = br#"{"obs":[1,2],"seq":7,"t":2.5}"#;
        assert_eq!(bench.arrive(10, own, None), Ok((7, 2.5, false)));
        let half = bench.arrive(20, br#"{"obs":[1,2],"seq":8}"#, None).unwrap_err();
        assert!(half.ends_with("`t` is missing: the time by the client's own clock, in seconds"));
    }

    #[test]
    fn a_robot_that_counts_itself_may_begin_anew_once_it_was_silent() {
        let json = |seq: u64, t: f64| format!(r#"{{"obs":[1,2],"seq":{seq},"t":{t}}}"#);
        let mut bench = Bench::new(RobotForm::Json);
        let mut arrive = |ms, seq, t| bench.arrive(ms, json(seq, t).as_bytes(), None).unwrap();
        assert_eq!(arrive(0, 400, 20.0), (400, 20.0, false));
        // One that comes late is no new beginning.
        assert_eq!(arrive(10, 399, 19.95), (399, 19.95, false));
        assert_eq!(arrive(20, 1, 0.0), (1, 0.0, false));
        assert_eq!(arrive(1_100, 2, 0.05), (401, 20.0, true));
        assert_eq!(arrive(1_150, 3, 0.1), (402, 20.05, false));
        // A silence alone changes nothing.
        assert_eq!(arrive(9_000, 4, 8.0), (403, 27.95, false));
        // It may count on, and have another clock.
        assert_eq!(arrive(19_000, 9, 0.5), (404, 27.95, true));
        assert_eq!(arrive(19_050, 10, 0.55), (405, 28.0, false));
    }

    #[test]
    fn a_number_out_of_all_order_is_not_the_end_of_numbers() {
        let json = |seq: u64, t: f64| format!(r#"{{"obs":[1,2],"seq":{seq},"t":{t}}}"#);
        let mut bench = Bench::new(RobotForm::Json);
        let mut arrive = |ms, seq, t| bench.arrive(ms, json(seq, t).as_bytes(), None);
        assert_eq!(arrive(0, 4, 0.2), Ok((4, 0.2, false)));
        let told = arrive(10, u64::MAX, 0.25).unwrap_err();
        assert_eq!(told, "`seq` is 18446744073709551615; allowed: 0 to 4611686018427387904");
        let told = arrive(20, 1 << 60, 0.3).unwrap_err();
        assert!(told.starts_with("`seq` leaps to 1152921504606846976"), "{told}");
        assert_eq!(arrive(50, 5, 0.35), Ok((5, 0.35, false)));
        // A source that counts there from now on is heard after a silence.
        assert_eq!(arrive(1_200, 1 << 60, 0.4), Ok((6, 0.35, true)));
        assert_eq!(arrive(1_250, (1 << 60) + 1, 0.45), Ok((7, 0.4, false)));
    }

    #[test]
    fn a_number_of_a_source_that_leaps_is_refused_and_makes_nobody_deaf() {
        let mut bench = Bench::new(RobotForm::Ros2);
        assert_eq!(bench.ros(0, OLD, 5, 0), Ok((1, 0.0, true)));
        let told = bench.ros(20, OLD, i64::MAX, 20).unwrap_err();
        assert!(
            told.starts_with("the number of the source leaps to 9223372036854775807"),
            "{told}"
        );
        assert_eq!(bench.ros(40, OLD, 6, 40), Ok((2, 0.04, false)));
        // A source that counts there from now on is heard after a silence.
        assert_eq!(bench.ros(1_200, OLD, i64::MAX - 1, 1_200), Ok((3, 0.04, true)));
        assert_eq!(bench.ros(1_220, OLD, i64::MAX, 1_220), Ok((4, 0.06, false)));
    }

    #[test]
    fn what_a_robot_sends_in_another_form_is_told_with_the_option_that_reads_it() {
        let mut bench = Bench::new(RobotForm::F32);
        let told = bench.arrive(0, br#"{"obs":[1,2]}"#, None).unwrap_err();
        assert_eq!(
            told,
            "the observation has 13 bytes; 2 numbers have 8; it looks like JSON: --obs-form json"
        );
        let told = bench.arrive(0, &message(), None).unwrap_err();
        assert!(told.ends_with("a Float32MultiArray of ROS 2: --obs-form cdr"), "{told}");
        let mut bench = Bench::new(RobotForm::Ros2);
        let told = bench.arrive(0, &message(), Some(&[15; 77])).unwrap_err();
        assert!(told.contains("rmw_zenoh 0.2.4 or later"), "{told}");
    }

    #[test]
    fn the_numbers_and_times_of_a_source_count() {
        let mut bench = Bench::new(RobotForm::Ros2);
        assert_eq!(bench.ros(0, OLD, 5, 0), Ok((1, 0.0, true)));
        assert_eq!(bench.ros(20, OLD, 6, 20), Ok((2, 0.02, false)));
        // One is lost, one comes late, one comes twice.
        assert_eq!(bench.ros(60, OLD, 8, 60), Ok((4, 0.06, false)));
        assert_eq!(bench.ros(70, OLD, 7, 40), Ok((3, 0.04, false)));
        assert_eq!(bench.ros(80, OLD, 8, 60), Ok((4, 0.06, false)));
        // What waited on its way for half a second is half a second older than what did not.
        assert_eq!(bench.ros(600, OLD, 9, 80), Ok((5, 0.08, false)));
        // A clock that is set back by a minute makes nothing older.
        assert_eq!(bench.ros(620, OLD, 10, -60_000), Ok((6, 0.08, true)));
        assert_eq!(bench.ros(640, OLD, 11, -59_980), Ok((7, 0.1, false)));
        // After a silence its clock still counts: what waited meanwhile is as old as it is.
        assert_eq!(bench.ros(9_000, OLD, 12, -59_960), Ok((8, 0.12, false)));
        // Numbers from before the first one are old, whatever they are.
        assert_eq!(bench.ros(9_010, OLD, i64::MIN, 0).map(|it| it.0), Ok(0));
    }

    #[test]
    fn a_clock_that_leaps_by_decades_begins_anew() {
        let mut bench = Bench::new(RobotForm::Ros2);
        let mut marked = |ms, number, time| {
            let mark = SourceMark { number, time, gid: OLD };
            bench.arrive(ms, &message(), Some(&mark.write()))
        };
        // It has no battery, and begins in 1970 until it is set.
        assert_eq!(marked(0, 1, 0), Ok((1, 0.0, true)));
        let set = 1_796_000_000_000_000_000;
        assert_eq!(marked(20, 2, set), Ok((2, 0.0, true)));
        assert_eq!(marked(40, 3, set + 20 * MS as i64), Ok((3, 0.02, false)));
        // One damaged time changes nothing for those after it.
        assert_eq!(marked(60, 4, i64::MAX), Ok((4, 0.02, true)));
        assert_eq!(marked(80, 5, set + 60 * MS as i64), Ok((5, 0.02, true)));
        assert_eq!(marked(100, 6, set + 80 * MS as i64), Ok((6, 0.04, false)));
    }

    #[test]
    fn a_second_source_has_to_wait_until_the_first_is_silent() {
        let mut bench = Bench::new(RobotForm::Ros2);
        bench.ros(0, OLD, 900, 0).unwrap();
        let told = bench.ros(10, NEW, 1, 10).unwrap_err();
        assert!(told.contains("two sources"), "{told}");
        assert_eq!(bench.ros(20, OLD, 901, 20), Ok((2, 0.02, false)));
        // Without anything beside it is yet another one.
        bench.arrive(30, &message(), None).unwrap_err();
        assert_eq!(bench.ros(1_100, NEW, 1, 1_100), Ok((3, 0.02, true)));
        assert_eq!(bench.ros(1_120, NEW, 2, 1_120), Ok((4, 0.04, false)));
        bench.ros(1_130, OLD, 902, 1_130).unwrap_err();
        // A source that has counted too far is heard again after a silence.
        assert_eq!(bench.ros(2_200, NEW, 1, 2_200), Ok((5, 0.04, true)));
    }
}
