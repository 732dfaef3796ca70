//! What the learner calls while it works: everything that a run leaves behind besides its checkpoints.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use leadtime_learner::{ProgressSink, RatedPolicy, RunEvent, UpdateProgress};
use leadtime_policy::Parameters;
use leadtime_proto::PolicySpec;
use serde_json::{Map, Value};
use tokio_util::sync::CancellationToken;

use super::display::Display;
use super::journal::Journal;
use super::metrics;
use crate::clock;
use crate::record::write_atomically;
use crate::tensorboard::EventFile;

/// File of the newest policy in a run directory.
pub const LAST_POLICY: &str = "policy.safetensors";
/// File of the best policy in a run directory.
pub const BEST_POLICY: &str = "best.safetensors";

/// Writes a run's metrics and policies, and shows its progress.
#[derive(Debug)]
pub struct RunSink {
    directory: PathBuf,
    policy: PolicySpec,
    metadata: BTreeMap<String, String>,
    steps_per_update: u64,
    journal: Journal,
    events: Option<EventFile>,
    display: Display,
    complained: bool,
    stop: Option<(u64, CancellationToken)>,
}

impl RunSink {
    /// Opens the files of a run directory.
    ///
    /// `metadata` goes into every policy file, with the policy's own figures added.
    ///
    /// # Errors
    ///
    /// Whatever the file system says.
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
            events: None,
            display: Display::new(),
            complained: false,
            stop: None,
        })
    }

    /// Asks the run to stop once it has made this many updates in all.
    pub fn stop_after(&mut self, n_updates: Option<u64>, shutdown: CancellationToken) {
        self.stop = n_updates.map(|n_updates| (n_updates, shutdown));
    }

    fn write_update(&mut self, progress: &UpdateProgress) -> io::Result<()> {
        let scalars = metrics::scalars(progress);
        let mut line = Map::new();
        line.insert("update".to_owned(), progress.n_updates.into());
        line.insert("steps".to_owned(), progress.n_steps.into());
        line.insert("time".to_owned(), clock::utc_now().into());
        let staleness: Map<String, Value> = progress
            .update
            .staleness
            .iter()
            .map(|(staleness, n)| (staleness.to_string(), Value::from(*n)))
            .collect();
        line.insert("staleness".to_owned(), staleness.into());
        let refusals = &progress.books.refusals;
        let refusals: Map<String, Value> =
            refusals.iter().map(|(cause, &n)| (cause.name().to_owned(), n.into())).collect();
        line.insert("refusals".to_owned(), refusals.into());
        for (name, value) in &scalars {
            line.insert(name.clone(), (*value).into());
        }
        self.journal.append(line)?;
        let now = clock::unix_seconds();
        self.events(0)?.scalars(now, progress.n_steps, &scalars)
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

    fn resume(&mut self, n_updates: u64) -> io::Result<()> {
        self.journal.rewind(n_updates)?;
        self.events(n_updates * self.steps_per_update + 1)?;
        Ok(())
    }

    /// Writes a policy file that explains itself.
    fn write_policy(&self, name: &str, policy: &RatedPolicy) -> anyhow::Result<()> {
        let mut metadata = self.metadata.clone();
        metadata.insert("policy_version".to_owned(), policy.version.to_string());
        if let Some(score) = policy.score {
            metadata.insert("training_score".to_owned(), score.to_string());
        }
        let parameters = Parameters::from_safetensors(&policy.weights, &self.policy)?;
        let bytes = parameters.to_safetensors(&metadata)?;
        Ok(write_atomically(&self.directory.join(name), &bytes)?)
    }

    /// Says once that a file cannot be written; the run goes on, because its checkpoints are what it needs.
    fn complain<E: Into<anyhow::Error>>(&mut self, result: Result<(), E>) {
        if let Err(error) = result
            && !self.complained
        {
            self.complained = true;
            let error = error.into();
            tracing::warn!(directory = %self.directory.display(), "metrics or policies cannot be written: {error:#}");
        }
    }
}

impl ProgressSink for RunSink {
    fn on_update(&mut self, progress: &UpdateProgress) {
        let written = self.write_update(progress);
        self.complain(written);
        self.display.update(progress);
        if let Some((n_updates, shutdown)) = &self.stop
            && progress.n_updates >= *n_updates
        {
            shutdown.cancel();
        }
    }

    fn on_event(&mut self, event: &RunEvent) {
        if let RunEvent::Resumed { n_updates, .. } = event {
            let resumed = self.resume(*n_updates);
            self.complain(resumed);
        }
        log(event);
    }

    fn on_policies(&mut self, last: &RatedPolicy, best: Option<&RatedPolicy>) {
        let written = self.write_policy(LAST_POLICY, last);
        self.complain(written);
        if let Some(best) = best {
            let written = self.write_policy(BEST_POLICY, best);
            self.complain(written);
        }
    }
}

impl Drop for RunSink {
    fn drop(&mut self) {
        self.display.finish();
    }
}

fn log(event: &RunEvent) {
    match event {
        RunEvent::Listening { locators } => {
            tracing::info!(at = %locators.join(", "), "listening");
        }
        RunEvent::Resumed { path, n_updates } => {
            tracing::info!(n_updates, checkpoint = %path.display(), "resumed");
        }
        RunEvent::CheckpointDamaged { path, damage } => {
            tracing::warn!(checkpoint = %path.display(), "a checkpoint cannot be used: {damage}; taking the one before");
        }
        RunEvent::ActorJoined { actor, n_actors } => {
            tracing::info!(%actor, n_actors, "actor joined");
        }
        RunEvent::ActorLeft { actor, n_actors, n_envs } => {
            tracing::info!(%actor, n_actors, n_envs, "actor left");
        }
        RunEvent::WaitingForActors { n_actors, n_needed } => {
            tracing::info!("waiting for actors: {n_actors} of {n_needed}");
        }
        RunEvent::Assigned { actor, epoch, n_given, n_kept } => {
            tracing::debug!(%actor, %epoch, n_given, n_kept, "environments assigned");
        }
        RunEvent::Refused { actor, cause, reason } => {
            let actor = actor.as_ref().map_or("unknown", |actor| actor.as_str());
            tracing::warn!(actor, ?cause, "message refused: {reason}");
        }
        RunEvent::CutOff { actor, reason, .. } => {
            tracing::warn!(%actor, "actor cut off: {reason}");
        }
        RunEvent::OtherProgram { actor, program } => {
            tracing::warn!(%actor, program, "another build of the program: the run is not reproducible bit for bit");
        }
        RunEvent::OtherCpu { actor, cpu } => {
            tracing::warn!(%actor, cpu, "another class of CPU: the run is not reproducible bit for bit");
        }
        RunEvent::CheckpointWritten { path, n_updates } => {
            tracing::debug!(n_updates, checkpoint = %path.display(), "checkpointed");
        }
        RunEvent::Stopping => tracing::info!("stopping: writing checkpoint and books"),
    }
}
