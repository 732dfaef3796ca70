//! Orders to actors, one at a time and in order per actor, off the learner's loop.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use leadtime_link::LearnerLink;
use leadtime_proto::EnvId;
use leadtime_proto::message::{Control, ControlReply};
use tokio::sync::mpsc;
use tracing::debug;

use crate::books::SenderKey;

/// The most orders that wait for one actor.
const QUEUED_ORDERS: usize = 64;
/// How long an actor may take to acknowledge an order.
const ORDER_TIMEOUT: Duration = Duration::from_secs(3);
/// How often an order is given before the actor is given up.
const ATTEMPTS: usize = 2;
/// The most failures that wait to be noticed.
const QUEUED_FAILURES: usize = 256;

/// What went wrong with an order.
#[derive(Debug)]
pub(crate) enum OrderFailure {
    /// The actor does not answer.
    Silent(SenderKey),
    /// The actor follows the order except for environments that it cannot restore.
    CannotRestore(SenderKey, Vec<EnvId>),
}

/// A courier per actor.
#[derive(Debug)]
pub(crate) struct Orders {
    link: Arc<LearnerLink>,
    couriers: BTreeMap<SenderKey, mpsc::Sender<Control>>,
    failed: mpsc::Sender<OrderFailure>,
    failures: mpsc::Receiver<OrderFailure>,
}

impl Orders {
    pub(crate) fn new(link: Arc<LearnerLink>) -> Self {
        let (failed, failures) = mpsc::channel(QUEUED_FAILURES);
        Self { link, couriers: BTreeMap::new(), failed, failures }
    }

    /// Queues an order. Returns whether there was room: an actor that takes no orders has none.
    pub(crate) fn give(&mut self, to: &SenderKey, control: Control) -> bool {
        let (link, failed) = (&self.link, &self.failed);
        let courier = self.couriers.entry(to.clone()).or_insert_with(|| {
            let (courier, orders) = mpsc::channel(QUEUED_ORDERS);
            tokio::spawn(deliver(Arc::clone(link), to.clone(), orders, failed.clone()));
            courier
        });
        courier.try_send(control).is_ok()
    }

    /// Lets go of couriers to actors that are gone; what they still carry is delivered if it can be.
    pub(crate) fn retain(&mut self, wanted: impl Fn(&SenderKey) -> bool) {
        self.couriers.retain(|key, courier| wanted(key) && !courier.is_closed());
    }

    /// Waits for the next order that failed.
    pub(crate) async fn failure(&mut self) -> OrderFailure {
        match self.failures.recv().await {
            Some(failure) => failure,
            None => std::future::pending().await,
        }
    }
}

async fn deliver(
    link: Arc<LearnerLink>,
    to: SenderKey,
    mut orders: mpsc::Receiver<Control>,
    failed: mpsc::Sender<OrderFailure>,
) {
    while let Some(control) = orders.recv().await {
        for attempt in 1..=ATTEMPTS {
            match link.control(&to.0, to.1, &control, ORDER_TIMEOUT).await {
                Ok(ControlReply::Followed { .. }) => break,
                Ok(ControlReply::CannotRestore { envs, .. }) => {
                    drop(failed.send(OrderFailure::CannotRestore(to.clone(), envs)).await);
                    break;
                }
                Err(error) => {
                    debug!(actor = %to.0, attempt, %error, "order not taken");
                    if attempt == ATTEMPTS {
                        drop(failed.send(OrderFailure::Silent(to)).await);
                        return;
                    }
                }
            }
        }
    }
}
