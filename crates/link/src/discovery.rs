//! Finding the runs at an address by the presence of their learners; no learner is asked anything.

use std::collections::BTreeSet;
use std::time::Duration;

use leadtime_proto::RunName;
use zenoh::Wait as _;
use zenoh::session::Session;

use crate::keys::{self, Keys};
use crate::{Error, Result};

/// Longest wait for one answer to "which learners are there?".
const LOOK: Duration = Duration::from_secs(1);
/// Most learners at one address that are looked at.
const MAX_LEARNERS: usize = 1_024;

/// Lists the runs whose learner is there now.
pub(crate) async fn runs(session: &Session) -> Result<BTreeSet<RunName>> {
    let key = Keys::Learners.to_string();
    let (sender, answers) = flume::bounded(MAX_LEARNERS);
    session
        .liveliness()
        .get(keys::expr(Keys::Learners))
        .timeout(LOOK)
        .callback(move |reply| {
            // More learners than anyone looks at are let go.
            drop(sender.try_send(reply));
        })
        .wait()
        .map_err(Error::network("look for learners on", &key))?;
    let mut runs = BTreeSet::new();
    // The network ends the answers at its own time-out; ours is for a network that does not.
    let look = async {
        while let Ok(reply) = answers.recv_async().await {
            let alive = reply.into_result().ok().and_then(|s| keys::parse_alive(s.key_expr()));
            runs.extend(alive.map(|alive| alive.run));
        }
    };
    // Running out of time leaves the runs that were found.
    drop(tokio::time::timeout(2 * LOOK, look).await);
    Ok(runs)
}
