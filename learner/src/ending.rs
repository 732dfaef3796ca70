//! How a run ends: its newest and its best policy, and the report.

use std::sync::Arc;

use leadtime_policy::Parameters;
use tokio_util::sync::CancellationToken;

use crate::books::Books;
use crate::builds::Builds;
use crate::coordinator::CoordinatorStart;
use crate::evaluation_thread::Evaluations;
use crate::report::{ProgressSink, RatedPolicy, RunEnd, RunHealth, RunReport};
use crate::resume::{ResumePoint, TrainingRecord};
use crate::{Error, LearnerConfig};

/// Ends a run whose updates were all made before: evaluates the policies that still wait for it, and hands the newest and the
/// best one and all evaluations on once more, because their files may have been lost since.
pub(crate) async fn already_trained(
    config: &LearnerConfig,
    mut point: ResumePoint,
    sink: &mut dyn ProgressSink,
    mut evaluations: Option<Evaluations>,
    stop: &CancellationToken,
) -> Result<RunReport, Error> {
    let (version, score) = (point.start.version, point.record.episodes.score());
    let weights = Arc::clone(&point.offered[&version]);
    let mut last = RatedPolicy { version, score, held_out: None, weights };
    let mut end = RunEnd::AlreadyFinished;
    if let (Some(evaluations), Some(_)) = (&mut evaluations, point.record.held_out.next()) {
        let health = RunHealth::default();
        if !evaluations.finish(&mut point.record.held_out, sink, stop, &health).await {
            end = RunEnd::Stopped;
        }
    }
    last.held_out = point.record.held_out.of(version);
    let best = best(&point.record, evaluations.as_ref(), &last);
    sink.on_policies(&last, best, point.record.held_out.history());
    let CoordinatorStart { books, builds, .. } = point.start;
    report(config, end, last, evaluations.as_ref(), point.record, books, builds)
}

/// Returns the best policy of a run: the last one where none was evaluated.
pub(crate) fn best<'a>(
    record: &'a TrainingRecord,
    evaluations: Option<&Evaluations>,
    last: &'a RatedPolicy,
) -> &'a RatedPolicy {
    evaluations.and_then(|_| record.held_out.best()).unwrap_or(last)
}

pub(crate) fn report(
    config: &LearnerConfig,
    end: RunEnd,
    last: RatedPolicy,
    evaluations: Option<&Evaluations>,
    record: TrainingRecord,
    books: Books,
    builds: Builds,
) -> Result<RunReport, Error> {
    let best = best(&record, evaluations, &last).clone();
    let n_updates = last.version.0;
    Ok(RunReport {
        end,
        n_updates,
        n_steps: n_updates * config.steps_per_update(),
        digest: Parameters::from_safetensors(&last.weights, &config.spec.policy)?.digest()?,
        last,
        best,
        held_out: record.held_out.history().to_vec(),
        episodes: record.episodes.means(),
        staleness: record.staleness,
        balance: books.check(),
        reproducible: config.is_reproducible(&builds, &books),
        books,
        builds,
    })
}
