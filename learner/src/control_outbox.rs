//! Control messages to actors, one at a time and in order per actor, off the learner's loop.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use leadtime_link::LearnerLink;
use leadtime_proto::message::{Control, ControlReply};
use leadtime_proto::{EnvId, Epoch};
use tokio::sync::mpsc;
use tracing::debug;

use crate::books::SenderKey;

/// The most messages that wait for one actor.
const QUEUED: usize = 64;
/// How long an actor may take to acknowledge a message.
const ACK_TIMEOUT: Duration = Duration::from_secs(3);
/// How often a message is sent before the actor is given up.
const ATTEMPTS: usize = 2;
/// The most failures that wait to be noticed.
const QUEUED_FAILURES: usize = 256;

/// What became of a control message, other than that it is followed.
#[derive(Debug)]
pub(crate) enum ControlFailure {
    /// The actor does not answer.
    Silent(SenderKey),
    /// The actor follows the assignment except for environments that it cannot restore.
    CannotRestore(SenderKey, Epoch, Vec<EnvId>),
}

/// One task per actor that sends its messages.
#[derive(Debug)]
pub(crate) struct ControlOutbox {
    link: Arc<LearnerLink>,
    tasks: BTreeMap<SenderKey, mpsc::Sender<Control>>,
    failed: mpsc::Sender<ControlFailure>,
    /// Control messages that failed.
    pub(crate) failures: mpsc::Receiver<ControlFailure>,
}

impl ControlOutbox {
    pub(crate) fn new(link: Arc<LearnerLink>) -> Self {
        let (failed, failures) = mpsc::channel(QUEUED_FAILURES);
        Self { link, tasks: BTreeMap::new(), failed, failures }
    }

    /// Queues a message. Returns whether there was room: an actor that acknowledges none has none.
    pub(crate) fn send(&mut self, to: &SenderKey, control: Control) -> bool {
        let (link, failed) = (&self.link, &self.failed);
        let task = self.tasks.entry(to.clone()).or_insert_with(|| {
            let (task, messages) = mpsc::channel(QUEUED);
            tokio::spawn(deliver(Arc::clone(link), to.clone(), messages, failed.clone()));
            task
        });
        task.try_send(control).is_ok()
    }

    /// Drops the tasks of actors that are gone; what they hold is still sent if it can be.
    pub(crate) fn retain(&mut self, wanted: impl Fn(&SenderKey) -> bool) {
        self.tasks.retain(|key, task| wanted(key) && !task.is_closed());
    }
}

async fn deliver(
    link: Arc<LearnerLink>,
    to: SenderKey,
    mut messages: mpsc::Receiver<Control>,
    failed: mpsc::Sender<ControlFailure>,
) {
    while let Some(control) = messages.recv().await {
        for attempt in 1..=ATTEMPTS {
            match link.control(&to.0, to.1, &control, ACK_TIMEOUT).await {
                Ok(ControlReply::Followed { .. }) => break,
                Ok(ControlReply::CannotRestore { epoch, envs }) => {
                    let failure = ControlFailure::CannotRestore(to.clone(), epoch, envs);
                    drop(failed.send(failure).await);
                    break;
                }
                Err(error) => {
                    debug!(actor = %to.0, attempt, %error, "control message not acknowledged");
                    if attempt == ATTEMPTS {
                        drop(failed.send(ControlFailure::Silent(to)).await);
                        return;
                    }
                }
            }
        }
    }
}
