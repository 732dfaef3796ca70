//! What can go wrong on the network, with what a person needs to put it right.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use leadtime_proto::codec::CodecError;
use leadtime_proto::ids::InvalidId;
use leadtime_proto::phrase::duration;
use leadtime_proto::{ActorId, ClientName, PolicyVersion, Refusal, RunName, ServiceName};
use thiserror::Error;

/// The reason with which a learner refuses every hello once it has dismissed its actors. Part of the protocol: the actor that receives it is
/// dismissed as well.
pub const RUN_IS_ENDING: &str = "the run is ending: nothing is left to do";

/// A result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The network library's own error: opaque, only to be shown.
#[derive(Debug)]
pub struct NetworkFault(pub(crate) zenoh::Error);

impl fmt::Display for NetworkFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.0.to_string();
        let told = without_place(&text);
        // A list of reasons loses its end with that.
        let is_cut = told.matches('[').count() > told.matches(']').count();
        let whole = if is_cut { told.replacen(": [", ": ", 1) } else { told.to_owned() };
        f.write_str(&whole)
    }
}

impl std::error::Error for NetworkFault {}

/// Returns an error of the library without its end, the place in the library's own sources, which helps nobody here. What is
/// vendored has a place below this repository.
pub(crate) fn without_place(text: &str) -> &str {
    let is_place = |rest: &str| {
        let word = rest.split_whitespace().next().unwrap_or_default();
        rest.starts_with('/') || word.contains(".rs:")
    };
    let mut ends = text.match_indices(" at ");
    let end = ends.find(|(at, word)| is_place(&text[at + word.len()..]));
    text[..end.map_or(text.len(), |(at, _)| at)].trim_end_matches('.')
}

/// Why something could not be done over the network.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A text that is no address.
    #[error("`{endpoint}` is not an address: {problem}")]
    Endpoint {
        /// The text as it was given.
        endpoint: String,
        /// What is wrong with it.
        problem: String,
    },
    /// No address at all.
    #[error("no address to listen on or to connect to")]
    NoEndpoint,
    /// Someone else listens at this address.
    #[error(
        "--listen: `{0}` is in use: another process listens there; choose another port or path, or stop it"
    )]
    AddressInUse(String),
    /// The host of this address is no address of this machine.
    #[error(
        "--listen: this machine has no address {0}: listen on one of its own, or on 0.0.0.0 for all"
    )]
    NotOurAddress(String),
    /// A file exists where the socket would be created; listening there would remove it.
    #[error("a file exists at {}, where the socket (or its lock) would be created: choose another path", .0.display())]
    NotASocket(PathBuf),
    /// A file that the address names for TLS.
    #[error("`{setting}` of the address: cannot read {}", path.display())]
    TlsFile {
        /// The name of the setting.
        setting: String,
        /// The path as given.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A certificate was given, and an address that does not use it.
    #[error(
        "`{0}` is not encrypted, although a certificate is given: write `tls/` instead of `tcp/`"
    )]
    NotEncrypted(String),
    /// An address with TLS, and no certificate.
    #[error(
        "`{0}` needs a certificate: give --tls DIR/ID with the files that `leadtime certs issue` makes"
    )]
    NoCertificate(String),
    /// An address with certificates of its own, and another one for the whole session.
    #[error(
        "`{0}` brings TLS settings of its own, and --tls gives others: leave out what follows the `#`"
    )]
    TlsTwice(String),
    /// A path that the network library cannot take.
    #[error("{}: a path of TLS files may hold none of ; = | # and no quotation mark", .0.display())]
    TlsPath(PathBuf),
    /// Not a list of who may do what.
    #[error("this is no access list: {0}; `leadtime certs acl` writes one")]
    AccessList(String),
    /// The hello of this actor reaches nobody, although a learner is present.
    #[error(
        "the access list there does not let `{actor}` say hello to run `{run}`: issue a certificate of role actor to it, write the list again, and restart the process that reads it"
    )]
    NotAllowed {
        /// The run whose learner is present.
        run: RunName,
        /// The name in the actor's certificate.
        actor: ActorId,
    },
    /// No learner is visible to this process, which shows a certificate.
    #[error(
        "no learner is visible at {endpoints} (waited {}): none is running there, or the access list there does not name `{name}`",
        duration(*timeout)
    )]
    Unlisted {
        /// The addresses that were looked at.
        endpoints: String,
        /// The name in our certificate.
        name: String,
        /// For how long it was waited.
        timeout: Duration,
    },
    /// Listening failed for another reason.
    #[error("cannot listen on `{endpoint}`")]
    Listen {
        /// The address that was to be listened on.
        endpoint: String,
        /// What the network said.
        #[source]
        source: NetworkFault,
    },
    /// Nobody can be reached, with the reason for every address.
    #[error("no {whom} can be reached (tried for {}): {obstacles}", duration(*timeout))]
    Unreachable {
        /// Who was looked for.
        whom: &'static str,
        /// Every address with what is in the way.
        obstacles: String,
        /// For how long it was tried.
        timeout: Duration,
    },
    /// Someone listens there, but no learner is to be found.
    #[error("no learner is running at {endpoints} (waited {})", duration(*timeout))]
    NoLearner {
        /// The addresses that were looked at.
        endpoints: String,
        /// For how long it was waited.
        timeout: Duration,
    },
    /// Another learner of this run is at work on the same network.
    #[error(
        "another learner of run `{run}` is at work at {endpoints}: stop it, or give this run another name (--name)"
    )]
    AnotherLearner {
        /// The run that both would train.
        run: RunName,
        /// The addresses of the routers.
        endpoints: String,
    },
    /// Several runs share the address and none was named.
    #[error("several runs share {endpoints}: name one of {}", list(runs))]
    SeveralRuns {
        /// The addresses that were looked at.
        endpoints: String,
        /// The runs that are there.
        runs: Vec<RunName>,
    },
    /// The run that was named is not there.
    #[error("run `{run}` is not at {endpoints}; there: {}", list(present))]
    RunNotFound {
        /// The run that was asked for.
        run: RunName,
        /// The addresses that were looked at.
        endpoints: String,
        /// The runs that are there.
        present: Vec<RunName>,
    },
    /// The learner does not want this actor.
    #[error("run `{run}` refused actor `{actor}`: {reason}")]
    Refused {
        /// The run that the actor asked to take part in.
        run: RunName,
        /// The name that the actor gave.
        actor: ActorId,
        /// Why, in the learner's words.
        reason: String,
    },
    /// The run has come to its end, or its learner was asked to stop: nobody is wanted any more.
    #[error("run `{run}`: {RUN_IS_ENDING}")]
    Ending {
        /// The run that is at its end.
        run: RunName,
    },
    /// No notifier of that name is at work there.
    #[error(
        "no notifier `{service}` is at work at {endpoints}; there: {}. Start a service: `leadtime serve POLICY`, with --service {service}",
        there(present)
    )]
    NoService {
        /// The notifier that was asked for.
        service: ServiceName,
        /// The addresses that were looked at.
        endpoints: String,
        /// Those that are there.
        present: Vec<ServiceName>,
    },
    /// A key that a robot cannot have.
    #[error("`{key}` cannot be a robot's key: {problem}")]
    RobotKey {
        /// The key as it was given.
        key: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A name that is a part of keys already.
    #[error("a client cannot be called `{0}`: the keys of presence are; choose another name")]
    ReservedName(ClientName),
    /// Another start of an actor with this name is a member.
    #[error("`{0}` is already here; choose another --id")]
    Taken(ActorId),
    /// Nobody acted on an order or answered a question in time.
    #[error("no answer on `{key}` within {}", duration(*timeout))]
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
        /// Why, in the peer's words.
        reason: String,
    },
    /// A version of the weights that the learner does not keep (any more).
    #[error("weights of version {version} cannot be pulled: {reason}")]
    NotKept {
        /// The version that was asked for.
        version: PolicyVersion,
        /// Why, in the learner's words.
        reason: String,
    },
    /// Weights that are not the ones which the learner announced as this version.
    #[error(
        "what arrives as weights of version {0} is not what the learner announced: its SHA-256 differs"
    )]
    ForeignWeights(PolicyVersion),
    /// A message that no receiver would take.
    #[error("message of {found} bytes for `{key}`, at most {limit} are possible")]
    TooLarge {
        /// Where it was to go.
        key: String,
        /// How many bytes it has.
        found: usize,
        /// The limit of its kind.
        limit: usize,
    },
    /// An actor that has not been welcomed to a run yet.
    #[error("actor `{0}` is in no run yet: it has to say hello first")]
    NotInARun(ActorId),
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
    /// This process may not open as many more files as the network library needs.
    #[error("the limit on open files is too small for the network: see `ulimit -n`")]
    TooFewFiles(#[source] std::io::Error),
    /// A thread that serves the network could not be started.
    #[error("cannot start a thread for the network")]
    Thread(#[source] std::io::Error),
    /// The operating system gives no random bytes.
    #[error("the operating system gives no random bytes for the keys of this process")]
    Random(#[source] getrandom::Error),
    /// The network library failed to do this in one of its own threads, or could not start one.
    #[error(
        "the network library failed to {0}; are there too few threads or memory for this process?"
    )]
    Panicked(&'static str),
    /// The connection was closed, or what listened for actors has ended.
    #[error("the network connection of this process has ended")]
    Dead,
    /// Closing took longer than this limit.
    #[error("closing the network connection took longer than {}", duration(*.0))]
    Close(Duration),
}

impl Error {
    pub(crate) fn network(action: &'static str, key: &str) -> impl FnOnce(zenoh::Error) -> Self {
        move |source| Self::Network { action, key: key.to_owned(), source: NetworkFault(source) }
    }
}

fn there(services: &[ServiceName]) -> String {
    let quoted: Vec<String> = services.iter().map(|service| format!("`{service}`")).collect();
    if quoted.is_empty() { "none".to_owned() } else { quoted.join(", ") }
}

fn list(runs: &[RunName]) -> String {
    let quoted: Vec<String> = runs.iter().map(|run| format!("`{run}`")).collect();
    quoted.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_library_says_is_shown_without_its_sources() {
        let text =
            "bound to tcp/[::1]:80: [[::1]:80: Permission denied (os error 13) at /tcp.rs:61.]";
        let shown = NetworkFault(text.into()).to_string();
        assert_eq!(shown, "bound to tcp/[::1]:80: [::1]:80: Permission denied (os error 13)");
        let vendored =
            "looked at nobody. at vendor/zenoh/src/a.rs:551. at vendor/zenoh/src/b.rs:7.";
        assert_eq!(NetworkFault(vendored.into()).to_string(), "looked at nobody");
    }

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
