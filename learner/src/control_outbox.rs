//! Control messages to actors, one at a time and in order per actor, off the learner's loop.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use leadtime_link::LearnerLink;
use leadtime_proto::message::{Assignment, Control, ControlReply};
use leadtime_proto::{EnvId, Epoch};
use tokio::sync::mpsc;
use tokio::task::AbortHandle;
use tokio::time::Instant;
use tracing::debug;

use crate::books::SenderKey;
use crate::roster::MembershipNumber;

/// The most messages that wait for one actor.
const QUEUED: usize = 64;
/// How long an actor may take to acknowledge a message.
const ACK_TIMEOUT: Duration = Duration::from_secs(3);
/// How long it may take if it has to restore snapshots first: a world in Python may replay whole episodes. An actor that is gone is
/// noticed without it, by its presence, and one that others wait for by its lateness.
const RESTORE_TIMEOUT: Duration = Duration::from_mins(2);
/// How often a message is sent before the actor is given up.
const ATTEMPTS: usize = 2;
/// How long what an actor was told is still sent once it is gone.
const LAST_WORDS: Duration = ACK_TIMEOUT.saturating_mul(ATTEMPTS as u32);
/// The most outcomes that wait to be noticed.
const QUEUED_OUTCOMES: usize = 256;

/// What came of a control message.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum ControlOutcome {
    /// The actor answered in this membership.
    Answered(SenderKey, MembershipNumber),
    /// The actor follows the assignment that it was given in this membership.
    Followed(SenderKey, MembershipNumber, Epoch),
    /// The actor did not answer in this membership.
    Silent(SenderKey, MembershipNumber),
    /// The actor follows the assignment except for environments that it cannot restore.
    CannotRestore(SenderKey, Epoch, Vec<EnvId>),
    /// The actor follows another assignment than the one that it was given.
    Astray(SenderKey, MembershipNumber, Epoch),
}

/// Who sends one membership's messages.
#[derive(Debug)]
struct Courier {
    membership: MembershipNumber,
    /// Where its messages are queued; none once the actor is gone.
    messages: Option<mpsc::Sender<Control>>,
    gone_at: Option<Instant>,
    task: AbortHandle,
}

/// One task per membership that sends its messages.
#[derive(Debug)]
pub(crate) struct ControlOutbox {
    link: Arc<LearnerLink>,
    couriers: BTreeMap<SenderKey, Courier>,
    told: mpsc::Sender<ControlOutcome>,
    /// What came of control messages.
    pub(crate) outcomes: mpsc::Receiver<ControlOutcome>,
}

impl ControlOutbox {
    pub(crate) fn new(link: Arc<LearnerLink>) -> Self {
        let (told, outcomes) = mpsc::channel(QUEUED_OUTCOMES);
        Self { link, couriers: BTreeMap::new(), told, outcomes }
    }

    /// Queues a message. Returns whether there was room: an actor that acknowledges none has none. An order to leave waits for no
    /// other one, for it makes all of them void.
    pub(crate) fn send(
        &mut self,
        to: &SenderKey,
        membership: MembershipNumber,
        control: Control,
    ) -> bool {
        let (link, told) = (&self.link, &self.told);
        let start = || {
            let (messages, queued) = mpsc::channel(QUEUED);
            let delivery = deliver(Arc::clone(link), to.clone(), membership, queued, told.clone());
            let task = tokio::spawn(delivery).abort_handle();
            Courier { membership, messages: Some(messages), gone_at: None, task }
        };
        let courier = self.couriers.entry(to.clone()).or_insert_with(start);
        if courier.membership != membership || matches!(control, Control::Stop { .. }) {
            // What was ordered before the actor was lost is void, too.
            courier.task.abort();
            *courier = start();
        }
        courier.messages.as_ref().is_some_and(|messages| messages.try_send(control).is_ok())
    }

    /// Lets the tasks of actors that are gone end; what they hold is still sent for [`LAST_WORDS`] if it can be, until the actor is a
    /// member again.
    pub(crate) fn retain(&mut self, wanted: impl Fn(&SenderKey) -> bool) {
        for (key, courier) in &mut self.couriers {
            if wanted(key) {
                continue;
            }
            courier.messages = None;
            if courier.gone_at.get_or_insert_with(Instant::now).elapsed() >= LAST_WORDS {
                courier.task.abort();
            }
        }
        self.couriers.retain(|_, courier| !courier.task.is_finished());
    }
}

async fn deliver(
    link: Arc<LearnerLink>,
    to: SenderKey,
    membership: MembershipNumber,
    mut messages: mpsc::Receiver<Control>,
    told: mpsc::Sender<ControlOutcome>,
) {
    while let Some(control) = messages.recv().await {
        let timeout = timeout_of(&control);
        for attempt in 1..=ATTEMPTS {
            match link.control(&to.0, to.1, &control, timeout).await {
                Ok(reply) => {
                    drop(told.send(outcome(&to, membership, &control, reply)).await);
                    break;
                }
                Err(error) => {
                    debug!(actor = %to.0, attempt, %error, "control message not acknowledged");
                    if attempt == ATTEMPTS {
                        drop(told.send(ControlOutcome::Silent(to, membership)).await);
                        return;
                    }
                }
            }
        }
    }
}

/// Returns how long an actor may take to acknowledge a message: an assignment is answered when its environments are ready.
fn timeout_of(control: &Control) -> Duration {
    let restores =
        |assignment: &Assignment| assignment.envs.iter().any(|env| !env.snapshot.is_empty());
    match control {
        Control::Assign(assignment) if restores(assignment) => RESTORE_TIMEOUT,
        Control::Assign(_) | Control::Wait | Control::Stop { .. } => ACK_TIMEOUT,
    }
}

/// Compares an answer with the message. Orders are sent one at a time and in order, so an actor that takes them from this
/// learner alone follows the one that it answers, and has trouble with environments that this one gave.
fn outcome(
    to: &SenderKey,
    membership: MembershipNumber,
    control: &Control,
    reply: ControlReply,
) -> ControlOutcome {
    let Control::Assign(Assignment { epoch: ordered, envs: given, .. }) = control else {
        return ControlOutcome::Answered(to.clone(), membership);
    };
    match reply {
        ControlReply::Followed { epoch } if epoch == *ordered => {
            ControlOutcome::Followed(to.clone(), membership, epoch)
        }
        ControlReply::CannotRestore { epoch, envs: named } if epoch == *ordered => {
            // Whatever it names, and however often: no more than was given comes of it, and only of what there is to restore. Without
            // a snapshot the same fresh episode would be given again at once, to the same answer, without end.
            let named: BTreeSet<EnvId> = named.into_iter().collect();
            let given = given.iter().filter(|env| !env.snapshot.is_empty()).map(|env| env.env_id);
            let envs = given.filter(|env_id| named.contains(env_id)).collect();
            ControlOutcome::CannotRestore(to.clone(), epoch, envs)
        }
        ControlReply::Followed { epoch } | ControlReply::CannotRestore { epoch, .. } => {
            ControlOutcome::Astray(to.clone(), membership, epoch)
        }
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{ActorId, Incarnation};

    use super::*;
    use crate::rollout_queue::RolloutQueue;

    #[test]
    fn an_answer_about_another_assignment_does_not_count_as_followed() {
        let key = (ActorId::new("a").unwrap(), Incarnation(1));
        let membership = MembershipNumber::default();
        let mut envs = RolloutQueue::beginning(4);
        envs[3].snapshot = vec![1];
        let order = Control::Assign(Assignment { epoch: Epoch(7), envs, keep: Vec::new() });
        let heard = |control: &Control, reply| outcome(&key, membership, control, reply);
        let followed = |epoch| ControlReply::Followed { epoch: Epoch(epoch) };
        let cannot =
            |epoch| ControlReply::CannotRestore { epoch: Epoch(epoch), envs: vec![EnvId(3)] };
        let astray = |epoch| ControlOutcome::Astray(key.clone(), membership, Epoch(epoch));
        let answered = || ControlOutcome::Answered(key.clone(), membership);
        let follows = ControlOutcome::Followed(key.clone(), membership, Epoch(7));
        assert_eq!(heard(&order, followed(7)), follows);
        assert_eq!(heard(&order, followed(u64::MAX)), astray(u64::MAX));
        assert_eq!(heard(&order, followed(6)), astray(6));
        assert_eq!(heard(&order, cannot(8)), astray(8));
        let known = ControlOutcome::CannotRestore(key.clone(), Epoch(7), vec![EnvId(3)]);
        assert_eq!(heard(&order, cannot(7)), known);
        let odd = |envs: &[u32]| ControlReply::CannotRestore {
            epoch: Epoch(7),
            envs: envs.iter().copied().map(EnvId).collect(),
        };
        assert_eq!(heard(&order, odd(&[9, 3, 2, 3])), known, "what was given to restore, and once");
        let nothing = ControlOutcome::CannotRestore(key.clone(), Epoch(7), Vec::new());
        assert_eq!(heard(&order, odd(&[0, 2])), nothing, "they begin as everybody's do");
        let stop = Control::Stop { reason: String::new(), cut_off: false };
        assert_eq!(heard(&stop, followed(6)), answered());
        assert_eq!(heard(&Control::Wait, followed(6)), answered());
    }

    #[test]
    fn an_actor_that_has_to_restore_snapshots_has_time_for_it() {
        let assign = |snapshot: &[u8]| {
            let mut envs = RolloutQueue::beginning(2);
            envs[1].snapshot = snapshot.to_vec();
            Control::Assign(Assignment { epoch: Epoch(1), envs, keep: Vec::new() })
        };
        // Sixteen environments in Python may take 70 s.
        assert!(timeout_of(&assign(b"state")) > Duration::from_secs(70));
        // Nothing else takes an actor long, and one that does not answer holds up the run.
        let stop = Control::Stop { reason: String::new(), cut_off: false };
        for control in [assign(b""), Control::Wait, stop] {
            assert_eq!(timeout_of(&control), ACK_TIMEOUT);
        }
    }
}
