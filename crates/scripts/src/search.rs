//! The search for a script: random proposals, raced on the same episodes, and small changes of the best.
//!
//! ```text
//! babble ──► values of the numbers ──► propose ──► 16 ──► 48 ──► 192 episodes ──► the best few ──┐
//!                                         ▲   drops out where it is clearly worse               │
//!                                         └──────────────── changed a little ◄──────────────────┘
//! ```
//!
//! Every candidate meets the same episodes, so differences are differences of scripts. All steps count, those of the babbling
//! and of the last comparison too. In the end the winner loses every rule and condition without which it does as well. The same settings give the same script: how many threads play makes no difference.

use leadtime_episodes::MakeEnvironment;
use leadtime_numerics::stats::{mean, percentile, standard_error};
use leadtime_numerics::{Purpose, stream};

use crate::arena::{Arena, Tried};
use crate::error::Error;
use crate::propose::{Proposer, ValueLog};
use crate::script::Script;

/// The most episodes in which things are said at random, to see what values the numbers take.
const BABBLED: u64 = 24;
/// The share of the steps that they may take.
const BABBLED_STEPS: f64 = 0.05;
/// Share of steps in which something is said at random.
const BABBLE: f64 = 0.15;
/// Episodes after which a candidate is compared with the best few, where there are enough steps.
const STAGES: [u64; 3] = [16, 48, 192];
/// How many scripts at least must have the steps for the last stage.
const N_WHOLE: u64 = 24;
/// How many good scripts are kept and changed.
const N_KEPT: usize = 6;
/// A candidate drops out where its mean is lower by more than so many standard errors of the difference.
const PATIENCE: f64 = 1.0;
/// Share of the steps in which candidates are drawn at random, before good ones are changed.
const RANDOM: f64 = 0.25;
/// Share of candidates that are drawn at random afterwards.
const FRESH: f64 = 0.15;
/// Share of the steps for the last comparison of the best.
const LAST: f64 = 0.12;
/// How many are in it.
const N_LAST: usize = 4;
/// Share of the steps in which the winner is made shorter.
const SHORTENED: f64 = 0.04;
/// What the return counts besides success: it guides where no script succeeds yet.
const RETURN_WEIGHT: f64 = 0.05;

/// How a script is searched.
#[derive(Clone, Copy)]
pub struct SearchSettings<'a> {
    /// Environment steps that the whole search may take; the candidate in work is finished.
    pub n_steps: u64,
    /// Names the episodes and the proposals.
    pub seed: u64,
    /// Threads; the result does not depend on it.
    pub n_threads: usize,
    /// Asked before every episode whether to end with [`Error::Interrupted`].
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl std::fmt::Debug for SearchSettings<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { n_steps, seed, .. } = self;
        write!(f, "SearchSettings({n_steps} steps, seed {seed})")
    }
}

/// How far a search is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchProgress {
    /// Environment steps so far.
    pub n_steps: u64,
    /// Scripts that were tried so far.
    pub n_candidates: u64,
    /// Success of the best so far, on the episodes of the search.
    pub best: Option<f64>,
}

/// A script, and what it took to find it.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundScript {
    /// The best script of the search.
    pub script: Script,
    /// Environment steps that the search took.
    pub n_steps: u64,
    /// Candidates that were tried.
    pub n_candidates: u64,
    /// Its success on the episodes of the search, among which it was chosen: too good.
    pub success: f64,
}

/// A script that has been played in some episodes of the search.
#[derive(Clone, Debug)]
struct PlayedScript {
    script: Script,
    tried: Vec<Tried>,
    /// One for each episode played.
    scores: Vec<f64>,
}

impl PlayedScript {
    fn new(script: Script) -> Self {
        Self { script, tried: Vec::new(), scores: Vec::new() }
    }

    fn success(&self) -> f64 {
        mean(&self.tried.iter().map(|tried| tried.success).collect::<Vec<_>>())
    }
}

/// Searches a script for a task.
///
/// # Errors
///
/// [`Error::NoMessages`] if none are sent in the task, [`Error::Task`] if it cannot be made, [`Error::Endless`] if an episode
/// does not end, [`Error::Interrupted`] if it was stopped.
pub fn search(
    make: &MakeEnvironment<'_>,
    settings: &SearchSettings<'_>,
    progress: &mut dyn FnMut(&SearchProgress),
) -> Result<FoundScript, Error> {
    let mut race = Tournament::begin(make, settings)?;
    let n_last = (settings.n_steps as f64 * LAST) as u64;
    let n_race = settings.n_steps - n_last;
    while race.n_steps < n_race {
        let share = race.n_steps as f64 / settings.n_steps as f64;
        let script = race.propose(share < RANDOM);
        race.enter(PlayedScript::new(script))?;
        progress(&race.progress());
    }
    race.finish(settings.n_steps - (settings.n_steps as f64 * SHORTENED) as u64)?;
    race.shorten(settings.n_steps)?;
    progress(&race.progress());
    let Some(best) = race.kept.first() else { return Err(Error::NoMessages) };
    let success = best.success();
    let script = best.script.clone();
    Ok(FoundScript { script, n_steps: race.n_steps, n_candidates: race.n_candidates, success })
}

/// A search while it goes on: candidates play against the best so far.
struct Tournament<'a> {
    arena: Arena<'a>,
    proposer: Proposer,
    /// Returns that count as 0 and as 1.
    returns: [f64; 2],
    /// The best so far, the best first, all of them played to the last stage.
    kept: Vec<PlayedScript>,
    draws: leadtime_numerics::Pcg64,
    stages: [u64; 3],
    n_steps: u64,
    n_candidates: u64,
}

impl<'a> Tournament<'a> {
    fn begin(make: &MakeEnvironment<'_>, settings: &SearchSettings<'a>) -> Result<Self, Error> {
        let SearchSettings { seed, n_threads, stop, n_steps: n_all } = *settings;
        let draws = |part| stream(seed, Purpose::Search, part, 0);
        let mut arena = Arena::new(make, seed, n_threads, stop)?;
        let task = arena.environment().scriptable().ok_or(Error::NoMessages)?;
        let mut log = ValueLog::new(task.quantities().len());
        let look = |now: &[f32], before: &[f32]| log.look(now, before);
        let most = (n_all as f64 * BABBLED_STEPS) as u64;
        let babbled = arena.babble(BABBLE, 0..BABBLED, most, &mut draws(0), look)?;
        let task = arena.environment().scriptable().ok_or(Error::NoMessages)?;
        let proposer = Proposer::new(task, log, draws(1));
        let n_steps: u64 = babbled.iter().map(|tried| tried.n_steps).sum();
        let stages = stages(n_all, n_steps / babbled.len() as u64);
        let mut returns: Vec<f64> = babbled.iter().map(|tried| tried.total_reward).collect();
        returns.sort_by(f64::total_cmp);
        let returns = [percentile(&returns, 5.0), percentile(&returns, 95.0)];
        let (kept, draws) = (Vec::new(), draws(2));
        let mut race =
            Self { arena, proposer, returns, kept, draws, stages, n_steps, n_candidates: 0 };
        // Silence takes part: a script that is worse than none is not found.
        race.enter(PlayedScript::new(Script::default()))?;
        Ok(race)
    }

    fn propose(&mut self, at_random: bool) -> Script {
        if at_random || self.draws.unit() < FRESH {
            return self.proposer.random();
        }
        // The better, the likelier.
        let n = self.kept.len();
        let place = self.draws.below(n).min(self.draws.below(n));
        self.proposer.changed(&self.kept[place].script)
    }

    /// Plays a candidate as long as it may be one of the best, and keeps it if it is.
    fn enter(&mut self, mut contender: PlayedScript) -> Result<(), Error> {
        self.n_candidates += 1;
        for n in self.stages {
            self.play(&mut contender, n)?;
            // One that does what another one does, such as never to speak, would take the place of something new.
            if self.kept.iter().any(|kept| kept.tried.starts_with(&contender.tried)) {
                return Ok(());
            }
            let worst = self.kept.last().filter(|_| self.kept.len() == N_KEPT);
            if worst.is_some_and(|worst| is_clearly_worse(&contender.scores, &worst.scores)) {
                return Ok(());
            }
        }
        let better = |kept: &PlayedScript| mean(&kept.scores) >= mean(&contender.scores);
        let place = self.kept.partition_point(better);
        self.kept.insert(place, contender);
        self.kept.truncate(N_KEPT);
        Ok(())
    }

    /// Plays a script on until it has been played in the first `n` episodes.
    fn play(&mut self, contender: &mut PlayedScript, n: u64) -> Result<(), Error> {
        let begun = contender.tried.len() as u64;
        let tried = self.arena.play(&contender.script, begun..n)?;
        self.n_steps += tried.iter().map(|tried| tried.n_steps).sum::<u64>();
        let [low, high] = self.returns;
        let scores = tried.iter().map(|tried| {
            let share = (tried.total_reward - low) / (high - low).max(f64::MIN_POSITIVE);
            tried.success + RETURN_WEIGHT * share.clamp(0.0, 1.0)
        });
        contender.scores.extend(scores);
        contender.tried.extend(tried);
        Ok(())
    }

    /// Compares the best on further episodes until the steps are used up, and sorts them.
    fn finish(&mut self, n_all: u64) -> Result<(), Error> {
        let mut last: Vec<PlayedScript> = self.kept.drain(..).take(N_LAST).collect();
        let [few, _, chose] = self.stages;
        let mut n = chose;
        while self.n_steps < n_all {
            n += few;
            for contender in &mut last {
                self.play(contender, n)?;
            }
        }
        // Only on episodes that chose none of them, if there are any.
        let fresh = |it: &PlayedScript| {
            let rest = it.scores.get(chose as usize..).filter(|rest| !rest.is_empty());
            mean(rest.unwrap_or(&it.scores))
        };
        last.sort_by(|a, b| fresh(b).total_cmp(&fresh(a)));
        self.kept = last;
        Ok(())
    }

    /// Leaves out rules and conditions of the best without which it does as well, as long as there are steps.
    fn shorten(&mut self, n_all: u64) -> Result<(), Error> {
        let [_, _, n] = self.stages;
        let Some(mut best) = self.kept.first().cloned() else { return Ok(()) };
        let mut next = 0;
        while let Some(script) = shorter(&best.script, next) {
            if self.n_steps >= n_all {
                break;
            }
            let mut contender = PlayedScript::new(script);
            self.play(&mut contender, n)?;
            if mean(&contender.scores) >= mean(&best.scores[..contender.scores.len()]) {
                best = contender;
            } else {
                next += 1;
            }
        }
        self.kept[0] = best;
        Ok(())
    }

    fn progress(&self) -> SearchProgress {
        let best = self.kept.first().map(PlayedScript::success);
        SearchProgress { n_steps: self.n_steps, n_candidates: self.n_candidates, best }
    }
}

/// Leaves out the `place`-th part of a script, rules first and from the last one on, then conditions; `None` after the last.
fn shorter(script: &Script, place: usize) -> Option<Script> {
    let mut shorter = script.clone();
    let n = shorter.rules.len();
    if place < n {
        drop(shorter.rules.remove(n - 1 - place));
        return Some(shorter);
    }
    let mut place = place - n;
    for rule in &mut shorter.rules {
        if place < rule.when.len() {
            drop(rule.when.remove(place));
            return Some(shorter);
        }
        place -= rule.when.len();
    }
    None
}

/// Returns the stages for a number of steps: fewer episodes where an episode takes much of them.
fn stages(n_steps: u64, n_per_episode: u64) -> [u64; 3] {
    let [few, more, whole] = STAGES;
    let n = (n_steps / n_per_episode.max(1) / N_WHOLE).clamp(8, whole);
    [(few * n / whole).max(2), (more * n / whole).max(4), n]
}

/// Returns whether scores are clearly lower than others of the same episodes.
fn is_clearly_worse(scores: &[f64], others: &[f64]) -> bool {
    let differences: Vec<f64> = scores.iter().zip(others).map(|(a, b)| a - b).collect();
    mean(&differences) + PATIENCE * standard_error(&differences) < 0.0
}

#[cfg(test)]
mod tests {
    use leadtime_episodes::Player;

    use super::*;
    use crate::bound::ScriptPlayer;
    use crate::test_support::{cliff, played, share};

    const N_STEPS: u64 = 250_000;

    fn found(seed: u64, n_threads: usize) -> FoundScript {
        let settings = SearchSettings { n_steps: N_STEPS, seed, n_threads, stop: &|| false };
        search(&cliff, &settings, &mut |_| {}).unwrap()
    }

    #[test]
    fn the_same_seed_finds_the_same_script_and_it_works_elsewhere() {
        let one = found(1, 1);
        assert_eq!(one, found(1, 2), "threads make no difference");
        assert_ne!(one.script, found(2, 1).script);
        let player = Player::scripted("found", Box::new(ScriptPlayer::new(one.script.clone())));
        let held_out = share(&played(&player, 200, 77));
        assert!(held_out > 0.9, "{held_out}: {}", one.script);
        assert_eq!(share(&played(&Player::baseline("unaided"), 200, 77)), 0.0);
        assert!(one.n_candidates > 20 && one.success > 0.9);
        // The last comparison of a few may end a little early or late.
        assert!((N_STEPS * 9 / 10..N_STEPS * 5 / 4).contains(&one.n_steps), "{}", one.n_steps);
    }

    #[test]
    fn parts_are_left_out_rules_first() {
        let text = "[[rules]]\nwhen = [{ of = \"a\" }, { of = \"b\" }]\n[[rules]]\nwhen = [{ of = \"c\" }]";
        let script = Script::read(text).unwrap();
        let without: Vec<String> =
            (0..).map_while(|place| shorter(&script, place)).map(|it| it.to_string()).collect();
        let both = "1. keep silent if a and b\n2. keep silent";
        let expected = [
            "1. keep silent if a and b",
            "1. keep silent if c",
            "1. keep silent if b\n2. keep silent if c",
        ];
        assert_eq!(without[..3], expected);
        assert_eq!(without[4..], [both]);
    }

    #[test]
    fn few_steps_make_short_stages() {
        assert_eq!(stages(1_600_000, 40), STAGES);
        assert_eq!(stages(100_000, 40), [8, 26, 104]);
        assert_eq!(stages(1_000, 40), [2, 4, 8]);
    }

    #[test]
    fn a_search_can_be_stopped() {
        let settings = SearchSettings { n_steps: 1_000, seed: 1, n_threads: 2, stop: &|| true };
        let stopped = search(&cliff, &settings, &mut |_| {});
        assert!(matches!(stopped, Err(Error::Interrupted)), "{stopped:?}");
    }
}
