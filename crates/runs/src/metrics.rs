//! Every number that a run plots, by name.

use leadtime_learner::UpdateProgress;

/// Lists the scalars of one update in a fixed order; a number that does not exist yet is left out.
///
/// Units and meaning: `docs/metrics.md`.
pub(crate) fn scalars(progress: &UpdateProgress) -> Vec<(String, f64)> {
    let UpdateProgress { episodes, update, phases, books, .. } = progress;
    let all = [
        ("episodes/finished", Some(episodes.n_finished as f64)),
        ("episodes/return", episodes.episode_return),
        ("episodes/success", episodes.success),
        ("episodes/length", episodes.length),
        ("train/policy_loss", Some(update.policy_loss)),
        ("train/value_loss", Some(update.value_loss)),
        ("train/entropy", Some(update.entropy)),
        ("train/old_approx_kl", Some(update.old_approx_kl)),
        ("train/approx_kl", Some(update.approx_kl)),
        ("train/clip_fraction", Some(update.clip_fraction)),
        ("train/explained_variance", Some(update.explained_variance)),
        ("train/learning_rate", Some(update.learning_rate)),
        ("train/samples", Some(update.n_samples as f64)),
        ("train/staleness", Some(mean_staleness(progress))),
        ("system/steps_per_second", Some(progress.steps_per_second)),
        ("system/wait_seconds", Some(phases.wait.as_secs_f64())),
        ("system/train_seconds", Some(phases.train.as_secs_f64())),
        ("system/checkpoint_seconds", Some(phases.checkpoint.as_secs_f64())),
        ("system/weights_seconds", Some(phases.weights.as_secs_f64())),
        ("system/actors", Some(progress.n_actors as f64)),
        ("system/queued", Some(progress.n_queued as f64)),
    ];
    let all = all.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?)));
    // What is unused at the end is not known before.
    let books = books.entries().into_iter().filter(|(name, _)| *name != "unused_at_end");
    all.chain(books.map(|(name, n)| (format!("books/{name}"), n as f64))).collect()
}

fn mean_staleness(progress: &UpdateProgress) -> f64 {
    let staleness = &progress.update.staleness;
    let n_rollouts: u64 = staleness.values().sum();
    let sum: u64 = staleness.iter().map(|(staleness, n)| staleness * n).sum();
    if n_rollouts == 0 { 0.0 } else { sum as f64 / n_rollouts as f64 }
}
