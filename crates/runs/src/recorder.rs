//! Writes down what a learner reports: metrics, event files, policy files; its checkpoints are its own.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use leadtime_config::Config;
use leadtime_learner::{HeldOutMeans, RatedPolicy, UpdateProgress, write_atomically};
use leadtime_link::Archive;
use leadtime_policy::Parameters;
use leadtime_proto::{PolicySpec, hex};
use serde_json::{Value, json};
use toml::Table;
use tracing::warn;

use crate::contents::{CONFIG, TENSORBOARD};
use crate::journal::{JOURNAL, Journal};
use crate::policy_file::{self, BEST_POLICY, LAST_POLICY, VERSION, WEIGHTS_SHA256};
use crate::tensorboard::EventFile;
use crate::{RunDir, RunRecord, clock, held_out, history, metrics};

/// The open files of a run.
#[derive(Debug)]
pub struct RunRecorder {
    directory: PathBuf,
    policy: PolicySpec,
    metadata: BTreeMap<String, String>,
    steps_per_update: u64,
    /// The run's description for observers.
    about: Value,
    /// The message about its last update, for observers.
    bulletin: Option<Vec<u8>>,
    /// The configuration, which event files hold as hyper-parameters.
    settings: Table,
    journal: Journal,
    /// Whether the journal ends with the update before the next one: a predecessor may have been killed further on.
    is_rewound: bool,
    events: Option<EventFile>,
    /// What is written again if the directory vanishes.
    record: Option<RunRecord>,
    /// Whether the record and the configuration on the disk are still those of an earlier start.
    is_to_be_noted: bool,
}

impl RunRecorder {
    /// Opens the files of a run directory.
    ///
    /// # Errors
    ///
    /// If a file cannot be made or opened.
    pub fn open(directory: &Path, config: &Config, run: &str) -> io::Result<Self> {
        Ok(Self {
            directory: directory.to_owned(),
            policy: config.policy.clone(),
            metadata: policy_file::metadata(config, run),
            steps_per_update: config.steps_per_update(),
            about: history::about(config, run, directory),
            bulletin: None,
            settings: config.table.clone(),
            journal: Journal::open(directory)?,
            is_rewound: false,
            events: None,
            record: None,
            is_to_be_noted: false,
        })
    }

    /// Keeps the record of an opened run. It is written with the configuration once the run is at work ([`Self::note_start`]), and
    /// again, should the directory be removed or moved away meanwhile: nobody could take the run up without them.
    pub fn keeping(self, run: &RunDir) -> Self {
        Self { record: Some(run.record.clone()), is_to_be_noted: run.is_to_be_noted, ..self }
    }

    /// Writes down that this start has taken the run up, unless that is done.
    ///
    /// # Errors
    ///
    /// If a file cannot be written; the next policies are then preceded by another try.
    pub fn note_start(&mut self) -> io::Result<()> {
        let Some(record) = self.record.as_ref().filter(|_| self.is_to_be_noted) else {
            return Ok(());
        };
        record.write(&self.directory)?;
        self.write_config()?;
        self.is_to_be_noted = false;
        Ok(())
    }

    /// Notes that the run goes on from a checkpoint.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn resumed(&mut self, n_updates: u64) -> io::Result<()> {
        self.about["resumed_from"] = n_updates.into();
        self.rewind(n_updates)?;
        self.events(n_updates * self.steps_per_update + 1).map(|_file| ())
    }

    /// Makes the line of an update, as the journal has it.
    pub fn line(progress: &UpdateProgress) -> Value {
        line(progress, &metrics::scalars(progress))
    }

    /// Writes one update and its line to the journal and to the event file.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn update(&mut self, progress: &UpdateProgress, line: &Value) -> io::Result<()> {
        if !self.is_rewound {
            self.rewind(progress.n_updates.saturating_sub(1))?;
        }
        let scalars = metrics::scalars(progress);
        self.bulletin = Some(history::bulletin(line));
        self.journal.append(line)?;
        self.events(0)?.scalars(clock::unix_seconds(), progress.n_steps, &scalars)
    }

    /// Takes the message about the last update, for observers.
    pub fn take_bulletin(&mut self) -> Option<Vec<u8>> {
        self.bulletin.take()
    }

    /// Returns what observers may ask for.
    pub fn archive(&self) -> Archive {
        history::archive(&self.about, &self.directory)
    }

    /// Writes the newest and the best policy, and what is missing in the file of the evaluations.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn policies(
        &mut self,
        last: &RatedPolicy,
        best: &RatedPolicy,
        history: &[HeldOutMeans],
    ) -> io::Result<()> {
        self.keep_directory()?;
        self.write_policy(LAST_POLICY, last)?;
        self.write_policy(BEST_POLICY, best)?;
        held_out::write(&self.directory, history, self.steps_per_update)
    }

    /// Writes every evaluation on held-out episodes so far, and the newest one to the event file.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn held_out(&mut self, history: &[HeldOutMeans]) -> io::Result<()> {
        let steps_per_update = self.steps_per_update;
        held_out::write(&self.directory, history, steps_per_update)?;
        let Some(newest) = history.last() else { return Ok(()) };
        let steps = newest.version.0 * steps_per_update;
        self.events(0)?.scalars(clock::unix_seconds(), steps, &held_out::scalars(newest))
    }

    /// Makes the directory a run's again, if it is none any more.
    fn keep_directory(&mut self) -> io::Result<()> {
        let Some(record) = &self.record else { return Ok(()) };
        if self.directory.join(CONFIG).exists() {
            return self.note_start();
        }
        record.write(&self.directory)?;
        self.journal = Journal::open(&self.directory)?;
        self.events = None;
        // As at the beginning of a run, it comes last.
        self.write_config()?;
        self.is_to_be_noted = false;
        let directory = self.directory.display();
        warn!(%directory, "the run's directory was moved or removed: it is made again, and the run can be taken up from it");
        Ok(())
    }

    fn write_config(&self) -> io::Result<()> {
        let text = self.settings.to_string();
        write_atomically(&self.directory.join(CONFIG), text.as_bytes())
    }

    fn rewind(&mut self, n_updates: u64) -> io::Result<()> {
        let missing = self.journal.rewind(n_updates)?;
        self.is_rewound = true;
        if let Some(missing) = missing {
            let journal = self.directory.join(JOURNAL);
            warn!(journal = %journal.display(), "metrics of {missing} are missing: the disk was full, or the file was damaged or moved away");
        }
        Ok(())
    }

    /// Returns the event file, made at the first call for steps from `first_step` on.
    fn events(&mut self, first_step: u64) -> io::Result<&mut EventFile> {
        if self.events.is_none() {
            let directory = self.directory.join(TENSORBOARD);
            let (now, process) = (clock::unix_seconds(), std::process::id());
            let mut file = EventFile::create(&directory, now, process, first_step)?;
            file.settings(now, &self.settings)?;
            self.events = Some(file);
        }
        Ok(self.events.as_mut().expect("made just now"))
    }

    /// Writes a policy file that explains itself.
    fn write_policy(&self, name: &str, policy: &RatedPolicy) -> io::Result<()> {
        let mut metadata = self.metadata.clone();
        metadata.insert(VERSION.to_owned(), policy.version.to_string());
        if let Some(score) = policy.score {
            metadata.insert("training_score".to_owned(), score.to_string());
        }
        let held_out = policy.held_out.iter().flat_map(held_out::scalars);
        metadata.extend(held_out.map(|(name, value)| (name.replace('/', "_"), value.to_string())));
        let parameters = Parameters::from_safetensors(&policy.weights, &self.policy);
        let bytes = parameters.and_then(|parameters| {
            metadata.insert(WEIGHTS_SHA256.to_owned(), hex::encode(&parameters.digest()?));
            parameters.to_safetensors(&metadata)
        });
        write_atomically(&self.directory.join(name), &bytes.map_err(io::Error::other)?)
    }
}

/// Makes a journal line of an update.
fn line(progress: &UpdateProgress, scalars: &[(String, f64)]) -> Value {
    let mut line = json!({
        "update": progress.n_updates,
        "steps": progress.n_steps,
        "time": clock::utc_now(),
        "staleness": progress.update.staleness,
        "refusals": progress.books.refusals,
    });
    if !progress.update.clip_by_staleness.is_empty() {
        line["clip_by_staleness"] = json!(progress.update.clip_by_staleness);
    }
    for (name, value) in scalars {
        line[name] = (*value).into();
    }
    line
}

#[cfg(test)]
mod tests {
    use std::fs;

    use leadtime_proto::PolicyVersion;

    use super::*;
    use crate::held_out::HELD_OUT;
    use crate::test_support::config;

    #[test]
    fn evaluations_that_could_not_be_written_are_written_with_the_next_policies() {
        let runs = tempfile::tempdir().unwrap();
        let config = config(runs.path(), "cartpole", "r", &[]);
        let (run, _) = RunDir::open(&config, None, &crate::ProgramBuild::default()).unwrap();
        let mut recorder = RunRecorder::open(&run.path, &config, "r").unwrap();
        let version = PolicyVersion(5);
        let (n_episodes, error) = (20, 0.5);
        let (episode_return, length) = (2.5, 3.0);
        let means =
            HeldOutMeans { version, n_episodes, success: None, episode_return, length, error };
        let weights = Parameters::initialize(&config.policy, 1).unwrap();
        let weights = weights.to_safetensors(&BTreeMap::new()).unwrap().into();
        let policy = RatedPolicy { version, score: None, held_out: Some(means), weights };
        let table = run.path.join(HELD_OUT);
        recorder.policies(&policy, &policy, &[]).unwrap();
        assert!(!table.exists(), "nothing was evaluated");
        fs::create_dir(&table).unwrap();
        recorder.held_out(&[means]).unwrap_err();
        fs::remove_dir(&table).unwrap();
        recorder.policies(&policy, &policy, &[means]).unwrap();
        assert_eq!(held_out::read(&run.path)[0]["update"], 5);
        assert!(held_out::of_best(&run.path).is_some());
    }
}
