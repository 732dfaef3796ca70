//! What a notifier does over the course of an episode: short first, longer once it is safe, silent when safe?
//!
//! Time is told by the hazard: the step at which something happens to the same person in the same episode when nobody
//! speaks ([`hazards`]). A message before it comes in time; after it, the person would be safe unaided or lost.

use leadtime_sims::Environment;

use crate::error::Error;
use crate::measure::{Evaluation, Player, hazards};
use crate::playthrough::{Playthrough, Story, Utterance};

/// Names of the columns, in the order of [`row`].
const COLUMNS: [&str; 4] =
    ["first_l", "later_l", "per_step_before_hazard", "per_step_after_hazard"];

/// Plays an evaluation's episodes again, message by message, and adds what they say to it.
///
/// The columns: l of the first message, mean l of the others, messages per step before and after the hazard. A task
/// without hazards, or that cannot be drawn, leaves the evaluation as it is.
///
/// # Errors
///
/// As [`Playthrough::record`].
pub fn with_claims(
    evaluation: Evaluation,
    unaided: &Evaluation,
    environment: &mut dyn Environment,
    player: &Player,
) -> Result<Evaluation, Error> {
    let Some(hazards) = hazards(unaided).filter(|_| environment.scene().is_some()) else {
        return Ok(evaluation);
    };
    let mut columns: [Vec<f32>; 4] = Default::default();
    for (index, hazard) in (0..evaluation.episodes.len()).zip(hazards) {
        let played = Playthrough::record(environment, player, evaluation.seed, index as u64)?;
        let story = Story::new(&played.scenes);
        for (column, value) in
            columns.iter_mut().zip(row(&story.utterances, played.n_steps(), hazard as usize))
        {
            column.push(value);
        }
    }
    let named = COLUMNS.iter().zip(&columns);
    Ok(named.fold(evaluation, |so_far, (name, column)| so_far.with_column(name, column)))
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
    use super::*;

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
