//! Finding the runs at an address by the presence of their learners; no learner is asked anything.

use std::collections::BTreeSet;
use std::fmt;
use std::time::{Duration, Instant};

use leadtime_proto::RunName;
use zenoh::Wait as _;
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::session::Session;

use crate::keys::{self, Keys};
use crate::{ConnectSettings, Error, Result, ask, session};

/// Longest wait for one answer to "which learners are there?".
const LOOK: Duration = Duration::from_secs(1);
/// How long a learner that is present may take to show that it is alive. One that was killed is waited for only as long as it stays
/// visible, which is less: the rest is for one on a busy machine.
const PROOF_OF_LIFE: Duration = Duration::from_secs(6);
/// How long a run that was named may be missing while others are there.
const WRONG_RUN_GRACE: Duration = Duration::from_secs(2);
/// The first pause between attempts to find a run.
pub(crate) const MIN_PAUSE: Duration = Duration::from_millis(20);
/// The longest pause between them.
pub(crate) const MAX_PAUSE: Duration = Duration::from_millis(500);
/// Most learners at one address that are looked at.
const MAX_LEARNERS: usize = 1_024;

/// Lists the runs whose learner is present now.
pub(crate) async fn runs(session: &Session) -> Result<BTreeSet<RunName>> {
    let (keys, action) = (Keys::Learners, "look for learners on");
    let found = tokens(session, keys, action, LOOK, MAX_LEARNERS).await?;
    Ok(found.iter().filter_map(|key| keys::parse_alive(key)).map(|alive| alive.run).collect())
}

/// Returns whether a learner of this run is there and answers: the presence of one that was killed may last a moment longer.
pub(crate) async fn is_led(session: &Session, run: &RunName) -> Result<bool> {
    let (keys, action) = (Keys::LearnerOf(run), "look for learners on");
    let found = tokens(session, keys, action, LOOK, MAX_LEARNERS).await?;
    let is_present = found.iter().any(|key| keys::parse_alive(key).is_some());
    Ok(is_present && ask::is_answered(session, Keys::PullsOf(run), PROOF_OF_LIFE).await?)
}

/// Finds a run: the named one, or the only one present. Looks until `settings.timeout` has passed since `started`, and for
/// [`WRONG_RUN_GRACE`] while only other runs are present. Every look is on the session that is `current` then.
///
/// # Errors
///
/// [`Error::SeveralRuns`] if none was named and several are present, [`Error::RunNotFound`] if only others than the named one
/// are; [`Error::NoLearner`] if none is.
pub(crate) async fn find(
    current: impl Fn() -> Session,
    settings: &ConnectSettings,
    wanted: Option<&RunName>,
    started: Instant,
) -> Result<RunName> {
    let timeout = settings.timeout;
    let endpoints = || session::describe(&settings.endpoints);
    let mut pause = MIN_PAUSE;
    loop {
        let mut runs = runs(&current()).await?;
        match wanted {
            Some(run) if runs.contains(run) => return Ok(run.clone()),
            None if runs.len() > 1 => {
                let runs = runs.into_iter().collect();
                return Err(Error::SeveralRuns { endpoints: endpoints(), runs });
            }
            None if let Some(run) = runs.pop_first() => return Ok(run),
            _ => {}
        }
        let waited = started.elapsed();
        let patience = if runs.is_empty() { timeout } else { timeout.min(WRONG_RUN_GRACE) };
        if waited >= patience {
            return Err(match wanted {
                Some(run) if !runs.is_empty() => {
                    let present = runs.into_iter().collect();
                    Error::RunNotFound { run: run.clone(), endpoints: endpoints(), present }
                }
                _ => Error::NoLearner { endpoints: endpoints(), timeout },
            });
        }
        tokio::time::sleep(pause.min(patience.saturating_sub(waited))).await;
        pause = (pause * 2).min(MAX_PAUSE);
    }
}

/// Lists the keys of the tokens that are present now, at most `most`; `look` is the longest wait for one answer.
pub(crate) async fn tokens(
    session: &Session,
    keys: impl fmt::Display,
    action: &'static str,
    look: Duration,
    most: usize,
) -> Result<Vec<OwnedKeyExpr>> {
    Ok(look_for(session, keys, action, look, most).await?.0)
}

/// Does the same, and returns whether these are all of them: as far as is known nothing was late, and nothing dropped.
pub(crate) async fn look_for(
    session: &Session,
    keys: impl fmt::Display,
    action: &'static str,
    look: Duration,
    most: usize,
) -> Result<(Vec<OwnedKeyExpr>, bool)> {
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
    let (mut found, mut n_failed) = (Vec::new(), 0);
    // The network ends the answers at its own time-out, and says so in one more; ours is for a network that does not.
    let take = async {
        while let Ok(reply) = answers.recv_async().await {
            match reply.into_result() {
                Ok(token) => found.push(OwnedKeyExpr::from(token.key_expr().clone())),
                Err(_) => n_failed += 1,
            }
        }
    };
    // Running out of time leaves what was found.
    let is_over = tokio::time::timeout(2 * look, take).await.is_ok();
    let is_whole = is_over && n_failed == 0 && found.len() < most;
    Ok((found, is_whole))
}
