//! What a notifier reports about a session: what it does, how old its observation is, what went wrong, why it is
//! silent.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::latency::LatencyHistogram;
use crate::say::milliseconds;

/// What a session does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LiveState {
    /// No observation has come yet.
    Waiting,
    /// Nothing is said at present.
    Silent,
    /// An utterance is being spoken.
    Speaking,
    /// The loudspeaker is gone: what is said goes on in text. Reported instead of silent and speaking.
    Mute,
    /// The newest observation is too old: nothing new starts.
    Stale,
    /// The client is gone, or says nothing any more.
    Lost,
    /// The episode has ended.
    Ended,
    /// The session is over.
    Closed,
}

/// Why nothing is said.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Silence {
    /// None: something is said.
    #[default]
    None,
    /// No observation has come yet.
    NoObservation,
    /// The policy has nothing to say.
    Policy,
    /// The policy wants to speak, and may not yet.
    Blocked,
    /// There is no sentence for what it wants to say.
    NoSentence,
    /// The newest observation is older than so many seconds.
    Stale(f64),
    /// Nothing has come for so many seconds.
    Quiet(f64),
    /// No observation has been taken for so long that the session is over.
    Forgotten,
    /// The client is gone.
    ClientGone,
    /// The episode has ended.
    Ended,
    /// So many unusable messages in a row, and what was wrong with the last.
    Refused(u32, String),
    /// The loudspeaker is gone.
    Mute,
    /// Another client was given the place, because this one was not there.
    NoPlace,
    /// The notifier ends its work.
    Closing,
}

impl fmt::Display for Silence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => Ok(()),
            Self::NoObservation => f.write_str("no observation has come yet"),
            Self::Policy => f.write_str("the policy has nothing to say"),
            Self::Blocked => {
                f.write_str("the policy wants to speak, and what is being said comes first")
            }
            Self::NoSentence => {
                f.write_str("no sentence for what the policy wants to say holds now")
            }
            Self::Stale(after) => write!(f, "the newest observation is older than {after} s"),
            Self::Quiet(after) => write!(f, "no observation has come for {after} s"),
            Self::Forgotten => {
                f.write_str("no observation has been taken for ten minutes; open a new session")
            }
            Self::ClientGone => f.write_str("the client is gone"),
            Self::Ended => f.write_str("the episode has ended; a new one has another number"),
            Self::Refused(n, last) => {
                write!(
                    f,
                    "{n} messages in a row could not be used; open a new session. The last one: {last}"
                )
            }
            Self::Mute => f.write_str("the loudspeaker is gone; what is said goes on in text"),
            Self::NoPlace => f.write_str(
                "another client was given the place, as this one was not there; open a new session",
            ),
            Self::Closing => f.write_str("the notifier ends"),
        }
    }
}

impl Serialize for Silence {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// What has happened to a client's messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LiveCounts {
    /// Observations that were taken.
    pub taken: u64,
    /// Numbers that never came.
    pub missed: u64,
    /// Observations that came twice or after a newer one.
    pub out_of_order: u64,
    /// Messages that could not be used.
    pub refused: u64,
    /// Messages that were never looked at, because a newer one had replaced them.
    pub overwritten: u64,
    /// Observations far outside of the range of one of their numbers.
    pub strange: u64,
    /// Names among the facts of observations that are none of the task's.
    pub unknown_facts: u64,
    /// Steps that were taken late.
    pub late_steps: u64,
    /// Steps that were taken in all.
    pub steps: u64,
    /// Utterances that were started.
    pub utterances: u64,
}

/// One status of a session.
#[derive(Debug, Serialize)]
pub struct StatusLine<'a> {
    /// Name of the session, as its answer gave it.
    pub session: &'a str,
    /// What the session does.
    pub state: LiveState,
    /// For how long, in seconds.
    pub since: f64,
    /// Why nothing is said; empty while something is.
    pub why: &'a Silence,
    /// The newest observation, by its number.
    pub last_seq: u64,
    /// How old it is, in seconds; nothing before the first.
    pub age: Option<f64>,
    /// What was wrong with a message, or is strange about one; empty if nothing.
    pub told: &'a str,
    /// What has happened to the client's messages.
    #[serde(flatten)]
    pub counts: LiveCounts,
    /// From an observation's arrival, or from a step's time, to the end of what was said about it.
    pub latency_us: LatencyNote,
}

/// A histogram in three numbers, in microseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LatencyNote {
    p50: f64,
    p99: f64,
    max: f64,
}

impl From<&LatencyHistogram> for LatencyNote {
    fn from(times: &LatencyHistogram) -> Self {
        let [p50, p99] = [0.5, 0.99].map(|share| times.quantile_us(share).round());
        Self { p50, p99, max: times.max_us().round() }
    }
}

impl StatusLine<'_> {
    /// Writes it as JSON.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.clear();
        // Plain data into memory: it cannot fail.
        drop(serde_json::to_writer(out, self));
    }
}

/// Nanoseconds as seconds, to milliseconds.
pub(crate) fn seconds(nanoseconds: u64) -> f64 {
    milliseconds(nanoseconds as f64 * 1e-9)
}
