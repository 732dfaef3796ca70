//! Where a study's numbers are from.

use leadtime_eval::report::ProvenanceDetail;
use leadtime_runs::{ProgramBuild, RunRecord, clock, journal};

use crate::error::Error;
use crate::plan::{PlannedPart, PlannedTraining, StudyPlan};
use crate::profile;
use crate::request::StudyRequest;
use crate::result::TrainedRun;
use crate::study::WhichPolicy;

/// The name of the fact which command made a page.
pub(crate) const COMMAND: &str = "command";
/// The name of the fact which build carried the command out.
pub(crate) const PROGRAM: &str = "program";
/// Digits of a weights' digest.
const DIGEST_DIGITS: usize = 12;

/// Names a part's profile and how it was chosen.
pub(crate) fn profile(planned: &PlannedPart) -> String {
    let mut text = format!("`{}`", planned.profile.name);
    if planned.profile.name == planned.part.profile && !planned.part.note.is_empty() {
        text = format!("{text}, {}", planned.part.note.trim_end_matches('.'));
    }
    text
}

/// Says where a finished run comes from.
pub(crate) fn run(training: &PlannedTraining) -> Result<TrainedRun, Error> {
    let directory = training.directory();
    let record = RunRecord::read(&directory)?;
    let reproducible = record.is_reproducible(&directory) == Some(true);
    let unfinished = || Error::Refused(format!("run {} is not finished", training.name));
    let result = record.result.ok_or_else(unfinished)?;
    let commit = record.commit.map_or(String::new(), |commit| format!(" {}", cut(&commit)));
    Ok(TrainedRun {
        name: training.name.to_string(),
        seed: training.config.seed,
        configuration: training.hash.clone(),
        steps: result.steps,
        minutes: minutes(training),
        weights: cut(&result.weights_sha256),
        reproducible,
        program: format!("{}{commit}", record.version),
    })
}

/// Adds up the time of every update: pauses of an interrupted run do not count.
pub(crate) fn minutes(training: &PlannedTraining) -> f64 {
    let lines = journal::read(&training.directory()).unwrap_or_default();
    let (mut steps, mut seconds) = (0.0, 0.0);
    for line in lines {
        let number = |key: &str| line.get(key)?.as_f64();
        let now = number("steps").unwrap_or(steps);
        if let Some(speed) = number("system/steps_per_second").filter(|speed| *speed > 0.0) {
            seconds += (now - steps) / speed;
        }
        steps = now;
    }
    seconds / 60.0
}

fn cut(digest: &str) -> String {
    digest.chars().take(DIGEST_DIGITS).collect()
}

/// Lists the training seeds, by part where parts have different ones, and those of rows that have fewer.
fn seeds(parts: &[PlannedPart]) -> String {
    let lists: Vec<String> = parts.iter().map(seeds_of).collect();
    if let [first, rest @ ..] = lists.as_slice()
        && rest.iter().all(|list| list == first)
    {
        return first.clone();
    }
    let by_part = parts.iter().zip(&lists);
    let by_part = by_part.map(|(part, list)| format!("{}: {list}", part.part.name));
    by_part.collect::<Vec<_>>().join("; ")
}

fn seeds_of(part: &PlannedPart) -> String {
    let most = part.seeds();
    let fewer = part.rows.iter().filter(|row| row.seeds != most);
    let fewer = fewer.map(|row| format!("{} {}", row.row.name, range(&row.seeds)));
    let fewer: Vec<String> = fewer.collect();
    if fewer.is_empty() {
        return range(most);
    }
    format!("{} ({})", range(most), fewer.join(", "))
}

/// Writes neighbouring seeds by the first and the last.
fn range(seeds: &[u64]) -> String {
    match seeds {
        [] => String::new(),
        [only] => only.to_string(),
        [first, .., last] => format!("{first} to {last}"),
    }
}

/// Lists where a study's numbers are from.
pub(crate) fn details(
    plan: &StudyPlan,
    request: &StudyRequest,
    runs: &[TrainedRun],
) -> Vec<ProvenanceDetail> {
    let steps: u64 = runs.iter().map(|run| run.steps).sum();
    let minutes: f64 = runs.iter().map(|run| run.minutes).sum();
    let profiles = plan.parts.iter().map(|part| {
        let hash = profile::hash(&part.profile.config.table, plan.named.study.policy);
        format!("{} `{}` ({hash})", part.part.name, part.profile.name)
    });
    let policy = match plan.named.study.policy {
        WhichPolicy::Last => "the one at the end of training",
        WhichPolicy::Best => "the best one by the held-out episodes of its training",
    };
    let evaluation = format!(
        "{} episodes per training seed, under seed {} + training seed, the same for every notifier",
        request.episodes, request.eval_seed
    );
    let details = [
        ProvenanceDetail::new(COMMAND, format!("`{}`", request.command)),
        ProvenanceDetail::new("profiles and their hashes", profiles.collect::<Vec<_>>().join(", ")),
        ProvenanceDetail::new("training seeds", seeds(&plan.parts)),
        ProvenanceDetail::new("evaluation", evaluation),
        ProvenanceDetail::new("evaluated policy", policy),
        ProvenanceDetail::new(
            "training",
            format!("{} runs, {steps} steps, {minutes:.1} minutes", runs.len()),
        ),
    ];
    details.into_iter().chain(program_details(&request.build)).collect()
}

/// Describes the program, the processor and the day: the last lines of where numbers are from.
pub fn program_details(build: &ProgramBuild) -> [ProvenanceDetail; 3] {
    let commit = build.commit.as_deref().unwrap_or("unknown");
    [
        ProvenanceDetail::new(PROGRAM, format!("{}, commit {commit}", build.program)),
        ProvenanceDetail::new("processor", &build.cpu),
        ProvenanceDetail::new("date", clock::utc_date()),
    ]
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::test_support::{STUDY, plan, request};

    #[test]
    fn seeds_are_listed_by_part_where_parts_differ() {
        let (head, part) = STUDY.split_at(STUDY.find("[[parts]]").unwrap());
        let listed = |more: &str| {
            let other = part.replace("name = \"piloting\"", &format!("name = \"two\"\n{more}"));
            let plan = plan(&format!("{head}{part}{other}"), &request(Path::new("nowhere")));
            seeds(&plan.unwrap().parts)
        };
        assert_eq!(listed(""), "201 to 210");
        let expected = "piloting: 201 to 210; two: 301 to 310";
        assert_eq!(listed("first_seed = 301"), expected);
    }

    #[test]
    fn rows_with_fewer_seeds_are_listed_behind_the_others() {
        let text = STUDY.replace("name = \"prompt\"", "name = \"prompt\"\nseeds = 20");
        let plan = plan(&text, &request(Path::new("nowhere"))).unwrap();
        assert_eq!(seeds(&plan.parts), "201 to 220 (real_one 201 to 210)");
    }
}
