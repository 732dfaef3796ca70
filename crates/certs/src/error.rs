//! What can be wrong with certificates, with what a person needs to put it right.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// A result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why something about certificates could not be done.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A file that cannot be read or written.
    #[error("cannot {action} {}", path.display())]
    File {
        /// `read`, `write` or `lock`.
        action: &'static str,
        /// The file or directory that the system complained about.
        path: PathBuf,
        /// What the system says.
        #[source]
        source: io::Error,
    },
    /// The directory holds an authority already.
    #[error("{} holds an authority already: issue from it, or take another directory", .0.display())]
    AuthorityExists(PathBuf),
    /// The directory holds no authority, or is not there.
    #[error("there is no authority in {}: make one with `leadtime certs init {}`", .0.display(), .0.display())]
    NoAuthority(PathBuf),
    /// Another process is issuing.
    #[error("another `leadtime certs` is at work in {}: try again when it is done", .0.display())]
    Busy(PathBuf),
    /// This name has a certificate.
    #[error("{} exists already: renew it with `certs renew`, or remove it first", .0.display())]
    Taken(PathBuf),
    /// A key is there, and its certificate is not.
    #[error(
        "{} is there without its certificate {}, as a `leadtime certs` that was killed leaves it: remove the key, unless \
         you have moved that certificate elsewhere, and try again",
        key.display(),
        certificate.display()
    )]
    LoneKey {
        /// The file of the key, `NAME.key`.
        key: PathBuf,
        /// Where its certificate would be, `NAME.pem`.
        certificate: PathBuf,
    },
    /// One name was given twice.
    #[error("`{0}` is given twice: every process needs a name of its own")]
    Twice(String),
    /// Not a request for a certificate.
    #[error(
        "`{0}` does not say whose certificate: write ROLE:NAME, or ROLE:NAME@HOST for a process that is dialled"
    )]
    Request(String),
    /// This word is not a role.
    #[error("`{0}` is not a role: router, learner, actor, observer, recorder, service or robot")]
    Role(String),
    /// This text cannot be a name, by its characters, its length or because it is `ca`.
    #[error(
        "`{0}` is not a name for a certificate: use 1 to 48 of a-z, 0-9 and `-`, starting with a letter or digit, but not `ca`"
    )]
    Name(String),
    /// Below the keys of a notifier this word stands for something else than a client.
    #[error("`{0}` is not a name for a robot: a notifier's keys have that word for themselves")]
    RobotName(String),
    /// This text is not a host.
    #[error("`{0}` is neither a host's name nor an address")]
    Host(String),
    /// A lifetime that is no lifetime.
    #[error("a certificate has to last at least a second, and at most 100 years")]
    Lifetime,
    /// The authority's own certificate has ended.
    #[error("the authority in {} ended at {ended}: make another one with `certs init`, and issue all certificates again", directory.display())]
    AuthorityEnded {
        /// The directory of the authority.
        directory: PathBuf,
        /// The last moment at which it could sign.
        ended: jiff::Timestamp,
    },
    /// A file that is not what it should be.
    #[error("{} holds {found}", path.display())]
    Content {
        /// The file with the wrong content.
        path: PathBuf,
        /// What it holds instead.
        found: String,
    },
    /// A certificate that cannot be used, and why.
    #[error("{} cannot be used: {reason}", path.display())]
    Unfit {
        /// The file of the certificate, `NAME.pem`.
        path: PathBuf,
        /// What makes it unfit for a connection.
        reason: Unfit,
    },
    /// A key that others can read.
    #[error("{} can be read by everybody (mode {mode:03o}): `chmod 600` it, and issue a new one if somebody may have", path.display())]
    OpenKey {
        /// The file of the key, `NAME.key`.
        path: PathBuf,
        /// Its permission bits, such as `0o644`.
        mode: u32,
    },
    /// A certificate could not be made.
    #[error("cannot make a certificate")]
    Make(#[from] rcgen::Error),
}

/// Why a certificate cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Unfit {
    /// Its time is over.
    #[error("it ended at {0}; `leadtime certs renew` makes it anew")]
    Expired(jiff::Timestamp),
    /// It has not begun.
    #[error("it begins at {0}; is this machine's clock right?")]
    NotYetValid(jiff::Timestamp),
    /// It is not signed by the authority in its directory.
    #[error("it is not signed by the authority in {}", .0.display())]
    OtherAuthority(PathBuf),
    /// The key is another certificate's.
    #[error("{} is the key of another certificate", .0.display())]
    OtherKey(PathBuf),
    /// Good for one end of a connection only.
    #[error(
        "it has to be for both ends of a connection (extended key usage serverAuth and clientAuth)"
    )]
    OneEnd,
    /// Its subject names no process.
    #[error("its subject has no common name")]
    Nameless,
}
