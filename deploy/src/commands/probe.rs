//! `leadtime probe`: what a notifier knows of its listener's reaction delay.

use std::path::Path;

use anyhow::Context as _;
use leadtime_eval::measure::PlaySettings;
use leadtime_eval::probe::{ProbeResult, probe};
use leadtime_eval::report::Fact;
use leadtime_numerics::stats::Bootstrap;
use serde_json::{Value, json};

use super::policy_file::LoadedPolicy;
use super::{judge, origin, policy_file};
use crate::cli::ProbeArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::record::write_atomically;
use crate::{Program, output};
use leadtime_config::EvaluationAction;

/// Digits of the weights' digest.
const DIGEST_DIGITS: usize = 12;

pub(super) fn run(program: &Program, args: &ProbeArgs) -> Result<(), Failure> {
    let loaded = policy_file::load(program, &args.runs, &args.policy, &args.set)
        .blame(ExitCode::WrongInput)?;
    let action = args.action.unwrap_or(loaded.config.evaluation.action);
    let known = measure(program, args, &loaded, action).blame(ExitCode::WrongInput)?;
    if let Some(path) = &args.markdown {
        write(path, args, &loaded, action, &known).blame(ExitCode::WrongInput)?;
    }
    if args.json {
        output::json(&json!({
            "policy": loaded.path,
            "domain": loaded.config.domain.as_str(),
            "action": action,
            "seed": args.eval_seed,
            "reaction_delay": reaction_delay(&loaded),
            "knowledge": known,
        }));
    } else {
        output::line(known.text().trim_end());
    }
    Ok(())
}

fn measure(
    program: &Program,
    args: &ProbeArgs,
    loaded: &LoadedPolicy,
    action: EvaluationAction,
) -> anyhow::Result<ProbeResult> {
    let (config, n_episodes) = (&loaded.config, args.episodes);
    let player = judge::policy("policy", config, &loaded.parameters, action)?;
    let make = || program.registry.build(&config.evaluation.task);
    let settings =
        PlaySettings::new(u64::from(n_episodes), args.eval_seed).threads(judge::n_threads());
    tracing::info!(policy = %loaded.path.display(), n_episodes, "probing");
    Ok(probe(&make, &player, &settings, Bootstrap::new(config.seed))?)
}

/// Returns the setting of the person's delay, as the episodes have it.
fn reaction_delay(loaded: &LoadedPolicy) -> Value {
    let settings = serde_json::from_str::<Value>(&loaded.config.evaluation.task.settings);
    settings.unwrap_or_default()["human"]["reaction_delay"].take()
}

/// Writes the section of a page, with where its numbers are from.
fn write(
    path: &Path,
    args: &ProbeArgs,
    loaded: &LoadedPolicy,
    action: EvaluationAction,
    known: &ProbeResult,
) -> anyhow::Result<()> {
    let mut weights = output::hex(&loaded.parameters.digest()?);
    weights.truncate(DIGEST_DIGITS);
    let choices = format!("{action:?}").to_lowercase();
    let mut facts = vec![
        Fact::new("command", format!("`{}`", output::command_line(std::env::args().skip(1)))),
        Fact::new("policy", format!("`{}`, weights `{weights}`", args.policy)),
        Fact::new("domain", format!("`{}`", loaded.config.domain)),
        Fact::new("reaction delay", format!("`{}`", reaction_delay(loaded))),
        Fact::new("choices", choices),
        Fact::new("evaluation seed", args.eval_seed.to_string()),
    ];
    facts.extend(origin::this_program().context("reading the program's own file")?);
    let title = format!("What `{}` knows of its listener's reaction delay", args.policy);
    let text = known.markdown(&title, &facts);
    write_atomically(path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
}
