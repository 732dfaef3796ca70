//! An actor's status: what its loop last said, read on request.

use std::path::PathBuf;
use std::sync::Arc;

use leadtime_actor::ActorProgress;
use tokio::sync::watch;
use tokio_util::sync::DropGuard;

use crate::health::Liveness;
use crate::machine;
use crate::names::{Metric, MetricPage};
use crate::numbers::PageNumbers;
use crate::server::{StatusServer, StatusSource};

/// An actor's status page, which is served for as long as this lives.
#[derive(Debug)]
pub struct ActorStatus {
    _served: DropGuard,
}

#[derive(Debug)]
struct ActorPage {
    actor: String,
    /// The file of the actor's certificate.
    certificate: Option<PathBuf>,
    numbers: Arc<PageNumbers>,
    liveness: Arc<Liveness>,
    progress: watch::Receiver<Option<ActorProgress>>,
}

impl ActorStatus {
    /// Begins to serve what the actor's loop says.
    pub fn serve(
        server: StatusServer,
        actor: &str,
        certificate: Option<PathBuf>,
        progress: watch::Receiver<Option<ActorProgress>>,
    ) -> Self {
        let liveness = Liveness::new();
        let shared = Arc::new(ActorPage {
            actor: actor.to_owned(),
            certificate,
            numbers: PageNumbers::new(MetricPage::Actor),
            liveness: Arc::clone(&liveness),
            progress: progress.clone(),
        });
        tokio::spawn(async move {
            let mut progress = progress;
            while progress.changed().await.is_ok() {
                liveness.tick();
            }
            // The loop is over.
            liveness.end();
        });
        Self { _served: server.serve(shared) }
    }
}

impl StatusSource for ActorPage {
    fn metrics(&self) -> Result<String, std::fmt::Error> {
        let Self { numbers, .. } = self;
        let set = |metric, value: Option<f64>| numbers.set(metric, value.unwrap_or(f64::NAN));
        if let Some(progress) = &*self.progress.borrow() {
            numbers.set(Metric::ActorSteps, progress.n_steps as f64);
            numbers.set(Metric::Unacknowledged, progress.n_unacknowledged as f64);
            numbers.set(Metric::Reconnects, progress.n_reconnects as f64);
            set(Metric::WeightsVersion, progress.version.map(|version| version.0 as f64));
        }
        set(Metric::Resident, machine::resident_bytes());
        let certificate = self.certificate.as_deref().and_then(machine::certificate_end);
        set(Metric::CertificateEnd, certificate);
        numbers.text(("actor", &self.actor))
    }

    fn live(&self) -> Result<(), String> {
        // Before the first welcome there is no loop: the search for a learner has a limit of its own.
        if self.progress.borrow().is_none() { Ok(()) } else { self.liveness.check() }
    }

    fn ready(&self) -> Result<(), String> {
        self.live()?;
        match &*self.progress.borrow() {
            None => Err("no learner has been found yet".to_owned()),
            Some(progress) if progress.is_searching => Err("looking for the learner".to_owned()),
            Some(progress) if !progress.is_assigned => {
                Err("the learner has assigned no environments".to_owned())
            }
            Some(_) => Ok(()),
        }
    }
}
