//! TLS as the network library wants it: settings, and which addresses go with a certificate.

use std::path::Path;

use leadtime_certs::Identity;

use crate::{Endpoint, Error, Result};

type Setting = (&'static str, String);

/// Checks that addresses and certificate belong together: with one nothing goes out in the clear, without one no address
/// asks for it.
pub(crate) fn check(endpoints: &[Endpoint], identity: Option<&Identity>) -> Result<()> {
    for endpoint in endpoints {
        let (protocol, _, settings) = endpoint.parts();
        match (protocol, identity) {
            ("tcp", Some(_)) => return Err(Error::NotEncrypted(endpoint.plain().to_owned())),
            ("tls", Some(_)) if !settings.is_empty() => {
                return Err(Error::TlsTwice(endpoint.plain().to_owned()));
            }
            // Its certificates may be behind the address.
            ("tls", None) if settings.is_empty() => {
                return Err(Error::NoCertificate(endpoint.plain().to_owned()));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Tells whether one of the addresses is a unix socket.
pub(crate) fn has_socket<'a>(mut endpoints: impl Iterator<Item = &'a Endpoint>) -> bool {
    endpoints.any(|endpoint| endpoint.parts().0 == "unixsock-stream")
}

/// Returns the settings of a session with a certificate.
///
/// The library reads the files again whenever it dials, so replaced ones are used without a new session. It ends a
/// connection in the second in which the certificate of the other side does.
pub(crate) fn settings(identity: &Identity, has_socket: bool) -> Result<Vec<Setting>> {
    const TLS: [&str; 8] = [
        "transport/link/tls/root_ca_certificate",
        "transport/link/tls/listen_certificate",
        "transport/link/tls/listen_private_key",
        "transport/link/tls/connect_certificate",
        "transport/link/tls/connect_private_key",
        "transport/link/tls/enable_mtls",
        "transport/link/tls/verify_name_on_connect",
        "transport/link/tls/close_link_on_expiration",
    ];
    let authority = quoted(identity.authority())?;
    let (certificate, key) = (quoted(identity.certificate())?, quoted(identity.key())?);
    let yes = || "true".to_owned();
    let values =
        [authority, certificate.clone(), key.clone(), certificate, key, yes(), yes(), yes()];
    let protocols = if has_socket { "[\"tls\",\"unixsock-stream\"]" } else { "[\"tls\"]" };
    let mut settings: Vec<Setting> = TLS.into_iter().zip(values).collect();
    settings.push(("transport/link/protocols", protocols.to_owned()));
    Ok(settings)
}

/// Quotes a path and makes it absolute, because sessions outlive changes of directory. The library separates settings by special characters.
fn quoted(path: &Path) -> Result<String> {
    let odd = |c: char| matches!(c, ';' | '=' | '|' | '#' | '"' | '\\') || c.is_control();
    let whole = std::path::absolute(path).ok();
    let text = whole.as_deref().and_then(Path::to_str).filter(|text| !text.contains(odd));
    text.map(|text| format!("\"{text}\"")).ok_or_else(|| Error::TlsPath(path.to_owned()))
}
