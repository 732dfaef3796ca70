//! Asking a question and waiting for the first good answer, for a limited time.

use std::time::{Duration, Instant};

use leadtime_proto::Header;
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::Sample;
use zenoh::session::Session;

use crate::wire::Lane;
use crate::{Error, Result};

/// Most answers to one question that are looked at.
const MAX_ANSWERS: usize = 64;
/// Longest sentence that is taken from a peer.
const MAX_REASON_CHARS: usize = 1_000;
/// How long after our own limit the network may clean up.
const NETWORK_SLACK: Duration = Duration::from_secs(1);

/// A question.
#[derive(Debug)]
pub(crate) struct Question {
    /// Key and parameters.
    pub(crate) selector: String,
    pub(crate) header: Header,
    pub(crate) payload: Vec<u8>,
    pub(crate) lane: Lane,
    pub(crate) timeout: Duration,
}

/// What became of it.
#[derive(Debug)]
pub(crate) enum Answer {
    /// The first good answer.
    Reply(Box<Sample>),
    /// Only answers that say no; the last one's sentence.
    Rejected(String),
    /// Nobody was there to answer.
    Nobody,
    /// Someone may be there, but time is over.
    TimedOut,
}

/// Asks everyone at the key.
pub(crate) async fn ask(session: &Session, question: Question) -> Result<Answer> {
    let deadline = Instant::now() + question.timeout;
    let (sender, answers) = flume::bounded::<Reply>(MAX_ANSWERS);
    let session = session.clone();
    // Sending waits when the connection is congested, and would then hold up a whole worker.
    let sent = tokio::task::spawn_blocking(move || send(&session, question, sender)).await;
    sent.expect("sending a question does not panic")?;
    let mut rejected = None;
    loop {
        match tokio::time::timeout_at(deadline.into(), answers.recv_async()).await {
            Err(_) => return Ok(Answer::TimedOut),
            Ok(Err(flume::RecvError::Disconnected)) => break,
            Ok(Ok(reply)) => match reply.into_result() {
                Ok(sample) => return Ok(Answer::Reply(Box::new(sample))),
                Err(error) => rejected = Some(error.payload().to_bytes().into_owned()),
            },
        }
    }
    Ok(rejected.map_or(Answer::Nobody, |bytes| {
        Answer::Rejected(String::from_utf8_lossy(&bytes).chars().take(MAX_REASON_CHARS).collect())
    }))
}

fn send(session: &Session, question: Question, sender: flume::Sender<Reply>) -> Result<()> {
    let Question { selector, header, payload, lane, timeout } = question;
    session
        .get(&selector)
        .payload(payload)
        .attachment(header.to_bytes())
        .encoding(Encoding::APPLICATION_OCTET_STREAM)
        .priority(lane.priority)
        .congestion_control(lane.congestion)
        .express(lane.express)
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        .timeout(timeout + NETWORK_SLACK)
        .callback(move |reply| {
            // More answers than anyone looks at are let go.
            drop(sender.try_send(reply));
        })
        .wait()
        .map_err(Error::network("ask", &selector))
}
