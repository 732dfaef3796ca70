//! What a process shows of itself, checked before it is shown.
//!
//! The network library reads these files at every connection, and reports whatever is wrong with them as a time-out. So
//! they are looked at first, by the rules that a peer will apply.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use rustls::RootCertStore;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, UnixTime};
use rustls::server::WebPkiClientVerifier;
use rustls::server::danger::ClientCertVerifier;
use rustls::sign::CertifiedKey;

use crate::error::Unfit;
use crate::{Certificate, Error, Result, files};

/// The most certificates that are read from one file.
const MAX_CERTIFICATES: usize = 16;

/// The certificate of this process, its key, and the authority by which it knows others: three files that fit together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    authority: PathBuf,
    certificate: PathBuf,
    key: PathBuf,
    /// What the certificate said when it was read.
    pub shown: Certificate,
}

impl Identity {
    /// Reads and checks `DIR/ID.pem` and `DIR/ID.key` with the authority's `DIR/ca.pem`, given `DIR/ID`.
    ///
    /// # Errors
    ///
    /// [`Error::File`] or [`Error::Content`] if a file is not there or is something else, [`Error::OpenKey`] if
    /// everybody can read the key, [`Error::Unfit`] if peers would refuse the certificate.
    pub fn read(prefix: &Path, now: Timestamp) -> Result<Self> {
        let is_file = prefix.extension().is_some_and(|extension| extension == "pem");
        let prefix = if is_file { prefix.with_extension("") } else { prefix.to_owned() };
        let beside = |extension: &str| prefix.with_added_extension(extension);
        let (certificate, key) = (beside("pem"), beside("key"));
        let authority = prefix.with_file_name("ca.pem");
        let (shown, chain) = {
            let chain = certificates(&certificate)?;
            let content = |found| Error::Content { path: certificate.clone(), found };
            (Certificate::from_der(&chain[0]).map_err(content)?, chain)
        };
        let identity = Self { authority, certificate, key, shown };
        identity.check(chain, now)?;
        Ok(identity)
    }

    /// Returns the file of the authority.
    pub fn authority(&self) -> &Path {
        &self.authority
    }

    /// Returns the file of the certificate.
    pub fn certificate(&self) -> &Path {
        &self.certificate
    }

    /// Returns the file of the key.
    pub fn key(&self) -> &Path {
        &self.key
    }

    fn check(&self, chain: Vec<CertificateDer<'static>>, now: Timestamp) -> Result<()> {
        let unfit = |reason| Error::Unfit { path: self.certificate.clone(), reason };
        files::check_key_is_secret(&self.key)?;
        let no_key = || Error::Content { path: self.key.clone(), found: "no key".to_owned() };
        let key = PrivateKeyDer::from_pem_slice(&files::read(&self.key)?);
        let provider = ring::default_provider();
        let key = key.map_err(|_odd| no_key())?;
        let key = provider.key_provider.load_private_key(key).map_err(|_odd| no_key())?;
        let pair = CertifiedKey::new(chain, key);
        let chain = match pair.keys_match() {
            Ok(()) => pair.cert,
            Err(_other) => return Err(unfit(Unfit::OtherKey(self.key.clone()))),
        };
        if now < self.shown.begins {
            return Err(unfit(Unfit::NotYetValid(self.shown.begins)));
        }
        if now > self.shown.ends {
            return Err(unfit(Unfit::Expired(self.shown.ends)));
        }
        if self.shown.name.is_none() {
            return Err(unfit(Unfit::Nameless));
        }
        if !self.shown.is_for_both_ends {
            return Err(unfit(Unfit::OneEnd));
        }
        if Signers::read(&self.authority)?.have_signed(&chain, now) {
            return Ok(());
        }
        Err(unfit(Unfit::OtherAuthority(self.authority.clone())))
    }
}

/// The authorities of a file, as those who may have signed a certificate.
#[derive(Debug)]
pub(crate) struct Signers(Arc<dyn ClientCertVerifier>);

impl Signers {
    /// Reads the authorities' certificates from a PEM file.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let (roots, provider) = (roots(path)?.into(), ring::default_provider().into());
        let verifier = WebPkiClientVerifier::builder_with_provider(roots, provider).build();
        let found = "no authority".to_owned();
        let none = |_empty| Error::Content { path: path.to_owned(), found };
        verifier.map(Self).map_err(none)
    }

    /// Returns whether one of them has signed the first certificate of a chain, and it is valid at that moment.
    pub(crate) fn have_signed(&self, chain: &[CertificateDer<'_>], moment: Timestamp) -> bool {
        let seconds = u64::try_from(moment.as_second()).unwrap_or_default();
        let moment = UnixTime::since_unix_epoch(Duration::from_secs(seconds));
        let Some((own, others)) = chain.split_first() else { return false };
        self.0.verify_client_cert(own, others, moment).is_ok()
    }
}

/// Reads the authorities of a file: two, while one takes the place of the other.
pub(crate) fn roots(path: &Path) -> Result<RootCertStore> {
    let mut roots = RootCertStore::empty();
    for root in certificates(path)? {
        let found = "a certificate that cannot be an authority's".to_owned();
        let content = |_odd| Error::Content { path: path.to_owned(), found };
        roots.add(root).map_err(content)?;
    }
    Ok(roots)
}

/// Reads the certificates of a file, one at least.
pub(crate) fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>> {
    let bytes = files::read(path)?;
    let read = CertificateDer::pem_slice_iter(&bytes).take(MAX_CERTIFICATES);
    match read.collect::<Result<Vec<_>, _>>() {
        Ok(found) if !found.is_empty() => Ok(found),
        _ => {
            let found = "no certificate in PEM form".to_owned();
            Err(Error::Content { path: path.to_owned(), found })
        }
    }
}
