//! The way through: plan, train, judge, write.

use anyhow::Context as _;
use leadtime_eval::study::{StudyResult, TrainedRun};
use tokio_util::sync::CancellationToken;

use super::cells::Cells;
use super::judging::{Judge, bootstrap};
use super::plan::{self, Plan, Training};
use super::progress::Progress;
use super::train::train;
use super::write::Place;
use super::{catalog, configure, figures, provenance};
use crate::cli::CompareArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;
use crate::shutdown::{Watch, watch};
use leadtime_runs::Tasks;

/// Carries the command out.
///
/// # Errors
///
/// [`Failure`] with the exit code that the program should end with.
pub(in crate::commands) async fn run(program: &Tasks, args: &CompareArgs) -> Result<(), Failure> {
    let Some(name) = &args.study else { return list().blame(ExitCode::Failed) };
    let studies = catalog::find(name).blame(ExitCode::WrongInput)?;
    plan::check_choice(&studies, args).blame(ExitCode::WrongInput)?;
    configure::check_profiles(program, &studies, args).blame(ExitCode::WrongInput)?;
    let place = Place::new(args, &studies);
    for named in &studies {
        place.check(&named.name).blame(ExitCode::WrongInput)?;
    }
    let plans = studies.into_iter().map(|named| Plan::new(program, named, args));
    let mut plans = plans.collect::<anyhow::Result<Vec<_>>>().blame(ExitCode::WrongInput)?;
    let trainings = plan::share(&mut plans);
    if args.plan {
        show(&trainings);
        return Ok(());
    }
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    let mut progress = Progress::new(trainings);
    for plan in &plans {
        train(&plan.trainings(), args, &mut progress, &shutdown).await?;
        output::say(&format!("judging {}", plan.named.name));
        let result = judge(program, plan, args, &place, &shutdown)?;
        place.write(&result).blame(ExitCode::WrongInput)?;
    }
    place.write_index().blame(ExitCode::WrongInput)
}

/// Lists studies and rows.
fn list() -> anyhow::Result<()> {
    for name in catalog::names() {
        for named in catalog::find(name)? {
            output::line(&format!("{name}: {}", named.study.title));
            for part in &named.study.parts {
                let rows: Vec<&str> = part.rows.iter().map(|row| row.name.as_str()).collect();
                output::line(&format!("    {}: {}", part.name, rows.join(", ")));
            }
        }
    }
    Ok(())
}

/// Lists trainings and how far they are.
fn show(trainings: &[Training]) {
    let mut left = 0;
    for training in trainings {
        let [done, all] = training.steps();
        let state = match (training.is_finished(), done) {
            (true, _) => "finished",
            (false, 0) => "to do",
            (false, _) => "begun",
        };
        left += all - done;
        output::line(&format!("{state:<8}  {done:>9} of {all} steps  {}", training.name));
    }
    output::line(&format!("{} trainings, {left} steps to go", trainings.len()));
}

fn judge(
    program: &Tasks,
    plan: &Plan,
    args: &CompareArgs,
    place: &Place,
    shutdown: &CancellationToken,
) -> Result<StudyResult, Failure> {
    let cells = Cells::new().context("reading the program's own file")?;
    let mut judge = Judge::new(program, args, plan.named.study.judged, shutdown, cells);
    let mut parts = Vec::new();
    for planned in &plan.parts {
        let mut part = judge.part(planned)?;
        let stem = format!("{}-{}", plan.named.name, part.name);
        let drawn = figures::draw(&judge, planned, &part, &stem)?;
        part.pictures = place.write_pictures(drawn).blame(ExitCode::WrongInput)?;
        parts.push(part);
    }
    output::say(&judge.cells.sentence());
    let mut runs: Vec<TrainedRun> = Vec::new();
    for training in plan.trainings() {
        runs.push(provenance::run(training)?);
    }
    let command = output::command_line(std::env::args_os().skip(1));
    Ok(StudyResult {
        study: plan.named.name.clone(),
        title: plan.named.study.title.clone(),
        lead: plan.named.study.lead.clone(),
        warnings: warnings(plan, args),
        bootstrap: bootstrap(),
        provenance: provenance::facts(plan, args, &runs, &command)
            .context("reading the program's own file")?,
        parts,
    })
}

/// Says what a reader must know before quoting a number.
fn warnings(plan: &Plan, args: &CompareArgs) -> Vec<String> {
    let mut warnings = Vec::new();
    if args.quick {
        let text = "Quick: one training seed and a fraction of the steps. It shows that everything works; its figures \
                    are not to be quoted.";
        warnings.push(text.to_owned());
    }
    if !args.set.is_empty() {
        let keys: Vec<String> = args.set.iter().map(|set| format!("`{}`", set.key())).collect();
        warnings.push(format!("Changed on the command line: {}.", keys.join(", ")));
    }
    if let Some(steps) = args.steps {
        warnings.push(format!("Every training has {steps} steps, by the command line."));
    }
    if args.seeds.is_some() {
        warnings.push("Training seeds are those of the command line, not the study's.".to_owned());
    }
    if !args.has_the_tables_episodes() {
        let [n, seed] = [u64::from(args.episodes), args.eval_seed];
        warnings.push(format!(
            "Judged over {n} episodes per training seed, from evaluation seed {seed} on."
        ));
    }
    if plan.parts.iter().any(|planned| planned.profile.name != planned.part.profile) {
        warnings.push("The profile is that of the command line, not the study's.".to_owned());
    }
    if !(args.rows.is_empty() && args.parts.is_empty()) {
        warnings.push("Only some rows of the study are here.".to_owned());
    }
    warnings
}
