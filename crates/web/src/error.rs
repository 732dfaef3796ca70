//! Why nothing can be served.

use std::io;
use std::net::SocketAddr;

use thiserror::Error;

/// Why nothing can be served.
#[derive(Debug, Error)]
pub enum Error {
    /// The text is no address.
    #[error("`{text}` is not an address: write IP:PORT, such as {usual}, or localhost:PORT")]
    NotAnAddress {
        /// What was given.
        text: String,
        /// Where the same is served if nothing else is said.
        usual: &'static str,
    },
    /// Another process listens there.
    #[error("{0} is in use: stop what listens there, or choose another port (0 takes a free one)")]
    AddressInUse(SocketAddr),
    /// The system does not let this process listen there.
    #[error(
        "cannot listen at {address}: choose an address of this machine and a port that you may use"
    )]
    Bind {
        /// Where it was tried.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
}
