//! Why nothing can be served.

use std::io;
use std::net::SocketAddr;

use thiserror::Error;

/// Why nothing can be served.
#[derive(Debug, Error)]
pub enum Error {
    /// The text is no address.
    #[error(
        "`{0}` is not an address: write IP:PORT, such as 127.0.0.1:8080, [::1]:8080 or localhost:8080"
    )]
    NotAnAddress(String),
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
