//! What a notifier does over the course of an episode: short first, longer once it is safe, silent when safe?
//!
//! Time is told by the hazard: the step at which something happens to the same person in the same episode when nobody
//! speaks ([`hazards`]). A message before it comes in time; after it, the person would be safe unaided or lost.

use leadtime_episodes::{MakeEnvironment, PlaySettings, Player, play};

use crate::error::Error;
use crate::measure::{Evaluation, SpeechLog, Utterance, hazards};

/// Names of the columns, in the order of [`row`].
const COLUMNS: [&str; 4] =
    ["first_l", "later_l", "per_step_before_hazard", "per_step_after_hazard"];

/// Adds to an evaluation what was said in its episodes and when.
///
/// The columns: l of the first message, mean l of the others, messages per step before and after the hazard. A task
/// without hazards leaves the evaluation as it is.
///
/// # Shapes
///
/// `said`: per episode, what [`SpeechLog`] observed.
pub fn with_said(
    evaluation: Evaluation,
    unaided: &Evaluation,
    said: &[Vec<Utterance>],
) -> Evaluation {
    let Some(hazards) = hazards(unaided) else { return evaluation };
    let episodes = evaluation.episodes.iter().zip(said).zip(hazards);
    let rows: Vec<[f32; 4]> = episodes
        .map(|((episode, said), hazard)| row(said, episode.n_steps as usize, hazard as usize))
        .collect();
    let column = |i: usize| rows.iter().map(|row| row[i]).collect::<Vec<f32>>();
    let named = COLUMNS.iter().enumerate();
    named.fold(evaluation, |so_far, (i, name)| so_far.with_column(name, &column(i)))
}

/// Plays an evaluation's episodes again and adds what was said in them ([`with_said`]).
///
/// # Errors
///
/// As [`play`].
pub fn with_claims(
    evaluation: Evaluation,
    unaided: &Evaluation,
    make: &MakeEnvironment<'_>,
    player: &Player,
    n_threads: usize,
) -> Result<Evaluation, Error> {
    if make()?.insight().is_none() {
        return Ok(evaluation);
    }
    let settings = PlaySettings::new(evaluation.episodes.len() as u64, evaluation.seed);
    let said = play(make, player, &settings.threads(n_threads), |_| SpeechLog::default())?;
    Ok(with_said(evaluation, unaided, &said))
}

/// Computes the columns of one episode; NaN where one is undefined.
fn row(utterances: &[Utterance], n_steps: usize, hazard: usize) -> [f32; 4] {
    let mean = |of: &[Utterance]| {
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
    use crate::measure::evaluate;

    fn lander() -> Result<Box<dyn Environment>, TaskError> {
        Ok(Box::new(LanderTaskSettings::default().build()?))
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let settings = PlaySettings::new(5, 3);
        let unaided = evaluate(&lander, &Player::baseline("unaided"), &settings).unwrap();
        let player = Player::baseline("heuristic");
        let judged = evaluate(&lander, &player, &settings).unwrap();
        let told = |n_threads| {
            let told = with_claims(judged.clone(), &unaided, &lander, &player, n_threads);
            let bits = |value: &f32| value.to_bits();
            let rows = told.unwrap().episodes.into_iter();
            rows.map(|episode| episode.metrics.iter().map(bits).collect())
                .collect::<Vec<Vec<u32>>>()
        };
        let reference = told(1);
        assert_eq!(reference[0].len(), judged.metrics.len() + COLUMNS.len());
        assert_eq!(told(3), reference);
    }

    fn said(start: usize, conveyance: usize) -> Utterance {
        Utterance { topic: 0, start, comprehension: 2, conveyance, end: start + conveyance }
    }

    #[test]
    fn an_episode_is_told_by_its_hazard() {
        let utterances = [said(2, 2), said(8, 3), said(25, 5)];
        assert_eq!(row(&utterances, 60, 20), [2.0, 4.0, 0.1, 0.025]);
    }

    #[test]
    fn what_an_episode_lacks_is_no_number() {
        assert!(row(&[], 60, 20)[..2].iter().all(|value| value.is_nan()));
        assert_eq!(row(&[], 60, 20)[2..], [0.0, 0.0]);
        assert!(row(&[said(2, 2)], 60, 0)[2..].iter().all(|value| value.is_nan()));
        let [.., before, after] = row(&[said(2, 2)], 10, 20);
        assert!(before == 0.1 && after.is_nan(), "it ended before its hazard");
    }
}
