//! `leadtime compare`: arguments in, lines and exit codes out; the rest is [`leadtime_studies`].

use std::path::Path;
use std::time::{Duration, Instant};

use leadtime_proto::phrase::counted;
use leadtime_runs::Tasks;
use leadtime_runs::launch::LaunchError;
use leadtime_studies::{
    Crew, Error, EvalCache, PlannedTraining, StudyObserver, StudyRequest, StudySession,
    TrainingProgress, find, names,
};
use leadtime_table::{Table, wrapped};

use super::script_search;
use crate::build::this_build;
use crate::cli::CompareArgs;
use crate::ending::{Watch, drain_on_request, unless_drained, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::WIDTH;
use crate::{log, output, terminal};

/// Pause between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(15);

pub(super) async fn run(tasks: &Tasks, args: &CompareArgs) -> Result<(), Failure> {
    let Some(name) = &args.study else { return list().map_err(failure) };
    let studies = find(name).map_err(failure)?;
    let session = StudySession::plan(tasks, studies, request(args)?).map_err(failure)?;
    let crew = Crew { jobs: args.jobs, actors: args.actors };
    if args.plan {
        show(session.trainings());
        output::line(&wrapped(&session.estimate(crew).to_string(), WIDTH, 4));
        return Ok(());
    }
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    let drained = drain_on_request(&shutdown).blame(ExitCode::Failed)?;
    let done = session.carry_out(crew, &mut Console::default(), &shutdown).await;
    let command = output::this_command();
    match &done {
        Ok(()) => output::note(&format!(
            "\nNothing is trained or evaluated twice: the same command only draws again:\n  {command}"
        )),
        Err(Error::Interrupted) => {
            output::note(&format!("\nThe same command goes on with what is missing:\n  {command}"));
        }
        Err(_) => {}
    }
    unless_drained(done.map_err(failure), &drained)?;
    Ok(())
}

fn request(args: &CompareArgs) -> Result<StudyRequest, Failure> {
    Ok(StudyRequest {
        quick: args.quick,
        rows: args.rows.clone(),
        parts: args.parts.clone(),
        set: args.set.clone(),
        profiles: args.profile.clone(),
        seeds: args.seeds.clone(),
        steps: args.steps,
        episodes: args.episodes,
        eval_seed: args.eval_seed,
        runs: args.runs.clone(),
        out: args.out.clone(),
        command: output::this_command(),
        build: this_build().blame(ExitCode::Failed)?,
    })
}

/// Gives an error its exit code.
fn failure(error: Error) -> Failure {
    let code = match &error {
        Error::Interrupted => ExitCode::Interrupted,
        Error::Training { code, .. } => code.map_or(ExitCode::Failed, ExitCode::from_status),
        Error::Script(error) => script_search::exit_code(error),
        Error::Task(_) | Error::Play(_) | Error::Eval(_) | Error::Launch(LaunchError::Start(_)) => {
            ExitCode::Failed
        }
        _ => ExitCode::WrongInput,
    };
    // The user who interrupted the command needs no explanation.
    let error = (code != ExitCode::Interrupted).then(|| error.into());
    Failure { code, error }
}

/// Lists studies and rows.
fn list() -> Result<(), Error> {
    for name in names() {
        for named in find(name)? {
            output::line(&wrapped(&format!("{name}: {}", named.study.title), WIDTH, 4));
            for part in &named.study.parts {
                let rows: Vec<&str> = part.rows.iter().map(|row| row.name.as_str()).collect();
                let part = format!("    {}: {}", part.name, rows.join(", "));
                output::line(&wrapped(&part, WIDTH, 8));
            }
        }
    }
    Ok(())
}

/// Lists trainings and how far they are.
fn show(trainings: &[PlannedTraining]) {
    let mut table = Table::new(["state", "steps", "of", "training"]).left(&[0, 3]).elastic(3);
    let mut left = 0;
    for training in trainings {
        let [done, all] = training.steps();
        let state = match (training.is_finished(), done) {
            (true, _) => "finished",
            (false, 0) => "to do",
            (false, _) => "begun",
        };
        left += all - done;
        table.push([state, &done.to_string(), &all.to_string(), training.name.as_str()]);
    }
    output::line(&table.text_within(WIDTH));
    let n = counted(trainings.len(), "training");
    output::line(&format!("{n}, {} to go", counted(left, "step")));
}

/// Shows what goes on: a bar on a terminal, a plain line now and then elsewhere.
#[derive(Debug, Default)]
struct Console {
    last_line: Option<Instant>,
}

impl Drop for Console {
    fn drop(&mut self) {
        terminal::hide_bar();
    }
}

impl StudyObserver for Console {
    fn training(&mut self, progress: &TrainingProgress) {
        if !log::is_chatty() {
            return;
        }
        if terminal::is_watched() {
            let share = progress.done as f64 / progress.all as f64;
            terminal::show_bar(share, |room| progress.to_string().chars().take(room).collect());
        } else if self.last_line.is_none_or(|at| at.elapsed() >= LINE_EVERY) {
            self.last_line = Some(Instant::now());
            output::say(&progress.to_string());
        }
    }

    fn evaluating(&mut self, study: &str) {
        terminal::hide_bar();
        output::note(&format!("evaluating {study}"));
    }

    fn evaluated(&mut self, cache: &EvalCache) {
        output::note(&cache.sentence());
    }

    fn page(&mut self, markdown: &str) {
        output::line(markdown.trim_end());
    }

    fn written(&mut self, path: &Path) {
        output::line(&path.display().to_string());
    }
}

#[cfg(test)]
mod tests {
    use leadtime_scripts::Error as ScriptError;

    use super::*;

    #[test]
    fn a_search_that_fails_has_the_exit_code_that_it_has_alone() {
        let code = |error: ScriptError| failure(Error::Script(error)).code;
        assert_eq!(code(ScriptError::Endless { index: 0, n_steps: 1 }), ExitCode::Failed);
        let no_thread = std::io::Error::other("no thread");
        assert_eq!(code(ScriptError::Thread(no_thread)), ExitCode::Failed);
        assert_eq!(code(ScriptError::NoMessages), ExitCode::WrongInput);
    }
}
