//! What can go wrong on the network, with what a person needs to put it right.

use std::fmt;
use std::time::Duration;

use leadtime_proto::codec::CodecError;
use leadtime_proto::ids::InvalidId;
use leadtime_proto::{ActorId, PolicyVersion, Refusal, RunName};
use thiserror::Error;

use crate::EndpointProblem;

/// A result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The network library's own error: opaque, only to be shown.
pub struct NetworkFault(zenoh::Error);

impl NetworkFault {
    pub(crate) fn new(source: zenoh::Error) -> Self {
        Self(source)
    }
}

impl fmt::Debug for NetworkFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.0, f)
    }
}

impl fmt::Display for NetworkFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The library ends its errors with the place in its own sources, which helps nobody here.
        let text = self.0.to_string();
        f.write_str(text.split(" at /").next().unwrap_or(&text).trim_end_matches('.'))
    }
}

impl std::error::Error for NetworkFault {}

/// Why something could not be done over the network.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// An address that is none.
    #[error("`{endpoint}` is not an address: {problem}")]
    Endpoint {
        /// As given.
        endpoint: String,
        /// What is wrong with it.
        problem: EndpointProblem,
    },
    /// No address at all.
    #[error("no address to listen on or to connect to")]
    NoEndpoint,
    /// Someone else listens there.
    #[error(
        "address `{endpoint}` is in use: another learner listens there; choose another port or path, or stop it"
    )]
    AddressInUse {
        /// The address.
        endpoint: String,
        /// What the network said.
        #[source]
        source: NetworkFault,
    },
    /// Listening failed for another reason.
    #[error("cannot listen on `{endpoint}`")]
    Listen {
        /// The address.
        endpoint: String,
        /// What the network said.
        #[source]
        source: NetworkFault,
    },
    /// Nobody listens there.
    #[error(
        "nobody answers at {endpoints} (tried for {timeout:?}): start a learner there, or correct the address"
    )]
    NobodyThere {
        /// The addresses.
        endpoints: String,
        /// For how long it was tried.
        timeout: Duration,
        /// What the network said last.
        #[source]
        source: NetworkFault,
    },
    /// Someone listens there, but no learner is to be found.
    #[error("no learner is running at {endpoints} (waited {timeout:?})")]
    NoLearner {
        /// The addresses.
        endpoints: String,
        /// For how long it was waited.
        timeout: Duration,
    },
    /// Several runs share the address and none was named.
    #[error("several runs share {endpoints}: name one of {}", list(runs))]
    SeveralRuns {
        /// The addresses.
        endpoints: String,
        /// The runs that are there.
        runs: Vec<RunName>,
    },
    /// The run that was named is not there.
    #[error("run `{run}` is not at {endpoints}; there: {}", list(present))]
    RunNotFound {
        /// As named.
        run: RunName,
        /// The addresses.
        endpoints: String,
        /// The runs that are there.
        present: Vec<RunName>,
    },
    /// The learner does not want this actor.
    #[error("run `{run}` refused actor `{actor}`: {reason}")]
    Refused {
        /// The run.
        run: RunName,
        /// The actor.
        actor: ActorId,
        /// The learner's sentence.
        reason: String,
    },
    /// An actor of the same name is there, alive.
    #[error("`{actor}` is already here; choose another --id")]
    Taken {
        /// The name.
        actor: ActorId,
    },
    /// Nobody acted on an order or answered a question in time.
    #[error("no answer on `{key}` within {timeout:?}")]
    NoAnswer {
        /// Where it was asked.
        key: String,
        /// For how long it was waited.
        timeout: Duration,
    },
    /// An answer was given, but it is unusable.
    #[error("unusable answer on `{key}`")]
    BadAnswer {
        /// Where it was asked.
        key: String,
        /// What is wrong with it.
        #[source]
        source: Refusal,
    },
    /// The peer answered with an error.
    #[error("`{key}` answered: {reason}")]
    Rejected {
        /// Where it was asked.
        key: String,
        /// The peer's sentence.
        reason: String,
    },
    /// Weights that do not have the announced digest.
    #[error("weights of version {version} arrived damaged: their SHA-256 is not the announced one")]
    WeightsDamaged {
        /// The version.
        version: PolicyVersion,
    },
    /// Weights of another version than the one asked for.
    #[error("asked for weights of version {wanted}, got version {found}")]
    WrongVersion {
        /// As asked.
        wanted: PolicyVersion,
        /// As answered.
        found: PolicyVersion,
    },
    /// A message that no receiver would take.
    #[error("message of {found} bytes for `{key}`, at most {limit} are possible")]
    TooLarge {
        /// Where it was to go.
        key: String,
        /// Its size.
        found: usize,
        /// The limit of its kind.
        limit: usize,
    },
    /// An actor that has not been welcomed to a run yet.
    #[error("actor `{actor}` is in no run yet: it has to say hello first")]
    NotInARun {
        /// The actor.
        actor: ActorId,
    },
    /// A name that cannot be part of a key.
    #[error(transparent)]
    Name(#[from] InvalidId),
    /// A message of our own that cannot be encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The network failed underneath.
    #[error("cannot {action} `{key}`")]
    Network {
        /// What was being done.
        action: &'static str,
        /// The key that it was about.
        key: String,
        /// What the network said.
        #[source]
        source: NetworkFault,
    },
    /// A thread that serves the network could not be started.
    #[error("cannot start a thread for the network")]
    Thread(#[source] std::io::Error),
    /// Closing took longer than it may.
    #[error("closing the network connection took longer than {timeout:?}")]
    Close {
        /// The limit.
        timeout: Duration,
    },
}

impl Error {
    pub(crate) fn network(action: &'static str, key: &str) -> impl FnOnce(zenoh::Error) -> Self {
        move |source| Self::Network { action, key: key.to_owned(), source: NetworkFault(source) }
    }
}

fn list(runs: &[RunName]) -> String {
    let quoted: Vec<String> = runs.iter().map(|run| format!("`{run}`")).collect();
    quoted.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_run_lists_the_runs_that_are_there() {
        let name = |text| RunName::new(text).unwrap();
        let error = Error::RunNotFound {
            run: name("c"),
            endpoints: "tcp/10.0.0.1:7447".to_owned(),
            present: vec![name("a"), name("b")],
        };
        assert_eq!(error.to_string(), "run `c` is not at tcp/10.0.0.1:7447; there: `a`, `b`");
    }
}
