//! Which connections owe the head of a request, so that one of them can make room.
//!
//! Anybody can open connections and send nothing. When all places are taken, the one that has owed a head for the longest time is
//! closed, and not the one that comes.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

/// The connections that owe a head, the one that has owed it for the longest time first.
#[derive(Debug, Default)]
pub(crate) struct OwedHeads {
    owed: Mutex<VecDeque<Arc<CancellationToken>>>,
    /// One more owes a head.
    news: Notify,
}

impl OwedHeads {
    fn lock(&self) -> MutexGuard<'_, VecDeque<Arc<CancellationToken>>> {
        self.owed.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks the connection that has owed a head for the longest time to end; `false` if none owes one.
    pub(crate) fn close_oldest(&self) -> bool {
        let oldest = self.lock().pop_front();
        oldest.map(|connection| connection.cancel()).is_some()
    }

    /// Waits until one more connection owes a head.
    pub(crate) async fn one_more(&self) {
        self.news.notified().await;
    }

    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.lock().len()
    }
}

/// A connection, which owes heads as long as this lives.
#[derive(Debug)]
pub(crate) struct HeadDebt {
    heads: Arc<OwedHeads>,
    /// Cancelled when it has to make room.
    end: Arc<CancellationToken>,
}

impl HeadDebt {
    /// A connection begins, which owes a head.
    pub(crate) fn new(heads: &Arc<OwedHeads>) -> Arc<Self> {
        let debt = Self { heads: Arc::clone(heads), end: Arc::default() };
        debt.owe();
        Arc::new(debt)
    }

    /// Waits until the connection has to make room.
    pub(crate) async fn has_to_go(&self) {
        self.end.cancelled().await;
    }

    fn owe(&self) {
        self.heads.lock().push_back(Arc::clone(&self.end));
        self.heads.news.notify_one();
    }

    fn settle(&self) {
        self.heads.lock().retain(|it| !Arc::ptr_eq(it, &self.end));
    }

    /// Notes that a head has come; the connection owes the next one when the answer is dropped.
    pub(crate) fn answering(self: &Arc<Self>) -> Answering {
        self.settle();
        Answering(Arc::clone(self))
    }
}

impl Drop for HeadDebt {
    fn drop(&mut self) {
        self.settle();
    }
}

/// A request that is being answered.
#[derive(Debug)]
pub(crate) struct Answering(Arc<HeadDebt>);

impl Answering {
    /// Goes on until all of a body is handed to the connection.
    pub(crate) fn with(self, body: Body) -> AnswerBody {
        AnswerBody { body, _answering: self }
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        self.0.owe();
    }
}

/// The body of an answer, which is dropped once all of it is handed to the connection.
#[derive(Debug)]
pub(crate) struct AnswerBody {
    body: Body,
    _answering: Answering,
}

impl HttpBody for AnswerBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
