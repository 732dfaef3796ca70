//! Making certificates, reading them, and refusing what peers would refuse.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use leadtime_certs::{Authority, Certificate, Error, Identity, IssueRequest, Issued, Role, Unfit};

const DAY: Duration = Duration::from_hours(24);

fn now() -> Timestamp {
    "2026-01-31T12:00:00Z".parse().unwrap()
}

fn later(time: Duration) -> Timestamp {
    now() + time
}

fn authority(directory: &Path) -> Authority {
    Authority::create(directory, "Test", now()).unwrap();
    Authority::open(directory, now()).unwrap()
}

fn issue(authority: &mut Authority, role: Role, name: &str) -> Issued {
    let hosts = ["box.example".to_owned(), "10.0.0.1".to_owned(), "fe80::1".to_owned()];
    authority.issue(role, &name.parse().unwrap(), &hosts, 90 * DAY, now()).unwrap()
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o777
}

#[test]
fn a_certificate_says_who_where_and_how_long() {
    let dir = tempfile::tempdir().unwrap();
    let pki = dir.path().join("pki");
    let mut authority = authority(&pki);
    let Issued { certificate, path, .. } = issue(&mut authority, Role::Actor, "a7");
    assert_eq!(certificate, Certificate::read(&path).unwrap());
    assert_eq!((certificate.name.as_deref(), certificate.role), (Some("a7"), Some(Role::Actor)));
    assert_eq!(certificate.hosts, ["box.example", "10.0.0.1", "fe80::1"]);
    assert_eq!(certificate.begins, now() - Duration::from_mins(5));
    assert_eq!(certificate.ends, later(90 * DAY));
    assert!(certificate.is_for_both_ends && !certificate.is_authority);
    let modes = ["ca.key", "a7.key", "ca.pem", "a7.pem"].map(|name| mode(&pki.join(name)));
    assert_eq!(modes, [0o600, 0o600, 0o644, 0o644]);
    let ca = Certificate::read(&pki.join("ca.pem")).unwrap();
    assert!(ca.is_authority && ca.role.is_none());
    let identity = Identity::read(&pki.join("a7"), now()).unwrap();
    assert_eq!(identity, Identity::read(&path, now()).unwrap(), "with or without `.pem`");
    assert_eq!(identity.shown, certificate);
}

#[test]
fn another_program_takes_a_certificate_for_one_of_its_authority() {
    let openssl = |arguments: &[&str]| Command::new("openssl").args(arguments).output();
    if !openssl(&["version"]).is_ok_and(|done| done.status.success()) {
        println!("skipped: there is no openssl here");
        return;
    }
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let issued = issue(&mut authority(dir.path()), Role::Actor, "a1");
    drop(authority(other.path()));
    let (leaf, at) = (issued.path.to_str().unwrap(), now().as_second().to_string());
    let verify = |directory: &Path| {
        let ca = directory.join("ca.pem");
        let ca = ca.to_str().unwrap();
        openssl(&["verify", "-attime", &at, "-CAfile", ca, leaf]).unwrap()
    };
    let done = verify(dir.path());
    let (told, error) =
        (String::from_utf8_lossy(&done.stdout), String::from_utf8_lossy(&done.stderr));
    assert!(done.status.success() && told.trim() == format!("{leaf}: OK"), "{told}{error}");
    assert!(!verify(other.path()).status.success(), "of another authority");
}

#[test]
fn a_fleet_of_certificates_has_a_number_each_and_is_listed() {
    let dir = tempfile::tempdir().unwrap();
    let mut authority = authority(dir.path());
    let started = Instant::now();
    for number in 0..200 {
        issue(&mut authority, Role::Actor, &format!("a{number}"));
    }
    println!("200 certificates in {:?}", started.elapsed());
    assert_eq!(fs::read_to_string(dir.path().join("serial")).unwrap(), "200\n");
    let listed = Authority::list(dir.path()).unwrap();
    assert_eq!((listed.issued.len(), listed.left_out.len()), (200, 0));
}

#[test]
fn other_files_beside_the_certificates_are_neither_listed_nor_renewed() {
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let at = |name: &str| dir.path().join(name);
    let mut ours = authority(dir.path());
    let own = issue(&mut ours, Role::Actor, "a1");
    let foreign = issue(&mut authority(other.path()), Role::Actor, "a2");
    fs::copy(foreign.path, at("a2.pem")).unwrap();
    fs::copy(&own.path, at("copy.pem")).unwrap();
    fs::copy(at("a1.key"), at("a-key.pem")).unwrap();
    fs::create_dir(at("folder.pem")).unwrap();
    fs::write(at("torn.pem"), "-----BEGIN CERTIFICATE-----").unwrap();
    // These are clearly something else, and are passed over in silence.
    fs::copy(at("ca.pem"), at("site.pem")).unwrap();
    fs::write(at("notes.txt"), "").unwrap();
    fs::write(at("Dhparam.pem"), "").unwrap();
    let listed = Authority::list(dir.path()).unwrap();
    assert_eq!(listed.issued, [own]);
    let told: Vec<String> = listed.left_out.iter().map(ToString::to_string).collect();
    let parts = [
        "no certificate",
        "not signed by",
        "a certificate of `a1`",
        "no certificate",
        "cannot read",
    ];
    assert_eq!(told.len(), parts.len(), "{told:?}");
    assert!(told.iter().zip(parts).all(|(told, part)| told.contains(part)), "{told:?}");
    let before = contents(dir.path());
    assert_eq!(ours.renew(30 * DAY, later(DAY)).unwrap(), []);
    assert!(contents(dir.path()) == before);
    let renewed = ours.renew(365 * DAY, later(91 * DAY)).unwrap();
    assert_eq!(renewed.iter().map(|it| it.name.as_str()).collect::<Vec<_>>(), ["a1"]);
}

/// Lists what is in a directory, with what it holds; but for the serial number, of which none is given twice.
fn contents(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    let files = entries.filter(|path| !path.ends_with("serial") && path.is_file());
    files.map(|path| (path.display().to_string(), fs::read(&path).unwrap())).collect()
}

#[test]
fn several_are_issued_together_or_not_at_all() {
    let dir = tempfile::tempdir().unwrap();
    let mut authority = authority(dir.path());
    issue(&mut authority, Role::Actor, "a9");
    let before = contents(dir.path());
    let requests = |texts: &[&str]| -> Vec<IssueRequest> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    };
    // The third one cannot be made.
    for third in ["actor:a9", "learner:l1@a/b", "observer:r1", "robot:alive"] {
        let wanted = requests(&["router:r1@gate", "actor:a1", third]);
        let error = authority.issue_all(&wanted, DAY, now()).unwrap_err();
        let of_name = matches!(error, Error::Taken(_) | Error::Twice(_) | Error::RobotName(_));
        assert!(of_name || matches!(error, Error::Host(_)), "{third}: {error}");
        assert_eq!(contents(dir.path()), before, "{third}");
    }
    let wanted = requests(&["router:r1@gate,10.0.0.1", "actor:a1", "observer:o1"]);
    authority.issue_all(&wanted, Duration::ZERO, now()).unwrap_err();
    assert_eq!(contents(dir.path()), before);

    let issued = authority.issue_all(&wanted, DAY, now()).unwrap();
    let made = |it: &Issued| (it.role, it.name.to_string(), it.certificate.hosts.clone());
    assert_eq!(
        issued.iter().map(made).collect::<Vec<_>>(),
        wanted
            .iter()
            .map(|it| (it.role, it.name.to_string(), it.hosts.clone()))
            .collect::<Vec<_>>()
    );
    for name in ["r1", "a1", "o1"] {
        Identity::read(&dir.path().join(name), now()).unwrap();
    }
    authority.withdraw(&wanted);
    assert_eq!(contents(dir.path()), before);
    authority.issue_all(&requests(&["actor:alive"]), DAY, now()).expect("no client of a notifier");
}

#[test]
fn files_that_exist_are_not_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let mut first = authority(dir.path());
    issue(&mut first, Role::Learner, "l1");
    let again = first.issue(Role::Actor, &"l1".parse().unwrap(), &[], DAY, now());
    assert!(matches!(again.unwrap_err(), Error::Taken(_)));
    assert!(matches!(Authority::open(dir.path(), now()).unwrap_err(), Error::Busy(_)));
    let another = Authority::create(dir.path(), "Test", now()).unwrap_err();
    assert!(matches!(another, Error::AuthorityExists(_)));
    for (hosts, lifetime) in [(vec!["a b".to_owned()], DAY), (Vec::new(), Duration::ZERO)] {
        let name = "a1".parse().unwrap();
        first.issue(Role::Actor, &name, &hosts, lifetime, now()).unwrap_err();
    }
}

#[test]
fn a_key_that_a_kill_left_alone_is_named_and_an_empty_one_is_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    // What is left if the authority's certificate was not written any more.
    fs::write(at("ca.key"), "a key").unwrap();
    let error = Authority::create(dir.path(), "Test", now()).unwrap_err();
    assert!(matches!(&error, Error::LoneKey { key, .. } if *key == at("ca.key")), "{error}");
    fs::write(at("ca.key"), "").unwrap();
    let mut authority = authority(dir.path());

    let before = contents(dir.path());
    fs::write(at("a1.key"), "a key").unwrap();
    let wanted: [IssueRequest; 2] = ["actor:a1", "actor:a2"].map(|text| text.parse().unwrap());
    let error = authority.issue_all(&wanted, DAY, now()).unwrap_err();
    let told = error.to_string();
    let (key, pem) = (at("a1.key"), at("a1.pem"));
    let start = format!("{} is there without its certificate {}", key.display(), pem.display());
    assert!(told.starts_with(&start) && told.contains("remove the key"), "{told}");
    assert_eq!(fs::read(&key).unwrap(), b"a key");
    fs::remove_file(&key).unwrap();
    assert_eq!(contents(dir.path()), before, "nothing was issued");

    // A power cut leaves empty files, with the mode of whoever made them.
    for name in ["a1.key", "a1.pem", "a2.key"] {
        fs::write(at(name), "").unwrap();
    }
    authority.issue_all(&wanted, DAY, now()).unwrap();
    assert_eq!(mode(&key), 0o600);
    for name in ["a1", "a2"] {
        Identity::read(&at(name), now()).unwrap();
    }
}

#[test]
fn a_certificate_that_ends_soon_is_renewed_with_its_key() {
    let dir = tempfile::tempdir().unwrap();
    let mut authority = authority(dir.path());
    let old = issue(&mut authority, Role::Actor, "a7");
    let key = fs::read(dir.path().join("a7.key")).unwrap();
    // Keys may be elsewhere: only the machine of the process needs it.
    fs::remove_file(dir.path().join("a7.key")).unwrap();
    let month = 30 * DAY;
    assert_eq!(authority.renew(month, later(59 * DAY)).unwrap(), []);
    let renewed = authority.renew(month, later(61 * DAY)).unwrap();
    assert_eq!(renewed.len(), 1);
    let new = &renewed[0].certificate;
    assert_eq!(new.ends, later(151 * DAY));
    assert_eq!((&new.hosts, new.role), (&old.certificate.hosts, Some(Role::Actor)));
    fs::write(dir.path().join("a7.key"), key).unwrap();
    fs::set_permissions(dir.path().join("a7.key"), fs::Permissions::from_mode(0o600)).unwrap();
    Identity::read(&dir.path().join("a7"), later(149 * DAY)).unwrap();
}

#[test]
fn who_watches_for_new_certificates_hears_of_them_once_and_of_nothing_else() {
    let unit = include_str!("../../../deploy/systemd/leadtime-new-certs.path");
    assert!(unit.contains("\nPathChanged=/etc/leadtime/tls/renewed\n"), "{unit}");
    let dir = tempfile::tempdir().unwrap();
    let directory = dir.path().canonicalize().unwrap();
    let (stamp, serial) = (directory.join("renewed"), directory.join("serial"));
    let mut authority = authority(&directory);
    for name in ["a1", "a2"] {
        issue(&mut authority, Role::Actor, name);
    }
    let before = contents(&directory);
    assert_eq!(authority.renew(30 * DAY, now()).unwrap(), []);
    assert_eq!(contents(&directory), before);
    assert_eq!(fs::read_to_string(&serial).unwrap(), "2\n");
    assert_eq!(authority.renew(30 * DAY, later(61 * DAY)).unwrap().len(), 2);
    let first = fs::read_to_string(&stamp).unwrap();
    assert_eq!(authority.renew(30 * DAY, later(62 * DAY)).unwrap(), []);
    assert_eq!(fs::read_to_string(&stamp).unwrap(), first);
}

#[test]
fn a_certificate_never_outlives_its_authority() {
    let dir = tempfile::tempdir().unwrap();
    let mut authority = authority(dir.path());
    let name = "a1".parse().unwrap();
    let long = authority.issue(Role::Actor, &name, &[], 36_500 * DAY, now()).unwrap();
    let ends = Certificate::read(&dir.path().join("ca.pem")).unwrap().ends;
    assert_eq!(long.certificate.ends, ends);
    drop(authority);
    let late = Authority::open(dir.path(), ends).unwrap_err();
    assert!(matches!(late, Error::AuthorityEnded { .. }));
}

#[test]
fn a_certificate_that_peers_would_refuse_is_refused_here_first() {
    let dir = tempfile::tempdir().unwrap();
    let mut authority = authority(dir.path());
    for name in ["a1", "a2"] {
        issue(&mut authority, Role::Actor, name);
    }
    let at = |name: &str| dir.path().join(name);
    let unfit = |moment| match Identity::read(&at("a1"), moment).unwrap_err() {
        Error::Unfit { reason, .. } => reason,
        other => panic!("{other}"),
    };
    assert_eq!(unfit(later(91 * DAY)), Unfit::Expired(later(90 * DAY)));
    let begins = now() - Duration::from_mins(5);
    assert_eq!(unfit(begins - Duration::from_secs(1)), Unfit::NotYetValid(begins));

    let key = fs::read(at("a1.key")).unwrap();
    fs::copy(at("a2.key"), at("a1.key")).unwrap();
    assert_eq!(unfit(now()), Unfit::OtherKey(at("a1.key")));
    fs::write(at("a1.key"), key).unwrap();
    fs::set_permissions(at("a1.key"), fs::Permissions::from_mode(0o644)).unwrap();
    let open = Identity::read(&at("a1"), now()).unwrap_err();
    assert!(matches!(open, Error::OpenKey { mode: 0o644, .. }), "{open}");
    fs::set_permissions(at("a1.key"), fs::Permissions::from_mode(0o640)).unwrap();
    Identity::read(&at("a1"), now()).expect("its group may read it");

    let other = tempfile::tempdir().unwrap();
    Authority::create(other.path(), "Other", now()).unwrap();
    let ours = fs::read(at("ca.pem")).unwrap();
    let theirs = fs::read(other.path().join("ca.pem")).unwrap();
    fs::write(at("ca.pem"), &theirs).unwrap();
    assert_eq!(unfit(now()), Unfit::OtherAuthority(at("ca.pem")));
    fs::write(at("ca.pem"), [theirs, ours].concat()).unwrap();
    Identity::read(&at("a1"), now()).expect("one of two authorities is enough");

    for (file, bytes) in [("a1.pem", "nothing"), ("a1.key", "nothing"), ("ca.pem", "")] {
        let before = fs::read(at(file)).unwrap();
        fs::write(at(file), bytes).unwrap();
        let error = Identity::read(&at("a1"), now()).unwrap_err();
        assert!(matches!(error, Error::Content { .. }), "{file}: {error}");
        fs::write(at(file), before).unwrap();
    }
    let missing = Identity::read(&at("a9"), now()).unwrap_err();
    assert!(matches!(missing, Error::File { .. }));
}

#[test]
fn a_damaged_file_of_an_authority_is_named_with_what_helps() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let mut authority = authority(dir.path());
    let issued = issue(&mut authority, Role::Actor, "a1");
    let mut renew = || authority.renew(100 * DAY, now());
    // The key of a process need not be here.
    let key = fs::read(at("a1.key")).unwrap();
    fs::remove_file(at("a1.key")).unwrap();
    assert_eq!(renew().unwrap().len(), 1);
    let before = fs::read(&issued.path).unwrap();
    fs::write(at("a1.key"), "").unwrap();
    let error = renew().unwrap_err().to_string();
    assert!(error.contains("a1.key holds no private key") && error.contains("issue"), "{error}");
    assert!(fs::read(&issued.path).unwrap() == before, "nothing was renewed");
    fs::write(at("a1.key"), key).unwrap();
    for damage in [&b"many"[..], b"\xff\xfe"] {
        fs::write(at("serial"), damage).unwrap();
        let error = renew().unwrap_err().to_string();
        assert!(error.contains("serial holds no serial number: write"), "{error}");
    }
    fs::remove_file(at("ca.key")).unwrap();
    fs::create_dir(at("ca.key")).unwrap();
    drop(authority);
    let error = Authority::open(dir.path(), now()).unwrap_err();
    let cause = std::error::Error::source(&error).unwrap().to_string();
    assert!(
        error.to_string().ends_with("ca.key") && cause == "it is not a file",
        "{error}: {cause}"
    );
}

#[test]
fn a_directory_without_an_authority_is_told_with_what_makes_one() {
    let dir = tempfile::tempdir().unwrap();
    for directory in [dir.path().to_owned(), dir.path().join("nowhere")] {
        let place = directory.display();
        let expected = format!(
            "there is no authority in {place}: make one with `leadtime certs init {place}`"
        );
        assert_eq!(Authority::open(&directory, now()).unwrap_err().to_string(), expected);
        assert_eq!(Authority::list(&directory).unwrap_err().to_string(), expected);
    }
}

#[test]
fn a_pipe_in_the_place_of_a_certificate_blocks_nobody() {
    let dir = tempfile::tempdir().unwrap();
    drop(authority(dir.path()));
    let pipe = dir.path().join("a1.pem");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let error = Certificate::read(&pipe).unwrap_err();
    assert_eq!(std::error::Error::source(&error).unwrap().to_string(), "it is not a file");
    assert_eq!(Authority::list(dir.path()).unwrap().left_out.len(), 1);
}
