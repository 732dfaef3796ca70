//! Every number of the status pages: name, type, labels, meaning. Nothing is served under a name that is not here.

use leadtime_proto::RefusalCause;

/// What kind of number it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MetricKind {
    /// It only grows; its samples' names end in `_total`.
    Counter,
    /// It goes up and down.
    Gauge,
    /// How often which value came.
    Histogram,
}

/// On whose page it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MetricPage {
    /// The learner's, with the label `run`.
    Learner,
    /// The actor's, with the label `actor`.
    Actor,
    /// Both pages.
    Both,
}

/// The label that tells a metric's samples apart, with its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MetricLabel {
    /// There is one sample.
    None,
    /// A sample for each of these values.
    Of(&'static str, &'static [&'static str]),
    /// A sample for each cause of a refusal.
    Cause,
}

/// Everything about a metric that does not change.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MetricRow {
    /// Its name, without [`PREFIX`] and without `_total`.
    pub name: &'static str,
    /// What kind of number it is.
    pub kind: MetricKind,
    /// What tells its samples apart.
    pub label: MetricLabel,
    /// On whose page it is.
    pub page: MetricPage,
    /// What it counts or measures, in one sentence.
    pub help: &'static str,
}

/// What every name begins with.
pub(crate) const PREFIX: &str = "leadtime";
/// Upper bounds of the buckets of a staleness; one without a bound follows.
pub(crate) const STALENESS_BUCKETS: [u64; 6] = [0, 1, 2, 4, 8, 16];
/// The entries of the books that a page shows: of rollouts, and not those of the end.
pub(crate) const BOOK_ENTRIES: &[&str] = &[
    "published",
    "trained",
    "dropped_stale",
    "refused",
    "superseded",
    "rolled_back",
    "duplicates",
];
const ENTRY: MetricLabel = MetricLabel::Of("entry", BOOK_ENTRIES);
const PHASE: MetricLabel = MetricLabel::Of("phase", &["wait", "train", "checkpoint", "weights"]);

macro_rules! metrics {
    ($($variant:ident = $name:literal $kind:ident $label:expr, $page:ident, $help:literal;)*) => {
        /// A metric; its row in [`METRICS`] says the rest.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum Metric {
            $(#[doc = $help] $variant,)*
        }

        /// All metrics, in the order of [`Metric`].
        pub(crate) const METRICS: &[MetricRow] = &[
            $(MetricRow {
                name: $name,
                kind: MetricKind::$kind,
                label: $label,
                page: MetricPage::$page,
                help: $help,
            },)*
        ];
    };
}

metrics! {
    Steps = "steps" Counter MetricLabel::None, Learner, "environment steps trained on since the learner started";
    Updates = "updates" Counter MetricLabel::None, Learner, "updates since the learner started";
    Episodes = "episodes" Counter MetricLabel::None, Learner, "training episodes that ended since the learner started";
    RunSteps = "run_steps" Gauge MetricLabel::None, Learner, "environment steps trained on in the whole run";
    RunUpdates = "run_updates" Gauge MetricLabel::None, Learner, "updates of the whole run";
    RunEpisodes = "run_episodes" Gauge MetricLabel::None, Learner, "training episodes of the whole run that ended";
    Books = "books" Counter ENTRY, Learner, "rollouts since the learner started, by what became of them";
    Refusals = "refusals" Counter MetricLabel::Cause, Learner, "messages refused since the learner started, by cause";
    Staleness = "staleness" Histogram MetricLabel::None, Learner, "learner version at use minus behaviour version, of the rollouts trained on";
    SuccessRatio = "success_ratio" Gauge MetricLabel::None, Learner, "mean success of the last 100 training episodes";
    Return = "return" Gauge MetricLabel::None, Learner, "mean undiscounted return of the last 100 training episodes";
    Entropy = "entropy" Gauge MetricLabel::None, Learner, "mean entropy of the executed distribution, in nats";
    Kl = "kl" Gauge MetricLabel::None, Learner, "approximate KL divergence of the last update";
    ExplainedVariance = "explained_variance" Gauge MetricLabel::None, Learner, "share of the returns' variance that the value explains";
    LearningRate = "learning_rate" Gauge MetricLabel::None, Learner, "learning rate of the last update";
    Actors = "actors" Gauge MetricLabel::None, Learner, "actors connected";
    EnvironmentsWaiting = "environments_waiting" Gauge MetricLabel::None, Learner, "environments of which no rollout has arrived for the next update";
    QueuedRollouts = "queued_rollouts" Gauge MetricLabel::None, Learner, "rollouts that wait for their update, or are in it";
    QueuedBytes = "queued_bytes" Gauge MetricLabel::None, Learner, "bytes received and not looked at yet";
    PhaseSeconds = "phase_seconds" Counter PHASE, Learner, "where the trainer's time went";
    WaitRatio = "wait_ratio" Gauge MetricLabel::None, Learner, "share of the last minute in which the trainer waited for rollouts";
    BooksImbalance = "books_imbalance" Gauge MetricLabel::None, Learner, "rollouts published and not accounted for; anything but 0 is a bug";
    LinesDropped = "lines_dropped" Counter MetricLabel::None, Learner, "lines of metrics.jsonl, event files and policy files that could not be written";
    CheckpointAge = "checkpoint_age_seconds" Gauge MetricLabel::None, Learner, "time since the last checkpoint was written, or since the start";
    CheckpointInterval = "checkpoint_interval_seconds" Gauge MetricLabel::None, Learner, "the configured time between checkpoints";
    Unsaved = "unsaved_seconds" Gauge MetricLabel::None, Learner, "for how long no checkpoint could be written; 0 while all is well";
    DiskFree = "disk_free_bytes" Gauge MetricLabel::None, Learner, "bytes free on the disk of the run directory";
    DiskSize = "disk_size_bytes" Gauge MetricLabel::None, Learner, "bytes that the disk of the run directory holds";
    ActorSteps = "actor_steps" Counter MetricLabel::None, Actor, "environment steps simulated";
    Unacknowledged = "rollouts_unacknowledged" Gauge MetricLabel::None, Actor, "rollouts sent and not acknowledged";
    WeightsVersion = "weights_version" Gauge MetricLabel::None, Actor, "newest version of the weights that this actor has";
    Reconnects = "reconnects" Counter MetricLabel::None, Actor, "hellos after the first: losses of the learner, and doubts about it";
    Resident = "process_resident_bytes" Gauge MetricLabel::None, Both, "memory of the process";
    CertificateEnd = "certificate_end_timestamp_seconds" Gauge MetricLabel::None, Both, "when the certificate in use ends, in seconds since 1970";
}

#[cfg(test)]
impl Metric {
    /// Returns what is known of it.
    pub(crate) fn row(self) -> &'static MetricRow {
        &METRICS[self as usize]
    }
}

impl MetricRow {
    /// Returns the values of its label, one per sample; one empty value without a label.
    pub(crate) fn label_values(&self) -> Vec<&'static str> {
        match self.label {
            MetricLabel::None => vec![""],
            MetricLabel::Of(_, values) => values.to_vec(),
            MetricLabel::Cause => RefusalCause::ALL.iter().map(|cause| cause.name()).collect(),
        }
    }

    /// Returns its label's name; empty without one.
    pub(crate) fn label_name(&self) -> &'static str {
        match self.label {
            MetricLabel::None => "",
            MetricLabel::Of(name, _) => name,
            MetricLabel::Cause => "cause",
        }
    }

    /// Returns the name under which it is scraped.
    #[cfg(test)]
    pub(crate) fn scraped_name(&self) -> String {
        let end = if self.kind == MetricKind::Counter { "_total" } else { "" };
        format!("{PREFIX}_{}{end}", self.name)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;

    fn repository(path: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
    }

    fn known() -> BTreeSet<String> {
        METRICS.iter().map(MetricRow::scraped_name).collect()
    }

    /// Returns every word that begins with the prefix and an underscore.
    fn names_in(text: &str) -> BTreeSet<String> {
        let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let words = text.split(|c: char| !is_part(c));
        words.filter(|word| word.starts_with("leadtime_")).map(str::to_owned).collect()
    }

    #[test]
    fn names_are_distinct_and_rows_are_in_their_order() {
        assert_eq!(known().len(), METRICS.len());
        assert_eq!(Metric::CertificateEnd as usize, METRICS.len() - 1);
        assert_eq!(Metric::Resident.row().name, "process_resident_bytes");
    }

    #[test]
    fn the_page_about_metrics_has_a_row_for_each_and_no_other() {
        let page = fs::read_to_string(repository("docs/metrics.md")).unwrap();
        let rows = page.lines().filter_map(|line| line.strip_prefix("| `leadtime_"));
        let rows: Vec<&str> = rows.collect();
        let documented: BTreeSet<String> = rows
            .iter()
            .map(|row| format!("leadtime_{}", row.split('`').next().unwrap_or_default()))
            .collect();
        assert_eq!(documented, known());
        for metric in METRICS {
            let row = rows.iter().find(|row| {
                format!("leadtime_{row}").starts_with(&format!("{}`", metric.scraped_name()))
            });
            let row = row.unwrap_or_else(|| panic!("{}", metric.name));
            assert!(row.contains(metric.help), "{}: {row}", metric.name);
            assert!(row.contains(metric.label_name()), "{}: {row}", metric.name);
        }
    }

    #[test]
    fn dashboard_alerts_and_manifests_ask_only_for_names_that_there_are() {
        let mut samples = known();
        let histogram = Metric::Staleness.row().scraped_name();
        samples.extend(["_bucket", "_sum", "_count"].map(|end| format!("{histogram}{end}")));
        for (file, least) in [
            ("deploy/grafana/leadtime.json", 15),
            ("deploy/grafana/alerts.yaml", 6),
            ("deploy/kubernetes/autoscaler.yaml", 1),
        ] {
            let asked = names_in(&fs::read_to_string(repository(file)).unwrap());
            assert!(asked.len() >= least, "{file} asks for {asked:?}");
            let unknown: Vec<&String> = asked.difference(&samples).collect();
            assert!(unknown.is_empty(), "{file} asks for {unknown:?}");
        }
    }
}
