//! Finding the runs at an address by the presence of their learners; no learner is asked anything.

use std::collections::BTreeSet;
use std::fmt;
use std::time::Duration;

use leadtime_proto::RunName;
use zenoh::Wait as _;
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::session::Session;

use crate::keys::{self, Keys};
use crate::{Error, Result};

/// Longest wait for one answer to "which learners are there?".
const LOOK: Duration = Duration::from_secs(1);
/// Most learners at one address that are looked at.
const MAX_LEARNERS: usize = 1_024;

/// Lists the runs whose learner is present now.
pub(crate) async fn runs(session: &Session) -> Result<BTreeSet<RunName>> {
    let (keys, action) = (Keys::Learners, "look for learners on");
    let found = tokens(session, keys, action, LOOK, MAX_LEARNERS).await?;
    Ok(found.iter().filter_map(|key| keys::parse_alive(key)).map(|alive| alive.run).collect())
}

/// Lists the keys of the tokens that are present now, at most `most`; `look` is the longest wait for one answer.
pub(crate) async fn tokens(
    session: &Session,
    keys: impl fmt::Display,
    action: &'static str,
    look: Duration,
    most: usize,
) -> Result<Vec<OwnedKeyExpr>> {
    let (sender, answers) = flume::bounded(most);
    session
        .liveliness()
        .get(keys::expr(&keys))
        .timeout(look)
        .callback(move |reply| {
            // Answers beyond the limit are dropped.
            drop(sender.try_send(reply));
        })
        .wait()
        .map_err(Error::network(action, &keys.to_string()))?;
    let mut found = Vec::new();
    // The network ends the answers at its own time-out; ours is for a network that does not.
    let take = async {
        while let Ok(reply) = answers.recv_async().await {
            let token = reply.into_result().ok();
            found.extend(token.map(|token| OwnedKeyExpr::from(token.key_expr().clone())));
        }
    };
    // Running out of time leaves what was found.
    drop(tokio::time::timeout(2 * look, take).await);
    Ok(found)
}
