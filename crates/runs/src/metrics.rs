//! Every number that a run plots, by name.

use leadtime_learner::UpdateProgress;

/// Lists the scalars of one update in a fixed order; a number that does not exist yet is left out.
///
/// Units and meaning: `docs/metrics.md`.
pub fn scalars(progress: &UpdateProgress) -> Vec<(String, f64)> {
    let mut all: Vec<(&str, Option<f64>)> = Vec::with_capacity(32);
    all.extend(episodes(progress));
    all.extend(training(progress).map(|(name, value)| (name, Some(value))));
    all.extend(system(progress).map(|(name, value)| (name, Some(value))));
    all.extend(books(progress).map(|(name, value)| (name, Some(value as f64))));
    all.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
}

fn episodes(progress: &UpdateProgress) -> [(&'static str, Option<f64>); 4] {
    let episodes = &progress.episodes;
    [
        ("episodes/finished", Some(episodes.n_finished as f64)),
        ("episodes/return", episodes.episode_return),
        ("episodes/success", episodes.success),
        ("episodes/length", episodes.length),
    ]
}

fn training(progress: &UpdateProgress) -> [(&'static str, f64); 10] {
    let update = &progress.update;
    [
        ("train/policy_loss", update.policy_loss),
        ("train/value_loss", update.value_loss),
        ("train/entropy", update.entropy),
        ("train/old_approx_kl", update.old_approx_kl),
        ("train/approx_kl", update.approx_kl),
        ("train/clip_fraction", update.clip_fraction),
        ("train/explained_variance", update.explained_variance),
        ("train/learning_rate", update.learning_rate),
        ("train/samples", update.n_samples as f64),
        ("train/staleness", mean_staleness(progress)),
    ]
}

fn system(progress: &UpdateProgress) -> [(&'static str, f64); 5] {
    [
        ("system/steps_per_second", progress.steps_per_second),
        ("system/wait_seconds", progress.phases.wait.as_secs_f64()),
        ("system/train_seconds", progress.phases.train.as_secs_f64()),
        ("system/actors", progress.n_actors as f64),
        ("system/queued", progress.n_queued as f64),
    ]
}

fn books(progress: &UpdateProgress) -> [(&'static str, u64); 8] {
    let books = &progress.books;
    [
        ("books/published", books.published),
        ("books/trained", books.trained),
        ("books/dropped_stale", books.dropped_stale),
        ("books/refused", books.refused),
        ("books/superseded", books.superseded),
        ("books/rolled_back", books.rolled_back),
        ("books/duplicates", books.duplicates),
        ("books/steps_redone", books.steps_redone),
    ]
}

fn mean_staleness(progress: &UpdateProgress) -> f64 {
    let (mut n_rollouts, mut sum) = (0, 0);
    for (staleness, n) in &progress.update.staleness {
        n_rollouts += n;
        sum += staleness * n;
    }
    if n_rollouts == 0 { 0.0 } else { sum as f64 / n_rollouts as f64 }
}
