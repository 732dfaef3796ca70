//! Who is let in by a certificate and who is not, and what each of them is told.

use std::time::Duration;

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
        with(self.identity(name), endpoint, SOON)
    }
}

fn with(identity: Identity, endpoint: &Endpoint, timeout: Duration) -> ConnectSettings {
    ConnectSettings {
        identity: Some(identity),
        timeout,
        ..ConnectSettings::new(vec![endpoint.clone()])
    }
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

/// Dials, and returns what is said when it does not work.
async fn told(identity: Identity, endpoint: &Endpoint) -> String {
    let settings = with(identity, endpoint, Duration::from_millis(300));
    let error = ActorLink::open(&settings, &actor_id("a"), &start("a")).await.unwrap_err();
    assert!(matches!(error, Error::Unreachable { .. }), "{error}");
    error.to_string()
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

    let said = told(theirs.identity("a1"), &endpoint).await;
    assert!(said.contains("is not signed by our authority"), "{said}");
    let said = told(ours.identity_at("old", early), &endpoint).await;
    assert!(said.contains("our certificate is refused as expired"), "{said}");
    let said = told(ours.identity_at("young", late), &endpoint).await;
    assert!(said.contains("our certificate is refused"), "{said}");

    // In the clear, or without a certificate, nobody comes in.
    let plain: Endpoint = endpoint.as_str().replace("tls/", "tcp/").parse().unwrap();
    let bare = ConnectSettings {
        timeout: Duration::from_millis(300),
        ..ConnectSettings::new(vec![plain])
    };
    ActorLink::open(&bare, &actor_id("a1"), &start("a1")).await.unwrap_err();
    let nameless =
        format!("{endpoint}#root_ca_certificate_file={}/ca.pem", ours.dir.path().display());
    let bare = ConnectSettings {
        timeout: Duration::from_millis(300),
        ..ConnectSettings::new(vec![nameless.parse().unwrap()])
    };
    ActorLink::open(&bare, &actor_id("a1"), &start("a1")).await.unwrap_err();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_listener_with_a_certificate_that_does_not_do_is_not_dialled() {
    let ours = Pki::new();
    ours.issue(Role::Actor, "a1");
    ours.issue(Role::Learner, "l1");
    let (_learner, endpoint) = learner(&ours, "l1").await;
    // The same port under a name that is not in the certificate.
    let other: Endpoint = endpoint.as_str().replace("127.0.0.1", "127.0.0.2").parse().unwrap();
    let said = told(ours.identity("a1"), &other).await;
    assert!(said.contains("refused"), "nobody listens there: {said}");
    let any = ListenSettings {
        identity: Some(ours.identity("l1")),
        ..ListenSettings::new(vec!["tls/0.0.0.0:0".parse().unwrap()])
    };
    let router = RouterLink::open(&any).await.unwrap();
    let port = router.locators()[0].rsplit(':').next().unwrap().to_owned();
    let other: Endpoint = format!("tls/127.0.0.2:{port}").parse().unwrap();
    let said = told(ours.identity("a1"), &other).await;
    assert!(said.contains("is not for `127.0.0.2` but for"), "{said}");

    let plain = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let (plain, _events) =
        LearnerLink::open(&run("two"), DOMAIN, &learner_start(), &plain).await.unwrap();
    let clear: Endpoint = plain.locators()[0].replace("tcp/", "tls/").parse().unwrap();
    let said = told(ours.identity("a1"), &clear).await;
    assert!(said.contains("without --tls") || said.contains("does not answer a TLS"), "{said}");
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
