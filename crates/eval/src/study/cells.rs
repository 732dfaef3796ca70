//! Numbers as the cells of a table.

use crate::measure::{Measure, written};
use crate::study::Published;

/// What stands for a number that there is none of.
pub(super) const NONE: &str = "\u{2013}";

/// Writes a measured number: mean, standard deviation over training seeds, interval.
pub(super) fn measured(measure: Option<&Measure>) -> String {
    let Some((measure, interval)) = measure.and_then(|m| Some((m, m.interval?))) else {
        return NONE.to_owned();
    };
    let [mean, bounds] = written(&interval);
    // As many digits as the mean has.
    let digits = mean.split_once('.').map_or(0, |(_, digits)| digits.len());
    match measure.deviation_over_seeds() {
        Some(deviation) => format!("{mean} ± {deviation:.digits$} {bounds}"),
        None => format!("{mean} {bounds}"),
    }
}

/// Writes a published number.
pub(super) fn published(published: Option<&Published>) -> String {
    let Some(published) = published else { return NONE.to_owned() };
    let mean = published.mean;
    match published.deviation {
        Some(deviation) => format!("{mean:.2} ± {deviation:.2}"),
        None => format!("{mean:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use leadtime_numerics::stats::Interval;

    fn measure(by_seed: &[f64]) -> Measure {
        let interval = Some(Interval { estimate: 0.5, low: 0.25, high: 0.75 });
        let (name, by_seed) = ("success".to_owned(), by_seed.to_vec());
        Measure { name, n: 8, interval, standard_deviation: None, by_seed }
    }

    #[test]
    fn a_cell_has_the_deviation_only_over_several_seeds() {
        assert_eq!(measured(Some(&measure(&[0.4, 0.6]))), "0.500 ± 0.141 [0.250, 0.750]");
        assert_eq!(measured(Some(&measure(&[0.5]))), "0.500 [0.250, 0.750]");
        assert_eq!(measured(Some(&Measure { interval: None, ..measure(&[]) })), NONE);
        assert_eq!(measured(None), NONE);
    }
}
