//! Why nobody can be reached at an address. The network library only says that its time is over, so it is tried once
//! more, by hand, with what the system says.

use std::io::ErrorKind;
use std::net::{TcpStream, ToSocketAddrs as _};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use leadtime_certs::{HandshakeRefusal, Identity};
use thiserror::Error;

use crate::Endpoint;

/// How long one attempt to connect may take.
const ATTEMPT: Duration = Duration::from_millis(800);
/// The most of a name's addresses that are tried.
const MAX_ADDRESSES: usize = 3;

/// What is in the way.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub(crate) enum Obstacle {
    #[error("the host's name cannot be resolved: correct the address")]
    Unresolved,
    #[error("the connection is refused: start a learner there, or correct the address")]
    Refused,
    #[error("there is no such socket: start a learner there, or correct the path")]
    NoSocket,
    #[error("the host does not answer: is it up, and does a firewall let this port through?")]
    Silent,
    /// What the system says.
    #[error("{0}")]
    Other(String),
    #[error(
        "a program listens there, but it does not answer as a learner does: is it the right port?"
    )]
    NoLearner,
    #[error(
        "a program listens there, but no encrypted connection comes about: the certificate there has to be signed by the \
         authority in `root_ca_certificate_file`, be for this host's name, and not be expired; and the learner may ask \
         for a certificate of ours"
    )]
    NoTls,
    #[error(transparent)]
    Handshake(#[from] HandshakeRefusal),
}

/// Finds out why nobody can be reached, by this process or by one without a certificate; takes a few seconds at most.
pub(crate) fn diagnose(endpoint: &Endpoint, identity: Option<&Identity>) -> Obstacle {
    let (protocol, address, _) = endpoint.parts();
    match protocol {
        "unixsock-stream" => UnixStream::connect(address)
            .map_or_else(|error| obstacle(&error), |_| Obstacle::NoLearner),
        "tls" => match (tcp(address), identity) {
            (Err(obstacle), _) => obstacle,
            (Ok(_), None) => Obstacle::NoTls,
            (Ok(stream), Some(identity)) => handshake(address, identity, stream),
        },
        _ => tcp(address).err().unwrap_or(Obstacle::NoLearner),
    }
}

/// Shakes hands as this process would.
fn handshake(address: &str, identity: &Identity, stream: TcpStream) -> Obstacle {
    let limited = stream.set_read_timeout(Some(ATTEMPT));
    if let Err(error) = limited.and_then(|()| stream.set_write_timeout(Some(ATTEMPT))) {
        return Obstacle::Other(error.to_string());
    }
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    identity.probe(host, stream).map_or_else(Obstacle::Handshake, |()| Obstacle::NoLearner)
}

/// Tries to connect.
fn tcp(address: &str) -> Result<TcpStream, Obstacle> {
    let Ok(addresses) = address.to_socket_addrs() else { return Err(Obstacle::Unresolved) };
    let mut last = Obstacle::Unresolved;
    for address in addresses.take(MAX_ADDRESSES) {
        match TcpStream::connect_timeout(&address, ATTEMPT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = obstacle(&error),
        }
    }
    Err(last)
}

fn obstacle(error: &std::io::Error) -> Obstacle {
    match error.kind() {
        ErrorKind::ConnectionRefused => Obstacle::Refused,
        ErrorKind::NotFound => Obstacle::NoSocket,
        ErrorKind::TimedOut => Obstacle::Silent,
        _ => Obstacle::Other(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    fn at(address: &str) -> Obstacle {
        diagnose(&address.parse().unwrap(), None)
    }

    #[test]
    fn a_refusal_a_foreign_program_and_an_unknown_name_are_told_apart() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        assert_eq!(at(&format!("tcp/127.0.0.1:{port}")), Obstacle::NoLearner);
        assert_eq!(at(&format!("tls/127.0.0.1:{port}")), Obstacle::NoTls);
        drop(listener);
        assert_eq!(at(&format!("tcp/127.0.0.1:{port}")), Obstacle::Refused);
        assert_eq!(at("tcp/no-such-host.invalid:1"), Obstacle::Unresolved);
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("z");
        assert_eq!(at(&format!("unixsock-stream/{}", socket.display())), Obstacle::NoSocket);
        drop(std::os::unix::net::UnixListener::bind(&socket).unwrap());
        assert_eq!(at(&format!("unixsock-stream/{}", socket.display())), Obstacle::Refused);
    }
}
