//! A learner's answers to observers: the description of the run, and its history.
//!
//! The history is read from a file, which takes a while. So it is answered in a thread of its own, one question at a
//! time, and never by the network's callbacks or the learner's loop.

use std::fmt;
use std::sync::Arc;
use std::thread;

use leadtime_proto::header::Schema;
use leadtime_proto::limits::{MAX_HISTORY_POINTS, MAX_METRICS_BYTES};
use leadtime_proto::{Header, Incarnation, RunName};
use zenoh::query::{Parameters, Query, Queryable};
use zenoh::session::Session;

use crate::answer::{Answers, PendingReply, unload};
use crate::keys::{FROM, Key, POINTS};
use crate::pubsub::take_questions;
use crate::{Error, Result};

/// Questions about the history that wait for the one that is being answered; an asker beyond them tries again.
const MAX_WAITING: usize = 32;
/// Points of an answer where the question names no number.
const DEFAULT_POINTS: usize = 1_000;

/// Makes the history from an update on, with at most the given number of points: compressed JSON, or a sentence that says why not.
pub type HistoryMaker = dyn Fn(u64, usize) -> Result<Vec<u8>, String> + Send + Sync;

/// What observers may ask a learner for.
#[derive(Clone)]
pub struct Archive {
    /// What the run is, as JSON.
    pub about: Vec<u8>,
    /// Makes the history of the run when somebody asks.
    pub history: Arc<HistoryMaker>,
}

impl fmt::Debug for Archive {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Archive({} bytes about the run)", self.about.len())
    }
}

/// Answers observers until it is dropped.
pub(crate) fn serve(
    session: &Session,
    run: &RunName,
    incarnation: Incarnation,
    answers: &Answers,
    archive: Archive,
) -> Result<[Queryable<()>; 2]> {
    let Archive { about, history } = archive;
    let header = Header::plain(Schema::About, incarnation, &about);
    let answerer = answers.clone();
    let abouts = take_questions(session, Key::About(run), move |mut query| {
        unload(&mut query);
        answerer.give(PendingReply::Message(query, header, about.clone().into()));
    })?;
    let (sender, questions) = flume::bounded::<Query>(MAX_WAITING);
    let answerer = answers.clone();
    let work = move || {
        for query in questions {
            answerer.give(answer(query, incarnation, history.as_ref()));
        }
    };
    // Detached: it ends by itself when the question's place is undeclared.
    let thread = thread::Builder::new().name("link-history".to_owned()).spawn(work);
    drop(thread.map_err(Error::Thread)?);
    let histories = take_questions(session, Key::History(run), move |mut query| {
        unload(&mut query);
        drop(sender.try_send(query));
    })?;
    Ok([abouts, histories])
}

fn answer(query: Query, incarnation: Incarnation, history: &HistoryMaker) -> PendingReply {
    let (from, n_points) = match asked(query.parameters()) {
        Ok(asked) => asked,
        Err(reason) => return PendingReply::Refusal(query, reason),
    };
    match history(from, n_points) {
        Ok(bytes) if bytes.len() <= MAX_METRICS_BYTES => {
            let header = Header::plain(Schema::History, incarnation, &bytes);
            PendingReply::Message(query, header, bytes.into())
        }
        Ok(_) => {
            PendingReply::Refusal(query, "the history is too large: ask for fewer points".into())
        }
        Err(reason) => PendingReply::Refusal(query, reason),
    }
}

/// Reads what a question asks for.
fn asked(parameters: &Parameters<'_>) -> Result<(u64, usize), String> {
    let number =
        |name: &str, default: u64| parameters.get(name).map_or(Ok(default), str::parse::<u64>);
    let read = number(FROM, 0).ok().zip(number(POINTS, DEFAULT_POINTS as u64).ok());
    let is_allowed = |(_, points): &(u64, u64)| (1..=MAX_HISTORY_POINTS as u64).contains(points);
    let (from, points) = read.filter(is_allowed).ok_or_else(|| {
        format!("write ?from=UPDATE;points=NUMBER, with 1 to {MAX_HISTORY_POINTS} points")
    })?;
    Ok((from, points as usize))
}

/// Reads what a question about the history asks for, as a learner that is asked does: the first update, and the most points.
///
/// # Errors
///
/// A sentence that says what can be asked, if it asks for anything else.
#[cfg(feature = "fakes")]
pub fn history_question(parameters: &str) -> Result<(u64, usize), String> {
    asked(&parameters.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_has_bounds_and_defaults() {
        let asked = |text: &str| asked(&text.into());
        assert_eq!(asked(""), Ok((0, DEFAULT_POINTS)));
        assert_eq!(asked("from=7;points=4000"), Ok((7, 4_000)));
        for odd in [
            "from=-1",
            "from=",
            "points=0",
            "points=4001",
            "points=99999999999999999999999",
            "from=1;DROP;points=x",
            "from=7&points=4000",
        ] {
            let refused = asked(odd).unwrap_err();
            assert!(refused.contains("from=UPDATE;points=NUMBER, with 1 to 4000"), "{refused}");
        }
    }
}
