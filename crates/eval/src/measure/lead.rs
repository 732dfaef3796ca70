//! Lead time: how long before the hazard the first warning came.
//!
//! The hazard of an episode is what happens to the same listener in the same world without any messages: the
//! first step in a danger zone, or the crash. So two notifiers are measured against the same moment, also where a
//! warning has averted it.

use super::evaluation::Evaluation;

/// The metrics that [`lead_times`] and [`hazards`] read.
#[cfg(test)]
pub(super) const HAZARDS: [&str; 3] = [FIRST, DANGER, CRASHED];
/// Name of the measure.
pub(super) const LEAD_TIME: &str = "lead_time";
const FIRST: &str = "first_notification";
const DANGER: &str = "danger_from";
const CRASHED: &str = "crashed";

/// Returns whether a task with these metrics has lead times.
pub(super) fn is_known(metrics: &[String]) -> bool {
    let has = |name: &str| metrics.iter().any(|metric| metric == name);
    has(FIRST) && (has(DANGER) || has(CRASHED))
}

/// Adds the lead time to an evaluation, where the task has one.
pub fn with_lead_times(evaluation: Evaluation, unaided: &Evaluation) -> Evaluation {
    match lead_times(&evaluation, unaided) {
        Some(leads) => evaluation.with_column(LEAD_TIME, &leads),
        None => evaluation,
    }
}

/// Computes, per episode, the steps from a player's first message to the hazard of the unaided listener in the same
/// episode; negative if the message came later, NaN where there was no message or no hazard.
///
/// `None` if the task knows no such metrics, or if the two played other episodes.
fn lead_times(player: &Evaluation, unaided: &Evaluation) -> Option<Vec<f32>> {
    let same = player.seed == unaided.seed && player.episodes.len() == unaided.episodes.len();
    let first = player.column(FIRST).filter(|_| same)?;
    let hazards = hazards(unaided)?;
    let lead = |(first, hazard): (f64, f64)| {
        let defined = first > 0.0 && hazard > 0.0;
        if defined { (hazard - first) as f32 } else { f32::NAN }
    };
    Some(first.into_iter().zip(hazards).map(lead).collect())
}

/// Returns the step of each episode's hazard, counted from 1; 0 where there was none. `None` if the task knows no hazards.
pub(super) fn hazards(unaided: &Evaluation) -> Option<Vec<f64>> {
    if let Some(steps) = unaided.column(DANGER) {
        return Some(steps);
    }
    let crashed = unaided.column(CRASHED)?;
    // A crash ends the episode.
    let step = |(crashed, n): (f64, u64)| if crashed > 0.5 { n as f64 } else { 0.0 };
    Some(crashed.into_iter().zip(unaided.episodes.iter().map(|e| e.n_steps)).map(step).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation(metric: &str, rows: &[(u64, f32)]) -> Evaluation {
        let rows: Vec<_> = rows.iter().map(|&(n, value)| (n, [value])).collect();
        Evaluation::of([metric], &rows)
    }

    #[test]
    fn the_lead_is_from_the_first_message_to_what_would_have_happened() {
        let player = evaluation(FIRST, &[(90, 5.0), (90, 40.0), (90, 0.0), (90, 3.0)]);
        let zones = evaluation("danger_from", &[(80, 25.0), (80, 30.0), (80, 30.0), (80, 0.0)]);
        let leads = lead_times(&player, &zones).unwrap();
        assert_eq!(leads[..2], [20.0, -10.0]);
        assert!(leads[2].is_nan() && leads[3].is_nan());
        let crashes = evaluation("crashed", &[(25, 1.0), (30, 1.0), (30, 1.0), (30, 0.0)]);
        assert_eq!(lead_times(&player, &crashes).unwrap()[..2], [20.0, -10.0]);
    }

    #[test]
    fn other_episodes_and_tasks_without_hazards_have_no_lead() {
        let player = evaluation("first_notification", &[(90, 5.0)]);
        let other = Evaluation { seed: 2, ..evaluation("crashed", &[(25, 1.0)]) };
        assert_eq!(lead_times(&player, &other), None);
        assert_eq!(lead_times(&player, &evaluation("fuel", &[(25, 1.0)])), None);
    }
}
