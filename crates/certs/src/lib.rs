//! Certificates: an authority of one's own, a certificate for every process, and whether one can be used.
//!
//! What this crate does not know: sessions, runs, and what a role allows (`leadtime-link` writes that list).
//!
//! ```text
//! DIR/ca.pem  ca.key  serial       the authority: its certificate, its key (0600), the last serial number
//! DIR/a7.pem  a7.key               one process: the role is the subject's unit, the name its common name
//! DIR/renewed                      when certificates were last renewed: written after the last of them
//! ```
//!
//! # Invariants
//!
//! * Keys are files of mode 0600; every file is replaced in one step. [`Authority::renew`] keeps the key, so that a process
//!   that reads its two files meanwhile never finds one that does not fit the other.
//! * Several certificates are issued together or not at all.
//! * Every certificate has a beginning and an end, ends no later than its authority, and is good for both ends of a
//!   connection: a learner listens and dials.
//! * No clock: what time it is comes in as an argument.
//!
//! # Where to start
//!
//! [`Authority`] makes certificates, [`Identity`] is what a process shows of itself, [`Certificate`] reads one.

mod authority;
mod certificate;
mod error;
mod files;
mod identity;
mod name;
mod probe;
mod request;
mod role;

pub use authority::{Authority, Issued, Listing};
pub use certificate::Certificate;
pub use error::{Error, Result, Unfit};
pub use identity::Identity;
pub use name::PeerName;
pub use probe::HandshakeRefusal;
pub use request::IssueRequest;
pub use role::Role;
