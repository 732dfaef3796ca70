//! Making certificates: the authority, one for each process, and the same again before they end.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Read as _, Seek as _, Write as _};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use jiff::Timestamp;
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose, PublicKeyData, SerialNumber, SubjectPublicKeyInfo,
};
use rustls::pki_types::PrivateKeyDer;
use rustls::pki_types::pem::PemObject as _;
use time::OffsetDateTime;

use crate::files::{self, Durability, Readers, failed};
use crate::identity::{self, Signers};
use crate::{Certificate, Error, IssueRequest, PeerName, Result, Role, Unfit};

/// How long an authority lasts.
const AUTHORITY_LIFETIME: Duration = Duration::from_hours(24 * 3650);
/// The longest life of a certificate that can be asked for.
const MAX_LIFETIME: Duration = Duration::from_hours(24 * 36_500);
/// A certificate begins so long before it is made: the clocks of two machines differ.
const CLOCK_SKEW: Duration = Duration::from_mins(5);

/// In the keys of a notifier it stands beside the names of clients, and can be none of them.
const NO_ROBOT: &str = "alive";

/// The file that is written when certificates were renewed, after the last of them: processes that have to read new ones watch this.
const STAMP: &str = "renewed";

/// What a damaged file of serial numbers holds, and what helps.
const NO_SERIAL: &str = "no serial number: write the highest number of its certificates into it \
                         (`leadtime certs show`)";
/// What a damaged key holds, and what helps.
const NO_KEY: &str =
    "no private key, so its certificate is of no use: remove both, and issue them again";

/// A certificate that was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issued {
    /// What its process does.
    pub role: Role,
    /// The name of its process.
    pub name: PeerName,
    /// The file that it was written to.
    pub path: PathBuf,
    /// What the certificate states.
    pub certificate: Certificate,
}

/// The certificates of a directory.
#[derive(Debug, Default)]
pub struct Listing {
    /// Those that the directory's authority has issued, by name.
    pub issued: Vec<Issued>,
    /// What is wrong with the others that have such a file name and may be meant to be ours: they are none, or cannot be read,
    /// or are another authority's or another name's.
    pub left_out: Vec<Error>,
}

/// An authority in its directory; no other process can issue from it meanwhile.
#[derive(Debug)]
pub struct Authority {
    directory: PathBuf,
    ends: Timestamp,
    issuer: Issuer<'static, KeyPair>,
    /// Holds the last serial number, and the lock.
    serial: File,
}

impl Authority {
    /// Makes an authority in a directory, which is made if it is not there.
    ///
    /// # Errors
    ///
    /// [`Error::AuthorityExists`], [`Error::LoneKey`] if only the key of one is there, or [`Error::File`] if the directory cannot
    /// be written.
    pub fn create(directory: &Path, name: &str, now: Timestamp) -> Result<Certificate> {
        let [certificate, key, serial] = paths(directory);
        if files::holds_something(&certificate) {
            return Err(Error::AuthorityExists(directory.to_owned()));
        }
        check_no_lone_key(&certificate, &key)?;
        fs::create_dir_all(directory).map_err(failed("write", directory))?;
        let key_pair = KeyPair::generate()?;
        let mut params = CertificateParams::default();
        params.distinguished_name = DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        limit(&mut params, now, add(now, AUTHORITY_LIFETIME)?)?;
        let signed = params.self_signed(&key_pair)?;
        // The key first: a certificate says that everything is there.
        let flushed = Durability::Flushed;
        files::write(&serial, "0\n", Readers::Owner, flushed)?;
        files::write(&key, &key_pair.serialize_pem(), Readers::Owner, flushed)?;
        files::write(&certificate, &signed.pem(), Readers::Everybody, flushed)?;
        Certificate::read(&certificate)
    }

    /// Opens the authority of a directory.
    ///
    /// # Errors
    ///
    /// [`Error::NoAuthority`] if it is not there, [`Error::File`], [`Error::OpenKey`], [`Error::Content`],
    /// [`Error::AuthorityEnded`], or [`Error::Busy`] if another process has it.
    pub fn open(directory: &Path, now: Timestamp) -> Result<Self> {
        let [certificate, key, serial] = paths(directory);
        check_is_there(directory, &certificate)?;
        let text = |path: &Path| {
            let no_text = |_odd| "bytes that are no text".to_owned();
            String::from_utf8(files::read(path)?).map_err(no_text).map_err(content(path))
        };
        let pem = text(&certificate)?;
        files::check_key_is_secret(&key)?;
        let pair = KeyPair::from_pem(&text(&key)?).map_err(|_odd| "no private key".to_owned());
        let pair = pair.map_err(content(&key))?;
        // With two authorities in the file, during a change from one to the other, the first one signs.
        let read = Certificate::parse(pem.as_bytes()).map_err(content(&certificate))?;
        if read.public_key != pair.subject_public_key_info() {
            let found = "the key of another authority than ca.pem".to_owned();
            return Err(content(&key)(found));
        }
        if read.ends <= now {
            let (directory, ended) = (directory.to_owned(), read.ends);
            return Err(Error::AuthorityEnded { directory, ended });
        }
        let issuer = Issuer::from_ca_cert_pem(&pem, pair)?;
        let serial = files::lock(&serial, directory)?;
        Ok(Self { directory: directory.to_owned(), ends: read.ends, issuer, serial })
    }

    /// Makes key and certificate of a process.
    ///
    /// `hosts` are the names and addresses under which it is dialled; a process that only dials others needs none. The certificate ends
    /// after `lifetime`, or with the authority.
    ///
    /// # Errors
    ///
    /// [`Error::Taken`] if a certificate of that name is there, [`Error::LoneKey`] if only a key is, [`Error::Host`] if a host is
    /// neither a name nor an address, [`Error::Lifetime`] if the lifetime is under a second or over 100 years, [`Error::File`] or
    /// [`Error::Content`] if a file cannot be written or the serial number cannot be read.
    pub fn issue(
        &mut self,
        role: Role,
        name: &PeerName,
        hosts: &[String],
        lifetime: Duration,
        now: Timestamp,
    ) -> Result<Issued> {
        let request = IssueRequest { role, name: name.clone(), hosts: hosts.to_vec() };
        let mut issued = self.issue_all(&[request], lifetime, now)?;
        Ok(issued.remove(0))
    }

    /// Makes keys and certificates of several processes, or of none: if one cannot be made, there is none of the others
    /// either.
    ///
    /// # Errors
    ///
    /// Those of [`Authority::issue`], [`Error::Twice`], and [`Error::RobotName`].
    pub fn issue_all(
        &mut self,
        requests: &[IssueRequest],
        lifetime: Duration,
        now: Timestamp,
    ) -> Result<Vec<Issued>> {
        let mut names = BTreeSet::new();
        for IssueRequest { role, name, .. } in requests {
            if *role == Role::Robot && name.as_str() == NO_ROBOT {
                return Err(Error::RobotName(name.to_string()));
            }
            let [certificate, key] = self.files(name);
            if files::holds_something(&certificate) {
                return Err(Error::Taken(certificate));
            }
            check_no_lone_key(&certificate, &key)?;
            if !names.insert(name) {
                return Err(Error::Twice(name.to_string()));
            }
        }
        // Everything is signed before the first file is written.
        let mut signed = Vec::new();
        for IssueRequest { role, name, hosts } in requests {
            let key = KeyPair::generate()?;
            let pem = self.sign(*role, name, hosts, lifetime, now, &key)?;
            signed.push((*role, name, key.serialize_pem(), pem));
        }
        let write = |(role, name, key, pem): &(Role, &PeerName, String, String)| {
            let [path, key_path] = self.files(name);
            files::write(&key_path, key, Readers::Owner, Durability::Eventual)?;
            files::write(&path, pem, Readers::Everybody, Durability::Eventual)?;
            let certificate = Certificate::read(&path)?;
            Ok(Issued { role: *role, name: (*name).clone(), path, certificate })
        };
        let written: Result<Vec<Issued>> = signed.iter().map(write).collect();
        if written.is_err() {
            self.withdraw(requests);
        }
        written
    }

    /// Removes what [`Authority::issue_all`] has just made for these requests, which nobody has got yet.
    pub fn withdraw(&self, requests: &[IssueRequest]) {
        for file in requests.iter().flat_map(|request| self.files(&request.name)) {
            // What cannot be removed is told by the next try, as taken.
            drop(fs::remove_file(file));
        }
    }

    /// Returns the files of a process: its certificate, its key.
    fn files(&self, name: &PeerName) -> [PathBuf; 2] {
        ["pem", "key"].map(|extension| self.directory.join(format!("{name}.{extension}")))
    }

    /// Renews the certificates that end within `before`: for the same role, hosts and time, and for the same key, which
    /// need not be here. Those that [`Authority::list`] leaves out stay as they are. If there are any, the file `renewed` is
    /// written at the end; without any nothing is.
    ///
    /// # Errors
    ///
    /// [`Error::File`] if the directory cannot be read or written, [`Error::Content`] if the file of the authority, or that of
    /// a key that is here, holds something else.
    pub fn renew(&mut self, before: Duration, now: Timestamp) -> Result<Vec<Issued>> {
        let soon = add(now, before)?;
        let mut renewed = Self::list(&self.directory)?.issued;
        renewed.retain(|issued| issued.certificate.ends <= soon);
        // Before the first of them is made.
        renewed.iter().try_for_each(|issued| self.check_key(&issued.name))?;
        let mut made = Vec::new();
        let all_made: Result<()> = renewed.into_iter().try_for_each(|issued| {
            made.push(self.renew_one(issued, now)?);
            Ok(())
        });
        let (stamp, text) = (self.directory.join(STAMP), format!("{now}\n"));
        let stamped = || files::write(&stamp, &text, Readers::Everybody, Durability::Eventual);
        let told = if made.is_empty() { Ok(()) } else { stamped() };
        all_made.and(told).map(|()| made)
    }

    fn renew_one(&mut self, issued: Issued, now: Timestamp) -> Result<Issued> {
        let Issued { role, name, path, certificate: old } = issued;
        let key = SubjectPublicKeyInfo::from_der(&old.public_key)?;
        let lifetime = Duration::try_from(old.ends.duration_since(old.begins));
        let lifetime = lifetime.map_err(|_negative| Error::Lifetime)?;
        let lifetime = lifetime.saturating_sub(CLOCK_SKEW).max(Duration::from_secs(1));
        let pem = self.sign(role, &name, &old.hosts, lifetime, now, &key)?;
        files::write(&path, &pem, Readers::Everybody, Durability::Flushed)?;
        Ok(Issued { role, certificate: Certificate::read(&path)?, name, path })
    }

    /// Refuses a file in the place of a key that holds no key: its certificate would be renewed for nothing.
    fn check_key(&self, name: &PeerName) -> Result<()> {
        let [_, path] = self.files(name);
        let away = [io::ErrorKind::NotFound, io::ErrorKind::PermissionDenied];
        match files::read(&path) {
            Err(Error::File { source, .. }) if away.contains(&source.kind()) => Ok(()),
            Err(error) => Err(error),
            Ok(bytes) => match PrivateKeyDer::from_pem_slice(&bytes) {
                Ok(_) => Ok(()),
                Err(_odd) => Err(content(&path)(NO_KEY.to_owned())),
            },
        }
    }

    /// Lists what the authority of a directory has issued there, whether it is still valid or not.
    ///
    /// Other files may lie beside it. A certificate without one of our roles is passed over; what may have been meant as one
    /// is in [`Listing::left_out`].
    ///
    /// # Errors
    ///
    /// [`Error::NoAuthority`], or [`Error::File`] or [`Error::Content`] if the directory or the file of its authority cannot be
    /// read.
    pub fn list(directory: &Path) -> Result<Listing> {
        let [authority, ..] = paths(directory);
        check_is_there(directory, &authority)?;
        let signers = Signers::read(&authority)?;
        let entries = fs::read_dir(directory).map_err(failed("read", directory))?;
        let mut listing = Listing::default();
        for entry in entries {
            let path = entry.map_err(failed("read", directory))?.path();
            let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
            let Ok(name) = stem.parse::<PeerName>() else { continue };
            if path.extension().is_none_or(|extension| extension != "pem") {
                continue;
            }
            match look_at(path, name, &signers, &authority) {
                Ok(issued) => listing.issued.extend(issued),
                Err(error) => listing.left_out.push(error),
            }
        }
        listing.issued.sort_by(|one, other| one.name.cmp(&other.name));
        listing.left_out.sort_by_key(ToString::to_string);
        Ok(listing)
    }

    fn sign(
        &mut self,
        role: Role,
        name: &PeerName,
        hosts: &[String],
        lifetime: Duration,
        now: Timestamp,
        key: &impl PublicKeyData,
    ) -> Result<String> {
        if !(Duration::from_secs(1)..=MAX_LIFETIME).contains(&lifetime) {
            return Err(Error::Lifetime);
        }
        hosts.iter().try_for_each(|host| check_host(host))?;
        let mut params = CertificateParams::new(hosts.to_vec())?;
        params.distinguished_name = DistinguishedName::new();
        params.distinguished_name.push(DnType::OrganizationalUnitName, role.as_str());
        params.distinguished_name.push(DnType::CommonName, name.as_str());
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        params.use_authority_key_identifier_extension = true;
        limit(&mut params, now, add(now, lifetime)?.min(self.ends))?;
        params.serial_number = Some(SerialNumber::from(self.next_serial()?));
        Ok(params.signed_by(key, &self.issuer)?.pem())
    }

    /// Counts up the serial number, in its file first: no number is given twice.
    fn next_serial(&mut self) -> Result<u64> {
        let path = self.directory.join("serial");
        let mut bytes = Vec::new();
        let mut read = || {
            self.serial.rewind()?;
            self.serial.read_to_end(&mut bytes)
        };
        read().map_err(failed("read", &path))?;
        let text = String::from_utf8_lossy(&bytes);
        let last = text.trim();
        let last = if last.is_empty() { Ok(0) } else { last.parse::<u64>() };
        let next = last.ok().and_then(|last| last.checked_add(1));
        let next = next.ok_or_else(|| content(&path)(NO_SERIAL.to_owned()))?;
        let mut write = || {
            self.serial.rewind()?;
            // A number never has fewer digits than the one before it.
            self.serial.write_all(format!("{next}\n").as_bytes())?;
            // The certificate goes to the disk at once, and may not be there before its number is.
            self.serial.sync_data()
        };
        write().map_err(failed("write", &path))?;
        Ok(next)
    }
}

/// Reads a certificate that was issued here; `None` if it has no role of ours.
fn look_at(
    path: PathBuf,
    name: PeerName,
    signers: &Signers,
    authority: &Path,
) -> Result<Option<Issued>> {
    let chain = identity::certificates(&path)?;
    let certificate = Certificate::from_der(&chain[0]).map_err(content(&path))?;
    let Some(role) = certificate.role else { return Ok(None) };
    if certificate.name.as_deref() != Some(name.as_str()) {
        let of = certificate.name.as_deref().unwrap_or("nobody");
        let of: String = of.escape_debug().take(80).collect();
        return Err(content(&path)(format!("a certificate of `{of}`, not of `{name}`")));
    }
    // It may have ended since.
    if !signers.have_signed(&chain, certificate.begins) {
        let reason = Unfit::OtherAuthority(authority.to_owned());
        return Err(Error::Unfit { path, reason });
    }
    Ok(Some(Issued { role, name, path, certificate }))
}

fn paths(directory: &Path) -> [PathBuf; 3] {
    ["ca.pem", "ca.key", "serial"].map(|name| directory.join(name))
}

/// Refuses a directory without an authority.
fn check_is_there(directory: &Path, certificate: &Path) -> Result<()> {
    match fs::metadata(certificate) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(Error::NoAuthority(directory.to_owned()))
        }
        _ => Ok(()),
    }
}

/// Refuses a key without its certificate where both are about to be made: it may still be somebody's.
fn check_no_lone_key(certificate: &Path, key: &Path) -> Result<()> {
    if !files::holds_something(key) {
        return Ok(());
    }
    Err(Error::LoneKey { key: key.to_owned(), certificate: certificate.to_owned() })
}

fn content(path: &Path) -> impl FnOnce(String) -> Error + use<> {
    let path = path.to_owned();
    move |found| Error::Content { path, found }
}

/// Gives a certificate its beginning and its end; without them it would last from 1975 to 4096.
fn limit(params: &mut CertificateParams, now: Timestamp, end: Timestamp) -> Result<()> {
    let date = |moment: Timestamp| {
        OffsetDateTime::from_unix_timestamp(moment.as_second()).map_err(|_beyond| Error::Lifetime)
    };
    params.not_before = date(now.checked_sub(CLOCK_SKEW).map_err(|_beyond| Error::Lifetime)?)?;
    params.not_after = date(end)?;
    Ok(())
}

fn add(now: Timestamp, time: Duration) -> Result<Timestamp> {
    now.checked_add(time).map_err(|_beyond| Error::Lifetime)
}

/// Refuses what no one can be dialled under.
fn check_host(host: &str) -> Result<()> {
    let label = |label: &str| {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        (1..=63).contains(&label.len()) && label.chars().all(plain)
    };
    let is_name = host.len() <= 253 && host.split('.').all(label);
    if is_name || host.parse::<IpAddr>().is_ok() {
        return Ok(());
    }
    Err(Error::Host(host.chars().take(80).collect()))
}
