//! The runs in a directory, as they are listed.

use std::path::Path;
use std::{fs, io};

use leadtime_table::Table;
use serde::Serialize;
use serde_json::Value;

use leadtime_proto::phrase::with_causes;

use crate::contents::is_run;
use crate::layout::{is_left, n_updates_with, read_config};
use crate::race::RacerRecord;
use crate::record::RecordError;
use crate::{ForkOrigin, RunRecord, RunResult, held_out, journal, name_in_place, regular};

/// The columns of the list, and the main ones, which a terminal has room for.
const HEAD: &str =
    "run,domain,state,updates,steps,success,return,held out,weights,reproducible,forked from";
const MAIN: [usize; 7] = [0, 1, 2, 4, 5, 6, 7];
/// Which of the main columns stand back where a terminal has too little room, the first one first: a name, which is typed again,
/// has to be whole, and mostly holds the domain.
const DISPENSABLE: [usize; 5] = [1, 5, 3, 4, 6];
/// Hexadecimal digits of a digest in a row.
const DIGEST_DIGITS: usize = 12;

/// A run as it is listed.
#[derive(Debug, Default, Serialize)]
pub struct ListedRun {
    /// Its directory's, by which it is found.
    pub name: String,
    /// What it trains on.
    pub domain: String,
    /// `finished`, `unfinished`, `stopped` (by a race, which it can leave as any unfinished run) or `unreadable`.
    pub state: &'static str,
    /// Updates in its journal.
    pub updates: u64,
    /// Environment steps so far.
    pub steps: u64,
    /// Mean success of the last training episodes; `None` where the task knows none.
    pub success: Option<f64>,
    /// Mean return of the last training episodes.
    pub episode_return: Option<f64>,
    /// Mean success of the best policy on held-out episodes, or its mean return where the task knows no success; `None` where
    /// the run has not been evaluated while training.
    pub held_out: Option<f64>,
    /// Digest of the final weights; `None` while the run is unfinished.
    pub weights_sha256: Option<String>,
    /// Whether the same seed would give the same weights again; `None` while the run is unfinished.
    pub reproducible: Option<bool>,
    /// What the run was forked from.
    pub origin: Option<ForkOrigin>,
    /// When it began, UTC.
    pub started: String,
    /// Why the record cannot be read as one.
    pub problem: Option<String>,
}

impl ListedRun {
    /// Lists the runs in a directory, the oldest first; none if it does not exist.
    ///
    /// # Errors
    ///
    /// If the directory cannot be read.
    pub fn all(runs: &Path) -> io::Result<Vec<Self>> {
        let mut rows = Vec::new();
        regular::refuse_dead_link(runs)?;
        if runs.exists() {
            let entries = fs::read_dir(runs)?.filter_map(Result::ok);
            rows.extend(entries.filter_map(|entry| row(&entry.path())));
        }
        rows.sort_by(|a, b| (&a.started, &a.name).cmp(&(&b.started, &b.name)));
        Ok(rows)
    }

    /// Lists runs as rows, with the main columns or all.
    pub fn table(rows: &[Self], all: bool) -> Table {
        let head: Vec<&str> = HEAD.split(',').collect();
        let shown = if all { (0..head.len()).collect() } else { MAIN.to_vec() };
        let columns = shown.iter().map(|&i| head[i]);
        let mut table = Table::new(columns).left(&[0, 1, 2, 8, 9, 10]);
        if !all {
            table = table.dispensable(&DISPENSABLE);
        }
        for cells in rows.iter().map(Self::cells) {
            table.push(shown.iter().map(|&i| cells[i].as_str()));
        }
        table
    }

    fn cells(&self) -> [String; 11] {
        let none = || "-".to_owned();
        let number =
            |value: Option<f64>, digits| value.map_or_else(none, |x| format!("{x:.digits$}"));
        let cut = |digest: &str| digest.chars().take(DIGEST_DIGITS).collect::<String>();
        let reproducible = self.reproducible.map(|yes| if yes { "yes" } else { "no" });
        let origin = self.origin.as_ref();
        let origin = origin.map(|from| format!("{} {}", from.run, cut(&from.weights_sha256)));
        [
            self.name.clone(),
            self.domain.clone(),
            self.state.to_owned(),
            self.updates.to_string(),
            self.steps.to_string(),
            number(self.success, 2),
            number(self.episode_return, 1),
            number(self.held_out, 2),
            self.weights_sha256.as_deref().map_or_else(none, cut),
            reproducible.unwrap_or("-").to_owned(),
            origin.unwrap_or_default(),
        ]
    }

    /// Describes a run by its record and its journal.
    pub fn new(path: &Path, record: RunRecord) -> Self {
        let last = journal::last_line(path).unwrap_or_default();
        let whole = |key: &str| last.get(key).and_then(Value::as_u64).unwrap_or(0);
        let made = |result: &RunResult| (result.updates, result.steps);
        let begun = || {
            let updates = n_updates_with(path, None);
            let each = read_config(path).ok().and_then(|config| steps_per_update(&config));
            (updates, each.map_or(whole("steps"), |each| updates.saturating_mul(each)))
        };
        let (updates, steps) = record.result.as_ref().map_or_else(begun, made);
        // The journal of a disk that was full ends before the run does, and its last line is of another policy.
        let is_whole = whole("update") == updates;
        let number = |key: &str| last.get(key).filter(|_| is_whole).and_then(Value::as_f64);
        let reproducible = record.is_reproducible(path);
        let best = held_out::of_best(path).unwrap_or_default();
        let is_stopped = || {
            let record = RacerRecord::read(path).unwrap_or_default();
            record.is_stopped_at(updates)
        };
        let state = match &record.result {
            Some(_) => "finished",
            None if is_stopped() => "stopped",
            None => "unfinished",
        };
        let held_out = |key: &str| best.get(key).and_then(Value::as_f64);
        Self {
            name: name_in_place(path, &record),
            domain: record.domain,
            state,
            reproducible,
            origin: record.origin,
            weights_sha256: record.result.map(|result| result.weights_sha256),
            updates,
            steps,
            success: number("episodes/success"),
            episode_return: number("episodes/return"),
            held_out: held_out("held_out/success").or_else(|| held_out("held_out/return")),
            started: record.started,
            problem: None,
        }
    }
}

/// Returns the steps of an update of a run with this configuration.
fn steps_per_update(config: &toml::Table) -> Option<u64> {
    let factor = |key| u64::try_from(config.get("learner")?.get(key)?.as_integer()?).ok();
    factor("n_envs")?.checked_mul(factor("n_steps")?)
}

/// Describes a run directory; `None` if it is not one.
fn row(path: &Path) -> Option<ListedRun> {
    let is_left = path.file_name().and_then(|name| name.to_str()).is_some_and(is_left);
    (!is_left && is_run(path)).then(|| match RunRecord::read(path) {
        Ok(record) => ListedRun::new(path, record),
        Err(error) => unreadable(path, &error),
    })
}

fn unreadable(path: &Path, error: &RecordError) -> ListedRun {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    ListedRun {
        name: name.unwrap_or_default(),
        domain: "-".to_owned(),
        state: "unreadable",
        problem: Some(with_causes(error)),
        ..ListedRun::default()
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Seek as _, SeekFrom, Write as _};

    use super::*;
    use crate::layout::{n_saved, n_updates};
    use crate::test_support::config;
    use crate::{ProgramBuild, RunDir};

    #[test]
    fn of_a_journal_that_no_memory_holds_only_the_end_is_read() {
        let run = tempfile::tempdir().unwrap();
        let mut journal = fs::File::create(run.path().join("metrics.jsonl")).unwrap();
        journal.seek(SeekFrom::Start(1 << 38)).unwrap();
        let line = b"\n{\"update\": 7, \"steps\": 448, \"episodes/return\": 2.5}\n";
        journal.write_all(line).unwrap();
        let record = RunRecord::begin("r", "cartpole", 1, &ProgramBuild::default());
        let listed = ListedRun::new(run.path(), record);
        assert_eq!((listed.updates, listed.steps, listed.episode_return), (7, 448, Some(2.5)));
    }

    #[test]
    fn a_finished_run_is_listed_as_its_record_says_where_its_journal_ends_before() {
        let run = tempfile::tempdir().unwrap();
        let line = "{\"update\": 97, \"steps\": 49664, \"episodes/success\": 0.03}\n";
        fs::write(run.path().join("metrics.jsonl"), line).unwrap();
        let mut record = RunRecord::begin("r", "cartpole", 1, &ProgramBuild::default());
        let result = |updates, steps| RunResult { updates, steps, ..RunResult::default() };
        record.result = Some(result(585, 299_520));
        let listed = ListedRun::new(run.path(), record.clone());
        assert_eq!((listed.updates, listed.steps, listed.success), (585, 299_520, None));
        record.result = Some(result(97, 49_664));
        assert_eq!(ListedRun::new(run.path(), record).success, Some(0.03));
    }

    #[test]
    fn a_run_that_is_not_finished_is_as_far_as_its_newest_file_says() {
        let runs = tempfile::tempdir().unwrap();
        let config = config(runs.path(), "cartpole", "r", &[]);
        let (run, _) = RunDir::open(&config, None, &ProgramBuild::default()).unwrap();
        let each = config.steps_per_update();
        let line =
            format!("{{\"update\": 40, \"steps\": {}, \"episodes/success\": 1}}\n", 40 * each);
        fs::write(run.path.join("metrics.jsonl"), line).unwrap();
        let racer = r#"{"is_stopped": true, "quarter": {"updates": 90, "eval_seed": 1, "scores": [], "is_success": true, "episodes": "", "episode_return": 0.0}, "last": null}"#;
        fs::write(run.path.join("race.json"), racer).unwrap();
        let listed = || ListedRun::new(&run.path, RunRecord::read(&run.path).unwrap());
        let found = |listed: ListedRun| (listed.updates, listed.steps, listed.state);
        assert_eq!(found(listed()), (40, 40 * each, "unfinished"));
        fs::write(run.checkpoints().join("000000000090.checkpoint"), "state").unwrap();
        assert_eq!(listed().success, None, "it is another policy's");
        assert_eq!(found(listed()), (90, 90 * each, "stopped"));
        assert_eq!((n_updates(&run.path), n_saved(&run.path).unwrap()), (90, 90));
        // Killed some time after its last checkpoint.
        fs::write(run.path.join("metrics.jsonl"), "{\"update\": 97}\n").unwrap();
        assert_eq!((n_updates(&run.path), n_saved(&run.path).unwrap()), (97, 90));
        fs::remove_dir_all(run.checkpoints()).unwrap();
        fs::write(run.checkpoints(), "in the way").unwrap();
        assert_eq!(n_updates(&run.path), 97, "what can be read tells it");
    }

    #[test]
    fn a_name_is_whole_however_narrow_the_terminal_is() {
        let name = "table1-piloting-convey-react-0123456789ab-s201";
        let rows = [ListedRun {
            name: name.to_owned(),
            domain: "lander".to_owned(),
            state: "unfinished",
            steps: 1_600_000,
            success: Some(0.5),
            episode_return: Some(-123.4),
            held_out: Some(0.5),
            ..ListedRun::default()
        }];
        let shown = |width| ListedRun::table(&rows, false).text_within(width);
        for (width, columns) in [(200, 7), (80, 4), (60, 2), (40, 2)] {
            let text = shown(width);
            let cells = text.lines().nth(2).unwrap_or_default().split_whitespace();
            assert_eq!(cells.clone().next(), Some(name), "{text}");
            assert_eq!(cells.count(), columns, "{text}");
        }
    }
}
