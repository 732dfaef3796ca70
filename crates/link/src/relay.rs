//! A region's relay: it pulls each version of the weights once, for all actors of its region.
//!
//! ```text
//!             ┌── relay eu ◀── region/eu/weights/{domain}/latest ── actors of eu
//! learner ◀───┤   one pull for each version
//!             └── relay us ◀── region/us/weights/{domain}/latest ── actors of us
//! ```
//!
//! It keeps weights by their digest, which a pull names and which its answer must have, so it needs to know no run and
//! to trust nobody. A region has a key of its own because the network does not choose the nearest of several that
//! answer at one key. What a relay cannot get, an actor asks of the learner itself.

use std::collections::BTreeMap;

use bytes::Bytes;
use leadtime_proto::header::Schema;
use leadtime_proto::{DomainName, Header, Incarnation, PolicyVersion, RegionName, RunName, hex};
use tokio::task::{JoinHandle, JoinSet};
use tracing::debug;
use zenoh::query::{Query, Queryable};
use zenoh::session::Session;

use crate::Result;
use crate::answer::{Answers, PendingReply, unload};
use crate::ask;
use crate::keys::{self, Key, Keys, SHA256, VERSION};
use crate::pubsub::take_questions;

/// Threads that answer: this many slow connections do not hold up the others.
const N_ANSWERING: usize = 4;
/// Most questions that wait to be looked at, and most that wait for weights; beyond it the learner is asked itself.
const MAX_QUESTIONS: usize = 2_048;
/// Most versions that are pulled at once.
const MAX_PULLS: usize = 16;
/// The most bytes that are kept; the least recently used weights are dropped first.
const MAX_BYTES: usize = 256 << 20;

type Digest = [u8; 32];
/// The result of a pull: what was asked for, and the weights.
type Pulled = (Asked, Result<Vec<u8>>);

/// What a relay did since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RelayCounts {
    /// Versions that were pulled from a learner.
    pub pulled: u64,
    /// Questions that were answered with weights.
    pub answered: u64,
    /// Questions that could not be: the weights are not there, or too many ask at once.
    pub refused: u64,
}

/// A relay at work; it ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Relay {
    counts: tokio::sync::watch::Receiver<RelayCounts>,
    work: JoinHandle<()>,
    _questions: Queryable<()>,
}

impl Relay {
    pub(crate) fn start(session: &Session, region: &RegionName) -> Result<Self> {
        let (sender, questions) = flume::bounded(MAX_QUESTIONS);
        let answers = Answers::start(N_ANSWERING)?;
        let answerer = answers.clone();
        let declared = take_questions(session, Keys::PullsIn(region), move |mut query| {
            unload(&mut query);
            if let Err(full) = sender.try_send(query) {
                let busy = "too many questions wait here".to_owned();
                answerer.give(PendingReply::Refusal(full.into_inner(), busy));
            }
        })?;
        let (told, counts) = tokio::sync::watch::channel(RelayCounts::default());
        let desk = Desk {
            session: session.clone(),
            answers,
            shelf: RelayCache::new(MAX_BYTES),
            waiting: BTreeMap::new(),
            n_waiting: 0,
            pulls: JoinSet::new(),
            counts: told,
        };
        let work = tokio::spawn(desk.work(questions));
        Ok(Self { counts, work, _questions: declared })
    }

    pub(crate) fn counts(&self) -> RelayCounts {
        *self.counts.borrow()
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.work.abort();
    }
}

/// Takes questions and pulls what is missing; no question waits longer than a pull may take.
struct Desk {
    session: Session,
    answers: Answers,
    shelf: RelayCache,
    /// Who waits for weights that are on their way.
    waiting: BTreeMap<Asked, Vec<Query>>,
    n_waiting: usize,
    pulls: JoinSet<Pulled>,
    counts: tokio::sync::watch::Sender<RelayCounts>,
}

impl Desk {
    async fn work(mut self, questions: flume::Receiver<Query>) {
        loop {
            tokio::select! {
                question = questions.recv_async() => match question {
                    Ok(question) => self.take(question),
                    Err(flume::RecvError::Disconnected) => return,
                },
                Some(pulled) = self.pulls.join_next() => match pulled {
                    Ok(pulled) => self.deliver(pulled),
                    Err(error) => self.give_up(&error.to_string()),
                },
            }
        }
    }

    fn take(&mut self, query: Query) {
        let Some(asked) = Asked::read(&query) else {
            return self
                .refuse(query, "a pull has to say which version and digest it wants".to_owned());
        };
        if let Some((header, weights)) = self.shelf.take(&asked.sha256) {
            // Another run, or a fork, may have the same weights under another number.
            return self.answer(query, Header { version: asked.version, ..header }, weights);
        }
        if self.n_waiting >= MAX_QUESTIONS {
            return self.refuse(query, "too many questions wait here".to_owned());
        }
        if let Some(others) = self.waiting.get_mut(&asked) {
            others.push(query);
        } else if self.pulls.len() >= MAX_PULLS {
            return self.refuse(query, "too many versions are pulled at once".to_owned());
        } else {
            self.pulls.spawn(pull(self.session.clone(), asked.clone()));
            self.waiting.insert(asked, vec![query]);
        }
        self.n_waiting += 1;
    }

    fn deliver(&mut self, (asked, pulled): Pulled) {
        let waiting = self.waiting.remove(&asked).unwrap_or_default();
        self.n_waiting -= waiting.len();
        match pulled {
            Ok(weights) => {
                self.counts.send_modify(|counts| counts.pulled += 1);
                let header = Header::plain(Schema::Weights, Incarnation(0), &weights);
                let weights = Bytes::from(weights);
                self.shelf.put(asked.sha256, header, weights.clone());
                for query in waiting {
                    self.answer(
                        query,
                        Header { version: asked.version, ..header },
                        weights.clone(),
                    );
                }
            }
            Err(error) => {
                debug!(%error, "weights could not be pulled for a region");
                for query in waiting {
                    self.refuse(query, error.to_string());
                }
            }
        }
    }

    /// Refuses every question that waits, because a task that panicked does not say which pull it was.
    fn give_up(&mut self, reason: &str) {
        debug!(reason, "a pull of weights broke off");
        self.n_waiting = 0;
        for query in std::mem::take(&mut self.waiting).into_values().flatten() {
            self.refuse(query, reason.to_owned());
        }
    }

    fn answer(&self, query: Query, header: Header, weights: Bytes) {
        self.counts.send_modify(|counts| counts.answered += 1);
        self.answers.give(PendingReply::Message(query, header, weights.into()));
    }

    fn refuse(&self, query: Query, reason: String) {
        self.counts.send_modify(|counts| counts.refused += 1);
        self.answers.give(PendingReply::Refusal(query, reason));
    }
}

async fn pull(session: Session, asked: Asked) -> Pulled {
    let key = Key::Weights(&asked.run, &asked.domain);
    let pulled = ask::pull(&session, key, asked.version, asked.sha256, ask::PULL_TIMEOUT).await;
    (asked, pulled)
}

/// What a question at a relay's key asks for.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Asked {
    run: RunName,
    domain: DomainName,
    version: PolicyVersion,
    sha256: Digest,
}

impl Asked {
    fn read(query: &Query) -> Option<Self> {
        let (run, domain) = keys::parse_relayed(query.key_expr())?;
        let parameters = query.parameters();
        let version = PolicyVersion(parameters.get(VERSION)?.parse().ok()?);
        Some(Self { run, domain, version, sha256: hex::decode(parameters.get(SHA256)?)? })
    }
}

/// The weights that are kept, as many as fit.
#[derive(Debug)]
struct RelayCache {
    limit: usize,
    n_bytes: usize,
    /// Counts puts and takes: the entry with the lowest count was used least recently.
    clock: u64,
    kept: BTreeMap<Digest, (Header, Bytes, u64)>,
}

impl RelayCache {
    fn new(limit: usize) -> Self {
        Self { limit, n_bytes: 0, clock: 0, kept: BTreeMap::new() }
    }

    fn take(&mut self, sha256: &Digest) -> Option<(Header, Bytes)> {
        self.clock += 1;
        let (header, weights, used) = self.kept.get_mut(sha256)?;
        *used = self.clock;
        Some((*header, weights.clone()))
    }

    fn put(&mut self, sha256: Digest, header: Header, weights: Bytes) {
        self.clock += 1;
        self.n_bytes += weights.len();
        if let Some((_, before, _)) = self.kept.insert(sha256, (header, weights, self.clock)) {
            self.n_bytes -= before.len();
        }
        while self.n_bytes > self.limit {
            let oldest = self.kept.iter().min_by_key(|(_, (_, _, used))| *used);
            let Some(oldest) = oldest.map(|(&sha256, _)| sha256) else { return };
            if let Some((_, weights, _)) = self.kept.remove(&oldest) {
                self.n_bytes -= weights.len();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_unasked_for_longest_make_room() {
        let mut shelf = RelayCache::new(100);
        let put = |shelf: &mut RelayCache, name: u8, n_bytes: usize| {
            let weights = Bytes::from(vec![name; n_bytes]);
            let header = Header::plain(Schema::Weights, Incarnation(0), &weights);
            shelf.put([name; 32], header, weights);
        };
        for name in [1, 2, 3] {
            put(&mut shelf, name, 30);
        }
        assert!(shelf.take(&[1; 32]).is_some());
        put(&mut shelf, 4, 30);
        put(&mut shelf, 4, 30);
        assert!(shelf.take(&[2; 32]).is_none(), "nobody asked for it since it came");
        assert!([1, 3, 4].iter().all(|&name| shelf.take(&[name; 32]).is_some()));
        assert_eq!(shelf.n_bytes, 90);
        put(&mut shelf, 5, 101);
        assert!(shelf.kept.is_empty() && shelf.n_bytes == 0, "larger than the shelf");
    }
}
