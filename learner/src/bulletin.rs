//! What a learner publishes to observers without being asked: its updates, at most a few per second, and once a second who is
//! here.
//!
//! The newest update replaces one that was not published yet. Nothing here is waited for: the loop posts and goes on.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use leadtime_link::LearnerLink;
use leadtime_proto::ActorId;
use serde_json::{Value, json};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use tracing::debug;

use crate::report::RosterEntry;

/// The shortest time between two updates that observers receive.
const PAUSE: Duration = Duration::from_millis(200);
/// How long the end of a run waits for the last of them.
const FAREWELL: Duration = Duration::from_millis(500);
/// The most actors that are listed one by one.
const MAX_LISTED: usize = 256;
/// How many are listed if there are more: those that delivered longest ago.
const N_SLOWEST: usize = 64;

/// The state of a run, apart from its actors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RosterHead {
    pub(crate) version: u64,
    pub(crate) n_updates_total: u64,
    pub(crate) n_queued: u64,
    /// How many actors there have to be, if there are fewer.
    pub(crate) n_needed: Option<usize>,
    /// The update of the last checkpoint.
    pub(crate) checkpoint: u64,
}

/// Writes who is here, as observers read it.
pub(crate) fn roster(
    run: RosterHead,
    actors: Vec<RosterEntry>,
    queued: &BTreeMap<ActorId, usize>,
) -> Value {
    let n_actors = actors.len();
    let (listed, others) = listed(actors);
    let with_queue = |actor: &RosterEntry| {
        let mut listed = json!(actor);
        listed["queued_bytes"] = queued.get(&actor.id).copied().unwrap_or(0).into();
        listed
    };
    json!({
        "kind": "roster",
        "version": run.version,
        "total_updates": run.n_updates_total,
        "n_actors": n_actors,
        "n_queued": run.n_queued,
        "n_needed": run.n_needed,
        "checkpoint": run.checkpoint,
        "actors": listed.iter().map(with_queue).collect::<Vec<_>>(),
        "others": {
            "actors": others.len(),
            "envs": others.iter().map(|actor| actor.envs).sum::<usize>(),
            "refused": others.iter().flat_map(|actor| actor.refused.values()).sum::<u64>(),
        },
    })
}

/// Splits actors into those that are listed and those that are only summed.
fn listed(mut actors: Vec<RosterEntry>) -> (Vec<RosterEntry>, Vec<RosterEntry>) {
    if actors.len() <= MAX_LISTED {
        return (actors, Vec::new());
    }
    actors.sort_by(|a, b| b.silent_s.total_cmp(&a.silent_s));
    let others = actors.split_off(N_SLOWEST);
    (actors, others)
}

/// Publishes updates in a task of its own.
#[derive(Debug)]
pub(crate) struct Bulletin {
    newest: watch::Sender<Vec<u8>>,
    task: JoinHandle<()>,
    link: Arc<LearnerLink>,
}

impl Bulletin {
    /// Starts the task that publishes; it ends when the bulletin is dropped.
    pub(crate) fn start(link: Arc<LearnerLink>) -> Self {
        let (newest, updates) = watch::channel(Vec::new());
        let task = tokio::spawn(publish(Arc::clone(&link), updates));
        Self { newest, task, link }
    }

    /// Has an update published soon, unless a newer one comes before.
    pub(crate) fn post(&self, update: Vec<u8>) {
        self.newest.send_replace(update);
    }

    /// Publishes something at once.
    pub(crate) fn tell(&self, message: &Value) {
        if let Err(error) = self.link.publish_metrics(message.to_string().as_bytes()) {
            debug!(%error, "metrics not published");
        }
    }

    /// Publishes what is still to be published, and the end.
    pub(crate) async fn finish(self, end: &Value) {
        let Self { newest, mut task, link } = self;
        drop(newest);
        // Nothing comes after the end.
        if timeout(FAREWELL, &mut task).await.is_err() {
            task.abort();
        }
        if let Err(error) = link.publish_metrics(end.to_string().as_bytes()) {
            debug!(%error, "the end is not published");
        }
    }
}

async fn publish(link: Arc<LearnerLink>, mut updates: watch::Receiver<Vec<u8>>) {
    while updates.changed().await.is_ok() {
        let update = updates.borrow_and_update().clone();
        if let Err(error) = link.publish_metrics(&update) {
            debug!(%error, "an update is not published");
        }
        if updates.has_changed().is_ok() {
            sleep(PAUSE).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::RefusalCause;

    use super::*;

    fn entry(number: u64) -> RosterEntry {
        RosterEntry {
            id: ActorId::new(format!("a{number}")).unwrap(),
            incarnation: format!("{number:016x}"),
            envs: 2,
            epoch: 1,
            iteration: Some(number),
            staleness: Some(0),
            acknowledged: number,
            limit: number + 4,
            refused: BTreeMap::from([(RefusalCause::Credit, 1)]),
            silent_s: number as f64 * 0.5,
        }
    }

    fn told(n_actors: u64) -> Value {
        let run = RosterHead {
            version: 7,
            n_updates_total: 9,
            n_queued: 3,
            n_needed: None,
            checkpoint: 5,
        };
        let queued = BTreeMap::from([(ActorId::new("a1").unwrap(), 10)]);
        roster(run, (0..n_actors).map(entry).collect(), &queued)
    }

    #[test]
    fn everybody_is_listed_with_what_waits_of_them() {
        let told = told(2);
        assert_eq!((told["kind"].as_str(), &told["version"]), (Some("roster"), &json!(7)));
        assert_eq!(told["actors"][1]["queued_bytes"], 10);
        assert_eq!(told["actors"][0]["refused"], json!({"credit": 1}));
        assert_eq!(told["others"]["actors"], 0);
    }

    #[test]
    fn the_slowest_of_very_many_actors_are_listed_and_the_rest_are_summed() {
        let told = told(300);
        let listed = told["actors"].as_array().unwrap();
        assert_eq!((listed.len(), &listed[0]["id"]), (N_SLOWEST, &json!("a299")));
        assert_eq!(told["others"], json!({"actors": 236, "envs": 472, "refused": 236}));
        assert_eq!(told["n_actors"], 300);
        assert!(told.to_string().len() < 64 << 10);
    }
}
