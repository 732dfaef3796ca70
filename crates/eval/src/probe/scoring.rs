//! The probe itself: play, learn to read on one half of the episodes, scorer on the other.

use leadtime_numerics::proportion::with_width;
use leadtime_numerics::stats::{Bootstrap, mean};

use super::readers::Reader;
use super::record::{N_STAGES, ProbeSample, check_listener, record};
use super::result::{MIN_EPISODES, ProbeResult, ProbeStage, ReaderScore, Score};
use super::ridge::Ridge;
use crate::error::Error;
use crate::measure::{Difference, MakeEnvironment, PlaySettings, Player};

/// Plays episodes with a policy and measures how well the listener's reaction delay can be read off its features.
///
/// The number of threads does not change the result.
///
/// # Errors
///
/// [`Error::Probe`] if there are too few episodes, if the player is a script, or if there is no delay to be known:
/// nobody listens, or it never varies, or does so with every message. Any other [`Error`] in the cases of
/// [`crate::measure::evaluate`].
pub fn probe(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &PlaySettings<'_>,
    bootstrap: Bootstrap,
) -> Result<ProbeResult, Error> {
    check_probe(make, player, settings)?;
    let (n, name) = (settings.n_episodes, player.name());
    let samples = record(make, player, settings)?;
    let half = n / 2;
    let (seen, unseen): (Vec<&ProbeSample>, Vec<&ProbeSample>) =
        samples.iter().partition(|sample| sample.episode < half);
    let scorer = Scorer::new(&seen, unseen, bootstrap)?;
    Ok(ProbeResult {
        player: name.to_owned(),
        seed: settings.seed,
        n_learned_from: half,
        n_evaluated_on: n - half,
        bootstrap,
        readers: scorer.readers(),
        stages: (0..N_STAGES).map(|stage| scorer.stage(stage)).collect(),
        overall: scorer.overall(),
        differences: scorer.differences(),
    })
}

/// Checks what can be checked before any episode is played.
///
/// # Errors
///
/// As [`probe`], but for a delay that never varies.
pub fn check_probe(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &PlaySettings<'_>,
) -> Result<(), Error> {
    let (n, least, name) = (settings.n_episodes, 2 * MIN_EPISODES as u64, player.name());
    if n < least {
        let text = format!("{n} episodes are too few for a probe; allowed: at least {least}");
        return Err(Error::Probe(text));
    }
    player.check(make()?.as_ref())?;
    if player.hidden_dim() == 0 {
        let text = format!("`{name}` is a script, which has no features to read anything from");
        return Err(Error::Probe(text));
    }
    check_listener(make, settings)
}

/// What was learned, and the samples that it is evaluated on.
pub(super) struct Scorer<'a> {
    readers: Vec<Reader>,
    /// Samples of the first half by stage.
    n_seen: [usize; N_STAGES],
    unseen: Vec<&'a ProbeSample>,
    /// Samples of stages that enough episodes reached.
    common: Vec<&'a ProbeSample>,
    /// Mean delay of the first half.
    center: f64,
    bootstrap: Bootstrap,
}

impl<'a> Scorer<'a> {
    /// Learns from the samples that may be seen.
    pub(super) fn new(
        seen: &[&'a ProbeSample],
        unseen: Vec<&'a ProbeSample>,
        bootstrap: Bootstrap,
    ) -> Result<Self, Error> {
        let delays = by_episode(seen, |sample| f64::from(sample.delay));
        if let Some(&ProbeSample { delay, .. }) = seen.first().copied()
            && seen.iter().chain(&unseen).all(|sample| sample.delay == delay)
        {
            return Err(Error::Probe(format!(
                "the listener's reaction delay is {delay} in every episode, so there is nothing to be found out; let it \
                 vary, as with --set 'human.reaction_delay={{uniform={{low=0,high=5,drawn=\"per_episode\"}}}}'"
            )));
        }
        let count = |samples: &[&ProbeSample]| -> [usize; N_STAGES] {
            std::array::from_fn(|stage| samples.iter().filter(|s| s.stage == stage).count())
        };
        let (n_seen, n_unseen) = (count(seen), count(&unseen));
        let is_common = |stage: usize| n_seen[stage].min(n_unseen[stage]) >= MIN_EPISODES;
        let common = unseen.iter().copied().filter(|sample| is_common(sample.stage)).collect();
        let (readers, center) = (Reader::all(seen)?, mean(&delays));
        Ok(Self { readers, n_seen, unseen, common, center, bootstrap })
    }

    /// Returns for every reader how much of the delay's variance it explains.
    pub(super) fn readers(&self) -> Vec<ReaderScore> {
        let sum = |reader: &Reader| -> f64 {
            by_episode(&self.common, |sample| error(reader, sample).powi(2)).iter().sum()
        };
        let spread = sum(&Reader::Constant(self.center));
        let score = |reader: &Reader| ReaderScore {
            name: reader.name().to_owned(),
            n_features: reader.ridge().map_or(0, Ridge::n_features),
            penalty: reader.ridge().map(|ridge| ridge.penalty),
            r_squared: (spread > 0.0).then(|| 1.0 - sum(reader) / spread),
        };
        self.readers.iter().map(score).collect()
    }

    /// Scores every reader on the samples of one stage.
    pub(super) fn stage(&self, stage: usize) -> ProbeStage {
        let and_more = if stage + 1 == N_STAGES { " or more" } else { "" };
        let of = |samples: &[&'a ProbeSample]| -> Vec<&'a ProbeSample> {
            samples.iter().copied().filter(|sample| sample.stage == stage).collect()
        };
        let scores = self.scores(&of(&self.common), stage);
        let name = format!("{stage}{and_more}");
        ProbeStage { scores, ..described(name, self.n_seen[stage], &of(&self.unseen)) }
    }

    /// Scores all stages together: every episode counts once, and its stages alike.
    pub(super) fn overall(&self) -> ProbeStage {
        let scores = self.scores(&self.common, N_STAGES);
        // In the first stage there is every episode.
        ProbeStage { scores, ..described("all".to_owned(), self.n_seen[0], &self.common) }
    }

    /// Compares the errors of reading the features with those of every weaker reader, episode by episode.
    pub(super) fn differences(&self) -> Vec<Difference> {
        let Some((hidden, others)) = self.readers.split_last() else { return Vec::new() };
        let own = by_episode(&self.common, |sample| error(hidden, sample));
        let first = 2 * ((N_STAGES + 1) * self.readers.len()) as u64;
        let compare = |(i, reader): (usize, &Reader)| {
            let theirs = by_episode(&self.common, |sample| error(reader, sample));
            let change: Vec<f64> = own.iter().zip(theirs).map(|(a, b)| a - b).collect();
            Some(Difference {
                measure: "mean_absolute_error".to_owned(),
                of: hidden.name().to_owned(),
                minus: reader.name().to_owned(),
                interval: self.bootstrap.mean(&change, first + i as u64)?,
            })
        };
        others.iter().enumerate().filter_map(compare).collect()
    }

    /// Scores every reader; `place` is that of the samples among the stages, for every interval has its own draws.
    fn scores(&self, samples: &[&ProbeSample], place: usize) -> Vec<Score> {
        let score = |(i, reader): (usize, &Reader)| {
            let index = 2 * (place * self.readers.len() + i) as u64;
            let errors = by_episode(samples, |sample| error(reader, sample));
            let exact = by_episode(samples, |sample| {
                let is_exact = reader.read(sample).round() == f64::from(sample.delay);
                f64::from(u8::from(is_exact))
            });
            let error = self.bootstrap.mean(&errors, index)?;
            let share = self.bootstrap.mean(&exact, index + 1)?;
            let exact = with_width(share, exact.len(), self.bootstrap.confidence);
            Some(Score { error, exact })
        };
        self.readers.iter().enumerate().filter_map(score).collect()
    }
}

fn error(reader: &Reader, sample: &ProbeSample) -> f64 {
    (reader.read(sample) - f64::from(sample.delay)).abs()
}

/// Returns the mean of a number over the samples of each episode; samples of one episode lie side by side.
fn by_episode(samples: &[&ProbeSample], value: impl Fn(&ProbeSample) -> f64) -> Vec<f64> {
    let episodes = samples.chunk_by(|a, b| a.episode == b.episode);
    episodes.map(|of| mean(&of.iter().map(|sample| value(sample)).collect::<Vec<_>>())).collect()
}

/// Describes samples without scoring them.
fn described(name: String, n_learned_from: usize, samples: &[&ProbeSample]) -> ProbeStage {
    let average = |value: fn(&ProbeSample) -> u32| {
        let values = by_episode(samples, |sample| f64::from(value(sample)));
        (!values.is_empty()).then(|| mean(&values))
    };
    ProbeStage {
        name,
        n_learned_from,
        n_evaluated_on: samples.chunk_by(|a, b| a.episode == b.episode).count(),
        n_steps: samples.iter().map(|sample| sample.n_steps).sum(),
        mean_delay: average(|sample| sample.delay),
        mean_comprehended: average(|sample| sample.comprehended),
        scores: Vec::new(),
    }
}

#[cfg(test)]
#[path = "scoring_tests.rs"]
mod tests;
