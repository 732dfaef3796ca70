//! `leadtime report`: the page of a run with an evaluation of its policy, or of several runs side by side.

use std::path::PathBuf;

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
    let request = EvaluationRequest { episodes: args.episodes, action: *action, seed: *eval_seed };
    let (page, findings) = match (&files[..], &policies[..], &args.out) {
        ([run], [policy], out) => {
            let evaluated = evaluate_run(tasks, run, policy, &request)?;
            if out.is_none() {
                let saved = evaluation::save(&evaluated.record, &run.directory, &policy.config);
                saved.blame(ExitCode::WrongInput)?;
            }
            let page = out.clone().unwrap_or_else(|| run.directory.join(REPORT_PAGE));
            (page, evaluated.findings)
        }
        (_, _, Some(out)) => (out.clone(), evaluate_runs(tasks, &files, &policies, &request)?),
        _ => return Err(Failure::input("several runs: --out FILE says where their page goes")),
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
    let page = run.directory.join(REPORT_PAGE);
    output::file(&page, report(tasks, &[run], findings, &output::program()).html().as_bytes())
}
