//! A run by certificate, as people set it up: authority, router, learner, actors, all started as programs. It ends with the
//! weights of the same run over a unix socket; a peer without a good certificate gets nowhere and is told why.
//!
//! What each role may do, line by line, is in `crates/link/tests/network/access.rs`.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

#[expect(dead_code, reason = "the other process tests use the rest")]
#[path = "../processes/support.rs"]
mod support;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use leadtime_certs::{Authority, Identity, Role};
use leadtime_link::live::LiveClientLink;
use leadtime_link::{ConnectSettings, Error as LinkError};
use leadtime_proto::{ClientName, Incarnation};
use leadtime_runs::clock;
use support::{
    Finished, PACE, PATIENCE, Place, Running, gaps, get, outcome, repository, result, signal,
    updates, wait_for_words, wait_until,
};

const RUN: &str =
    "learner -c cartpole --seed 5 --name r --set learner.n_steps=32 --set learner.total_steps=5120";
/// A run that does not end by itself.
const LONG_RUN: &str =
    "learner -c cartpole --seed 5 --name r --set learner.n_steps=32 --set learner.total_steps=1e8";
/// How long the certificate lasts that is replaced, where an actor needs less than a quarter of that to be at work.
const SHORT_LIFE: Duration = Duration::from_secs(6);
/// How soon an actor is back after its certificate was replaced. It dials once a second at least, so two seconds are enough; five
/// times that on a busy machine.
const BACK_WITHIN: Duration = Duration::from_secs(10);
const DAY: Duration = Duration::from_hours(24);

/// Makes an authority and these certificates by the program.
fn certificates(place: &Place, directory: &str, peers: &[(&str, &str)]) {
    place.finish(&["certs init", directory]).with_code(0);
    for (role, name) in peers {
        let host =
            if matches!(*role, "router" | "learner" | "service") { "--host 127.0.0.1" } else { "" };
        place.finish(&["certs issue", directory, role, name, host]).with_code(0);
    }
}

/// Returns the address that a listener says it has.
fn address(listener: &Running) -> String {
    wait_for_words(listener, "tls/127.0.0.1:");
    let said = listener.stderr();
    let rest = said.split("tls/127.0.0.1:").nth(1).unwrap();
    let port: String = rest.chars().take_while(char::is_ascii_digit).collect();
    format!("tls/127.0.0.1:{port}")
}

/// Returns what a learner's status page tells of its certificate.
fn certificate_end(learner: &Running) -> String {
    let said = learner.stderr();
    let at = said.split("status at http://").nth(1).unwrap().split('/').next().unwrap();
    let (_, page) = get(at, "/metrics");
    let sample = page.lines().find(|it| it.starts_with("leadtime_certificate_end_timestamp"));
    sample.unwrap().to_owned()
}

/// Runs the same in the clear over a unix socket, with one actor.
fn reference(run: &[&str]) -> Finished {
    let place = Place::new();
    let endpoint = place.endpoint("z");
    let learner = place.start(&[run, &["--listen", &endpoint]].concat());
    let actor = place.start(&["actor --connect", &endpoint]);
    let finished = learner.finish(PATIENCE).with_code(0);
    actor.finish(PATIENCE).with_code(0);
    finished
}

#[test]
fn a_run_by_certificate_has_the_same_weights_and_strangers_get_nowhere() {
    let place = Place::new();
    let peers =
        [("router", "r1"), ("learner", "l1"), ("actor", "a1"), ("actor", "a2"), ("observer", "o1")];
    certificates(&place, "pki", &peers);
    place.finish(&["certs acl pki -o router.json5"]).with_code(0);
    // Issued after the list was written.
    place.finish(&["certs issue pki actor a3"]).with_code(0);
    certificates(&place, "other", &[("actor", "a1")]);

    let router = place.start(&["router --listen tls/127.0.0.1:0 --acl router.json5 --tls pki/r1"]);
    let there = address(&router);
    let learner = place.start(&[RUN, "--set run.actors_min=2 --tls pki/l1 --connect", &there]);
    let first = place.start(&["actor --tls pki/a1 --connect", &there]);
    wait_for_words(&learner, "1 of 2");

    let seen = place.finish(&["check --tls pki/o1 --connect", &there]).with_code(0);
    assert!(seen.stdout.contains(": r"), "{}", seen.stdout);
    let refused = |arguments: &str, code: i32, words: &str| {
        let actor = ["actor --connect-timeout 2s", arguments, "--connect", &there];
        place.finish(&actor).with_code(code).saying(&[words]);
    };
    refused("--tls other/a1", 3, "is not signed by our authority");
    refused("", 2, "needs a certificate");
    refused("--tls pki/o1", 2, "pki/o1.pem is for role observer");
    refused("--tls pki/a1 --id a2", 2, "the certificate is for `a1`");
    refused("--tls pki/a3", 3, "the access list there does not name `a3`");
    // Two of one name are one too many.
    let twice = place.finish(&["actor --connect-timeout 20s --tls pki/a1 --connect", &there]);
    twice.with_code(2).saying(&["`a1` is already here"]);
    let clear = there.replace("tls/", "tcp/");
    let told = place.finish(&["actor --connect-timeout 1s --connect", &clear]);
    told.with_code(3).saying(&["asks for TLS: write `tls/`"]);
    let told = place.finish(&["actor --tls pki/a2 --connect", &clear]);
    told.with_code(2).saying(&["is not encrypted"]);

    let second = place.start(&["actor --tls pki/a2 --connect", &there]);
    let secured = learner.finish(PATIENCE).with_code(0);
    first.finish(PATIENCE).with_code(0);
    second.finish(PATIENCE).with_code(0);
    signal("TERM", router.id());
    router.finish(PATIENCE).with_code(0);
    let calm = reference(&[RUN]);
    assert_eq!(outcome(&secured), outcome(&calm));
    assert_eq!(result(&place.run("r"))["books"]["balanced"], true);
}

#[test]
fn a_second_learner_of_a_run_does_not_start_and_one_that_was_killed_is_started_again_at_once() {
    let (place, other) = (Place::new(), Place::new());
    certificates(&place, "pki", &[("router", "r1"), ("learner", "l1"), ("actor", "a1")]);
    place.finish(&["certs acl pki -o acl.json5"]).with_code(0);
    let router = place.start(&["router --listen tls/127.0.0.1:0 --acl acl.json5 --tls pki/r1"]);
    let there = address(&router);
    let learner = || place.start(&[LONG_RUN, "--tls pki/l1 --connect", &there]);
    let first = learner();
    let helper = place.start(&["actor --tls pki/a1 --connect", &there]);
    wait_for_words(&first, "actor joined");
    let second = other.finish(&[LONG_RUN, "--tls", &place.file("pki/l1"), "--connect", &there]);
    second.with_code(2).saying(&["another learner of run `r` is at work at", &there]);
    first.kill();
    let again = learner();
    wait_for_words(&again, "actor joined");
    signal("TERM", again.id());
    again.finish(PATIENCE).with_code(130);
    helper.finish(PATIENCE);
}

#[test]
fn a_certificate_is_replaced_under_way_and_no_rollout_is_lost() {
    let place = Place::new();
    certificates(&place, "pki", &[("learner", "l1"), ("actor", "a1")]);
    let pki = place.path().join("pki");
    let issue = |lifetime| {
        for end in ["pem", "key"] {
            drop(fs::remove_file(pki.join("a1").with_extension(end)));
        }
        let mut authority = Authority::open(&pki, clock::now()).unwrap();
        authority.issue(Role::Actor, &"a1".parse().unwrap(), &[], lifetime, clock::now()).unwrap();
    };
    place.finish(&["certs acl pki -o acl.json5"]).with_code(0);
    let listening = "--listen tls/127.0.0.1:0 --tls pki/l1 --acl acl.json5 --status 127.0.0.1:0";
    let learner = place.start(&[LONG_RUN, listening]);
    let there = address(&learner);
    let run = place.run("r");
    let start = || place.start(&["actor --json --tls pki/a1 --connect", &there]);
    let goes_on = || {
        let before = updates(&run);
        wait_until("it goes on", PATIENCE, || updates(&run) > before + 3);
    };

    // One start with a certificate that lasts tells how long the next one needs here.
    let started = Instant::now();
    let first = start();
    goes_on();
    let lifetime = SHORT_LIFE.max(4 * started.elapsed());
    signal("TERM", first.id());
    first.finish(PATIENCE).with_code(130);
    wait_for_words(&learner, "actor left");
    issue(lifetime);
    let actor = start();
    goes_on();
    let (n_left, n_joined) = (learner.n_said("actor left"), learner.n_said("actor joined"));
    wait_until("its certificate has ended", lifetime + PATIENCE, || {
        learner.n_said("actor left") > n_left
    });
    issue(90 * DAY);
    let replaced = Instant::now();
    wait_until("it is back", PATIENCE, || learner.n_said("actor joined") > n_joined);
    let back = replaced.elapsed();
    println!("a certificate of {lifetime:?}: back {back:?} after it was replaced");
    assert!(back < BACK_WITHIN, "back only {back:?} after the files were replaced");
    goes_on();
    // Whoever listens has read its own when it started: that is the one whose end counts.
    let end_told = certificate_end(&learner);
    let mut authority = Authority::open(&pki, clock::now()).unwrap();
    authority.renew(365 * DAY, clock::now()).unwrap();
    assert_eq!(certificate_end(&learner), end_told);
    signal("TERM", learner.id());
    let stopped = learner.finish(PATIENCE).with_code(130);
    let journal = actor.finish(PATIENCE).with_code(0).json();
    assert!(journal["reconnects"].as_u64().unwrap() >= 1, "{journal}");
    // The run can be resumed, so its books are what the learner prints.
    assert!(stopped.stdout.contains(", all accounted for"), "{}", stopped.stdout);
    let (weights, n_updates) = outcome(&stopped);
    let calm = reference(&[LONG_RUN, "--stop-after", &n_updates]);
    assert_eq!((weights, n_updates), outcome(&calm));
}

#[test]
fn what_is_wrong_with_a_certificate_is_one_sentence() {
    let place = Place::new();
    certificates(&place, "pki", &[("learner", "l1"), ("actor", "a1"), ("actor", "a2")]);
    let pki = place.path().join("pki");
    let mut authority = Authority::open(&pki, clock::now()).unwrap();
    for (name, made) in [("old", clock::now() - 10 * DAY), ("young", clock::now() + DAY)] {
        authority.issue(Role::Actor, &name.parse().unwrap(), &[], DAY, made).unwrap();
    }
    drop(authority);
    let refused = |arguments: &str, words: &str| {
        let told = place.finish(&[arguments]).with_code(2).saying(&[words]);
        assert_eq!(told.stderr.trim().lines().count(), 1, "{}", told.stderr);
    };
    let actor = |name: &str, words: &str| {
        refused(&format!("-q actor --connect 127.0.0.1:1 --tls pki/{name}"), words);
    };
    actor("old", "it ended at");
    actor("young", "is this machine's clock right?");
    actor("nobody", "cannot read pki/nobody.pem");
    let key = |name: &str| pki.join(name).with_extension("key");
    let own = fs::read(key("a1")).unwrap();
    fs::write(key("a1"), fs::read(key("a2")).unwrap()).unwrap();
    actor("a1", "is the key of another certificate");
    fs::write(key("a1"), own).unwrap();
    fs::set_permissions(key("a1"), fs::Permissions::from_mode(0o604)).unwrap();
    actor("a1", "can be read by everybody (mode 604)");
    actor("l1", "is for role learner");

    refused("-q certs issue pki actor a1", "pki/a1.pem exists already");
    refused("-q certs issue pki robot:alive", "`alive` is not a name for a robot");
    for command in ["issue nowhere actor:a1", "renew nowhere", "acl nowhere"] {
        refused(&format!("-q certs {command}"), "`leadtime certs init nowhere`");
    }
    refused("-q certs init pki", "pki holds an authority already");
    refused("-q certs show pki/a1.key", "no certificate");
    refused("-q certs issue pki actor a4 --host a/b", "neither a host's name nor an address");
    refused("-q router --listen tls/127.0.0.1:0", "needs a certificate");
    refused("-q router --listen tcp/127.0.0.1:0 --tls pki/l1", "is for role learner");
    refused("-q learner --listen tcp/127.0.0.1:0 --tls pki/l1", "is not encrypted");
    place.write("acl.json5", "{\n  access_control: { enabled: true, messages: [] }\n}");
    refused(
        "-q learner --listen tls/127.0.0.1:0 --tls pki/l1 --acl acl.json5",
        "acl.json5: this is no access list: line 2: unknown field `messages`",
    );
    for wrong in ["certs issue pki king a5", "certs issue pki actor A", "certs issue pki actor"] {
        place.finish(&[wrong]).with_code(2);
    }
    assert!(!place.run("r").exists());
}

#[test]
fn an_address_that_lacks_its_certificate_is_refused_before_anything_is_made() {
    let place = Place::new();
    let policy = repository("deploy/policies/piloting.safetensors");
    let serve = format!("serve {policy} --state sessions --listen tls/127.0.0.1:0");
    for command in [
        "learner -c cartpole --listen tls/127.0.0.1:0",
        "learner -c cartpole --name r --trace t.json --connect tls/127.0.0.1:1",
        "up -c cartpole --name r --trace t.json --listen tls/127.0.0.1:0",
        "router --listen tls/127.0.0.1:0 --region eu",
        "actor --trace t.json --connect tls/127.0.0.1:1",
        "record -o r.mcap --connect tls/127.0.0.1:1",
        "record -o r.mcap --run r --connect tls/127.0.0.1:1",
        &serve,
    ] {
        let told = place.finish(&["-q", command]).with_code(2).saying(&["needs a certificate"]);
        assert_eq!(told.stderr.trim().lines().count(), 1, "{}", told.stderr);
        let entries = fs::read_dir(place.path()).unwrap().map(|entry| entry.unwrap().file_name());
        // What the program says is kept there, too.
        let is_made = |name: &OsString| !name.to_string_lossy().starts_with("log-");
        let left: Vec<OsString> = entries.filter(is_made).collect();
        assert!(left.is_empty(), "{command} left {left:?}");
    }
}

/// Lists the files of a directory with what they hold; but for the serial number, of which none is given twice.
fn contents(directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let files = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    let files = files.filter(|path| !path.ends_with("serial"));
    files.map(|path| (path.clone(), fs::read(&path).unwrap())).collect()
}

#[test]
fn an_ipv6_address_in_brackets_is_dialled_under_the_certificate_for_it() {
    if let Err(error) = TcpListener::bind("[::1]:0") {
        println!("skipped: there is no IPv6 here: {error}");
        return;
    }
    let place = Place::new();
    place.finish(&["certs init pki"]).with_code(0);
    place.finish(&["certs issue pki router:r1@::1 observer:o1"]).with_code(0);
    let router = place.start(&["router --listen tls/[::1]:0 --insecure --tls pki/r1"]);
    wait_for_words(&router, "router listens at tls/[::1]:");
    let said = router.stderr();
    let port = said.split("tls/[::1]:").nth(1).unwrap().split_whitespace().next().unwrap();
    let there = format!("tls/[::1]:{port}");
    let told = place.finish(&["watch --once --connect-timeout 3s --tls pki/o1 --connect", &there]);
    told.with_code(3).saying(&["no learner is running at"]);
}

#[test]
fn one_command_issues_several_certificates_and_their_list_or_nothing() {
    let place = Place::new();
    place.finish(&["certs init pki"]).with_code(0);
    let pki = place.path().join("pki");
    let everybody = "certs issue pki router:r1@127.0.0.1,localhost learner:l1 actor:a1 observer:o1";
    let before = contents(&pki);
    for (more, told) in [
        ("actor:a1", "`a1` is given twice"),
        ("king:k1", "`king` is not a role"),
        ("actor:a3@a/b", "neither a host's name nor an address"),
        ("a3", "`a3` does not say whose certificate"),
        ("--host box", "--host cannot say whose it is"),
        ("--lifetime 0s", "at least a second"),
    ] {
        place.finish(&[everybody, more]).with_code(2).saying(&[told]);
        assert!(contents(&pki) == before, "{more}");
    }
    let told = place.finish(&[everybody]).with_code(0);
    assert!(
        told.stdout.contains("access list pki/acl.json5 for 4 certificates"),
        "{}",
        told.stdout
    );
    let shown = place.finish(&["certs show pki/r1.pem --json"]).with_code(0).json();
    assert_eq!(shown["hosts"], serde_json::json!(["127.0.0.1", "localhost"]));
    let list = || fs::read_to_string(pki.join("acl.json5")).unwrap();
    let written = |place: &Place| place.finish(&["certs acl pki"]).with_code(0).stdout;
    assert_eq!(list(), written(&place));
    // One more is added, as long as nobody else has changed the list.
    place.finish(&["certs issue pki actor a2"]).with_code(0);
    assert_eq!(list(), written(&place));
    let shorter = list().replace("\"a1\"", "\"nobody\"");
    fs::write(pki.join("acl.json5"), &shorter).unwrap();
    let told = place.finish(&["certs issue pki actor:a3"]).with_code(0);
    assert!(told.stderr.contains("stays as it is"), "{}", told.stderr);
    assert_eq!(list(), shorter);
}

#[test]
fn a_certificate_is_issued_beside_files_that_are_none_of_ours() {
    let place = Place::new();
    place.finish(&["certs init pki"]).with_code(0);
    place.write("pki/dhparam.pem", "-----BEGIN DH PARAMETERS-----");
    for peer in ["learner:l1", "actor:a1"] {
        let told = place.finish(&["certs issue pki", peer]).with_code(0);
        assert_eq!(told.stderr.matches("pki/dhparam.pem holds no certificate").count(), 1);
    }
    let list = fs::read_to_string(place.path().join("pki/acl.json5")).unwrap();
    assert!(list.contains("\"a1\"") && !list.contains("dhparam"), "{list}");
    place.finish(&["certs renew pki"]).with_code(0).saying(&["neither listed nor renewed"]);
}

#[test]
fn an_open_address_is_warned_about_once_and_the_remedy_named() {
    let place = Place::new();
    let warned = |arguments: &str| {
        let learner = place.start(&[RUN, arguments]);
        wait_for_words(&learner, "waiting for actors");
        signal("TERM", learner.id());
        learner.finish(PATIENCE).with_code(130).stderr.matches("asks for no certificate").count()
    };
    assert_eq!(warned("--listen tcp/0.0.0.0:0"), 1);
    assert_eq!(warned("--listen tcp/0.0.0.0:0 --listen tcp/0.0.0.0:0"), 1);
    assert_eq!(warned("--listen tcp/0.0.0.0:0 --insecure"), 0);
    assert_eq!(warned("--listen tcp/127.0.0.1:0"), 0);
}

#[test]
fn a_router_that_lets_everybody_do_everything_warns_as_a_learner_does() {
    let place = Place::new();
    certificates(&place, "pki", &[("router", "r1")]);
    place.finish(&["certs acl pki -o acl.json5"]).with_code(0);
    let warned = |arguments: &str, words: &str| {
        let router = place.start(&["router", arguments]);
        wait_for_words(&router, "router listens");
        signal("TERM", router.id());
        let told = router.finish(PATIENCE).stderr;
        told.lines().filter(|line| line.contains("WARN") && line.contains(words)).count()
    };
    let open = "asks for no certificate";
    assert_eq!(warned("--listen tcp/0.0.0.0:0", open), 1);
    assert_eq!(warned("--listen tcp/127.0.0.1:0", open), 0);
    let everything = "may do everything; --acl FILE limits it";
    assert_eq!(warned("--listen tls/0.0.0.0:0 --tls pki/r1", everything), 1);
    assert_eq!(warned("--listen tls/0.0.0.0:0 --tls pki/r1 --insecure", everything), 0);
    assert_eq!(warned("--listen tls/0.0.0.0:0 --tls pki/r1 --acl acl.json5", everything), 0);
    assert_eq!(warned("--listen tls/127.0.0.1:0 --tls pki/r1", everything), 0);
}

/// Asks for a session with the certificate of `car-1` under another name; returns the error.
fn ask_as(place: &Place, there: &str, service: &str, client: &str) -> LinkError {
    let identity = Identity::read(&place.path().join("pki/car-1"), clock::now()).unwrap();
    let settings = ConnectSettings {
        identity: Some(identity),
        ..ConnectSettings::new(vec![there.parse().unwrap()])
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let link = LiveClientLink::open(&settings).await.unwrap();
        let (service, client) = (service.parse().unwrap(), ClientName::new(client).unwrap());
        let port = link.port(&service, &client, Incarnation(1)).unwrap();
        port.ask(b"{}".to_vec()).await.unwrap_err()
    })
}

#[test]
fn a_robot_is_spoken_to_under_its_own_name_only_directly_and_behind_a_router() {
    let place = Place::new();
    let peers = [
        ("router", "r1"),
        ("service", "n1"),
        ("robot", "car-1"),
        ("actor", "a1"),
        ("recorder", "w1"),
    ];
    certificates(&place, "pki", &peers);
    place.finish(&["certs acl pki -o acl.json5"]).with_code(0);
    let policy = repository("deploy/policies/piloting.safetensors");
    let serve = |arguments: &str| place.start(&["serve", &policy, "--tls pki/n1", arguments]);
    let drive = |there: &str, arguments: &str| {
        let more = "--episodes 2 --json --connect-timeout 3s";
        place.finish(&["drive", &policy, PACE, more, "--connect", there, arguments])
    };
    let router = place.start(&["router --listen tls/127.0.0.1:0 --acl acl.json5 --tls pki/r1"]);
    let behind = address(&router);
    let direct = serve("--service near --listen tls/127.0.0.1:0 --acl acl.json5");
    let away = serve(&format!("--service far --connect {behind}"));
    wait_for_words(&direct, "is at work");
    wait_for_words(&away, "is at work");
    for (there, service) in [(address(&direct), "near"), (behind, "far")] {
        let as_itself = format!("--tls pki/car-1 --service {service}");
        let file = format!("{service}.mcap");
        let recorded = ["record", "--connect", &there, "--service", service, "-o", &file];
        let recorder = place.start(&[&recorded[..], &["--tls pki/w1"]].concat());
        wait_for_words(&recorder, "recording notifier");
        let measures = drive(&there, &as_itself).with_code(0).json();
        assert_eq!(measures["comparison"]["summaries"][0]["n_episodes"], 2);
        signal("INT", recorder.id());
        recorder.finish(PATIENCE).with_code(0);
        let replayed = place.finish(&["replay --json", &file]).with_code(0).json();
        let session = &replayed["sessions"][0];
        assert_eq!(session["client"], format!("{service}/car-1"));
        assert_eq!(gaps(session), [""; 0]);
        assert!(session["events"].as_u64() > Some(0), "{session}");
        let robot = place.finish(&[&recorded[..6], &["other.mcap --tls pki/car-1"]].concat());
        robot.with_code(2).saying(&["is for role robot; this command needs one for role recorder"]);
        // Another name is refused before anything is asked, and nobody who asks all the same gets an answer.
        let as_another = format!("--tls pki/car-1 --client car-2 --service {service}");
        let told = ["--client car-2: the certificate is for `car-1`", "under its own name only"];
        drive(&there, &as_another).with_code(2).saying(&told);
        assert!(matches!(ask_as(&place, &there, service, "car-2"), LinkError::NoAnswer { .. }));
        let in_a_run = format!("--tls pki/a1 --service {service}");
        drive(&there, &in_a_run).with_code(2).saying(&["is for role actor"]);
    }
    let told = place.finish(&["serve", &policy, "--tls pki/car-1 --listen tls/127.0.0.1:0"]);
    told.with_code(2).saying(&["is for role robot; this command needs one for role service"]);
    drop((direct, away, router));
}
