//! `leadtime probe`: what a notifier knows of its listener's reaction delay.

use std::path::Path;

use leadtime_eval::measure::{Choice, PlaySettings};
use leadtime_eval::probe::{ProbeResult, check_probe, probe};
use leadtime_eval::report::ProvenanceDetail;
use leadtime_numerics::stats::Bootstrap;
use leadtime_proto::hex;
use leadtime_runs::{LoadedPolicy, Tasks};
use leadtime_studies::program_details;
use serde_json::{Value, json};

use super::evaluation;
use crate::build::this_build;
use crate::cli::ProbeArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// Digits of the weights' digest.
const DIGEST_DIGITS: usize = 12;

pub(super) fn run(tasks: &Tasks, args: &ProbeArgs) -> Result<(), Failure> {
    let acting = &args.acting;
    acting.choosing.worker.permit(tasks, &args.policy);
    let loaded = evaluation::load(tasks, &acting.choosing.runs, &args.policy, &acting.set);
    let loaded = loaded.blame(ExitCode::WrongInput)?;
    let action = acting.choosing.action.unwrap_or(loaded.config.evaluation.action);
    // First: a path that cannot be written is reported before the episodes are played.
    let page = args.markdown.as_deref();
    page.map_or(Ok(()), output::check_file).blame(ExitCode::WrongInput)?;
    let known = measure(tasks, args, &loaded, action).blame(ExitCode::WrongInput)?;
    // Printed first: a file that cannot be written must not cost the results.
    if args.json {
        output::json(&json!({
            "policy": loaded.path.display().to_string(),
            "domain": loaded.config.domain.as_str(),
            "action": action,
            "seed": acting.choosing.eval_seed,
            "reaction_delay": reaction_delay(&loaded),
            "knowledge": known,
        }));
    } else {
        output::line(known.text().trim_end());
    }
    page.map_or(Ok(()), |path| write(path, args, &loaded, action, &known))
}

fn measure(
    tasks: &Tasks,
    args: &ProbeArgs,
    loaded: &LoadedPolicy,
    action: Choice,
) -> anyhow::Result<ProbeResult> {
    let (config, n_episodes) = (&loaded.config, args.episodes);
    let player = loaded.player("policy", Some(action))?;
    let make = || tasks.registry.build(&config.evaluation.task);
    let settings = PlaySettings::new(u64::from(n_episodes), args.acting.choosing.eval_seed);
    let settings = settings.threads(leadtime_runs::build::n_cores());
    check_probe(&make, &player, &settings)?;
    evaluation::warn_of_own_episodes(loaded, settings.seed);
    tracing::info!(policy = %loaded.path.display(), n_episodes, "probing");
    Ok(probe(&make, &player, &settings, Bootstrap::new(config.seed))?)
}

/// Returns the setting of the listener's delay, as the episodes have it.
fn reaction_delay(loaded: &LoadedPolicy) -> Value {
    let settings = serde_json::from_str::<Value>(&loaded.config.evaluation.task.settings);
    settings.unwrap_or_default()["human"]["reaction_delay"].take()
}

/// Writes the section of a page, with where its numbers are from.
fn write(
    path: &Path,
    args: &ProbeArgs,
    loaded: &LoadedPolicy,
    action: Choice,
    known: &ProbeResult,
) -> Result<(), Failure> {
    let mut weights = hex::encode(&loaded.parameters.digest().blame(ExitCode::Failed)?);
    weights.truncate(DIGEST_DIGITS);
    let mut details = vec![
        ProvenanceDetail::new("command", format!("`{}`", output::this_command())),
        ProvenanceDetail::new(
            "policy",
            format!("`{}`, weights `{weights}`", args.policy.display()),
        ),
        ProvenanceDetail::new("domain", format!("`{}`", loaded.config.domain)),
        ProvenanceDetail::new("reaction delay", format!("`{}`", reaction_delay(loaded))),
        ProvenanceDetail::new("choices", format!("{action:?}").to_lowercase()),
        ProvenanceDetail::new("evaluation seed", args.acting.choosing.eval_seed.to_string()),
    ];
    details.extend(program_details(&this_build()?));
    let title = format!("What `{}` knows of its listener's reaction delay", args.policy.display());
    output::file(path, known.markdown(&title, &details).as_bytes()).blame(ExitCode::WrongInput)
}
