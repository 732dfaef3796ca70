//! Offering weights: the versions that are kept, who is told of them, and who gets them.
//!
//! A small announcement goes to everyone for every version and once a second; the weights themselves are pulled by
//! whoever wants them, at its own pace, late joiners included. Pulls are answered by a few threads of their own: an
//! answer waits for a slow connection, and a callback must not.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use leadtime_proto::header::{HEADER_BYTES, Schema};
use leadtime_proto::limits::MAX_LAG;
use leadtime_proto::message::Announcement;
use leadtime_proto::receive::{self, WEIGHTS};
use leadtime_proto::{Header, Incarnation, PolicyVersion, Refusal};
use sha2::{Digest as _, Sha256};
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Publisher;
use zenoh::query::Query;
use zenoh::sample::Sample;

use crate::intake::lock;
use crate::{Error, Result, wire};

/// The parameter of a pull that asks for one version.
pub(crate) const VERSION: &str = "version";
/// Pause between repetitions of the newest announcement.
pub(crate) const REPEAT: Duration = Duration::from_secs(1);
/// Most versions that are kept, whatever the learner retires: the newest, and all that the longest lag acts with.
const MAX_KEPT: usize = MAX_LAG as usize + 1;
/// Threads that answer pulls: this many slow connections do not hold up the others.
const N_THREADS: usize = 4;
/// Most answers that are owed at once; an asker beyond it tries again.
const MAX_OWED: usize = 1_024;
/// A pull's answer carries the header and the digest.
const ATTACHMENT_BYTES: usize = HEADER_BYTES + 32;

#[derive(Clone, Debug)]
struct Shelved {
    payload: ZBytes,
    attachment: [u8; ATTACHMENT_BYTES],
    announcement: Announcement,
}

/// The versions that can be pulled.
#[derive(Debug)]
pub(crate) struct Shelf {
    learner: Incarnation,
    versions: Mutex<BTreeMap<PolicyVersion, Shelved>>,
}

impl Shelf {
    pub(crate) fn new(learner: Incarnation) -> Self {
        Self { learner, versions: Mutex::default() }
    }

    /// Puts a version on the shelf and returns what to tell of it.
    pub(crate) fn put(&self, version: PolicyVersion, bytes: &[u8]) -> Announcement {
        let sha256: [u8; 32] = Sha256::digest(bytes).into();
        let header = Header { version, ..Header::plain(Schema::Weights, self.learner, bytes) };
        let mut attachment = [0; ATTACHMENT_BYTES];
        attachment[..HEADER_BYTES].copy_from_slice(&header.to_bytes());
        attachment[HEADER_BYTES..].copy_from_slice(&sha256);
        let size = bytes.len() as u64;
        let announcement = Announcement { learner: self.learner, version, size, sha256 };
        let shelved = Shelved { payload: ZBytes::from(bytes.to_vec()), attachment, announcement };
        let mut versions = lock(&self.versions);
        versions.insert(version, shelved);
        while versions.len() > MAX_KEPT {
            versions.pop_first();
        }
        announcement
    }

    /// Takes versions older than `oldest_kept` off the shelf.
    pub(crate) fn retire(&self, oldest_kept: PolicyVersion) {
        lock(&self.versions).retain(|&version, _| version >= oldest_kept);
    }

    fn newest(&self) -> Option<Announcement> {
        lock(&self.versions).last_key_value().map(|(_, shelved)| shelved.announcement)
    }

    /// Finds what a pull asks for, or says why it is not there.
    fn find(&self, wanted: Option<&str>) -> Result<Shelved, String> {
        let versions = lock(&self.versions);
        let (Some((oldest, _)), Some((newest, last))) =
            (versions.first_key_value(), versions.last_key_value())
        else {
            return Err("no weights are offered yet".to_owned());
        };
        let Some(wanted) = wanted else { return Ok(last.clone()) };
        let version = wanted.parse().ok().map(PolicyVersion);
        version.and_then(|version| versions.get(&version)).cloned().ok_or_else(|| {
            let wanted: String = wanted.chars().take(20).collect();
            format!("version {wanted} is not kept: versions {oldest} to {newest} are")
        })
    }

    fn serve(&self, query: &Query) {
        let found = self.find(query.parameters().get(VERSION));
        let sent = match found {
            Ok(shelved) => query
                .reply(query.key_expr().clone(), shelved.payload)
                .attachment(shelved.attachment)
                .encoding(Encoding::APPLICATION_OCTET_STREAM)
                .wait(),
            Err(reason) => query.reply_err(reason).encoding(Encoding::TEXT_PLAIN).wait(),
        };
        if let Err(error) = sent {
            tracing::debug!(%error, "a pull of weights could not be answered");
        }
    }
}

/// Reads the answer to a pull: all checks of a message, and the digest.
pub(crate) fn read(sample: &Sample) -> Result<Announced, Refusal> {
    let attachment = sample.attachment().map(ZBytes::to_bytes).unwrap_or_default();
    let header = attachment.get(..HEADER_BYTES);
    let header = receive::inspect(header, sample.payload().len(), WEIGHTS)?;
    let digest = attachment.get(HEADER_BYTES..).and_then(|rest| <[u8; 32]>::try_from(rest).ok());
    let digest = digest.ok_or(Refusal::Header { found: attachment.len() })?;
    let bytes = sample.payload().to_bytes().into_owned();
    receive::verify(&header, &bytes)?;
    Ok(Announced { header, digest, bytes })
}

/// Weights beside the digest that they are said to have.
#[derive(Debug)]
pub(crate) struct Announced {
    pub(crate) header: Header,
    pub(crate) digest: [u8; 32],
    bytes: Vec<u8>,
}

impl Announced {
    /// Returns version and bytes if the digest is right.
    pub(crate) fn checked(self) -> Result<(PolicyVersion, Vec<u8>)> {
        let version = self.header.version;
        if <[u8; 32]>::from(Sha256::digest(&self.bytes)) == self.digest {
            Ok((version, self.bytes))
        } else {
            Err(Error::WeightsDamaged { version })
        }
    }
}

/// Tells everyone of a version.
pub(crate) fn announce(publisher: &Publisher<'_>, announcement: &Announcement) -> Result<()> {
    let (header, payload) = wire::seal(Schema::Announcement, announcement.learner, announcement)?;
    publisher
        .put(payload)
        .attachment(header.to_bytes())
        .wait()
        .map_err(Error::network("announce weights on", publisher.key_expr()))
}

/// Repeats the newest announcement for as long as it is polled.
pub(crate) async fn repeat(publisher: Arc<Publisher<'static>>, shelf: Arc<Shelf>) {
    let mut ticks = tokio::time::interval(REPEAT);
    loop {
        ticks.tick().await;
        if let Some(newest) = shelf.newest()
            && let Err(error) = announce(&publisher, &newest)
        {
            tracing::debug!(%error, "announcement could not be repeated");
        }
    }
}

/// An answer that a callback owes.
#[derive(Debug)]
pub(crate) enum Owed {
    /// Weights.
    Weights(Query),
    /// A sentence that says no.
    Refusal(Query, String),
    /// Nothing but the end of the question.
    Nothing(Query),
}

/// Starts the threads that answer for the callbacks; they end when the sender is dropped.
pub(crate) fn start_answering(shelf: &Arc<Shelf>) -> Result<flume::Sender<Owed>> {
    let (sender, receiver) = flume::bounded(MAX_OWED);
    for i in 0..N_THREADS {
        let (shelf, receiver) = (Arc::clone(shelf), receiver.clone());
        let work = move || receiver.iter().for_each(|owed| answer(&shelf, owed));
        let name = format!("link-answer-{i}");
        // Detached: it ends by itself when the queryables are undeclared.
        drop(thread::Builder::new().name(name).spawn(work).map_err(Error::Thread)?);
    }
    Ok(sender)
}

fn answer(shelf: &Shelf, owed: Owed) {
    match owed {
        Owed::Weights(query) => shelf.serve(&query),
        Owed::Refusal(query, reason) => {
            let sent = query.reply_err(reason).encoding(Encoding::TEXT_PLAIN).wait();
            if let Err(error) = sent {
                tracing::debug!(%error, "a refusal could not be sent");
            }
        }
        Owed::Nothing(query) => drop(query),
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::Schedule;

    use super::*;

    #[test]
    fn a_shelf_gives_the_newest_or_the_version_asked_for() {
        let shelf = Shelf::new(Incarnation(1));
        assert_eq!(shelf.find(None).unwrap_err(), "no weights are offered yet");
        for version in 3..6 {
            shelf.put(PolicyVersion(version), &[version as u8]);
        }
        let version = |wanted| shelf.find(wanted).map(|shelved| shelved.announcement.version.0);
        assert_eq!(version(None), Ok(5));
        assert_eq!(version(Some("3")), Ok(3));
        shelf.retire(PolicyVersion(4));
        let gone = "version 3 is not kept: versions 4 to 5 are".to_owned();
        assert_eq!(version(Some("3")), Err(gone));
        assert!(version(Some("x")).is_err());
    }

    #[test]
    fn everything_that_the_longest_lag_acts_with_is_kept() {
        let (shelf, newest) = (Shelf::new(Incarnation(1)), PolicyVersion(MAX_LAG + 6));
        let oldest = Schedule::Lag(MAX_LAG).oldest_needed(newest);
        for version in oldest.0..=newest.0 {
            shelf.put(PolicyVersion(version), &[]);
        }
        shelf.retire(oldest);
        for version in oldest.0..=newest.0 {
            assert!(shelf.find(Some(&version.to_string())).is_ok(), "{version}");
        }
    }

    #[test]
    fn a_learner_that_never_retires_keeps_a_limited_number() {
        let shelf = Shelf::new(Incarnation(1));
        for version in 0..2 * MAX_KEPT as u64 {
            shelf.put(PolicyVersion(version), &[]);
        }
        assert_eq!(lock(&shelf.versions).len(), MAX_KEPT);
        assert!(shelf.find(Some("0")).is_err());
    }
}
