//! `leadtime report`: the page of a run with an evaluation of its policy, or of several runs side by side.

use std::path::{Path, PathBuf};

use leadtime_config::Config;
use leadtime_eval::measure::{Comparison, Difference, Player};
use leadtime_eval::playthrough::Spoken;
use leadtime_eval::report::{Picture, Verdict};
use leadtime_runs::evaluation::{TRAINED, UNAIDED, compare, evaluate_all, players, telling};
use leadtime_runs::report::{Findings, RunFiles, report};
use leadtime_runs::{EvaluationRecord, LoadedPolicy, Tasks, find_run};

use super::evaluation;
use crate::cli::ReportArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// The page's file in a run directory.
const PAGE: &str = "report.html";

pub(super) fn run(tasks: &Tasks, args: &ReportArgs) -> Result<(), Failure> {
    let find = |name: &String| find_run(&args.runs, name);
    let directories: Vec<PathBuf> =
        args.names.iter().map(find).collect::<Result<_, _>>().blame(ExitCode::WrongInput)?;
    let files = directories.iter().map(|directory| RunFiles::read(directory));
    let files: Vec<RunFiles> = files.collect::<Result<_, _>>().blame(ExitCode::WrongInput)?;
    let load =
        |directory: &PathBuf| LoadedPolicy::load(&tasks.registry, &args.runs, directory, &[]);
    let policies = directories.iter().map(load);
    let policies: Vec<LoadedPolicy> =
        policies.collect::<Result<_, _>>().blame(ExitCode::WrongInput)?;
    let (page, findings) = match (&policies[..], &directories[..], &args.out) {
        ([policy], [directory], out) => {
            let page = out.clone().unwrap_or_else(|| directory.join(PAGE));
            (page, one(tasks, args, policy, directory)?)
        }
        (_, _, Some(out)) => (out.clone(), several(tasks, args, &files, &policies)?),
        _ => return Err(Failure::input("several runs: --out FILE says where their page goes")),
    };
    let text = findings.comparison.as_ref().map(|found| found.text(false)).unwrap_or_default();
    let html = report(tasks, &files, findings).html();
    output::file(&page, html.as_bytes()).blame(ExitCode::WrongInput)?;
    output::line(&format!("{text}\nReport: {}", page.display()));
    Ok(())
}

/// Writes the page of a run into its directory.
pub(super) fn write(tasks: &Tasks, directory: &Path, findings: Findings) -> anyhow::Result<()> {
    let page = report(tasks, &[RunFiles::read(directory)?], findings).html();
    output::file(&directory.join(PAGE), page.as_bytes())
}

/// Introduces an evaluated run.
pub(super) fn lead(config: &Config, policy: &Path) -> String {
    let file = policy.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let (domain, n_updates) = (&config.domain, config.learner.n_updates());
    let n_steps = config.steps_per_update();
    format!(
        "Trained on domain {domain} for {n_updates} updates of {n_steps} steps by a learner and separate actors, then \
         evaluated on episodes that training never saw. The evaluated policy is {file}."
    )
}

/// Draws episodes for a page.
pub(super) fn pictures(episodes: &[Spoken]) -> Vec<Picture> {
    let numbered = episodes.iter().enumerate();
    numbered.map(|(i, spoken)| Picture::playthrough(spoken, &format!("playthrough-{i}"))).collect()
}

/// Evaluates one run beside everybody with whom its policy can be compared.
fn one(
    tasks: &Tasks,
    args: &ReportArgs,
    policy: &LoadedPolicy,
    directory: &Path,
) -> Result<Findings, Failure> {
    let config = &policy.config;
    let action = args.action.unwrap_or(config.evaluation.action);
    let trained = evaluation::policy(TRAINED, config, &policy.parameters, action)?;
    let all = players(tasks, trained, config, action)?;
    let n_episodes = args.episodes.unwrap_or(config.evaluation.episodes);
    let seed = args.eval_seed;
    let evaluations = evaluate_all(tasks, config, &all, n_episodes, seed)?;
    let comparison = compare(config, &evaluations, &[]);
    let record = EvaluationRecord::new(policy, action, seed, comparison.clone());
    evaluation::save(&record, directory, config).blame(ExitCode::WrongInput)?;
    let episodes = telling(tasks, config, &all, &evaluations)?;
    Ok(Findings {
        lead: lead(config, &policy.path),
        verdicts: verdicts(&comparison),
        pictures: pictures(&episodes),
        comparison: Some(comparison),
        notes: Vec::new(),
    })
}

/// Evaluates several runs, each in its own task, and the listener alone where that is the same for all.
fn several(
    tasks: &Tasks,
    args: &ReportArgs,
    files: &[RunFiles],
    policies: &[LoadedPolicy],
) -> Result<Findings, Failure> {
    let (mut evaluations, mut episodes) = (Vec::new(), Vec::new());
    for (file, policy) in files.iter().zip(policies) {
        let config = &policy.config;
        let action = args.action.unwrap_or(config.evaluation.action);
        let player = [evaluation::policy(file.name(), config, &policy.parameters, action)?];
        let n_episodes = args.episodes.unwrap_or(config.evaluation.episodes);
        let own = evaluate_all(tasks, config, &player, n_episodes, args.eval_seed)?;
        episodes.extend(telling(tasks, config, &player, &own)?);
        evaluations.extend(own);
    }
    let config = &policies[0].config;
    let task = &config.evaluation.task;
    let is_one_task = policies.iter().all(|policy| policy.config.evaluation.task == *task);
    let mut notes = Vec::new();
    if is_one_task {
        let scripts = tasks.registry.build(task).blame(ExitCode::Failed)?.baselines().to_vec();
        let alone: Vec<Player> = scripts
            .iter()
            .filter(|name| **name == UNAIDED)
            .map(|name| Player::baseline(name))
            .collect();
        let n_episodes = args.episodes.unwrap_or(config.evaluation.episodes);
        evaluations.extend(evaluate_all(tasks, config, &alone, n_episodes, args.eval_seed)?);
    } else {
        notes.push("The runs' tasks differ; each policy was evaluated in its own.".to_owned());
    }
    let mut comparison = compare(config, &evaluations, &[]);
    if !is_one_task {
        comparison.differences.clear();
    }
    Ok(Findings {
        lead: format!(
            "{} runs side by side, evaluated on episodes that training never saw.",
            files.len()
        ),
        verdicts: Vec::new(),
        pictures: pictures(&episodes),
        comparison: Some(comparison),
        notes,
    })
}

/// Says whether training gained anything: over the listener alone, or over the network before it.
fn verdicts(comparison: &Comparison) -> Vec<Verdict> {
    let find =
        |name: &str| comparison.differences.iter().find(|difference| difference.minus == name);
    let difference = find(UNAIDED).or_else(|| find("untrained"));
    let verdict = |difference: &Difference| {
        let holds = difference.interval.low > 0.0;
        let verb = if holds { "does" } else { "does not do" };
        let interval = difference.sentence(comparison.bootstrap.confidence);
        let other = &difference.minus;
        Verdict {
            holds,
            sentence: format!("The trained policy {verb} better than {other}: {interval}."),
        }
    };
    difference.map(verdict).into_iter().collect()
}
