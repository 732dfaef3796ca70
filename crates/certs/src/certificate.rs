//! What a certificate says.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::path::Path;

use jiff::Timestamp;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject as _;
use x509_parser::certificate::X509Certificate;
use x509_parser::extensions::GeneralName;
use x509_parser::prelude::FromDer as _;

use crate::{Error, Result, Role, files};

/// The most alternative names that are read.
const MAX_HOSTS: usize = 256;

/// What the first certificate of a file says. Its texts are anybody's: escape them before printing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certificate {
    /// The common name: the name of the process, as the access list has it.
    pub name: Option<String>,
    /// The organisational unit, if it is one of our roles.
    pub role: Option<Role>,
    /// Names and addresses under which its owner can be dialled.
    pub hosts: Vec<String>,
    /// The first moment at which it is valid.
    pub begins: Timestamp,
    /// The last moment at which it is valid.
    pub ends: Timestamp,
    /// Whether it can sign others.
    pub is_authority: bool,
    /// Whether it is for the end that listens, and for the one that dials.
    pub is_for_both_ends: bool,
    /// The public key with its algorithm, in DER.
    pub(crate) public_key: Vec<u8>,
}

impl Certificate {
    /// Reads the first certificate of a PEM file.
    ///
    /// # Errors
    ///
    /// [`Error::File`] if the file cannot be read, [`Error::Content`] if it holds no certificate, or a damaged one.
    pub fn read(path: &Path) -> Result<Self> {
        let content = |found: String| Error::Content { path: path.to_owned(), found };
        Self::parse(&files::read(path)?).map_err(content)
    }

    /// Reads the first certificate of PEM text, or says what is there instead.
    ///
    /// # Errors
    ///
    /// A fragment such as `no certificate in PEM form`, if there is none or it is damaged.
    pub fn parse(pem: &[u8]) -> Result<Self, String> {
        let none = |_unspecific| "no certificate in PEM form".to_owned();
        Self::from_der(&CertificateDer::from_pem_slice(pem).map_err(none)?)
    }

    /// Reads a certificate in DER, as a peer shows it, or says what is there instead.
    ///
    /// # Errors
    ///
    /// A fragment such as `a certificate that is damaged`, if it is damaged or followed by anything.
    pub fn from_der(der: &[u8]) -> Result<Self, String> {
        let damaged = || "a certificate that is damaged".to_owned();
        let (rest, certificate) = X509Certificate::from_der(der).map_err(|_odd| damaged())?;
        if !rest.is_empty() {
            return Err(damaged());
        }
        let time = |seconds: i64| Timestamp::from_second(seconds).map_err(|_beyond| damaged());
        let (subject, validity) = (certificate.subject(), certificate.validity());
        let name = subject.iter_common_name().next().and_then(|name| name.as_str().ok());
        let unit = subject.iter_organizational_unit().next().and_then(|unit| unit.as_str().ok());
        let names = certificate.subject_alternative_name().map_err(|_odd| damaged())?;
        let names = names.iter().flat_map(|names| &names.value.general_names);
        let usage = certificate.extended_key_usage().map_err(|_odd| damaged())?;
        let usage = usage.map(|usage| usage.value);
        Ok(Self {
            name: name.map(str::to_owned),
            role: unit.and_then(|unit| unit.parse().ok()),
            hosts: names.filter_map(host).take(MAX_HOSTS).collect(),
            begins: time(validity.not_before.timestamp())?,
            ends: time(validity.not_after.timestamp())?,
            is_authority: certificate.is_ca(),
            // Without the extension it is for everything.
            is_for_both_ends: usage
                .is_none_or(|usage| usage.any || (usage.server_auth && usage.client_auth)),
            public_key: certificate.public_key().raw.to_owned(),
        })
    }
}

fn host(name: &GeneralName<'_>) -> Option<String> {
    match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => {
            let v4 = <[u8; 4]>::try_from(*bytes).map(|bytes| IpAddr::V4(Ipv4Addr::from(bytes)));
            let v6 = <[u8; 16]>::try_from(*bytes).map(|bytes| IpAddr::V6(Ipv6Addr::from(bytes)));
            v4.or(v6).ok().map(|address| address.to_string())
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use leadtime_numerics::Pcg64;

    use super::*;
    use crate::Authority;

    #[test]
    fn a_damaged_certificate_is_read_or_refused_but_ends_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let now = Timestamp::from_second(1_700_000_000).unwrap();
        Authority::create(dir.path(), "Test", now).unwrap();
        let hosts = ["box.example".to_owned(), "10.0.0.1".to_owned()];
        let lifetime = std::time::Duration::from_hours(24);
        let mut authority = Authority::open(dir.path(), now).unwrap();
        let name = "a1".parse().unwrap();
        let made = authority.issue(Role::Actor, &name, &hosts, lifetime, now).unwrap();
        let der = CertificateDer::from_pem_file(made.path).unwrap();
        assert!(Certificate::from_der(&der).is_ok());
        let (mut draws, mut n_refused) = (Pcg64::seed_from_u64(7), 0);
        for round in 0..20_000 {
            let mut bytes = der.to_vec();
            for _ in 0..=round % 4 {
                let place = draws.below(bytes.len());
                bytes[place] ^= 1 << draws.below(8);
            }
            if round % 5 == 0 {
                bytes.truncate(draws.below(bytes.len()));
            }
            n_refused += u32::from(Certificate::from_der(&bytes).is_err());
        }
        assert!(n_refused > 4_000, "{n_refused}");
        for noise in [&b""[..], b"-----BEGIN CERTIFICATE-----", &[0xff; 4_096]] {
            Certificate::parse(noise).unwrap_err();
        }
    }
}
