//! The numbers of one page as atomics, and their text in the `OpenMetrics` format.
//!
//! A number that does not exist yet, such as the mean of no episodes, is left out of the text. A scrape may see some numbers
//! of an update and some of the one before; each by itself is whole.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, MetricEncoder, NoLabelSet, text};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::exemplar::Exemplar;
use prometheus_client::registry::Registry;

use crate::names::{
    METRICS, Metric, MetricKind, MetricLabel, MetricPage, PREFIX, STALENESS_BUCKETS,
};

/// Slots of a histogram: its buckets, the one without a bound, and the sum of the values.
const HISTOGRAM_SLOTS: usize = STALENESS_BUCKETS.len() + 2;

/// The numbers of a page: per metric, a slot per sample, as the bits of an `f64`; NaN where there is none.
#[derive(Debug)]
pub(crate) struct PageNumbers {
    page: MetricPage,
    slots: Vec<Vec<AtomicU64>>,
}

impl PageNumbers {
    /// Makes a page without a number.
    pub(crate) fn new(page: MetricPage) -> Arc<Self> {
        let slots = METRICS.iter().map(|row| {
            let (n, value) = match row.kind {
                MetricKind::Histogram => (HISTOGRAM_SLOTS, 0.0),
                _ => (row.label_values().len(), f64::NAN),
            };
            (0..n).map(|_| AtomicU64::new(f64::to_bits(value))).collect()
        });
        Arc::new(Self { page, slots: slots.collect() })
    }

    /// Sets the number of a metric without a label, or that of its first sample.
    pub(crate) fn set(&self, metric: Metric, value: f64) {
        self.set_sample(metric, 0, value);
    }

    /// Sets the numbers of a metric's samples, in the order of its label's values.
    pub(crate) fn set_all(&self, metric: Metric, values: impl IntoIterator<Item = f64>) {
        for (index, value) in values.into_iter().enumerate() {
            self.set_sample(metric, index, value);
        }
    }

    fn set_sample(&self, metric: Metric, index: usize, value: f64) {
        self.slots[metric as usize][index].store(value.to_bits(), Ordering::Relaxed);
    }

    /// Adds to the number of a sample; there is one writer.
    pub(crate) fn add(&self, metric: Metric, index: usize, more: f64) {
        let before = self.get(metric, index);
        self.set_sample(metric, index, if before.is_nan() { more } else { before + more });
    }

    /// Counts `n` rollouts of a staleness.
    pub(crate) fn observe_staleness(&self, staleness: u64, n: u64) {
        let bucket = STALENESS_BUCKETS.iter().position(|bound| staleness <= *bound);
        let bucket = bucket.unwrap_or(STALENESS_BUCKETS.len());
        self.add(Metric::Staleness, bucket, n as f64);
        self.add(Metric::Staleness, HISTOGRAM_SLOTS - 1, (staleness * n) as f64);
    }

    /// Returns the number of a sample; NaN if there is none.
    pub(crate) fn get(&self, metric: Metric, index: usize) -> f64 {
        f64::from_bits(self.slots[metric as usize][index].load(Ordering::Relaxed))
    }

    /// Writes the page in the `OpenMetrics` text format 1.0; `label` is in every sample.
    pub(crate) fn text(
        self: &Arc<Self>,
        label: (&'static str, &str),
    ) -> Result<String, fmt::Error> {
        let labels = [(label.0.into(), label.1.to_owned().into())];
        let mut registry = Registry::with_prefix_and_labels(PREFIX, labels.into_iter());
        registry.register_collector(Box::new(Arc::clone(self)));
        let mut text = String::new();
        text::encode(&mut text, &registry)?;
        Ok(text)
    }

    fn values(&self, index: usize) -> Vec<f64> {
        let load = |slot: &AtomicU64| f64::from_bits(slot.load(Ordering::Relaxed));
        self.slots[index].iter().map(load).collect()
    }
}

impl Collector for PageNumbers {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        for (index, row) in METRICS.iter().enumerate() {
            let is_here = row.page == self.page || row.page == MetricPage::Both;
            let values = self.values(index);
            if !is_here || values.iter().all(|value| !value.is_finite()) {
                continue;
            }
            let kind = match row.kind {
                MetricKind::Counter => MetricType::Counter,
                MetricKind::Gauge => MetricType::Gauge,
                MetricKind::Histogram => MetricType::Histogram,
            };
            let mut metric = encoder.encode_descriptor(row.name, row.help, None, kind)?;
            if row.kind == MetricKind::Histogram {
                histogram(&mut metric, &values)?;
                continue;
            }
            let samples = row.label_values().into_iter().zip(values);
            for (label, value) in samples.filter(|(_, value)| value.is_finite()) {
                if row.label == MetricLabel::None {
                    number(&mut metric, row.kind, value)?;
                } else {
                    let labels = [(row.label_name(), label)];
                    number(&mut metric.encode_family(&labels)?, row.kind, value)?;
                }
            }
        }
        Ok(())
    }
}

fn number(metric: &mut MetricEncoder<'_>, kind: MetricKind, value: f64) -> fmt::Result {
    const NONE: Option<&Exemplar<NoLabelSet, f64>> = None;
    let whole = value as u64;
    match kind {
        // Counts of things are written as whole numbers, sums of seconds are not.
        MetricKind::Counter if whole as f64 == value => metric.encode_counter(&whole, NONE),
        MetricKind::Counter => metric.encode_counter(&value, NONE),
        _ => metric.encode_gauge(&value),
    }
}

fn histogram(metric: &mut MetricEncoder<'_>, values: &[f64]) -> fmt::Result {
    let (counts, sum) = values.split_at(HISTOGRAM_SLOTS - 1);
    let bounds = STALENESS_BUCKETS.iter().map(|bound| *bound as f64).chain([f64::INFINITY]);
    let buckets: Vec<(f64, u64)> = bounds.zip(counts.iter().map(|count| *count as u64)).collect();
    let n_all = buckets.iter().map(|(_, n)| n).sum();
    metric.encode_histogram::<NoLabelSet>(sum[0], n_all, &buckets, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_what_was_set_and_nothing_else() {
        let numbers = PageNumbers::new(MetricPage::Learner);
        numbers.set(Metric::Steps, 2048.0);
        numbers.set(Metric::SuccessRatio, f64::NAN);
        numbers.set(Metric::Kl, 0.25);
        numbers.set_all(Metric::PhaseSeconds, [0.5, 1.0]);
        numbers.observe_staleness(0, 3);
        numbers.observe_staleness(3, 2);
        numbers.observe_staleness(99, 1);
        numbers.set(Metric::ActorSteps, 7.0);
        let text = numbers.text(("run", "lander-1")).unwrap();
        for line in [
            "leadtime_steps_total{run=\"lander-1\"} 2048",
            "leadtime_kl{run=\"lander-1\"} 0.25",
            "# TYPE leadtime_phase_seconds counter",
            "leadtime_phase_seconds_total{run=\"lander-1\",phase=\"wait\"} 0.5",
            "leadtime_phase_seconds_total{run=\"lander-1\",phase=\"train\"} 1",
            "leadtime_staleness_bucket{run=\"lander-1\",le=\"0.0\"} 3",
            "leadtime_staleness_bucket{run=\"lander-1\",le=\"4.0\"} 5",
            "leadtime_staleness_bucket{run=\"lander-1\",le=\"+Inf\"} 6",
            "leadtime_staleness_count{run=\"lander-1\"} 6",
            "leadtime_staleness_sum{run=\"lander-1\"} 105.0",
        ] {
            assert!(text.lines().any(|it| it == line), "no `{line}` in\n{text}");
        }
        assert!(text.ends_with("# EOF\n"), "{text}");
        for absent in ["success_ratio", "checkpoint\"", "actor_steps", "NaN"] {
            assert!(!text.contains(absent), "{text}");
        }
    }
}
