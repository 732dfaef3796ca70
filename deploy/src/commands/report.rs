//! `leadtime report`: the page of a run with an evaluation of its policy, or of several runs side by side.

use std::fs;
use std::path::{Path, PathBuf};

use leadtime_runs::findings::{EvaluationRequest, Findings, evaluate_run, evaluate_runs};
use leadtime_runs::report::report;
use leadtime_runs::{LoadedPolicy, REPORT_PAGE, RunFiles, Tasks, find_run};

use super::evaluation;
use crate::cli::{ChoosingArgs, ReportArgs};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW};

pub(super) fn run(tasks: &Tasks, args: &ReportArgs) -> Result<(), Failure> {
    let ChoosingArgs { eval_seed, action, runs, worker } = &args.choosing;
    worker.permit(tasks, runs);
    let find = |name: &PathBuf| find_run(runs, name);
    let directories: Vec<PathBuf> =
        args.names.iter().map(find).collect::<Result<_, _>>().blame(ExitCode::WrongInput)?;
    let files = directories.iter().map(|directory| RunFiles::read(directory));
    let files: Vec<RunFiles> = files.collect::<Result<_, _>>().blame(ExitCode::WrongInput)?;
    let load = |directory: &PathBuf| LoadedPolicy::load(&tasks.registry, runs, directory, &[]);
    let policies = directories.iter().map(load);
    let policies: Vec<LoadedPolicy> =
        policies.collect::<Result<_, _>>().blame(ExitCode::WrongInput)?;
    // First: what is in the way is reported before the episodes are played.
    let page = match (&directories[..], &args.out) {
        (_, Some(out)) => out.clone(),
        ([run], None) => own_page(run).blame(ExitCode::WrongInput)?,
        _ => return Err(Failure::input("several runs: --out FILE says where their page goes")),
    };
    output::check_file(&page).blame(ExitCode::WrongInput)?;
    for policy in &policies {
        evaluation::warn_of_own_episodes(policy, *eval_seed);
    }
    let request = EvaluationRequest { episodes: args.episodes, action: *action, seed: *eval_seed };
    let findings = match (&files[..], &policies[..]) {
        ([run], [policy]) => {
            let evaluated = evaluate_run(tasks, run, policy, &request)?;
            if args.out.is_none() {
                let saved = evaluation::save(&evaluated.record, &run.directory, &policy.config);
                saved.blame(ExitCode::WrongInput)?;
            }
            evaluated.findings
        }
        _ => evaluate_runs(tasks, &files, &policies, &request)?,
    };
    let text = findings.comparison.as_ref().map(|found| found.text(false)).unwrap_or_default();
    let html = report(tasks, &files, findings, &output::program()).html();
    output::file(&page, html.as_bytes()).blame(ExitCode::WrongInput)?;
    output::line(&format!("{text}\nReport: {}", page.display()));
    output::next(&policies[0].path, &[DRAW]);
    Ok(())
}

/// Writes the page of a run into its directory.
pub(super) fn write(tasks: &Tasks, run: RunFiles, findings: Findings) -> anyhow::Result<()> {
    let page = own_page(&run.directory)?;
    output::file(&page, report(tasks, &[run], findings, &output::program()).html().as_bytes())
}

/// Returns where the page of a run goes. In the place of a run's own file a pipe is a mistake: nobody waits for its reader.
fn own_page(run: &Path) -> anyhow::Result<PathBuf> {
    let page = run.join(REPORT_PAGE);
    let is_other = fs::metadata(&page).is_ok_and(|found| !found.is_file());
    anyhow::ensure!(!is_other, "{} is not a file: move it away", page.display());
    Ok(page)
}
