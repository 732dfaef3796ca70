//! Where a study's numbers are from.

use anyhow::Context as _;
use leadtime_eval::report::Fact;
use leadtime_eval::study::TrainedRun;

use super::configure;
use super::plan::{Plan, PlannedPart, Training};
use super::study::WhichPolicy;
use crate::cli::CompareArgs;
use crate::commands::origin;
use leadtime_runs::RunRecord;
use leadtime_runs::journal;

/// Digits of a weights' digest.
const DIGEST_DIGITS: usize = 12;

/// Names a part's profile and how it was chosen.
pub(super) fn profile(planned: &PlannedPart) -> String {
    let mut text = format!("`{}`", planned.profile.name);
    if planned.profile.name == planned.part.profile && !planned.part.note.is_empty() {
        text = format!("{text}, {}", planned.part.note.trim_end_matches('.'));
    }
    text
}

/// Tells where a finished run comes from.
///
/// # Errors
///
/// A record that cannot be read, or a run that is not finished.
pub(super) fn run(training: &Training) -> anyhow::Result<TrainedRun> {
    let directory = training.directory();
    let record = RunRecord::read(&directory)?;
    let result = record.result.with_context(|| format!("run {} is not finished", training.name))?;
    let commit = record.commit.map_or(String::new(), |commit| format!(" {}", cut(&commit)));
    Ok(TrainedRun {
        name: training.name.to_string(),
        seed: training.config.seed,
        configuration: training.hash.clone(),
        steps: result.steps,
        minutes: minutes(training),
        weights: cut(&result.weights_sha256),
        reproducible: result.reproducible,
        program: format!("{}{commit}", record.version),
    })
}

/// Adds up the time of every update: pauses of an interrupted run do not count.
fn minutes(training: &Training) -> f64 {
    let lines = journal::read(&training.directory()).unwrap_or_default();
    let mut steps = 0.0;
    let mut seconds = 0.0;
    for line in lines {
        let now = line.get("steps").and_then(serde_json::Value::as_f64).unwrap_or(steps);
        let speed = line.get("system/steps_per_second").and_then(serde_json::Value::as_f64);
        if let Some(speed) = speed.filter(|speed| *speed > 0.0) {
            seconds += (now - steps) / speed;
        }
        steps = now;
    }
    seconds / 60.0
}

fn cut(digest: &str) -> String {
    digest.chars().take(DIGEST_DIGITS).collect()
}

/// Lists the training seeds, by part where parts have different ones.
fn seeds(parts: &[PlannedPart]) -> String {
    let list =
        |part: &PlannedPart| part.seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
    match parts {
        [first, rest @ ..] if rest.iter().all(|part| part.seeds == first.seeds) => list(first),
        _ => {
            let told = parts.iter().map(|part| format!("{}: {}", part.part.name, list(part)));
            told.collect::<Vec<_>>().join("; ")
        }
    }
}

/// Lists where a study's numbers are from.
///
/// # Errors
///
/// As [`origin::this_program`].
pub(super) fn facts(
    plan: &Plan,
    args: &CompareArgs,
    runs: &[TrainedRun],
    command: &str,
) -> anyhow::Result<Vec<Fact>> {
    let steps: u64 = runs.iter().map(|run| run.steps).sum();
    let minutes: f64 = runs.iter().map(|run| run.minutes).sum();
    let profiles = plan.parts.iter().map(|part| {
        let hash = configure::hash(&part.profile.config.table);
        format!("{} `{}` ({hash})", part.part.name, part.profile.name)
    });
    let judged = match plan.named.study.judged {
        WhichPolicy::Last => "the one at the end of training",
        WhichPolicy::Best => "the one with the best mean success over 100 training episodes",
    };
    let mut facts = vec![
        Fact::new("command", format!("`{command}`")),
        Fact::new("profiles and their hashes", profiles.collect::<Vec<_>>().join(", ")),
        Fact::new("training seeds", seeds(&plan.parts)),
        Fact::new(
            "evaluation",
            format!(
                "{} episodes per training seed, under seed {} + training seed, the same for every notifier",
                args.episodes, args.eval_seed
            ),
        ),
        Fact::new("judged policy", judged),
        Fact::new("training", format!("{} runs, {steps} steps, {minutes:.1} minutes", runs.len())),
    ];
    facts.extend(origin::this_program()?);
    Ok(facts)
}

#[cfg(test)]
mod tests {
    use super::super::test_support::{args, study};
    use super::*;
    use leadtime_runs::Tasks;

    #[test]
    fn seeds_are_told_by_part_where_parts_differ() {
        let part = |name: &str, more: &str| {
            format!(
                "[[parts]]\nname = \"{name}\"\ntitle = \"t\"\nprofile = \"lander\"\nquick_steps = 4096\n{more}\n\
                 columns = [\"success\"]\nevaluations = [{{ name = \"own\", title = \"own\" }}]\n\
                 [[parts.rows]]\nname = \"r\"\ntitle = \"R\"\n"
            )
        };
        let told = |first: &str, second: &str| {
            let parts = [part("one", first), part("two", second)].concat();
            let text = format!("title = \"t\"\nlead = \"l\"\n{parts}");
            let runs = tempfile::tempdir().unwrap();
            let plan =
                Plan::new(&Tasks::new(), study("t", &text), &args(runs.path(), &[])).unwrap();
            seeds(&plan.parts)
        };
        assert_eq!(told("", ""), "201, 202, 203, 204, 205");
        let expected = "one: 201, 202, 203, 204, 205; two: 301, 302, 303, 304, 305";
        assert_eq!(told("", "first_seed = 301"), expected);
    }
}
