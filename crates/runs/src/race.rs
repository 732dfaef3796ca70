//! A race: several seeds of one configuration, of which the hopeless are stopped at a quarter of the way.
//!
//! ```text
//! every racer to a quarter ─► the same held-out episodes for all ─► the hopeless are stopped, at most the better half goes on
//!     ─► these to the end ─► other held-out episodes for all of them ─► the winner
//! ```
//!
//! Racers are ordinary runs. What a race found out about each of them lies in its directory, so that a race which was
//! interrupted goes on where it was: its decisions are functions of these scores.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};
use std::{fmt, io};

use leadtime_config::{Config, ConfigError, Layer, identity};
use leadtime_eval::Error;
use leadtime_eval::measure::{PlaySettings, evaluate};
use leadtime_learner::held_out::{lead, score, spread};
use leadtime_learner::write_atomically;
use leadtime_proto::hex;
use serde::{Deserialize, Serialize};

use crate::build::n_cores;
use crate::digest::sha256;
use crate::directory_error::RunDirError;
use crate::held_out::{HeldOutUse, comparable, episodes, held_out_seed};
use crate::layout::{is_begun, is_finished, read_config};
use crate::{BEST_POLICY, LAST_POLICY, LoadedPolicy, RunRecord, Tasks, policy_file, regular};

/// A racer whose success at a quarter is further behind the leader's than this is hopeless.
pub const MARGIN: f64 = 0.1;
/// Where the task knows no success: a racer whose return is behind by more standard errors of the difference is hopeless.
const ERRORS_BEHIND: f64 = 2.0;
/// Racers are compared after this fraction of their updates: one in [`PARTS`].
const PARTS: u64 = 4;
/// At a quarter a racer plays one in so many of the episodes that it plays at the end.
const FEWER_AT_A_QUARTER: u32 = 5;
/// The fewest episodes of a comparison: one has no standard error.
const FEWEST_EPISODES: u32 = 2;
/// The copy of a racer's policy at a quarter.
pub(crate) const QUARTER_POLICY: &str = "quarter.safetensors";
/// The file of what a race found out, in a racer's directory.
pub(crate) const FILE: &str = "race.json";
/// Digits of the digest in the name of a race.
const NAME_DIGITS: usize = 8;
/// The longest name of a run.
const MAX_NAME: usize = 64;

/// How a racer's policy did in a comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RaceScore {
    /// Updates that made the policy.
    pub updates: u64,
    /// Seed of the episodes.
    pub eval_seed: u64,
    /// Success, or return where the task knows no success, in every episode.
    pub scores: Vec<f32>,
    /// Whether the scores are successes.
    pub is_success: bool,
    /// Digest of what decides the episodes and the choices in them.
    episodes: String,
    /// Mean return, which tells equal scores apart: early in a training nobody may succeed.
    pub episode_return: f64,
}

impl RaceScore {
    /// Returns the mean score.
    pub fn mean(&self) -> f64 {
        self.scores.iter().copied().map(f64::from).sum::<f64>() / self.scores.len().max(1) as f64
    }

    /// Returns the standard error of the mean; 0 of a single episode.
    pub fn error(&self) -> f64 {
        spread(self.scores.iter().copied().map(f64::from)).map_or(0.0, |spread| spread.error)
    }

    /// Compares policies in the same episodes; the better one is greater.
    fn compare(&self, other: &Self) -> Ordering {
        let by_score = self.mean().total_cmp(&other.mean());
        by_score.then_with(|| self.episode_return.total_cmp(&other.episode_return))
    }

    fn is_of(&self, eval_seed: u64, n_episodes: u32, episodes: &str) -> bool {
        let is_as_long = self.scores.len() == n_episodes as usize;
        self.eval_seed == eval_seed && is_as_long && self.episodes == episodes
    }
}

/// What a race found out about a racer: `race.json` in its directory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RacerRecord {
    /// How it did at a quarter.
    pub quarter: Option<RaceScore>,
    /// Whether it was stopped there.
    pub is_stopped: bool,
    /// How its best policy did at the end.
    pub last: Option<RaceScore>,
}

impl RacerRecord {
    /// Reads the record in a run's directory; an empty one if there is none.
    pub(crate) fn read(directory: &Path) -> io::Result<Self> {
        let text = regular::if_there(regular::read_to_string(&directory.join(FILE)))?;
        let Some(text) = text else { return Ok(Self::default()) };
        serde_json::from_str(&text).map_err(io::Error::other)
    }

    /// Returns whether the run stands where a race has stopped it.
    pub(crate) fn is_stopped_at(&self, n_updates: u64) -> bool {
        self.is_stopped && self.quarter.as_ref().is_some_and(|quarter| quarter.updates == n_updates)
    }
}

/// One seed of a race.
#[derive(Clone, Debug)]
pub struct Racer {
    /// The run's whole configuration, its name and seed included.
    pub config: Config,
    /// The run's directory.
    pub directory: PathBuf,
    /// What is known of it.
    pub record: RacerRecord,
}

/// Which of a racer's comparisons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RaceStage {
    /// At a quarter of the way: its newest policy.
    Quarter,
    /// At the end: its best policy.
    Final,
}

/// A racer's place among all, and its score.
type Ranked<'a> = (usize, &'a RaceScore);

/// What a race costs at most.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RaceCost {
    /// How many racers begin.
    pub racers: u64,
    /// Steps of each of them to the quarter.
    pub steps_each: u64,
    /// How many go on at most.
    pub keep: u64,
    /// Steps of each of these to the end.
    pub steps_more: u64,
    /// Steps of all together.
    pub steps: u64,
    /// The same in whole trainings.
    pub trainings: f64,
}

impl fmt::Display for RaceCost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { racers, steps_each, keep, steps_more, steps, trainings } = self;
        write!(
            f,
            "{racers} racers train {steps_each} steps each, then at most {keep} of them {steps_more} more:\nat most {steps} \
             steps, as many as {trainings:.2} whole trainings"
        )
    }
}

/// Several seeds of one configuration, and how far each has come.
#[derive(Clone, Debug)]
pub struct Race {
    /// Everybody who takes part, by ascending seed.
    pub racers: Vec<Racer>,
    /// How many go on at most.
    pub n_keep: usize,
    /// Episodes of the comparison at the end.
    n_episodes: u32,
    /// The seed of the first racer; each other one has the next.
    seed: u64,
}

impl Race {
    /// Plans a race of a configuration's seed and those after it; `name` begins the names of its runs.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] if a name cannot be a run's, or a seed is too large.
    pub fn plan(
        tasks: &Tasks,
        config: &Config,
        name: Option<&str>,
        n_racers: u32,
        n_episodes: u32,
    ) -> Result<Self, ConfigError> {
        let seeds = (0..u64::from(n_racers)).map(|i| config.seed + i);
        let racer = |seed: u64| {
            let suffix = format!("-s{seed}");
            let stem = name.map_or_else(|| own_name(config), str::to_owned);
            let stem: String = stem.chars().take(MAX_NAME - suffix.len()).collect();
            let name = format!("{stem}{suffix}");
            let text = format!("seed = {seed}\nrun.name = \"{name}\"\n");
            let config = config.with([Layer::text("the race", text)], &tasks.registry)?;
            let directory = config.run.directory.join(name);
            // One that cannot be read is refused by `check`.
            let record = RacerRecord::read(&directory).unwrap_or_default();
            Ok(Racer { config, directory, record })
        };
        Ok(Self {
            racers: seeds.map(racer).collect::<Result<_, ConfigError>>()?,
            n_keep: (n_racers as usize / 2).max(1),
            n_episodes: n_episodes.max(FEWEST_EPISODES),
            seed: config.seed,
        })
    }

    /// Makes sure that the racers which have begun did so with the race's configuration.
    ///
    /// # Errors
    ///
    /// [`RunDirError`] if one of them has another, with the difference, or is a fork, or if it or its record cannot be read.
    pub fn check(&self) -> Result<(), RunDirError> {
        for Racer { config, directory, .. } in &self.racers {
            if !is_begun(directory)? {
                continue;
            }
            if let Err(error) = RacerRecord::read(directory) {
                let file = directory.join(FILE);
                return Err(RunDirError::Refused(format!(
                    "{} is damaged ({error}); delete it, and the racer is compared again",
                    file.display()
                )));
            }
            if let Ok(Some(detour)) = RunRecord::detour(directory) {
                let run = directory.display();
                return Err(RunDirError::Refused(format!("{run} {detour}; take another --name")));
            }
            let mut changes = identity::difference(&read_config(directory)?, &config.table);
            changes.retain(|change| identity::decides_weights(&change.key, &config.table));
            if !changes.is_empty() {
                let changes: Vec<String> = changes.iter().map(ToString::to_string).collect();
                return Err(RunDirError::Refused(format!(
                    "{} began with another configuration: {}; give the old values, or take another --name",
                    directory.display(),
                    changes.join("; ")
                )));
            }
        }
        Ok(())
    }

    /// Returns after how many updates racers are compared.
    pub fn quarter(&self) -> u64 {
        (self.n_updates() / PARTS).max(1)
    }

    fn n_updates(&self) -> u64 {
        self.racers.first().map_or(0, |racer| racer.config.learner.n_updates())
    }

    /// Reckons what the race costs at most.
    pub fn cost(&self) -> RaceCost {
        let batch = self.racers.first().map_or(0, |racer| racer.config.steps_per_update());
        let (steps_each, whole) = (self.quarter() * batch, self.n_updates() * batch);
        let (n_racers, n_keep) = (self.racers.len() as u64, self.n_keep as u64);
        let steps_more = whole.saturating_sub(steps_each);
        let steps = n_racers * steps_each + n_keep * steps_more;
        let trainings = steps as f64 / whole.max(1) as f64;
        RaceCost { racers: n_racers, steps_each, keep: n_keep, steps_more, steps, trainings }
    }

    /// Returns how many episodes a comparison has.
    fn n_episodes(&self, stage: RaceStage) -> u32 {
        match stage {
            RaceStage::Quarter => self.n_episodes.div_ceil(FEWER_AT_A_QUARTER).max(FEWEST_EPISODES),
            RaceStage::Final => self.n_episodes,
        }
    }

    /// Digest of what decides the episodes of all comparisons.
    fn episodes(&self) -> String {
        self.racers
            .first()
            .map_or_else(String::new, |racer| hex::encode(&comparable(&racer.config)))
    }

    /// Returns the file of the policy that a racer takes part with in a comparison.
    ///
    /// At a quarter that is a copy of its newest one, because the run may go on before everybody has been compared.
    ///
    /// # Errors
    ///
    /// [`RunDirError`] if the racer has gone on from a quarter and has no copy, or if files cannot be read or written.
    pub fn policy(&self, racer: usize, stage: RaceStage) -> Result<PathBuf, RunDirError> {
        let directory = &self.racers[racer].directory;
        let (copy, newest) = (directory.join(QUARTER_POLICY), directory.join(LAST_POLICY));
        if stage == RaceStage::Final {
            // One that is lost comes back from the last checkpoint, before the racer is compared.
            let best = directory.join(BEST_POLICY);
            if best.is_file() {
                return Ok(best);
            }
            let helps = "put it back, or take another --name";
            return Err(RunDirError::Refused(format!(
                "{} is missing, and no checkpoint holds it; {helps}",
                best.display()
            )));
        }
        // One that has reached `evaluation.stop_at` before is compared as it ended.
        let n_newest = policy_file::n_updates(&newest).unwrap_or(0);
        let is_early = (1..self.quarter()).contains(&n_newest) && is_finished(directory);
        let n_compared = if is_early { n_newest } else { self.quarter() };
        let is_of_the_quarter =
            |file: &Path| policy_file::n_updates(file).is_ok_and(|n| n == n_compared);
        if is_of_the_quarter(&copy) {
            return Ok(copy);
        }
        if !is_of_the_quarter(&newest) {
            return Err(RunDirError::Refused(format!(
                "{} has gone on from update {}, and its policy there was not kept; take another --name",
                directory.display(),
                self.quarter()
            )));
        }
        regular::read(&newest)
            .and_then(|policy| write_atomically(&copy, &policy))
            .map_err(|error| RunDirError::Refused(format!("{}: {error}", copy.display())))?;
        Ok(copy)
    }

    fn eval_seed(&self, stage: RaceStage) -> u64 {
        let purpose = match stage {
            RaceStage::Quarter => HeldOutUse::Quarter,
            RaceStage::Final => HeldOutUse::Final,
        };
        held_out_seed(self.seed, purpose)
    }

    /// Returns how a racer did in a comparison, if it has taken part in it.
    pub fn score(&self, racer: usize, stage: RaceStage) -> Option<&RaceScore> {
        let record = &self.racers.get(racer)?.record;
        let score = match stage {
            RaceStage::Quarter => record.quarter.as_ref(),
            RaceStage::Final => record.last.as_ref(),
        };
        score.filter(|score| {
            score.is_of(self.eval_seed(stage), self.n_episodes(stage), &self.episodes())
        })
    }

    /// Returns whether a racer has been trained as far as a comparison needs.
    pub fn is_trained(&self, racer: usize, stage: RaceStage) -> bool {
        let Some(Racer { directory, .. }) = self.racers.get(racer) else { return false };
        match stage {
            RaceStage::Quarter => {
                let newest = policy_file::n_updates(&directory.join(LAST_POLICY));
                // A racer that has reached `evaluation.stop_at` goes no further.
                newest.is_ok_and(|n_updates| n_updates >= self.quarter()) || is_finished(directory)
            }
            RaceStage::Final => is_finished(directory),
        }
    }

    /// Plays the episodes of a comparison with a racer's policy.
    ///
    /// # Errors
    ///
    /// [`Error`] if the task cannot be built or an episode cannot be played.
    pub fn rate(
        &self,
        tasks: &Tasks,
        policy: &LoadedPolicy,
        stage: RaceStage,
    ) -> Result<RaceScore, Error> {
        let eval_seed = self.eval_seed(stage);
        // Not the run's own: evaluation may have changed since it began.
        let settings = self.racers.first().map_or(&policy.config, |racer| &racer.config);
        let (task, action) = (&settings.evaluation.task, settings.evaluation.action);
        let make = || tasks.registry.build(task);
        let settings = PlaySettings::new(u64::from(self.n_episodes(stage)), eval_seed);
        let player = policy.player("racer", Some(action))?;
        let evaluation = evaluate(&make, &player, &settings.threads(n_cores()))?;
        let played = episodes(&evaluation);
        Ok(RaceScore {
            updates: policy.n_updates,
            eval_seed,
            episodes: self.episodes(),
            scores: played.iter().map(|episode| score(episode) as f32).collect(),
            is_success: played.iter().all(|episode| episode.success.is_some()),
            episode_return: played.iter().map(|episode| episode.total_reward).sum::<f64>()
                / played.len().max(1) as f64,
        })
    }

    /// Keeps how a racer did in a comparison.
    ///
    /// # Errors
    ///
    /// If the file in its directory cannot be written.
    pub fn keep(&mut self, racer: usize, stage: RaceStage, score: RaceScore) -> io::Result<()> {
        let racer = &mut self.racers[racer];
        match stage {
            RaceStage::Quarter => racer.record.quarter = Some(score),
            RaceStage::Final => racer.record.last = Some(score),
        }
        racer.write()
    }

    /// Decides who goes on from a quarter, and notes whom it stops.
    ///
    /// # Errors
    ///
    /// If the file in a racer's directory cannot be written.
    pub fn stop_hopeless(&mut self) -> io::Result<Vec<usize>> {
        let scores = |i| self.score(i, RaceStage::Quarter);
        let scores: Vec<Option<&RaceScore>> = (0..self.racers.len()).map(scores).collect();
        let going_on = going_on(&scores, self.n_keep);
        for (i, racer) in self.racers.iter_mut().enumerate() {
            let is_stopped = racer.record.quarter.is_some() && !going_on.contains(&i);
            if racer.record.is_stopped != is_stopped {
                racer.record.is_stopped = is_stopped;
                racer.write()?;
            }
        }
        Ok(going_on)
    }

    /// Returns the racer that did best at the end; of equals the one with the smallest seed.
    pub fn winner(&self) -> Option<usize> {
        let going_on = (0..self.racers.len()).filter(|&i| !self.racers[i].record.is_stopped);
        let finished = going_on.filter_map(|i| Some((i, self.score(i, RaceStage::Final)?)));
        let winner =
            finished.reduce(|best, next| if next.1.compare(best.1).is_gt() { next } else { best });
        winner.map(|(i, _)| i)
    }
}

impl Racer {
    fn write(&self) -> io::Result<()> {
        let mut text = serde_json::to_string(&self.record).map_err(io::Error::other)?;
        text.push('\n');
        write_atomically(&self.directory.join(FILE), text.as_bytes())
    }
}

/// Names a race after everything that decides what it computes, so that the same command finds its runs again.
fn own_name(config: &Config) -> String {
    let mut identity = identity::of_training(&config.table).to_vec();
    identity.extend(config.seed.to_le_bytes());
    let digest: String = sha256(&identity).chars().take(NAME_DIGITS).collect();
    format!("race-{}-{digest}", config.domain.as_str().replace('_', "-"))
}

/// Decides which racers go on, in their order: at most so many, the leader always, and nobody who is hopelessly behind it.
/// A racer without a score has dropped out.
fn going_on(scores: &[Option<&RaceScore>], n_keep: usize) -> Vec<usize> {
    let mut ranked: Vec<Ranked<'_>> =
        scores.iter().enumerate().filter_map(|(i, score)| Some((i, (*score)?))).collect();
    // Stable: of equals, the one with the smaller seed is ahead.
    ranked.sort_by(|a, b| b.1.compare(a.1));
    let Some(&(_, leader)) = ranked.first() else { return Vec::new() };
    let is_hopeless = |score: &RaceScore| {
        lead(&leader.scores, &score.scores).is_some_and(|lead| {
            let allowed = if score.is_success { MARGIN } else { ERRORS_BEHIND * lead.error };
            lead.mean > allowed
        })
    };
    let ahead = ranked.iter().take(n_keep).filter(|(_, score)| !is_hopeless(score));
    let mut going_on: Vec<usize> = ahead.map(|(i, _)| *i).collect();
    going_on.sort_unstable();
    going_on
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::test_support::config;

    fn score(successes: usize, is_success: bool) -> RaceScore {
        let scores = (0..20).map(|i| f32::from(u8::from(i < successes))).collect();
        let episodes = String::new();
        RaceScore { updates: 5, eval_seed: 1, scores, is_success, episodes, episode_return: 0.0 }
    }

    fn goes_on(successes: &[usize], n_keep: usize) -> Vec<usize> {
        let scores: Vec<RaceScore> = successes.iter().map(|&n| score(n, true)).collect();
        going_on(&scores.iter().map(Some).collect::<Vec<_>>(), n_keep)
    }

    #[test]
    fn the_hopeless_are_stopped_and_at_most_so_many_go_on() {
        assert_eq!(goes_on(&[19, 5, 18, 19], 2), [0, 3]);
        assert_eq!(goes_on(&[19, 5, 18, 3], 2), [0, 2]);
        assert_eq!(goes_on(&[19, 5, 16, 3], 2), [0], "more than the margin behind");
        assert_eq!(goes_on(&[10, 10, 10, 10], 2), [0, 1], "of equals the smaller seeds");
        assert_eq!(goes_on(&[0, 0], 1), [0]);
        let [poor, rich] =
            [1.0, 2.0].map(|paid| RaceScore { episode_return: paid, ..score(0, true) });
        assert_eq!(
            going_on(&[Some(&poor), Some(&rich)], 1),
            [1],
            "of equals the one that is paid more"
        );
    }

    #[test]
    fn a_racer_that_dropped_out_does_not_go_on_and_returns_are_compared_by_their_errors() {
        let (ahead, close, far) = (score(12, false), score(10, false), score(2, false));
        assert_eq!(going_on(&[None, Some(&ahead), Some(&close), Some(&far)], 4), [1, 2]);
        assert_eq!(going_on(&[None, None], 1), [0; 0]);
    }

    #[test]
    fn a_race_names_ordinary_runs_and_says_what_it_costs() {
        let (tasks, runs) = (Tasks::new(), tempfile::tempdir().unwrap());
        let steps = ["learner.n_envs=4", "learner.n_steps=64", "learner.total_steps=10240"];
        let config = config(runs.path(), "cartpole", "", &steps);
        let race = Race::plan(&tasks, &config, None, 4, 100).unwrap();
        let seeds: Vec<u64> = race.racers.iter().map(|racer| racer.config.seed).collect();
        assert_eq!((seeds, race.quarter()), (vec![7, 8, 9, 10], 10));
        let name = race.racers[1].config.run.name.as_ref().unwrap().to_string();
        assert!(name.starts_with("race-cartpole-") && name.ends_with("-s8"), "{name}");
        let again = Race::plan(&tasks, &config, None, 2, 100).unwrap();
        assert_eq!(again.racers[1].config.run.name.as_ref().unwrap().as_str(), name);
        let cost = race.cost().to_string();
        assert!(cost.contains("at most 25600 steps, as many as 2.50 whole"), "{cost}");
        let long = "a".repeat(80);
        let named = Race::plan(&tasks, &config, Some(&long), 2, 100).unwrap();
        assert_eq!(named.racers[0].config.run.name.as_ref().unwrap().as_str().len(), MAX_NAME);
    }

    #[test]
    fn what_a_race_found_out_survives_the_disk_and_counts_for_its_own_episodes_only() {
        let (tasks, runs) = (Tasks::new(), tempfile::tempdir().unwrap());
        let config = config(runs.path(), "cartpole", "", &[]);
        let plan = |n_episodes| Race::plan(&tasks, &config, Some("r"), 2, n_episodes).unwrap();
        let mut race = plan(100);
        let (eval_seed, episodes) = (race.eval_seed(RaceStage::Quarter), race.episodes());
        let own = |n| RaceScore { eval_seed, episodes: episodes.clone(), ..score(n, true) };
        let (bad, good) = (own(2), own(19));
        for (i, score) in [bad, good].into_iter().enumerate() {
            fs::create_dir_all(&race.racers[i].directory).unwrap();
            race.keep(i, RaceStage::Quarter, score).unwrap();
        }
        assert_eq!(race.stop_hopeless().unwrap(), [1]);
        let again = plan(100);
        assert!(again.racers[0].record.is_stopped && !again.racers[1].record.is_stopped);
        assert!(again.racers[0].record.is_stopped_at(5));
        assert_eq!(again.score(1, RaceStage::Quarter), race.score(1, RaceStage::Quarter));
        assert_eq!((plan(50).score(1, RaceStage::Quarter), again.winner()), (None, None));
    }
}
