//! Addresses, checked before anything is opened, so that a typo is told as a typo.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;
use zenoh::config::EndPoint;

use crate::Error;

/// Longest path of a Unix socket: the kernel's 107 less the lock file's `.lock`.
const MAX_SOCKET_PATH: usize = 100;

/// An address that can be listened on or connected to, such as `tcp/127.0.0.1:7447`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint(String);

/// What is wrong with an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum EndpointProblem {
    /// No known protocol in front.
    #[error("it must start with `tcp/`, `tls/` or `unixsock-stream/`, as in `tcp/127.0.0.1:7447`")]
    Protocol,
    /// No host or no port.
    #[error("after the protocol come a host and a port, as in `tcp/127.0.0.1:7447`")]
    HostAndPort,
    /// No path, or one that is too long for a socket.
    #[error("the socket's path has {found} bytes; 1 to {MAX_SOCKET_PATH} are possible")]
    Path {
        /// Its length.
        found: usize,
    },
    /// A quotation mark, a backslash or something invisible.
    #[error("it holds a quotation mark, a backslash, a space or a control character")]
    Character,
    /// Wrong in some other way.
    #[error("its syntax is wrong")]
    Syntax,
}

impl Endpoint {
    /// Returns the address as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn check(text: &str) -> Result<(), EndpointProblem> {
        let odd = |c: char| matches!(c, '"' | '\\' | '\'') || c.is_control() || c.is_whitespace();
        if text.contains(odd) {
            return Err(EndpointProblem::Character);
        }
        let (protocol, rest) = text.split_once('/').ok_or(EndpointProblem::Protocol)?;
        let address = rest.split(['?', '#']).next().unwrap_or_default();
        match protocol {
            "tcp" | "tls" => {
                let (host, port) = address.rsplit_once(':').ok_or(EndpointProblem::HostAndPort)?;
                if host.is_empty() || port.parse::<u16>().is_err() {
                    return Err(EndpointProblem::HostAndPort);
                }
            }
            "unixsock-stream" if !(1..=MAX_SOCKET_PATH).contains(&address.len()) => {
                return Err(EndpointProblem::Path { found: address.len() });
            }
            "unixsock-stream" => {}
            _ => return Err(EndpointProblem::Protocol),
        }
        match EndPoint::from_str(text) {
            Ok(_) => Ok(()),
            Err(_) => Err(EndpointProblem::Syntax),
        }
    }
}

impl FromStr for Endpoint {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        match Self::check(text) {
            Ok(()) => Ok(Self(text.to_owned())),
            Err(problem) => Err(Error::Endpoint { endpoint: text.to_owned(), problem }),
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_typo_in_an_address_is_told_as_what_it_is() {
        use EndpointProblem as P;
        let long = format!("unixsock-stream//{}", "x".repeat(100));
        for (text, problem) in [
            ("127.0.0.1:7447", P::Protocol),
            ("http/host:1", P::Protocol),
            ("tcp/host", P::HostAndPort),
            ("tcp/:7447", P::HostAndPort),
            ("tcp/host:99999", P::HostAndPort),
            ("tcp/host :1", P::Character),
            ("tcp/a\":1", P::Character),
            ("unixsock-stream/", P::Path { found: 0 }),
            (long.as_str(), P::Path { found: 101 }),
        ] {
            assert_eq!(Endpoint::check(text), Err(problem), "{text}");
        }
    }

    #[test]
    fn usual_addresses_are_accepted() {
        for text in
            ["tcp/0.0.0.0:0", "tcp/[::1]:7447", "tls/host.example:7447", "unixsock-stream//tmp/z"]
        {
            assert_eq!(text.parse::<Endpoint>().unwrap().as_str(), text);
        }
    }
}
