//! Writes down what a learner reports: metrics, event files, policy files; its checkpoints are its own.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use leadtime_learner::{RatedPolicy, UpdateProgress, write_atomically};
use leadtime_policy::Parameters;
use leadtime_proto::PolicySpec;
use serde_json::{Map, Value};

use crate::journal::Journal;
use crate::policy_file::{BEST_POLICY, LAST_POLICY, VERSION};
use crate::tensorboard::EventFile;
use crate::{clock, metrics};

/// The open files of a run.
#[derive(Debug)]
pub struct RunRecorder {
    directory: PathBuf,
    policy: PolicySpec,
    metadata: BTreeMap<String, String>,
    steps_per_update: u64,
    journal: Journal,
    /// Whether the journal ends with the update before the next one: a predecessor may have been killed further on.
    is_rewound: bool,
    events: Option<EventFile>,
}

impl RunRecorder {
    /// Opens the files of a run directory.
    ///
    /// `metadata` goes into every policy file, with the policy's own figures added.
    ///
    /// # Errors
    ///
    /// If a file cannot be made or opened.
    pub fn open(
        directory: &Path,
        policy: PolicySpec,
        metadata: BTreeMap<String, String>,
        steps_per_update: u64,
    ) -> io::Result<Self> {
        Ok(Self {
            directory: directory.to_owned(),
            policy,
            metadata,
            steps_per_update,
            journal: Journal::open(directory)?,
            is_rewound: false,
            events: None,
        })
    }

    /// Notes that the run goes on from a checkpoint.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn resumed(&mut self, n_updates: u64) -> io::Result<()> {
        self.rewind(n_updates)?;
        self.events(n_updates * self.steps_per_update + 1)?;
        Ok(())
    }

    /// Writes one update to the journal and to the event file.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn update(&mut self, progress: &UpdateProgress) -> io::Result<()> {
        if !self.is_rewound {
            self.rewind(progress.n_updates.saturating_sub(1))?;
        }
        let scalars = metrics::scalars(progress);
        self.journal.append(line(progress, &scalars))?;
        self.events(0)?.scalars(clock::unix_seconds(), progress.n_steps, &scalars)
    }

    /// Writes the newest and the best policy.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn policies(&self, last: &RatedPolicy, best: Option<&RatedPolicy>) -> io::Result<()> {
        self.write_policy(LAST_POLICY, last)?;
        best.map_or(Ok(()), |best| self.write_policy(BEST_POLICY, best))
    }

    fn rewind(&mut self, n_updates: u64) -> io::Result<()> {
        self.journal.rewind(n_updates)?;
        self.is_rewound = true;
        Ok(())
    }

    /// Returns the event file, made at the first call for steps from `first_step` on.
    fn events(&mut self, first_step: u64) -> io::Result<&mut EventFile> {
        if self.events.is_none() {
            let directory = self.directory.join("tensorboard");
            let process = std::process::id();
            let now = clock::unix_seconds();
            self.events = Some(EventFile::create(&directory, now, process, first_step)?);
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
        let parameters = Parameters::from_safetensors(&policy.weights, &self.policy);
        let bytes = parameters.and_then(|parameters| parameters.to_safetensors(&metadata));
        write_atomically(&self.directory.join(name), &bytes.map_err(io::Error::other)?)
    }
}

/// Makes a journal line of an update.
fn line(progress: &UpdateProgress, scalars: &[(String, f64)]) -> Map<String, Value> {
    let staleness = &progress.update.staleness;
    let staleness: Map<String, Value> =
        staleness.iter().map(|(staleness, &n)| (staleness.to_string(), n.into())).collect();
    let refusals = &progress.books.refusals;
    let refusals: Map<String, Value> =
        refusals.iter().map(|(cause, &n)| (cause.name().to_owned(), n.into())).collect();
    let mut line = Map::new();
    line.insert("update".to_owned(), progress.n_updates.into());
    line.insert("steps".to_owned(), progress.n_steps.into());
    line.insert("time".to_owned(), clock::utc_now().into());
    line.insert("staleness".to_owned(), staleness.into());
    line.insert("refusals".to_owned(), refusals.into());
    line.extend(scalars.iter().map(|(name, value)| (name.clone(), (*value).into())));
    line
}
