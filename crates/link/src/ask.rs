//! Asking a question and waiting for the first usable answer, for a limited time that covers the sending, too.

use std::time::{Duration, Instant};

use leadtime_proto::{Header, text};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::Sample;
use zenoh::session::Session;

use crate::wire::Qos;
use crate::{Error, Result};

/// Most answers to one question that are looked at.
const MAX_ANSWERS: usize = 64;
/// How long a pull of weights may take.
pub(crate) const PULL_TIMEOUT: Duration = Duration::from_secs(10);
/// How long after our own limit the network may clean up.
const NETWORK_SLACK: Duration = Duration::from_secs(1);

/// A question.
#[derive(Debug)]
pub(crate) struct Inquiry {
    /// Key and parameters.
    pub(crate) selector: String,
    pub(crate) header: Header,
    pub(crate) payload: Vec<u8>,
    pub(crate) qos: Qos,
    pub(crate) timeout: Duration,
}

/// What became of it.
#[derive(Debug)]
pub(crate) enum InquiryEnd<T> {
    /// The first usable answer.
    Good(T),
    /// Only answers that are no use; what is wrong with the last one.
    Unusable(Error),
    /// Only answers that say no; the last one's sentence.
    Rejected(String),
    /// Nobody was there to answer.
    Nobody,
    /// Someone may be there, but time is over.
    TimedOut,
}

/// Asks everyone at the key, and reads answers until one can be used.
pub(crate) async fn ask<T>(
    session: &Session,
    question: Inquiry,
    mut read: impl FnMut(&Sample) -> Result<T>,
) -> Result<InquiryEnd<T>> {
    let deadline = (Instant::now() + question.timeout).into();
    let (sender, answers) = flume::bounded::<Reply>(MAX_ANSWERS);
    let session = session.clone();
    // Sending waits when the connection is congested, and would then hold up a whole worker. A thread that still waits
    // when time is over ends with the connection.
    let sending = tokio::task::spawn_blocking(move || send(&session, question, sender));
    match tokio::time::timeout_at(deadline, sending).await {
        Err(_) => return Ok(InquiryEnd::TimedOut),
        Ok(sent) => sent.map_err(|_panicked| Error::Panicked { action: "ask a question" })??,
    }
    let mut fallback = InquiryEnd::Nobody;
    loop {
        match tokio::time::timeout_at(deadline, answers.recv_async()).await {
            Err(_) if matches!(fallback, InquiryEnd::Nobody) => return Ok(InquiryEnd::TimedOut),
            Err(_) | Ok(Err(flume::RecvError::Disconnected)) => return Ok(fallback),
            Ok(Ok(reply)) => match reply.into_result() {
                Ok(sample) => match read(&sample) {
                    Ok(good) => return Ok(InquiryEnd::Good(good)),
                    // A plain no says more than an answer that is no use, which may be anybody's.
                    Err(_) if matches!(fallback, InquiryEnd::Rejected(_)) => {}
                    Err(error) => fallback = InquiryEnd::Unusable(error),
                },
                Err(error) => {
                    let reason = error.payload().to_bytes();
                    let reason = text::sentence(&String::from_utf8_lossy(&reason));
                    fallback = InquiryEnd::Rejected(reason);
                }
            },
        }
    }
}

fn send(session: &Session, question: Inquiry, sender: flume::Sender<Reply>) -> Result<()> {
    let Inquiry { selector, header, payload, qos, timeout } = question;
    session
        .get(&selector)
        .payload(payload)
        .attachment(header.to_bytes())
        .encoding(Encoding::APPLICATION_OCTET_STREAM)
        .priority(qos.priority)
        .congestion_control(qos.congestion)
        .express(qos.express)
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
