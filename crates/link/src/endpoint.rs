//! Addresses, checked before anything is opened, so that a typo is reported as a typo.

use std::fmt;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileTypeExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use zenoh::config::EndPoint;

use crate::Error;

/// Longest path of a Unix socket: the kernel's 107 less the lock file's `.lock`.
const MAX_SOCKET_PATH: usize = 100;
const NO_PROTOCOL: &str =
    "it must start with `tcp/`, `tls/` or `unixsock-stream/`, as in `tcp/127.0.0.1:7447`";
const NO_PORT: &str = "it has no port; write HOST:PORT, as in `127.0.0.1:7447`";
const NO_HOST_AND_PORT: &str = "it needs a host and a port, as in `tcp/127.0.0.1:7447`";
const ODD_CHARACTER: &str =
    "it holds a quotation mark, a backslash, a space or a control character";

/// An address that can be listened on or connected to, such as `tcp/127.0.0.1:7447` (or `127.0.0.1:7447` for short).
///
/// `tls/` takes its certificates from the settings of the session, or from behind a `#`, as
/// `tls/host:7447#root_ca_certificate_file=ca.pem`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint(String);

impl Endpoint {
    /// Returns the address as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns protocol, address and settings.
    pub(crate) fn parts(&self) -> (&str, &str, &str) {
        let (protocol, rest) = self.0.split_once('/').unwrap_or_default();
        let (address, settings) = rest.split_once('#').unwrap_or((rest, ""));
        (protocol, address.split('?').next().unwrap_or_default(), settings)
    }

    /// Returns the address as a person reads it, without its settings.
    pub(crate) fn plain(&self) -> &str {
        self.0.split('#').next().unwrap_or_default()
    }

    /// Reads an address as a person writes it whose process has a certificate: without a protocol it is TLS.
    ///
    /// # Errors
    ///
    /// [`Error::Endpoint`].
    pub fn encrypted(text: &str) -> Result<Self, Error> {
        Self::read(text, "tls")
    }

    /// Reads an address, which is of this protocol if it names none.
    fn read(text: &str, protocol: &str) -> Result<Self, Error> {
        let whole = if text.contains('/') { text.to_owned() } else { format!("{protocol}/{text}") };
        match Self::check(&whole) {
            Ok(()) => Ok(Self(whole)),
            // As it was written.
            Err(problem) => Err(Error::Endpoint { endpoint: text.to_owned(), problem }),
        }
    }

    /// Tells whether other machines can reach this address without showing who they are: neither local nor TLS with
    /// certificates on both sides, which every session with a certificate of its own asks for.
    pub fn is_open_to_strangers(&self) -> bool {
        let (protocol, _, settings) = self.parts();
        match protocol {
            "tcp" => self.is_beyond_this_machine(),
            "tls" => !settings.split(';').any(|setting| setting == "enable_mtls=true"),
            _ => false,
        }
    }

    /// Tells whether other machines can reach this address.
    pub fn is_beyond_this_machine(&self) -> bool {
        let Some(host) = self.host() else { return false };
        let ip = host.trim_matches(['[', ']']).parse::<std::net::IpAddr>();
        host != "localhost" && !ip.is_ok_and(|ip| ip.is_loopback())
    }

    /// Returns the host; `None` for a socket.
    pub(crate) fn host(&self) -> Option<&str> {
        let (protocol, address, _) = self.parts();
        let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
        (protocol != "unixsock-stream").then_some(host)
    }

    /// Returns the file of the certificate that a process shows here, if its settings name one.
    pub fn certificate(&self) -> Option<PathBuf> {
        let (_, _, settings) = self.parts();
        let files = settings.split(';').filter_map(|setting| setting.split_once('='));
        let ours = ["listen_certificate_file", "connect_certificate_file"];
        files.filter(|(name, _)| ours.contains(name)).map(|(_, path)| path.into()).next()
    }

    /// Checks the address before a session listens there: the network library removes any file that exists where
    /// its socket, or the lock beside it, is to be.
    pub(crate) fn check_listen(&self) -> Result<(), Error> {
        self.check_files()?;
        let ("unixsock-stream", address, _) = self.parts() else { return Ok(()) };
        let path = Path::new(address);
        let lock = path.with_added_extension("lock");
        // A symbolic link is looked at itself, not what it points to: the link is what would be removed.
        let found = path.symlink_metadata();
        if found.as_ref().is_ok_and(|found| !found.file_type().is_socket()) {
            return Err(Error::NotASocket(path.to_owned()));
        }
        // A lock file of the library's own is empty.
        if lock.symlink_metadata().is_ok_and(|found| !found.is_file() || found.len() > 0) {
            return Err(Error::NotASocket(lock));
        }
        // Some other program's socket has no lock that would protect it; one where nobody answers is left over.
        if found.is_ok() && UnixStream::connect(path).is_ok() {
            return Err(Error::AddressInUse(self.plain().to_owned()));
        }
        Ok(())
    }

    /// Checks that the files which the settings name can be read: the library reports one that cannot as a time-out.
    pub(crate) fn check_files(&self) -> Result<(), Error> {
        let (_, _, settings) = self.parts();
        let files = settings.split(';').filter_map(|setting| setting.split_once('='));
        for (setting, path) in files.filter(|(setting, _)| setting.ends_with("_file")) {
            open_file(Path::new(path)).map_err(|source| Error::TlsFile {
                setting: setting.to_owned(),
                path: path.into(),
                source,
            })?;
        }
        Ok(())
    }

    /// Says what is wrong with an address, if anything is.
    fn check(text: &str) -> Result<(), String> {
        let odd = |c: char| matches!(c, '"' | '\\' | '\'') || c.is_control() || c.is_whitespace();
        if text.contains(odd) {
            return Err(ODD_CHARACTER.to_owned());
        }
        let (protocol, rest) = text.split_once('/').ok_or(NO_PROTOCOL)?;
        let address = rest.split(['?', '#']).next().unwrap_or_default();
        match protocol {
            "tcp" | "tls" => {
                let (host, port) = address.rsplit_once(':').ok_or(NO_PORT)?;
                if host.is_empty() || port.parse::<u16>().is_err() {
                    return Err(NO_HOST_AND_PORT.to_owned());
                }
            }
            "unixsock-stream" if !(1..=MAX_SOCKET_PATH).contains(&address.len()) => {
                let found = address.len();
                return Err(format!(
                    "the socket's path has {found} bytes; 1 to {MAX_SOCKET_PATH} are possible"
                ));
            }
            "unixsock-stream" => {}
            _ => return Err(NO_PROTOCOL.to_owned()),
        }
        EndPoint::from_str(text).map(drop).map_err(|_unspecific| "its syntax is wrong".to_owned())
    }
}

/// Opens what the library reads as a file. A pipe would keep its reader waiting for ever.
fn open_file(path: &Path) -> io::Result<File> {
    if path.metadata()?.is_file() {
        return File::open(path);
    }
    Err(io::Error::other("it is not a file"))
}

impl FromStr for Endpoint {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        // An address as everybody else writes it.
        Self::read(text, "tcp")
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use std::error::Error as _;
    use std::process::Command;

    use super::*;

    #[test]
    fn a_typo_in_an_address_is_reported_as_what_it_is() {
        let long = format!("unixsock-stream//{}", "x".repeat(100));
        for (text, problem) in [
            ("127.0.0.1:7447", NO_PROTOCOL),
            ("http/host:1", NO_PROTOCOL),
            ("tcp/host", NO_PORT),
            ("tcp/:7447", NO_HOST_AND_PORT),
            ("tcp/host:99999", NO_HOST_AND_PORT),
            ("tcp/host :1", ODD_CHARACTER),
            ("tcp/a\":1", ODD_CHARACTER),
            ("unixsock-stream/", "the socket's path has 0 bytes; 1 to 100 are possible"),
            (long.as_str(), "the socket's path has 101 bytes; 1 to 100 are possible"),
        ] {
            assert_eq!(Endpoint::check(text), Err(problem.to_owned()), "{text}");
        }
        for read in ["foo".parse::<Endpoint>(), Endpoint::encrypted("foo")] {
            let told = read.unwrap_err().to_string();
            assert_eq!(told, format!("`foo` is not an address: {NO_PORT}"));
        }
    }

    fn endpoint(text: &str) -> Endpoint {
        text.parse().unwrap()
    }

    #[test]
    fn only_addresses_that_others_can_reach_without_a_certificate_are_open() {
        for closed in [
            "tcp/127.0.0.1:7447",
            "tcp/127.0.0.2:7447",
            "tcp/[::1]:0",
            "tcp/localhost:1",
            "unixsock-stream//tmp/a",
            "tls/h:1#listen_certificate_file=l.pem;enable_mtls=true",
        ] {
            assert_eq!(endpoint(closed).as_str(), closed);
            assert!(!endpoint(closed).is_open_to_strangers(), "{closed}");
        }
        for open in ["tcp/0.0.0.0:7447", "tcp/box.example.org:1", "tls/0.0.0.0:1", "tcp/[::]:1"] {
            assert!(endpoint(open).is_open_to_strangers(), "{open}");
        }
        assert_eq!(endpoint("127.0.0.1:7447").as_str(), "tcp/127.0.0.1:7447");
    }

    #[test]
    fn a_file_where_a_socket_is_to_be_stays_what_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let listen = |name: &str| {
            endpoint(&format!("unixsock-stream/{}", at(name).display())).check_listen()
        };
        std::fs::write(at("file"), b"precious").unwrap();
        std::os::unix::fs::symlink(at("file"), at("link")).unwrap();
        std::fs::write(at("z.lock"), b"precious").unwrap();
        for name in ["file", "link", "z"] {
            let error = listen(name).unwrap_err();
            assert!(error.to_string().contains("a file exists at"), "{error}");
        }
        for name in ["file", "z.lock"] {
            assert_eq!(std::fs::read(at(name)).unwrap(), b"precious");
        }
        listen("new").unwrap();
        let socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        assert!(matches!(listen("socket").unwrap_err(), Error::AddressInUse { .. }));
        drop(socket);
        listen("socket").expect("nobody listens there any more");
    }

    #[test]
    fn a_certificate_that_cannot_be_read_is_named() {
        let error = endpoint("tls/h:1#root_ca_certificate_file=/no/ca.pem;enable_mtls=true");
        let error = error.check_files().unwrap_err().to_string();
        assert_eq!(error, "`root_ca_certificate_file` of the address: cannot read /no/ca.pem");
    }

    #[test]
    fn a_pipe_is_no_certificate_and_nobody_waits_for_it() {
        let place = tempfile::tempdir().unwrap();
        let pipe = place.path().join("ca.pem");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let error = endpoint(&format!("tls/h:1#root_ca_certificate_file={}", pipe.display()));
        let error = error.check_files().unwrap_err();
        assert_eq!(error.source().unwrap().to_string(), "it is not a file");
    }
}
