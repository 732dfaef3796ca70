//! Why no encrypted connection comes about: the handshake done once by hand, with everything that it shows.
//!
//! The network library says of every failure that its time is over. A peer that refuses our certificate says why by an
//! alert, after the handshake is done on our side; so it is read until then.

use std::io::{self, ErrorKind, Read as _};
use std::net::TcpStream;
use std::sync::Arc;

use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{PrivateKeyDer, ServerName};
use rustls::version::TLS13;
use rustls::{AlertDescription, CertificateError, ClientConfig, ClientConnection, Stream};
use thiserror::Error;

use crate::Identity;
use crate::identity::{certificates, roots};

/// Why a handshake fails.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum HandshakeRefusal {
    /// The other side speaks something else.
    #[error(
        "the program that listens there speaks no TLS: it was started without --tls, or is another one"
    )]
    NoTls,
    /// The connection is closed before a handshake.
    #[error(
        "the connection is closed there before a TLS handshake: the program that listens was started without --tls, or passes \
         on to one that is not running"
    )]
    Closed,
    /// Nothing comes within the time that is waited.
    #[error(
        "the program that listens there does not answer a TLS handshake: is it the right port?"
    )]
    Silent,
    /// Their certificate is signed by somebody else.
    #[error(
        "the certificate there is not signed by our authority: both have to be issued by one `leadtime certs init`"
    )]
    OtherAuthority,
    /// Their certificate is over.
    #[error("the certificate there has ended: renew it and start that program again")]
    TheirsEnded,
    /// Their certificate has not begun.
    #[error("the certificate there is not valid yet: do the clocks agree?")]
    TheirsNotYetValid,
    /// Their certificate is for other hosts.
    #[error(
        "the certificate there is not for `{host}` but for {}: issue it with --host {host}, or use that name",
        list(names)
    )]
    OtherHost {
        /// The host that was dialled.
        host: String,
        /// Those of the certificate.
        names: Vec<String>,
    },
    /// Something else about their certificate.
    #[error("the certificate there cannot be used: {0}")]
    Theirs(String),
    /// They do not know our authority.
    #[error("our certificate is refused: it is not signed by the authority there")]
    OursForeign,
    /// They say that our certificate is over.
    #[error("our certificate is refused as expired: renew it; do the clocks agree?")]
    OursEnded,
    /// They want a certificate, and we have shown none.
    #[error("a certificate is asked for: give --tls DIR/ID")]
    OursMissing,
    /// Some other alert about our certificate.
    #[error("our certificate is refused ({0})")]
    Ours(String),
    /// The connection breaks, or our own files have changed.
    #[error("the TLS handshake fails: {0}")]
    Broken(String),
}

impl Identity {
    /// Does a TLS handshake as this process on a connection, whose read and write time-outs limit how long it takes.
    ///
    /// # Errors
    ///
    /// What prevents it; none if both sides accept each other.
    pub fn probe(&self, host: &str, mut stream: TcpStream) -> Result<(), HandshakeRefusal> {
        let broken = |error: String| HandshakeRefusal::Broken(error);
        // An IPv6 address stands in brackets where it is dialled, and without them in a certificate.
        let host = host.trim_matches(['[', ']']);
        let config = self.client_config().map_err(broken)?;
        let name =
            ServerName::try_from(host.to_owned()).map_err(|error| broken(error.to_string()))?;
        let mut connection = ClientConnection::new(Arc::new(config), name)
            .map_err(|error| broken(error.to_string()))?;
        while connection.is_handshaking() {
            match connection.complete_io(&mut stream) {
                Ok((0, 0)) => return Err(HandshakeRefusal::Closed),
                Ok(_) => {}
                Err(error) => return Err(refusal(&error, host)),
            }
        }
        match Stream::new(&mut connection, &mut stream).read(&mut [0]) {
            Err(error) if !is_time_out(&error) && error.kind() != ErrorKind::UnexpectedEof => {
                Err(refusal(&error, host))
            }
            // It waits for us to speak: we are let in.
            _ => Ok(()),
        }
    }

    fn client_config(&self) -> Result<ClientConfig, String> {
        let text = |error: &dyn std::error::Error| error.to_string();
        let chain = certificates(self.certificate()).map_err(|error| text(&error))?;
        let roots = roots(self.authority()).map_err(|error| text(&error))?;
        let key = PrivateKeyDer::from_pem_file(self.key()).map_err(|error| text(&error))?;
        let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_protocol_versions(&[&TLS13])
            .map_err(|error| text(&error))?;
        let builder = builder.with_root_certificates(roots);
        builder.with_client_auth_cert(chain, key).map_err(|error| text(&error))
    }
}

fn is_time_out(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

fn refusal(error: &io::Error, host: &str) -> HandshakeRefusal {
    if is_time_out(error) {
        return HandshakeRefusal::Silent;
    }
    let Some(error) = error.get_ref().and_then(|error| error.downcast_ref::<rustls::Error>())
    else {
        return match error.kind() {
            ErrorKind::UnexpectedEof | ErrorKind::ConnectionReset => HandshakeRefusal::Closed,
            _ => HandshakeRefusal::Broken(error.to_string()),
        };
    };
    match error {
        rustls::Error::InvalidMessage(_) => HandshakeRefusal::NoTls,
        rustls::Error::InvalidCertificate(reason) => theirs(reason, host),
        rustls::Error::AlertReceived(alert) => match alert {
            AlertDescription::UnknownCA | AlertDescription::BadCertificate => {
                HandshakeRefusal::OursForeign
            }
            AlertDescription::CertificateExpired => HandshakeRefusal::OursEnded,
            AlertDescription::CertificateRequired => HandshakeRefusal::OursMissing,
            other => HandshakeRefusal::Ours(format!("{other:?}")),
        },
        other => HandshakeRefusal::Broken(other.to_string()),
    }
}

fn theirs(reason: &CertificateError, host: &str) -> HandshakeRefusal {
    match reason {
        CertificateError::UnknownIssuer | CertificateError::BadSignature => {
            HandshakeRefusal::OtherAuthority
        }
        CertificateError::Expired | CertificateError::ExpiredContext { .. } => {
            HandshakeRefusal::TheirsEnded
        }
        CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
            HandshakeRefusal::TheirsNotYetValid
        }
        CertificateError::NotValidForName => {
            HandshakeRefusal::OtherHost { host: host.to_owned(), names: Vec::new() }
        }
        CertificateError::NotValidForNameContext { presented, .. } => {
            HandshakeRefusal::OtherHost { host: host.to_owned(), names: presented.clone() }
        }
        other => HandshakeRefusal::Theirs(other.to_string()),
    }
}

fn list(names: &[String]) -> String {
    if names.is_empty() {
        return "nobody who dials".to_owned();
    }
    // A peer's names: escaped, and not endless.
    let quoted = names.iter().take(4).map(|name| format!("`{}`", plain(name).escape_debug()));
    quoted.collect::<Vec<_>>().join(", ")
}

/// Takes a name out of the form in which the TLS library lists it.
fn plain(name: &str) -> &str {
    let kinds = ["DnsName(\"", "IpAddress("];
    let inner = kinds.iter().find_map(|kind| name.strip_prefix(*kind));
    inner.map_or(name, |inner| inner.trim_end_matches(['"', ')']))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_a_certificate_are_written_as_they_are_dialled() {
        let names = ["DnsName(\"router.example\")", "IpAddress(10.0.0.1)", "IpAddress(fd00::1)"];
        let names = names.map(str::to_owned).to_vec();
        let told = HandshakeRefusal::OtherHost { host: "box".to_owned(), names }.to_string();
        let expected = "not for `box` but for `router.example`, `10.0.0.1`, `fd00::1`: issue it";
        assert!(told.contains(expected), "{told}");
        let names = vec!["\u{1b}[31m".to_owned()];
        let told = HandshakeRefusal::OtherHost { host: "box".to_owned(), names }.to_string();
        assert!(told.contains("for `\\u{1b}[31m`"), "{told}");
    }
}
