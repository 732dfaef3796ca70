//! Pulling a version of the weights, and believing only the one that the learner announced.

use leadtime_proto::header::Schema;
use leadtime_proto::receive::{self, WEIGHTS};
use leadtime_proto::{DomainName, Header, Incarnation, PolicyVersion, RunName};
use sha2::{Digest as _, Sha256};
use zenoh::sample::Sample;
use zenoh::session::Session;

use crate::ask::{Inquiry, InquiryEnd, PULL_TIMEOUT, ask};
use crate::keys::{self, Key};
use crate::{Error, Result, wire};

/// Pulls a version and returns its bytes.
///
/// Anyone in the network can answer, so every answer is looked at until one has the digest: a faster answer with
/// something else in it keeps nobody from the learner's.
pub(crate) async fn pull(
    session: &Session,
    run: &RunName,
    domain: &DomainName,
    incarnation: Incarnation,
    version: PolicyVersion,
    sha256: [u8; 32],
) -> Result<Vec<u8>> {
    let key = Key::Weights(run, domain).to_string();
    let question = Inquiry {
        selector: format!("{key}?{}={version}", keys::VERSION),
        header: Header::plain(Schema::Weights, incarnation, &[]),
        payload: Vec::new(),
        qos: wire::BULK,
        timeout: PULL_TIMEOUT,
    };
    match ask(session, question, |sample| read(sample, &key, version, sha256)).await? {
        InquiryEnd::Good(bytes) => Ok(bytes),
        InquiryEnd::Unusable(error) => Err(error),
        InquiryEnd::Rejected(reason) => Err(Error::NotKept { version, reason }),
        InquiryEnd::Nobody | InquiryEnd::TimedOut => {
            Err(Error::NoAnswer { key, timeout: PULL_TIMEOUT })
        }
    }
}

fn read(sample: &Sample, key: &str, version: PolicyVersion, sha256: [u8; 32]) -> Result<Vec<u8>> {
    let bad = |source| Error::BadAnswer { key: key.to_owned(), source };
    let header =
        wire::inspect(sample.attachment(), Some(sample.payload()), WEIGHTS).map_err(bad)?;
    let bytes = sample.payload().to_bytes();
    receive::verify(&header, &bytes).map_err(bad)?;
    if header.version != version || <[u8; 32]>::from(Sha256::digest(&bytes)) != sha256 {
        return Err(Error::ForeignWeights { version });
    }
    Ok(bytes.into_owned())
}
