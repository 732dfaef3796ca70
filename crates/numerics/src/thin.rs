//! Long series kept short: per stretch of a series and number, the minimum and the maximum, so that no spike is lost.
//!
//! ```text
//! updates   1 2 3 4 | 5 6 7 8 | 9 10          a stride of 4: each stretch becomes one point
//! points        4   |     8   |   10           named by its last update, with the extremes of every number
//! ```

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Digits of a number that is plotted.
const DIGITS: i32 = 5;

/// The extremes of one number, a pair per point; `None` where the number does not exist.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Extremes {
    /// The smallest value of each stretch.
    pub min: Vec<Option<f32>>,
    /// The largest value of each stretch.
    pub max: Vec<Option<f32>>,
}

impl Extremes {
    fn len(&self) -> usize {
        self.min.len()
    }

    /// Makes it as long as the series, with points at which the number does not exist.
    fn pad(&mut self, n_points: usize) {
        self.min.resize(n_points, None);
        self.max.resize(n_points, None);
    }

    fn take_in(&mut self, value: f32) {
        if let (Some(min), Some(max)) = (self.min.last_mut(), self.max.last_mut()) {
            *min = least(*min, Some(value));
            *max = greatest(*max, Some(value));
        }
    }

    fn join_pairs(&mut self) {
        self.min = self.min.chunks(2).map(|pair| pair.iter().copied().fold(None, least)).collect();
        self.max =
            self.max.chunks(2).map(|pair| pair.iter().copied().fold(None, greatest)).collect();
    }
}

fn least(a: Option<f32>, b: Option<f32>) -> Option<f32> {
    a.map_or(b, |a| Some(b.map_or(a, |b| a.min(b))))
}

fn greatest(a: Option<f32>, b: Option<f32>) -> Option<f32> {
    a.map_or(b, |a| Some(b.map_or(a, |b| a.max(b))))
}

/// Several numbers over the updates of a run, in at most so many points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThinSeries {
    /// The last update of each stretch.
    pub x: Vec<u64>,
    /// The numbers by name, each as long as `x`.
    pub scalars: BTreeMap<String, Extremes>,
    #[serde(skip)]
    max_points: usize,
    /// Updates that one point stands for.
    #[serde(default = "one")]
    stride: u64,
    #[serde(skip)]
    in_last: u64,
}

fn one() -> u64 {
    1
}

/// Makes a number of points even, so that a full series consists of whole pairs.
fn even(max_points: usize) -> usize {
    max_points.max(2) / 2 * 2
}

/// An empty series, of which others are made by [`ThinSeries::resume`].
impl Default for ThinSeries {
    fn default() -> Self {
        Self::new(0)
    }
}

impl ThinSeries {
    /// Starts an empty series that will have at most `max_points` points, an even number.
    pub fn new(max_points: usize) -> Self {
        Self {
            x: Vec::new(),
            scalars: BTreeMap::new(),
            max_points: even(max_points),
            stride: 1,
            in_last: 0,
        }
    }

    /// Goes on with a series that somebody else thinned; numbers that are not as long as `x` are dropped.
    pub fn resume(self, max_points: usize) -> Self {
        let mut series = Self { max_points: even(max_points), stride: self.stride.max(1), ..self };
        let n_points = series.x.len();
        series
            .scalars
            .retain(|_, extremes| extremes.len() == n_points && extremes.max.len() == n_points);
        series.in_last = series.stride;
        while series.x.len() > series.max_points {
            series.join_pairs();
        }
        series
    }

    /// Takes in the numbers of an update. One that is not after the last makes the points from it on void: the newest
    /// line of an update counts.
    pub fn push<'a>(&mut self, update: u64, numbers: impl IntoIterator<Item = (&'a str, f64)>) {
        self.rewind(update);
        if self.in_last >= self.stride || self.x.is_empty() {
            if self.x.len() >= self.max_points {
                self.join_pairs();
            }
            self.x.push(update);
            self.in_last = 0;
        }
        self.in_last += 1;
        if let Some(last) = self.x.last_mut() {
            *last = update;
        }
        let n_points = self.x.len();
        for (name, value) in numbers {
            if !value.is_finite() {
                continue;
            }
            if !self.scalars.contains_key(name) {
                self.scalars.insert(name.to_owned(), Extremes::default());
            }
            if let Some(extremes) = self.scalars.get_mut(name) {
                extremes.pad(n_points);
                extremes.take_in(rounded(value));
            }
        }
        for extremes in self.scalars.values_mut() {
            extremes.pad(n_points);
        }
    }

    /// Forgets the points of updates from this one on.
    fn rewind(&mut self, update: u64) {
        let kept = self.x.partition_point(|x| *x < update);
        if kept < self.x.len() {
            self.x.truncate(kept);
            self.scalars.values_mut().for_each(|extremes| extremes.pad(kept));
            self.in_last = self.stride;
        }
    }

    fn join_pairs(&mut self) {
        self.x = self.x.chunks(2).filter_map(|pair| pair.last().copied()).collect();
        self.scalars.values_mut().for_each(Extremes::join_pairs);
        self.stride = self.stride.saturating_mul(2);
    }

    /// Returns the points of updates from this one on.
    pub fn since(&self, update: u64) -> Self {
        let first = self.x.partition_point(|x| *x < update);
        let part = |extremes: &Extremes| Extremes {
            min: extremes.min[first..].to_vec(),
            max: extremes.max[first..].to_vec(),
        };
        Self {
            x: self.x[first..].to_vec(),
            scalars: self.scalars.iter().map(|(name, it)| (name.clone(), part(it))).collect(),
            ..*self
        }
    }

    /// Returns how many updates a point stands for.
    pub fn stride(&self) -> u64 {
        self.stride
    }

    /// Returns the last update; 0 before the first.
    pub fn last(&self) -> u64 {
        self.x.last().copied().unwrap_or(0)
    }
}

/// Rounds to the digits that a picture can show, which makes the text of long series short.
pub fn rounded(value: f64) -> f32 {
    if value == 0.0 || !value.is_finite() {
        return value as f32;
    }
    let scale = libm::pow(10.0, f64::from(DIGITS - 1) - libm::floor(libm::log10(value.abs())));
    let rounded = libm::round(value * scale) / scale;
    if rounded.is_finite() { rounded as f32 } else { value as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A series with a single spike.
    fn spiky(n: u64, max_points: usize) -> ThinSeries {
        let mut series = ThinSeries::new(max_points);
        for update in 1..=n {
            let value = if update == 777 { 9.0 } else { 1.0 };
            series.push(update, [("a", value)]);
        }
        series
    }

    #[test]
    fn a_series_has_few_points_in_order_and_keeps_its_extremes() {
        for n in [1, 2, 7, 100, 101, 1_000, 12_345] {
            let series = spiky(n, 100);
            assert!(
                series.x.len() <= 100 && series.x.len() as u64 >= n.min(50),
                "{n}: {}",
                series.x.len()
            );
            assert!(series.x.is_sorted_by(|a, b| a < b), "{n}");
            assert_eq!(series.last(), n);
            let a = &series.scalars["a"];
            assert_eq!((a.min.len(), a.max.len()), (series.x.len(), series.x.len()));
            let spike = a.max.iter().flatten().copied().fold(0.0, f32::max);
            assert_eq!(spike, if n >= 777 { 9.0 } else { 1.0 });
            assert!(a.min.iter().all(|min| *min == Some(1.0)), "{n}");
        }
    }

    #[test]
    fn points_are_spread_evenly() {
        let series = spiky(10_000, 100);
        let widths: Vec<u64> = series.x.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let (widest, last) = (widths.iter().max().unwrap(), widths.last().unwrap());
        assert!(widths[..widths.len() - 1].iter().all(|width| width == widest), "{widths:?}");
        assert!(last <= widest);
    }

    #[test]
    fn the_newest_line_of_an_update_counts() {
        let mut series = ThinSeries::new(10);
        (1..=6).for_each(|update| series.push(update, [("a", update as f64)]));
        series.push(4, [("a", 40.0), ("b", 1.0)]);
        assert_eq!(series.x, [1, 2, 3, 4]);
        assert_eq!(series.scalars["a"].max.last(), Some(&Some(40.0)));
        assert_eq!(series.scalars["b"].min, [None, None, None, Some(1.0)]);
        series.push(5, [("a", f64::NAN)]);
        assert_eq!(series.scalars["a"].max.last(), Some(&None), "what is no number is no point");
    }

    #[test]
    fn it_survives_text_and_goes_on() {
        let series = spiky(1_000, 100);
        let text = serde_json::to_string(&series).unwrap();
        let mut read = serde_json::from_str::<ThinSeries>(&text).unwrap().resume(100);
        assert_eq!(read.x, series.x);
        (1_001..=3_000).for_each(|update| read.push(update, [("a", 2.0)]));
        assert!(read.x.len() <= 100 && read.last() == 3_000);
        let end = read.since(2_900);
        assert!(end.x.iter().all(|x| *x >= 2_900) && end.x.len() == end.scalars["a"].min.len());
        // What does not fit together is not believed.
        let odd = r#"{"x":[1,2],"scalars":{"a":{"min":[1.0],"max":[1.0]}}}"#;
        assert!(serde_json::from_str::<ThinSeries>(odd).unwrap().resume(9).scalars.is_empty());
    }

    #[test]
    fn numbers_are_rounded_to_what_can_be_seen() {
        for (value, text) in
            [(0.123_456_789, "0.12346"), (-98_765_432.1, "-98765000.0"), (0.0, "0.0")]
        {
            assert_eq!(format!("{:?}", rounded(value)), text);
        }
        assert!(rounded(1e-320).is_finite() && rounded(f64::MAX).is_infinite());
    }
}
