//! `leadtime pilot eval`: a pilot flies without zones and messages, on Gymnasium's seeds.

use std::path::Path;

use anyhow::{Context as _, anyhow};
use leadtime_lander::pilot::{Flyer, Pilot, PilotEvaluation, evaluate};
use leadtime_lander::world::PhysicsSettings;
use leadtime_runs::policy_file::what_it_is;
use leadtime_runs::regular;
use leadtime_table::Table;
use serde_json::json;

use crate::cli::PilotEvalArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(super) fn run(args: &PilotEvalArgs) -> Result<(), Failure> {
    let settings = PhysicsSettings { wind: args.wind, ..PhysicsSettings::default() };
    let from_file;
    let flyer = match args.pilot.to_str() {
        Some("heuristic") => Flyer::Heuristic,
        Some("embedded") => Flyer::Network { pilot: Pilot::embedded(), rests: false },
        _ => {
            from_file = read(&args.pilot).blame(ExitCode::WrongInput)?;
            Flyer::Network { pilot: &from_file, rests: false }
        }
    };
    let evaluation = evaluate(flyer, &settings, args.seeds.clone());
    print(args, &evaluation);
    Ok(())
}

fn read(file: &Path) -> anyhow::Result<Pilot> {
    let shown = file.display();
    let bytes = regular::read(file)
        .with_context(|| format!("pilot `{shown}` is neither heuristic, embedded nor a file"))?;
    Pilot::from_safetensors(&bytes)
        .map_err(|error| anyhow!("{shown} is not a pilot: {}", what_it_is(&bytes, &error)))
}

fn print(args: &PilotEvalArgs, evaluation: &PilotEvaluation) {
    if args.json {
        let mut told = json!(evaluation);
        told["pilot"] = args.pilot.display().to_string().into();
        told["seeds"] = format!("{}..{}", args.seeds.start, args.seeds.end).into();
        told["wind"] = args.wind.into();
        output::json(&told);
        return;
    }
    let wind = if args.wind { "with wind" } else { "without wind" };
    let n = evaluation.n_episodes;
    output::line(&format!("pilot {}, {n} episodes {wind}", args.pilot.display()));
    let (mean, error) = (evaluation.mean_return, evaluation.standard_error);
    let mut table = Table::new(["episodes", "share"]);
    for (name, share) in [
        ("landed", evaluation.landed),
        ("crashed", evaluation.crashed),
        ("out", evaluation.out),
        ("timed out", evaluation.timed_out),
    ] {
        table.push([name.to_owned(), format!("{share:.3}")]);
    }
    output::line(&format!("return {mean:.1} +- {error:.1} (mean, standard error)\n"));
    output::line(table.text().trim_end());
}
