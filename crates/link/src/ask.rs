//! Asking a question and waiting for the first usable answer, for a limited time that covers the sending, too.

use std::fmt;
use std::time::{Duration, Instant};

use leadtime_proto::header::Schema;
use leadtime_proto::receive::{self, Expected, WEIGHTS};
use leadtime_proto::{Header, Incarnation, PolicyVersion, Refusal, RunName, hex, text};
use sha2::{Digest as _, Sha256};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::{Locality, Sample};
use zenoh::session::Session;

use crate::keys::{self, Key, Keys, SHA256, VERSION};
use crate::wire::{self, Qos};
use crate::{Error, Result};

/// Most answers to one question that are looked at.
const MAX_ANSWERS: usize = 64;
/// How long a pull of weights may take.
pub(crate) const PULL_TIMEOUT: Duration = Duration::from_secs(10);
/// How often the way to a learner and back is measured; the first time finds caches cold.
const N_PROBES: usize = 5;
/// How long one of them may take.
const PROBE_TIMEOUT: Duration = Duration::from_secs(5);
/// How long after our own limit the network may clean up.
const NETWORK_SLACK: Duration = Duration::from_secs(1);

/// A question with everything that is needed to send it.
#[derive(Debug)]
pub(crate) struct Inquiry {
    pub(crate) key: String,
    pub(crate) parameters: String,
    pub(crate) header: Header,
    pub(crate) payload: Vec<u8>,
    pub(crate) qos: Qos,
    pub(crate) timeout: Duration,
}

impl Inquiry {
    /// Makes one without a payload.
    fn without_payload(
        key: &str,
        parameters: String,
        schema: Schema,
        qos: Qos,
        timeout: Duration,
    ) -> Self {
        let header = Header::plain(schema, Incarnation(0), &[]);
        Self { key: key.to_owned(), parameters, header, payload: Vec::new(), qos, timeout }
    }
}

/// What became of it.
#[derive(Debug)]
pub(crate) enum InquiryEnd<T> {
    /// The first usable answer.
    Good(T),
    /// Only answers that say no; the last one's sentence.
    Rejected(String),
    /// Nobody was there to answer.
    Nobody,
    /// Someone may be there, but time is over.
    TimedOut,
}

/// Asks everyone at the key for a message, and returns the first that can be read and is the best there can be; else the
/// first that can be read, once nobody is left who might answer, or time is over.
pub(crate) async fn ask_for<T>(
    session: &Session,
    question: Inquiry,
    read: impl Fn(&Sample) -> Result<T, Refusal>,
    is_best: impl Fn(&T) -> bool,
) -> Result<InquiryEnd<T>> {
    let key = question.key.clone();
    let read = |sample: &Sample| {
        read(sample).map_err(|source| Error::BadAnswer { key: key.clone(), source })
    };
    ask(session, question, read, is_best).await
}

/// Pulls a version of the weights from a learner or a relay, and returns its bytes.
///
/// Anyone in the network can answer, so every answer is looked at until one has the digest that the learner announced: a
/// faster wrong answer does not hide the learner's.
pub(crate) async fn pull(
    session: &Session,
    at: Key<'_>,
    version: PolicyVersion,
    sha256: [u8; 32],
    timeout: Duration,
) -> Result<Vec<u8>> {
    let key = at.to_string();
    let parameters = format!("{VERSION}={version};{SHA256}={}", hex::encode(&sha256));
    let question = Inquiry::without_payload(&key, parameters, Schema::Weights, wire::BULK, timeout);
    let read = |sample: &Sample| {
        let (header, bytes) = read_whole(sample, &key, WEIGHTS)?;
        if header.version != version || <[u8; 32]>::from(Sha256::digest(&bytes)) != sha256 {
            return Err(Error::ForeignWeights(version));
        }
        Ok(bytes)
    };
    match ask(session, question, read, |_| true).await? {
        InquiryEnd::Good(bytes) => Ok(bytes),
        InquiryEnd::Rejected(reason) => Err(Error::NotKept { version, reason }),
        InquiryEnd::Nobody | InquiryEnd::TimedOut => Err(Error::NoAnswer { key, timeout }),
    }
}

/// Asks a run's learner for bytes that are not in the codec's encoding, and returns the first that arrive whole.
pub(crate) async fn ask_bytes(
    session: &Session,
    key: Key<'_>,
    parameters: String,
    expected: Expected,
    timeout: Duration,
) -> Result<(Incarnation, Vec<u8>)> {
    let key = key.to_string();
    let question =
        Inquiry::without_payload(&key, parameters, expected.schema, wire::ARCHIVE, timeout);
    let read = |sample: &Sample| {
        read_whole(sample, &key, expected).map(|(header, bytes)| (header.incarnation, bytes))
    };
    match ask(session, question, read, |_| true).await? {
        InquiryEnd::Good(answer) => Ok(answer),
        InquiryEnd::Rejected(reason) => Err(Error::Rejected { key, reason }),
        InquiryEnd::Nobody | InquiryEnd::TimedOut => Err(Error::NoAnswer { key, timeout }),
    }
}

/// Checks an answer's header and its bytes, which are not decoded.
fn read_whole(sample: &Sample, key: &str, expected: Expected) -> Result<(Header, Vec<u8>)> {
    let bad = |source| Error::BadAnswer { key: key.to_owned(), source };
    let header =
        wire::inspect(sample.attachment(), Some(sample.payload()), expected).map_err(bad)?;
    let bytes = sample.payload().to_bytes();
    receive::verify(&header, &bytes).map_err(bad)?;
    Ok((header, bytes.into_owned()))
}

/// Measures the round-trip time to a run's learner: the shortest of a few short questions.
pub(crate) async fn round_trip(session: &Session, run: &RunName) -> Result<Duration> {
    let mut shortest = Duration::MAX;
    for _ in 0..N_PROBES {
        let asked = Instant::now();
        if !is_answered(session, Keys::PullsOf(run), PROBE_TIMEOUT).await? {
            let key = Keys::PullsOf(run).to_string();
            return Err(Error::NoAnswer { key, timeout: PROBE_TIMEOUT });
        }
        shortest = shortest.min(asked.elapsed());
    }
    Ok(shortest)
}

/// Returns whether somebody else answers an empty question at a key within this time.
///
/// A learner that is asked for weights without being told which, at [`Keys::PullsOf`], answers with a sentence, and so does a notifier
/// that is asked at [`LiveKey::Life`](crate::live::LiveKey::Life).
pub(crate) async fn is_answered(
    session: &Session,
    key: impl fmt::Display,
    timeout: Duration,
) -> Result<bool> {
    let (key, schema, qos) = (key.to_string(), Schema::Weights, wire::CONTROL);
    let question = Inquiry::without_payload(&key, String::new(), schema, qos, timeout);
    let end = ask(session, question, |_| Ok(()), |()| true).await?;
    Ok(matches!(end, InquiryEnd::Good(()) | InquiryEnd::Rejected(_)))
}

/// Asks everyone at the key, and reads answers until one is the best there can be. Else the first that can be used counts, and
/// without any what is wrong with the last one.
async fn ask<T>(
    session: &Session,
    question: Inquiry,
    mut read: impl FnMut(&Sample) -> Result<T>,
    is_best: impl Fn(&T) -> bool,
) -> Result<InquiryEnd<T>> {
    let deadline = (Instant::now() + question.timeout).into();
    let (sender, answers) = flume::bounded::<Reply>(MAX_ANSWERS);
    let session = session.clone();
    // Sending waits when the connection is congested, and would then hold up a whole worker. A thread that still waits
    // when time is over ends with the connection.
    let sending = tokio::task::spawn_blocking(move || send(&session, question, sender));
    match tokio::time::timeout_at(deadline, sending).await {
        Err(_) => return Ok(InquiryEnd::TimedOut),
        Ok(sent) => sent.map_err(|_panicked| Error::Panicked("ask a question"))??,
    }
    let mut fallback = Ok(InquiryEnd::Nobody);
    loop {
        match tokio::time::timeout_at(deadline, answers.recv_async()).await {
            Err(_) if matches!(fallback, Ok(InquiryEnd::Nobody)) => {
                return Ok(InquiryEnd::TimedOut);
            }
            Err(_) | Ok(Err(flume::RecvError::Disconnected)) => return fallback,
            Ok(Ok(reply)) => match reply.into_result() {
                Ok(sample) => match read(&sample) {
                    Ok(good) if is_best(&good) => return Ok(InquiryEnd::Good(good)),
                    _ if matches!(fallback, Ok(InquiryEnd::Good(_))) => {}
                    Ok(good) => fallback = Ok(InquiryEnd::Good(good)),
                    // A plain no says more than an answer that is no use, which may be anybody's.
                    Err(_) if matches!(fallback, Ok(InquiryEnd::Rejected(_))) => {}
                    Err(error) => fallback = Err(error),
                },
                Err(_) if matches!(fallback, Ok(InquiryEnd::Good(_))) => {}
                Err(error) => {
                    let reason = error.payload().to_bytes();
                    let reason = text::sentence(&String::from_utf8_lossy(&reason));
                    fallback = Ok(InquiryEnd::Rejected(reason));
                }
            },
        }
    }
}

fn send(session: &Session, question: Inquiry, sender: flume::Sender<Reply>) -> Result<()> {
    let Inquiry { key, parameters, header, payload, qos, timeout } = question;
    session
        .get((keys::expr(&key), parameters))
        .payload(payload)
        .attachment(header.to_bytes())
        .encoding(Encoding::APPLICATION_OCTET_STREAM)
        .priority(qos.priority)
        .congestion_control(qos.congestion)
        .express(qos.express)
        .target(QueryTarget::All)
        // Nobody asks themselves.
        .allowed_destination(Locality::Remote)
        .consolidation(ConsolidationMode::None)
        .timeout(timeout + NETWORK_SLACK)
        .callback(move |reply| {
            // Answers beyond the limit are dropped.
            drop(sender.try_send(reply));
        })
        .wait()
        .map_err(Error::network("ask", &key))
}
