//! Why nobody can be reached at an address. The network library only says that its time is over, so it is tried once
//! more, by hand, with what the system says.

use std::io::{ErrorKind, Read as _, Write as _};
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

/// Who is looked for, as a noun for messages.
type Whom = &'static str;

/// Says how to start the process that is looked for.
fn start(whom: &str) -> String {
    match whom {
        "notifier" => "start a service there: `leadtime serve POLICY --listen ENDPOINT`".to_owned(),
        whom => format!("start a {whom} there"),
    }
}

/// What is in the way.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub(crate) enum Obstacle {
    #[error("the host's name cannot be resolved: correct the address")]
    Unresolved,
    #[error("the connection is refused: {}, or correct the address", start(.0))]
    Refused(Whom),
    #[error("there is no such socket: {}, or correct the path", start(.0))]
    NoSocket(Whom),
    #[error("the host does not answer: is it up, and does a firewall let this port through?")]
    Silent,
    /// What the system says.
    #[error("{0}")]
    Other(String),
    #[error("a program listens there, but it does not answer as a {0} does: is it the right port?")]
    Stranger(Whom),
    #[error(
        "the program that listens there asks for TLS: write `tls/` instead of `tcp/`, with --tls DIR/ID"
    )]
    Encrypted,
    #[error(
        "a program listens there, but no encrypted connection comes about: the certificate there has to be signed by the \
         authority in `root_ca_certificate_file`, be for this host's name, and not be expired; and the {0} may ask \
         for a certificate of ours"
    )]
    NoTls(Whom),
    #[error(transparent)]
    Handshake(#[from] HandshakeRefusal),
}

/// Finds out why nobody can be reached, by this process or by one without a certificate; takes a few seconds at most.
pub(crate) fn diagnose(endpoint: &Endpoint, identity: Option<&Identity>, whom: Whom) -> Obstacle {
    let (protocol, address, _) = endpoint.parts();
    match protocol {
        "unixsock-stream" => UnixStream::connect(address)
            .map_or_else(|error| obstacle(&error, whom), |_| Obstacle::Stranger(whom)),
        "tls" => match (tcp(address, whom), identity) {
            (Err(obstacle), _) => obstacle,
            (Ok(_), None) => Obstacle::NoTls(whom),
            (Ok(stream), Some(identity)) => handshake(address, identity, stream, whom),
        },
        _ => match tcp(address, whom) {
            Err(obstacle) => obstacle,
            Ok(stream) if speaks_tls(&stream) => Obstacle::Encrypted,
            Ok(_) => Obstacle::Stranger(whom),
        },
    }
}

/// Tells whether TLS is spoken there: what is no record of it is answered with an alert.
fn speaks_tls(mut stream: &TcpStream) -> bool {
    const NO_RECORD: &[u8] = b"\x05\0hello";
    const ALERT: [u8; 2] = [21, 3];
    let mut answer = [0; 2];
    let asked = stream.set_read_timeout(Some(ATTEMPT)).and_then(|()| stream.write_all(NO_RECORD));
    let answered = asked.and_then(|()| stream.read_exact(&mut answer));
    answered.is_ok() && answer == ALERT
}

/// Shakes hands as this process would.
fn handshake(address: &str, identity: &Identity, stream: TcpStream, whom: Whom) -> Obstacle {
    let limited = stream.set_read_timeout(Some(ATTEMPT));
    if let Err(error) = limited.and_then(|()| stream.set_write_timeout(Some(ATTEMPT))) {
        return Obstacle::Other(error.to_string());
    }
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    identity.probe(host, stream).map_or_else(Obstacle::Handshake, |()| Obstacle::Stranger(whom))
}

/// Connects to one of a host's addresses, or says what is in the way at the last one.
fn tcp(address: &str, whom: Whom) -> Result<TcpStream, Obstacle> {
    let Ok(addresses) = address.to_socket_addrs() else { return Err(Obstacle::Unresolved) };
    let mut last = Obstacle::Unresolved;
    for address in addresses.take(MAX_ADDRESSES) {
        match TcpStream::connect_timeout(&address, ATTEMPT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = obstacle(&error, whom),
        }
    }
    Err(last)
}

fn obstacle(error: &std::io::Error, whom: Whom) -> Obstacle {
    match error.kind() {
        ErrorKind::ConnectionRefused => Obstacle::Refused(whom),
        ErrorKind::NotFound => Obstacle::NoSocket(whom),
        ErrorKind::TimedOut => Obstacle::Silent,
        _ => Obstacle::Other(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    fn at(address: &str) -> Obstacle {
        diagnose(&address.parse().unwrap(), None, "router")
    }

    #[test]
    fn a_refusal_a_foreign_program_and_an_unknown_name_are_told_apart() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        assert_eq!(at(&format!("tcp/127.0.0.1:{port}")), Obstacle::Stranger("router"));
        assert_eq!(at(&format!("tls/127.0.0.1:{port}")), Obstacle::NoTls("router"));
        drop(listener);
        assert_eq!(at(&format!("tcp/127.0.0.1:{port}")), Obstacle::Refused("router"));
        assert_eq!(at("tcp/no-such-host.invalid:1"), Obstacle::Unresolved);
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("z");
        assert_eq!(
            at(&format!("unixsock-stream/{}", socket.display())),
            Obstacle::NoSocket("router")
        );
        drop(std::os::unix::net::UnixListener::bind(&socket).unwrap());
        assert_eq!(
            at(&format!("unixsock-stream/{}", socket.display())),
            Obstacle::Refused("router")
        );
    }

    #[test]
    fn a_program_that_asks_for_tls_is_told_from_a_foreign_one() {
        for (answer, expected) in [
            (b"\x15\x03\x03\x00\x02\x02\x32".as_slice(), Obstacle::Encrypted),
            (b"SSH-2.0".as_slice(), Obstacle::Stranger("router")),
        ] {
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            let port = listener.local_addr().unwrap().port();
            let named = std::thread::Builder::new().name("foreign".to_owned());
            let there = named.spawn(move || {
                let (mut stream, _) = listener.accept().unwrap();
                stream.read_exact(&mut [0; 7]).unwrap();
                stream.write_all(answer).unwrap();
            });
            assert_eq!(at(&format!("tcp/127.0.0.1:{port}")), expected);
            there.unwrap().join().unwrap();
        }
    }

    #[test]
    fn a_missing_process_is_named_with_the_command_that_starts_it() {
        let told = Obstacle::Refused("notifier").to_string();
        let start = "start a service there: `leadtime serve POLICY --listen ENDPOINT`, or";
        assert!(told.contains(start), "{told}");
        assert!(Obstacle::NoSocket("learner").to_string().contains("start a learner there, or"));
    }
}
