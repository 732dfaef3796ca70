//! Ways to predict the listener's reaction delay, from a constant to a regression on the policy's features.

use super::record::{N_STAGES, ProbeSample};
use super::ridge::{Case, Ridge};
use crate::error::Error;

/// A way to predict the delay.
#[derive(Clone, Debug)]
pub(super) enum Reader {
    /// The same for everybody.
    Constant(f64),
    /// One value per stage; those of stages that are too rare are not used.
    PerStage([f64; N_STAGES]),
    /// Linear in the policy's input.
    Input(Ridge),
    /// Linear in the policy's features.
    Hidden(Ridge),
}

impl Reader {
    /// Fits every reader to samples, weakest first.
    pub(super) fn all(samples: &[&ProbeSample]) -> Result<Vec<Self>, Error> {
        let in_stage =
            |stage| median(samples.iter().filter(|s| s.stage == stage).map(|s| (s.delay, 1.0)));
        Ok(vec![
            Self::Constant(median(samples.iter().map(|s| (s.delay, s.weight)))),
            Self::PerStage(std::array::from_fn(in_stage)),
            Self::Input(regression(samples, |sample| &sample.input)?),
            Self::Hidden(regression(samples, |sample| &sample.hidden)?),
        ])
    }

    /// Returns the name that tables give it.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Constant(_) => "constant",
            Self::PerStage(_) => "constant per stage",
            Self::Input(_) => "policy's input",
            Self::Hidden(_) => "hidden features",
        }
    }

    pub(super) fn ridge(&self) -> Option<&Ridge> {
        match self {
            Self::Input(ridge) | Self::Hidden(ridge) => Some(ridge),
            _ => None,
        }
    }

    /// Predicts the delay, in steps; a delay is never negative.
    pub(super) fn read(&self, sample: &ProbeSample) -> f64 {
        let predicted = match self {
            Self::Constant(delay) => *delay,
            Self::PerStage(delays) => delays[sample.stage],
            Self::Input(ridge) => ridge.predict(&sample.input),
            Self::Hidden(ridge) => ridge.predict(&sample.hidden),
        };
        predicted.max(0.0)
    }
}

fn regression<'a>(
    samples: &[&'a ProbeSample],
    features: fn(&'a ProbeSample) -> &'a [f32],
) -> Result<Ridge, Error> {
    let case = |&sample: &&'a ProbeSample| {
        let (group, target) = (sample.episode, f64::from(sample.delay));
        Case { group, features: features(sample), target, weight: sample.weight }
    };
    Ridge::cross_validated(&samples.iter().map(case).collect::<Vec<_>>())
}

/// Returns the smallest delay that half of the weight does not exceed; 0 without any.
fn median(delays: impl Iterator<Item = (u32, f64)>) -> f64 {
    let mut delays: Vec<(u32, f64)> = delays.collect();
    delays.sort_by_key(|(delay, _)| *delay);
    let half = delays.iter().map(|(_, weight)| weight).sum::<f64>() / 2.0;
    let mut below = 0.0;
    let middle = delays.iter().find(|(_, weight)| {
        below += weight;
        below >= half
    });
    middle.map_or(0.0, |(delay, _)| f64::from(*delay))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(episode: u64, stage: usize, delay: u32) -> ProbeSample {
        let (input, hidden) = (vec![0.0], vec![delay as f32, 1.0]);
        let rest = ProbeSample { weight: 0.5, ..ProbeSample::default() };
        ProbeSample { episode, stage, delay, input, hidden, ..rest }
    }

    #[test]
    fn each_reader_uses_what_it_is_named_after() {
        let both = |i| [sample(i, 0, (i % 5) as u32), sample(i, 1, (i % 2) as u32)];
        let samples: Vec<ProbeSample> = (0..40).flat_map(both).collect();
        let readers = Reader::all(&samples.iter().collect::<Vec<_>>()).unwrap();
        let told: Vec<f64> = readers.iter().map(|reader| reader.read(&sample(50, 0, 4))).collect();
        assert_eq!(told[..2], [1.0, 2.0]);
        // An input that never changes predicts the mean: of 2 in stage 0 and of 1/2 in stage 1.
        assert!((told[2] - 1.25).abs() < 1e-9 && (told[3] - 4.0).abs() < 1e-3, "{told:?}");
        assert_eq!(readers[1].read(&sample(50, 1, 4)), 0.0);
        let n_features = readers.iter().map(|reader| reader.ridge().map_or(0, Ridge::n_features));
        assert_eq!(n_features.collect::<Vec<_>>(), [0, 0, 1, 2]);
    }

    #[test]
    fn a_median_goes_by_weight() {
        let delays = [(5, 1.0), (0, 0.3), (0, 0.3), (1, 0.3)];
        assert_eq!(median(delays.into_iter()), 5.0);
        assert_eq!(median(delays.into_iter().map(|(delay, _)| (delay, 1.0))), 0.0);
        assert_eq!(median(std::iter::empty()), 0.0);
    }
}
