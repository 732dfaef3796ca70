//! What the page of a run says beside its records: an evaluation of the policy, and whether training gained anything.

use std::path::Path;

use leadtime_config::Config;
use leadtime_eval::Error;
use leadtime_eval::measure::{Choice, Comparison, Player, with_outcomes};
use leadtime_eval::playthrough::Spoken;
use leadtime_eval::report::Verdict;

use crate::command_line::command_line;
use crate::digest::sha256;
use crate::evaluation::{
    TRAINED, UNAIDED, UNTRAINED, compare, evaluate_all, main_measure, play_all, players, telling,
};
use crate::policy_file::{BEST_POLICY, LAST_POLICY};
use crate::regular;
use crate::run_files::RunFiles;
use crate::{EvaluationRecord, LoadedPolicy, Tasks};

/// What the trained policy must gain over the unaided listener, in success, with its whole interval, in a built-in world.
/// Elsewhere nobody knows what can be gained, and any gain will do.
const MARK: f64 = 0.3;

/// What an evaluation adds to a run's own records.
#[derive(Debug, Default)]
pub struct Findings {
    /// Introduction for readers who do not know the run.
    pub lead: String,
    /// Whether training gained anything.
    pub verdict: Option<Verdict>,
    /// The players side by side.
    pub comparison: Option<Comparison>,
    /// Episodes to look at.
    pub episodes: Vec<Spoken>,
    /// Remarks for the reader.
    pub notes: Vec<String>,
}

/// How runs are evaluated.
#[derive(Clone, Copy, Debug)]
pub struct EvaluationRequest {
    /// Episodes per player; `None`: the configuration's.
    pub episodes: Option<u32>,
    /// How the policies choose; `None`: as the configuration says.
    pub action: Option<Choice>,
    /// Seed of the episodes.
    pub seed: u64,
}

impl EvaluationRequest {
    fn n_episodes(&self, config: &Config) -> u32 {
        self.episodes.unwrap_or(config.evaluation.episodes)
    }
}

/// What the evaluation of a run gave: its page, and the record that its directory keeps.
#[derive(Debug)]
pub struct RunEvaluation {
    /// What its page says.
    pub findings: Findings,
    /// What can be kept in its directory.
    pub record: EvaluationRecord,
}

impl Findings {
    /// Describes a run after training, with the last evaluation if that is of the present policy.
    pub fn of_training(config: &Config, run: &RunFiles, program: &str) -> Self {
        let trained = trained(config, run.n_updates());
        let report = command_line(program, ["report".into(), run.directory.clone().into()]);
        let last = EvaluationRecord::read(&run.directory);
        let is_current = |record: &EvaluationRecord| {
            let files = [BEST_POLICY, LAST_POLICY].map(|file| run.directory.join(file));
            let bytes = files.iter().find_map(|file| regular::read(file).ok());
            bytes.is_some_and(|bytes| sha256(&bytes) == record.policy_sha256)
        };
        let (evaluation, comparison) = match last {
            None => ("the policy has not been evaluated yet".to_owned(), None),
            Some(last) if is_current(&last) => {
                let file = file_name(Path::new(&last.policy));
                (format!("the table is of the last evaluation of {file}"), Some(last.comparison))
            }
            Some(last) => {
                let sentence =
                    "the last evaluation, in `eval.json`, is of an earlier policy, from update";
                (format!("{sentence} {}", last.updates), None)
            }
        };
        let lead = format!(
            "Training {trained}. The curves are of training episodes, unless they are called held out; {evaluation}. `{report}` evaluates the policy, draws \
             an episode, and writes this page again."
        );
        let verdict = comparison.as_ref().and_then(|found| verdict(config, found, run.is_quick()));
        Self { lead, verdict, comparison, notes: notes(run), ..Self::default() }
    }
}

/// Evaluates a run's policy beside everybody with whom it can be compared.
///
/// # Errors
///
/// [`Error`] if the task or a network cannot be built, or an episode cannot be played.
pub fn evaluate_run(
    tasks: &Tasks,
    run: &RunFiles,
    policy: &LoadedPolicy,
    request: &EvaluationRequest,
) -> Result<RunEvaluation, Error> {
    let (config, seed) = (&policy.config, request.seed);
    let action = request.action.unwrap_or(config.evaluation.action);
    let players = players(tasks, policy.player(TRAINED, request.action)?, config, action)?;
    let evaluations = evaluate_all(tasks, config, &players, request.n_episodes(config), seed)?;
    let comparison = compare(config, &evaluations, &[]);
    let lead = format!(
        "Trained {}, then evaluated on {}. The evaluated policy is {}, from update {}.",
        trained(config, run.n_updates()),
        which_episodes(config.seed == seed),
        file_name(&policy.path),
        policy.n_updates
    );
    let episodes = telling(tasks, config, &players, &evaluations)?;
    let mut notes = notes(run);
    if let [_, other, ..] = &players[..]
        && !episodes.is_empty()
    {
        let other = other.name();
        let choice = format!("the first episode in which {TRAINED} succeeds and {other} fails");
        notes.push(format!("The playthroughs show {choice}, or the very first if there is none."));
    }
    let findings = Findings {
        lead,
        verdict: verdict(config, &comparison, run.is_quick()),
        comparison: Some(comparison.clone()),
        episodes,
        notes,
    };
    Ok(RunEvaluation { findings, record: EvaluationRecord::new(policy, action, seed, comparison) })
}

/// Evaluates several runs (one policy each, at least one), each in its own task, and the listener alone where that is the
/// same for all.
///
/// # Errors
///
/// As [`evaluate_run`].
pub fn evaluate_runs(
    tasks: &Tasks,
    runs: &[RunFiles],
    policies: &[LoadedPolicy],
    request: &EvaluationRequest,
) -> Result<Findings, Error> {
    let is_own = policies.iter().any(|policy| policy.config.seed == request.seed);
    let lead =
        format!("{} runs side by side, evaluated on {}.", runs.len(), which_episodes(is_own));
    let Some(LoadedPolicy { config, .. }) = policies.first() else {
        return Ok(Findings { lead, ..Findings::default() });
    };
    let task = &config.evaluation.task;
    let is_one_task = policies.iter().all(|policy| policy.config.evaluation.task == *task);
    // In one task the listener alone plays once, for all of them.
    let played = if is_one_task { play_all } else { evaluate_all };
    let play = |config: &Config, players: &[Player]| {
        played(tasks, config, players, request.n_episodes(config), request.seed)
    };
    let (mut evaluations, mut episodes) = (Vec::new(), Vec::new());
    for (run, policy) in runs.iter().zip(policies) {
        let player = [policy.player(run.name(), request.action)?];
        let own = play(&policy.config, &player)?;
        episodes.extend(telling(tasks, &policy.config, &player, &own)?);
        evaluations.extend(own);
    }
    let mut notes = Vec::new();
    if is_one_task && tasks.registry.build(task)?.baselines().contains(&UNAIDED) {
        for unaided in play(config, &[Player::baseline(UNAIDED)])? {
            let split = |evaluation| with_outcomes(evaluation, &unaided);
            evaluations = evaluations.into_iter().map(split).collect();
            evaluations.push(unaided);
        }
    }
    let mut comparison = compare(config, &evaluations, &[]);
    if !is_one_task {
        comparison.differences.clear();
        notes.push("The runs' tasks differ; each policy was evaluated in its own.".to_owned());
    }
    let comparison = Some(comparison);
    Ok(Findings { lead, verdict: None, comparison, episodes, notes })
}

/// Says whether training gained enough over the listener alone, or, where nobody is alone, over the network before it.
fn verdict(config: &Config, comparison: &Comparison, is_quick: bool) -> Option<Verdict> {
    if is_quick {
        let sentence = "The mechanics work; learning was not checked (--quick).".to_owned();
        return Some(Verdict { holds: true, sentence });
    }
    let measure = main_measure(config);
    let against = |name: &str| {
        let mut all = comparison.differences.iter();
        all.find(|difference| difference.measure == measure && difference.minus == name)
    };
    let difference = against(UNAIDED).or_else(|| against(UNTRAINED))?;
    let is_marked = measure == "success" && difference.minus == UNAIDED;
    let is_marked = is_marked && Tasks::is_built_in(config.domain.as_str());
    let (mark, amount) =
        if is_marked { (MARK, format!("more than {MARK} ")) } else { (0.0, String::new()) };
    let holds = difference.interval.low > mark;
    let bar = if is_marked { " That much is expected of a full training." } else { "" };
    let verb = if holds { "gained" } else { "did not gain" };
    let interval = difference.sentence(comparison.bootstrap.confidence);
    let sentence = format!("The trained policy {verb} {amount}in {measure}: {interval}.{bar}");
    Some(Verdict { holds, sentence })
}

fn notes(run: &RunFiles) -> Vec<String> {
    let quick = "This was a quick run: it checks the mechanics only, and its figures say nothing about learning.";
    run.is_quick().then(|| quick.to_owned()).into_iter().collect()
}

/// Says what a run was trained on, and for how long.
fn trained(config: &Config, n_updates: u64) -> String {
    let (domain, n_all) = (&config.domain, config.learner.n_updates());
    let n = if n_updates == n_all { String::new() } else { format!("{n_updates} of ") };
    let n_steps = config.steps_per_update();
    format!(
        "on domain {domain} for {n}{n_all} updates of {n_steps} steps by a learner and separate actors"
    )
}

/// Says what training had to do with the episodes of an evaluation: it begins with those of its own seed.
fn which_episodes(is_own: bool) -> &'static str {
    if is_own {
        "episodes of a training's own seed, the first of which it began with"
    } else {
        "episodes that training never saw"
    }
}

fn file_name(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

#[cfg(test)]
#[path = "findings_tests.rs"]
mod tests;
