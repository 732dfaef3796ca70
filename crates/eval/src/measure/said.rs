//! What a notifier does over the course of an episode: short first, longer once it is safe, silent when safe?
//!
//! Time is counted from the hazard: the step at which something happens to the same listener in the same episode when
//! nobody speaks. A message before it comes in time; after it, the listener would be safe unaided or lost.

use super::evaluation::Evaluation;
use super::lead;
use super::utterance::LoggedMessage;

/// Names of the columns, in the order of [`row`].
pub(super) const COLUMNS: [&str; 4] =
    ["first_l", "later_l", "per_step_before_hazard", "per_step_after_hazard"];

/// Adds to an evaluation what was said in its episodes and when.
///
/// The columns: l of the first message, mean l of the others, messages per step before and after the hazard. A task
/// without hazards leaves the evaluation as it is.
///
/// # Shapes
///
/// `said`: per episode, what [`SpeechLog`](super::SpeechLog) observed.
pub fn with_said(
    evaluation: Evaluation,
    unaided: &Evaluation,
    said: &[Vec<LoggedMessage>],
) -> Evaluation {
    let hazards = lead::hazards(unaided).filter(|_| lead::is_known(&unaided.metrics));
    let Some(hazards) = hazards else { return evaluation };
    let episodes = evaluation.episodes.iter().zip(said).zip(hazards);
    let rows: Vec<[f32; 4]> = episodes
        .map(|((episode, said), hazard)| row(said, episode.n_steps as usize, hazard as usize))
        .collect();
    let column = |i: usize| rows.iter().map(|row| row[i]).collect::<Vec<f32>>();
    let named = COLUMNS.iter().enumerate();
    named.fold(evaluation, |so_far, (i, name)| so_far.with_column(name, &column(i)))
}

/// Computes the columns of one episode; NaN where one is undefined.
fn row(utterances: &[LoggedMessage], n_steps: usize, hazard: usize) -> [f32; 4] {
    let mean = |of: &[LoggedMessage]| {
        let sum: usize = of.iter().map(|utterance| utterance.conveyance).sum();
        sum as f32 / of.len() as f32
    };
    let (first, later) = utterances.split_at(utterances.len().min(1));
    let n_before = utterances.iter().filter(|utterance| utterance.start < hazard).count();
    let n_after = utterances.len() - n_before;
    let per_step =
        |n: usize, steps: usize| if hazard == 0 { f32::NAN } else { n as f32 / steps as f32 };
    let before = hazard.min(n_steps);
    // 0 / 0 is no number, which is what an empty stretch has.
    [mean(first), mean(later), per_step(n_before, before), per_step(n_after, n_steps - before)]
}

#[cfg(test)]
mod tests {
    use leadtime_lander::task::LanderTaskSettings;
    use leadtime_sims::{Environment, TaskError};

    use super::*;
    use crate::measure::{PlaySettings, Player, SpeechLog, evaluate, evaluate_with};
    use crate::playthrough::Playthrough;

    fn lander() -> Result<Box<dyn Environment>, TaskError> {
        Ok(Box::new(LanderTaskSettings::default().build()?))
    }

    #[test]
    fn the_pass_that_measures_hears_what_the_scenes_of_the_same_episodes_show() {
        let settings = PlaySettings::new(5, 3).threads(2);
        let unaided = evaluate(&lander, &Player::baseline("unaided"), &settings).unwrap();
        let player = Player::baseline("heuristic");
        let log = |_| SpeechLog::default();
        let (evaluation, heard) = evaluate_with(&lander, &player, &settings, log).unwrap();
        assert!(heard.iter().flatten().count() > 5);
        for (index, heard) in (0..).zip(&heard) {
            let played = Playthrough::record(&lander, &player, 3, index).unwrap();
            let moments: Vec<_> = played.scenes.iter().map(|scene| scene.listener.word).collect();
            assert_eq!(*heard, LoggedMessage::all(&moments));
        }
        let n_metrics = evaluation.metrics.len();
        let evaluation = with_said(evaluation, &unaided, &heard);
        assert_eq!(evaluation.metrics[n_metrics..], COLUMNS);
        let lost = Evaluation { metrics: vec!["crashed".to_owned()], ..unaided };
        assert!(with_said(lost.clone(), &lost, &heard).metrics.len() == 1, "nobody listens");
    }

    fn said(start: usize, conveyance: usize) -> LoggedMessage {
        let end = start + conveyance;
        LoggedMessage { topic: 0, start, comprehension: 2, conveyance, needed: 2, end }
    }

    #[test]
    fn messages_are_counted_before_and_after_the_hazard_and_undefined_rates_are_not_numbers() {
        let utterances = [said(2, 2), said(8, 3), said(25, 5)];
        assert_eq!(row(&utterances, 60, 20), [2.0, 4.0, 0.1, 0.025]);
        assert!(row(&[], 60, 20)[..2].iter().all(|value| value.is_nan()));
        assert_eq!(row(&[], 60, 20)[2..], [0.0, 0.0]);
        assert!(row(&[said(2, 2)], 60, 0)[2..].iter().all(|value| value.is_nan()));
        let [.., before, after] = row(&[said(2, 2)], 10, 20);
        assert!(before == 0.1 && after.is_nan(), "it ended before its hazard");
    }
}
