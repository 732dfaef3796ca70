//! The weights that a learner offers: which versions are kept, and what is announced of them.
//!
//! A small announcement goes to everyone for every version and once a second; the weights themselves are pulled by
//! any process that wants them, at its own pace, late joiners included.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use leadtime_proto::header::Schema;
use leadtime_proto::limits::MAX_LAG;
use leadtime_proto::message::Announcement;
use leadtime_proto::receive::ANNOUNCEMENT;
use leadtime_proto::{Header, PolicyVersion, Refusal, Sequence};
use sha2::{Digest as _, Sha256};
use zenoh::Wait as _;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::sample::Sample;

use crate::lock::lock;
use crate::proof::{self, StartKey};
use crate::{Error, Result, wire};

/// Pause between repetitions of the newest announcement.
pub(crate) const REPEAT: Duration = Duration::from_secs(1);
/// Most versions that are kept, whatever the learner retires: the newest, and all that the longest lag acts with.
const MAX_KEPT: usize = MAX_LAG as usize + 1;
/// Retired versions that are kept: an actor that has just received the announcement of one may still pull it.
const GRACE: usize = 4;

#[derive(Clone, Debug)]
struct Kept {
    weights: Arc<[u8]>,
    payload: ZBytes,
    header: Header,
    sha256: [u8; 32],
}

/// The versions that can be pulled: the only place where a learner keeps them.
#[derive(Debug)]
pub(crate) struct WeightStore {
    learner: StartKey,
    versions: Mutex<BTreeMap<PolicyVersion, Kept>>,
}

impl WeightStore {
    pub(crate) fn new(learner: StartKey) -> Self {
        Self { learner, versions: Mutex::default() }
    }

    /// Keeps a version; the bytes are shared, not copied.
    pub(crate) fn put(&self, version: PolicyVersion, weights: Arc<[u8]>) {
        let header = Header {
            version,
            ..Header::plain(Schema::Weights, self.learner.incarnation(), &weights)
        };
        let sha256 = Sha256::digest(&weights).into();
        let payload = ZBytes::from(Bytes::from_owner(Arc::clone(&weights)));
        let mut versions = lock(&self.versions);
        versions.insert(version, Kept { weights, payload, header, sha256 });
        while versions.len() > MAX_KEPT {
            versions.pop_first();
        }
    }

    /// Drops versions older than `oldest_kept`, except the last few of them.
    pub(crate) fn retire(&self, oldest_kept: PolicyVersion) {
        let mut versions = lock(&self.versions);
        while versions.len() > GRACE
            && versions.first_key_value().is_some_and(|(&oldest, _)| oldest < oldest_kept)
        {
            versions.pop_first();
        }
    }

    /// Lists the kept versions from `oldest` on.
    pub(crate) fn since(&self, oldest: PolicyVersion) -> Vec<(PolicyVersion, Arc<[u8]>)> {
        let versions = lock(&self.versions);
        versions.range(oldest..).map(|(&v, kept)| (v, Arc::clone(&kept.weights))).collect()
    }

    /// Says which versions there are, and how to know them.
    pub(crate) fn announcement(&self) -> Announcement {
        let versions = lock(&self.versions);
        let versions = versions.iter().map(|(&version, kept)| (version, kept.sha256)).collect();
        Announcement { learner: self.learner.incarnation(), versions }
    }

    /// Finds what a pull asks for, or says why it is not there.
    pub(crate) fn find(&self, wanted: Option<&str>) -> Result<(Header, ZBytes), String> {
        let versions = lock(&self.versions);
        let version = wanted.and_then(|wanted| wanted.parse().ok()).map(PolicyVersion);
        if let Some(kept) = version.and_then(|version| versions.get(&version)) {
            return Ok((kept.header, kept.payload.clone()));
        }
        let (Some((oldest, _)), Some((newest, _))) =
            (versions.first_key_value(), versions.last_key_value())
        else {
            return Err("no weights are offered yet".to_owned());
        };
        let wanted: String = wanted.unwrap_or("none").chars().take(20).collect();
        Err(format!("version {wanted} is not kept: versions {oldest} to {newest} are"))
    }
}

/// Tells everyone which versions there are.
pub(crate) fn announce(publisher: &Publisher<'_>, store: &WeightStore) -> Result<()> {
    let (schema, news) = (Schema::Announcement, store.announcement());
    let (header, payload) = wire::sign(schema, &store.learner, Sequence(0), &news)?;
    publisher
        .put(payload)
        .attachment(header.to_bytes())
        .wait()
        .map_err(Error::network("announce weights on", publisher.key_expr()))
}

/// Reads an announcement, which the learner that it names has to have signed.
pub(crate) fn read_announcement(sample: &Sample) -> Result<Announcement, Refusal> {
    let (attachment, payload) = (sample.attachment(), Some(sample.payload()));
    let (start, news) = wire::unseal_signed::<Announcement>(attachment, payload, ANNOUNCEMENT)?;
    if news.learner == start { Ok(news) } else { Err(proof::refused()) }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{Schedule, codec, limits};

    use super::*;

    fn filled(versions: std::ops::Range<u64>) -> WeightStore {
        let store = WeightStore::new(StartKey::numbered(1));
        versions.for_each(|v| store.put(PolicyVersion(v), Arc::from([v as u8])));
        store
    }

    fn version(store: &WeightStore, wanted: &str) -> Result<u64, String> {
        store.find(Some(wanted)).map(|(header, _)| header.version.0)
    }

    #[test]
    fn a_version_is_there_until_it_is_retired_and_a_few_others_came() {
        let none = filled(0..0);
        assert_eq!(version(&none, "1").unwrap_err(), "no weights are offered yet");
        let store = filled(3..9);
        assert_eq!((version(&store, "3"), version(&store, "8")), (Ok(3), Ok(8)));
        store.retire(PolicyVersion(8));
        let gone = version(&store, "3").unwrap_err();
        assert_eq!(gone, "version 3 is not kept: versions 5 to 8 are");
        assert_eq!(version(&store, "5"), Ok(5), "who was just told of it may still pull it");
        assert!(version(&store, "x").is_err());
        let told = store.announcement();
        assert_eq!((told.newest(), told.versions.len()), (PolicyVersion(8), GRACE));
        assert_eq!(store.since(PolicyVersion(7)).len(), 2);
    }

    #[test]
    fn everything_that_the_longest_lag_acts_with_is_kept_and_can_be_announced() {
        let newest = PolicyVersion(MAX_LAG + 6);
        let oldest = Schedule::Lag(MAX_LAG).oldest_needed(newest);
        let store = filled(0..newest.0 + 1);
        store.retire(oldest);
        for version in oldest.0..=newest.0 {
            assert!(store.find(Some(&version.to_string())).is_ok(), "{version}");
        }
        assert_eq!(store.announcement().versions.len(), MAX_KEPT);
        let told = codec::encode(&store.announcement()).unwrap();
        assert!(told.len() <= limits::MAX_NOTICE_BYTES, "{}", told.len());
    }
}
