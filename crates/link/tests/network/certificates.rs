//! Who is let in by a certificate and who is not, and what each of them is told.

use std::time::{Duration, Instant};

use jiff::Timestamp;
use leadtime_certs::{Authority, Identity, Role};
use leadtime_link::{
    ActorLink, ConnectSettings, Endpoint, Error, LearnerLink, ListenSettings, RouterLink,
};
use tempfile::TempDir;
use zenoh::Session;

use crate::support::*;

const DAY: Duration = Duration::from_hours(24);

/// An authority in a directory of its own.
pub(crate) struct Pki {
    dir: TempDir,
    /// What time it is, by the directory's own date: only one file of the product reads the clock.
    now: Timestamp,
}

impl Pki {
    pub(crate) fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let now = dir.path().metadata().unwrap().modified().unwrap().try_into().unwrap();
        Authority::create(dir.path(), "Test", now).unwrap();
        Self { dir, now }
    }

    /// Makes a certificate that is good for a day.
    pub(crate) fn issue(&self, role: Role, name: &str) {
        self.issue_at(role, name, self.now);
    }

    fn issue_at(&self, role: Role, name: &str, now: Timestamp) {
        let hosts = ["127.0.0.1".to_owned(), "localhost".to_owned()];
        let mut authority = Authority::open(self.dir.path(), self.now).unwrap();
        authority.issue(role, &name.parse().unwrap(), &hosts, DAY, now).unwrap();
    }

    /// Reads a certificate at a moment at which it was good.
    fn identity_at(&self, name: &str, now: Timestamp) -> Identity {
        Identity::read(&self.dir.path().join(name), now).unwrap()
    }

    pub(crate) fn identity(&self, name: &str) -> Identity {
        self.identity_at(name, self.now)
    }

    /// How to listen at a port of the kernel's choice.
    pub(crate) fn listen(&self, name: &str) -> ListenSettings {
        let endpoint = "tls/127.0.0.1:0".parse().unwrap();
        ListenSettings {
            identity: Some(self.identity(name)),
            ..ListenSettings::new(vec![endpoint])
        }
    }

    pub(crate) fn connect(&self, name: &str, endpoint: &Endpoint) -> ConnectSettings {
        with(Some(self.identity(name)), endpoint, SOON)
    }
}

fn with(identity: Option<Identity>, endpoint: &Endpoint, timeout: Duration) -> ConnectSettings {
    ConnectSettings { identity, timeout, ..ConnectSettings::new(vec![endpoint.clone()]) }
}

/// Opens a session outside the link that shows this certificate.
pub(crate) async fn dialler(pki: &Pki, name: &str, endpoint: &Endpoint) -> zenoh::Result<Session> {
    let mut config = zenoh::Config::default();
    let file = |end: &str| format!("\"{}\"", pki.dir.path().join(end).display());
    let tls = "transport/link/tls";
    for (key, value) in [
        ("mode".to_owned(), "\"client\"".to_owned()),
        ("scouting/multicast/enabled".to_owned(), "false".to_owned()),
        ("connect/endpoints".to_owned(), format!("[\"{endpoint}\"]")),
        (format!("{tls}/root_ca_certificate"), file("ca.pem")),
        (format!("{tls}/connect_certificate"), file(&format!("{name}.pem"))),
        (format!("{tls}/connect_private_key"), file(&format!("{name}.key"))),
        (format!("{tls}/enable_mtls"), "true".to_owned()),
    ] {
        config.insert_json5(&key, &value).unwrap();
    }
    zenoh::open(config).await
}

async fn learner(pki: &Pki, name: &str) -> (LearnerLink, Endpoint) {
    let opened = LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &pki.listen(name)).await;
    let (learner, _events) = opened.unwrap();
    let endpoint = learner.locators()[0].parse().unwrap();
    (learner, endpoint)
}

/// Dials until one of these is said: on a busy machine a handshake may take longer than is waited for it.
async fn told(identity: Option<Identity>, endpoint: &Endpoint, words: &[&str]) {
    let settings = with(identity, endpoint, Duration::from_millis(300));
    let deadline = Instant::now() + SOON;
    loop {
        let error = ActorLink::open(&settings, &actor_id("a"), &start("a")).await.unwrap_err();
        assert!(matches!(error, Error::Unreachable { .. }), "{error}");
        let said = error.to_string();
        if words.iter().any(|words| said.contains(words)) {
            return;
        }
        assert!(Instant::now() < deadline, "none of {words:?} is said: {said}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_refused_at_the_handshake_is_told_why() {
    let (ours, theirs) = (Pki::new(), Pki::new());
    ours.issue(Role::Learner, "l1");
    ours.issue(Role::Actor, "a1");
    theirs.issue(Role::Actor, "a1");
    let (early, late) = (ours.now - 10 * DAY, ours.now + 10 * DAY);
    ours.issue_at(Role::Actor, "old", early);
    ours.issue_at(Role::Actor, "young", late);
    let (_learner, endpoint) = learner(&ours, "l1").await;
    let settings = ours.connect("a1", &endpoint);
    ActorLink::open(&settings, &actor_id("a1"), &start("a1"))
        .await
        .expect("its certificate is good");

    let foreign = Some(theirs.identity("a1"));
    told(foreign, &endpoint, &["is not signed by our authority"]).await;
    let old = Some(ours.identity_at("old", early));
    told(old, &endpoint, &["our certificate is refused as expired"]).await;
    let young = Some(ours.identity_at("young", late));
    told(young, &endpoint, &["our certificate is refused"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn in_the_clear_or_without_a_certificate_nobody_comes_in() {
    let ours = Pki::new();
    ours.issue(Role::Learner, "l1");
    let (_learner, endpoint) = learner(&ours, "l1").await;
    let plain: Endpoint = endpoint.as_str().replace("tls/", "tcp/").parse().unwrap();
    told(None, &plain, &["asks for TLS: write `tls/`"]).await;

    let file = |name: &str| ours.dir.path().join(name).display().to_string();
    let nameless = |endpoint: &Endpoint, timeout: Duration| {
        let endpoint = format!("{endpoint}#root_ca_certificate_file={}", file("ca.pem"));
        with(None, &endpoint.parse().unwrap(), timeout)
    };
    // A listener lets a client in well within this time.
    let settings = nameless(&endpoint, Duration::from_secs(2));
    let error = ActorLink::open(&settings, &actor_id("a1"), &start("a1")).await.unwrap_err();
    let words = "no encrypted connection comes about";
    assert!(error.to_string().contains(words), "{error}");
    // It is for the certificate that is missing: where nobody asks for one, the same settings do.
    let (certificate, key) = (file("l1.pem"), file("l1.key"));
    let lenient = format!(
        "tls/127.0.0.1:0#listen_certificate_file={certificate};listen_private_key_file={key};enable_mtls=false"
    );
    let lenient = ListenSettings::new(vec![lenient.parse().unwrap()]);
    let lenient = RouterLink::open(&lenient).await.unwrap();
    let settings = nameless(&lenient.locators()[0].parse().unwrap(), SOON);
    let opened = ActorLink::open(&settings, &actor_id("a1"), &start("a1")).await;
    opened.expect("nobody asks for a certificate there");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_listener_with_a_certificate_that_does_not_do_is_not_dialled() {
    let ours = Pki::new();
    ours.issue(Role::Actor, "a1");
    ours.issue(Role::Learner, "l1");
    let (_learner, endpoint) = learner(&ours, "l1").await;
    // The same port under a name that is not in the certificate.
    let other: Endpoint = endpoint.as_str().replace("127.0.0.1", "127.0.0.2").parse().unwrap();
    // Nobody listens there.
    told(Some(ours.identity("a1")), &other, &["the connection is refused"]).await;
    let any = ListenSettings {
        identity: Some(ours.identity("l1")),
        ..ListenSettings::new(vec!["tls/0.0.0.0:0".parse().unwrap()])
    };
    let router = RouterLink::open(&any).await.unwrap();
    let port = router.locators()[0].rsplit(':').next().unwrap().to_owned();
    let other: Endpoint = format!("tls/127.0.0.2:{port}").parse().unwrap();
    told(Some(ours.identity("a1")), &other, &["is not for `127.0.0.2` but for"]).await;

    let plain = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let (plain, _events) =
        LearnerLink::open(&run("two"), DOMAIN, &learner_start(), &plain).await.unwrap();
    let clear: Endpoint = plain.locators()[0].replace("tcp/", "tls/").parse().unwrap();
    let words = ["without --tls", "does not answer a TLS"];
    told(Some(ours.identity("a1")), &clear, &words).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn with_a_certificate_nothing_goes_out_in_the_clear() {
    let pki = Pki::new();
    pki.issue(Role::Actor, "a1");
    pki.issue(Role::Learner, "l1");
    let plain: Endpoint = "tcp/127.0.0.1:1".parse().unwrap();
    let error = ActorLink::open(&pki.connect("a1", &plain), &actor_id("a1"), &start("a1"))
        .await
        .unwrap_err();
    assert!(matches!(error, Error::NotEncrypted(_)), "{error}");
    let mut listen = pki.listen("l1");
    listen.endpoints.push(plain);
    let error =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &listen).await.unwrap_err();
    assert!(matches!(error, Error::NotEncrypted(_)), "{error}");
    let encrypted: Endpoint = "tls/127.0.0.1:1".parse().unwrap();
    let settings = ConnectSettings::new(vec![encrypted]);
    let error = ActorLink::open(&settings, &actor_id("a1"), &start("a1")).await.unwrap_err();
    assert!(matches!(error, Error::NoCertificate(_)), "{error}");
    let twice: Endpoint = "tls/127.0.0.1:1#enable_mtls=false".parse().unwrap();
    let error = ActorLink::open(&pki.connect("a1", &twice), &actor_id("a1"), &start("a1"))
        .await
        .unwrap_err();
    assert!(matches!(error, Error::TlsTwice(_)), "{error}");
}
