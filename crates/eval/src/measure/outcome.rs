//! What messages changed: success split by what the same listener does alone in the same episode.
//!
//! A success rate mixes two things that differ in worth. Where the listener would have failed, a success is a hazard
//! averted; where they would have succeeded, a failure is harm done by speaking. On a road on which half of the drives
//! succeed anyway, a rate does not say which of the two a notifier does.

use super::evaluation::Evaluation;

/// Name of the share averted, of the episodes in which the unaided listener fails.
pub(super) const AVERTED: &str = "averted";
/// Name of the share harmed, of the episodes in which the unaided listener succeeds.
pub(super) const HARMED: &str = "harmed";
const SUCCESS: &str = "success";
/// What every task with a listener counts.
const NOTIFICATIONS: &str = "notifications";

/// Returns whether a task with these metrics has outcomes to split.
pub(super) fn is_known(metrics: &[String]) -> bool {
    [SUCCESS, NOTIFICATIONS].iter().all(|name| metrics.iter().any(|metric| metric == name))
}

/// Adds to an evaluation whether a hazard was averted or harm done, by what the unaided listener did in the same episodes.
///
/// A task without success or without a listener, and episodes of another seed, leave the evaluation as it is.
pub fn with_outcomes(evaluation: Evaluation, unaided: &Evaluation) -> Evaluation {
    let same =
        evaluation.seed == unaided.seed && evaluation.episodes.len() == unaided.episodes.len();
    let known = same && is_known(&evaluation.metrics);
    let both = evaluation.column(SUCCESS).zip(unaided.column(SUCCESS)).filter(|_| known);
    let Some((aided, unaided)) = both else { return evaluation };
    let column = |split: fn(bool, bool) -> f32| {
        let episodes = aided.iter().zip(&unaided);
        episodes.map(|(aided, alone)| split(*aided > 0.5, *alone > 0.5)).collect::<Vec<f32>>()
    };
    let averted = column(|aided, alone| if alone { f32::NAN } else { number(aided) });
    let harmed = column(|aided, alone| if alone { number(!aided) } else { f32::NAN });
    evaluation.with_column(AVERTED, &averted).with_column(HARMED, &harmed)
}

fn number(holds: bool) -> f32 {
    f32::from(u8::from(holds))
}

#[cfg(test)]
mod tests {
    use leadtime_numerics::stats::Bootstrap;

    use super::*;
    use crate::measure::Summary;

    fn evaluation(success: &[f32]) -> Evaluation {
        let rows: Vec<_> = success.iter().map(|&success| (90, [success, 1.0])).collect();
        Evaluation::of([SUCCESS, NOTIFICATIONS], &rows)
    }

    #[test]
    fn success_is_split_by_what_the_listener_does_alone() {
        let alone = evaluation(&[0.0, 0.0, 0.0, 0.0, 1.0]);
        let split = with_outcomes(evaluation(&[1.0, 1.0, 1.0, 0.0, 0.0]), &alone);
        let summary = Summary::new(&split, &Bootstrap::new(1));
        let measured = |name: &str| {
            let measure = summary.get(name).unwrap();
            (measure.n, measure.interval.unwrap().estimate)
        };
        assert_eq!(measured(AVERTED), (4, 0.75));
        assert_eq!(measured(HARMED), (1, 1.0));
    }

    #[test]
    fn other_episodes_and_tasks_without_a_listener_are_left_as_they_are() {
        let player = evaluation(&[1.0, 0.0]);
        let others = Evaluation { seed: 2, ..player.clone() };
        assert_eq!(with_outcomes(player.clone(), &others), player);
        assert_eq!(with_outcomes(player.clone(), &evaluation(&[1.0])), player);
        let balancing = Evaluation::of([SUCCESS], &[(90, [1.0])]);
        assert_eq!(with_outcomes(balancing.clone(), &balancing), balancing);
    }
}
