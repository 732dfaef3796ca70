//! Watching a run: on the network, on the disk, as text; what is wrong is one sentence, and nobody is disturbed.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::{Instant, UNIX_EPOCH};

use serde_json::Value;

use crate::support::{
    BEFORE_DEADLINE, PATIENCE, Place, Running, get, outcome, result, signal, wait_until,
};

/// A run that lasts until it is ended.
const LONG: &str = "-c cartpole --steps 5e7 --set learner.n_steps=32 --set run.checkpoint_every=10";
/// One that takes a second or two.
const SHORT: &str = "-c cartpole --steps 1e4";
/// Watchers that are killed during one run.
const N_KILLED: usize = 20;

/// A learner and an actor at a place, with the run at work.
fn at_work(place: &Place, name: &str) -> [Running; 2] {
    let endpoint = place.endpoint("l");
    let learner = place.start(&[&format!("learner --name {name} {LONG} --listen {endpoint}")]);
    let actor = place.start(&[&format!("actor --connect {endpoint} --id a")]);
    [learner, actor]
}

/// Looks until a run has made this many updates.
fn look(place: &Place, n_updates: u64) -> Value {
    let deadline = Instant::now() + PATIENCE;
    let command = format!("watch --connect {} --once --json", place.endpoint("l"));
    loop {
        let seen = place.finish(&[&command]).with_code(0).json();
        if seen["state"]["update"].as_u64().is_some_and(|update| update >= n_updates) {
            return seen;
        }
        assert!(Instant::now() < deadline, "{seen}");
    }
}

#[test]
fn a_run_at_work_is_seen_from_outside_as_text_and_as_json() {
    let place = Place::new();
    let _processes = at_work(&place, "r");
    let seen = look(&place, 3);
    assert_eq!((&seen["schema"], &seen["state"]["state"]), (&1.into(), &"training".into()));
    assert_eq!(seen["about"]["domain"], "cartpole");
    assert_eq!(seen["actors"][0]["id"], "a");
    assert!(seen["actors"][0]["credit"]["window"].as_u64().is_some(), "{}", seen["actors"]);
    assert_eq!(seen["update"]["books"]["balanced"], true);
    let x = seen["history"]["x"].as_array().unwrap();
    let newest = seen["state"]["update"].as_u64().unwrap();
    assert!(x.len() as u64 + 3 >= newest.min(1_000), "{} points of {newest} updates", x.len());
    let text =
        place.finish(&[&format!("watch --connect {} --once", place.endpoint("l"))]).with_code(0);
    for expected in ["r (cartpole): training", "books balanced", "explained variance", "iteration"]
    {
        assert!(text.stdout.contains(expected), "{expected} is not in: {}", text.stdout);
    }
}

#[test]
fn watchers_that_are_killed_change_no_bit() {
    let place = Place::new();
    let run =
        place.start(&[&format!("up --name watched {LONG}"), "--listen", &place.endpoint("l")]);
    look(&place, 1);
    for _ in 0..N_KILLED {
        let command = format!("watch --connect {} --http 127.0.0.1:0 --json", place.endpoint("l"));
        let watcher = place.start(&[&command]);
        wait_until("the page is served", PATIENCE, || watcher.stdout().contains("http://"));
        watcher.kill();
    }
    signal("TERM", run.id());
    let run = run.finish(PATIENCE).with_code(130);
    assert!(run.stdout.contains("all accounted for"), "{}", run.stdout);
    let (_, n_updates) = outcome(&run);
    let alone = place.finish(&[&format!("up --name alone {LONG} --stop-after {n_updates}")]);
    assert_eq!(outcome(&alone.with_code(0)), outcome(&run));
}

#[test]
fn a_run_with_its_page_beside_it_says_as_json_where_the_page_is_and_how_it_ended() {
    let place = Place::new();
    let up = place.start(&[&format!("up --name r {LONG} --watch 127.0.0.1:0 --json")]);
    let at = page_address(&up);
    let (code, page) = get(&at, "/");
    assert!(code == 200 && page.contains("<title>Leadtime</title>"), "{code}: {page}");
    wait_until("the page shows the run", PATIENCE, || {
        let shown: Value = serde_json::from_str(&get(&at, "/state.json").1).unwrap();
        shown["state"]["update"].as_u64() > Some(0)
    });
    signal("TERM", up.id());
    let said = up.finish(PATIENCE).with_code(130).stdout;
    let said: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(said.len(), 2, "{said:?}");
    let end = &said[1];
    assert!(end["updates"].as_u64() > Some(0), "{end}");
    assert_eq!(end["weights_sha256"].as_str().map(str::len), Some(64), "{end}");
    assert_eq!((&end["end"], &end["books"]["balanced"]), (&Value::Null, &true.into()), "{end}");
}

#[test]
fn a_finished_run_is_shown_from_its_directory() {
    let place = Place::new();
    place.finish(&[&format!("up --name done {SHORT}")]).with_code(0);
    let seen = place.finish(&["watch done --once --json"]).with_code(0).json();
    assert_eq!(seen["state"]["state"], "finished");
    assert_eq!(seen["state"]["update"], seen["state"]["total_updates"]);
    // Its books are those that it ended with.
    let (books, kept) = (&seen["update"]["books"], result(&place.run("done"))["books"].clone());
    assert_eq!(books["published"], kept["published"], "{books} {kept}");
    assert_eq!(books["balanced"], true, "{books}");
    let unused = books["entries"].as_array().unwrap().last().unwrap();
    assert_eq!((&unused[0], &unused[1]), (&"unused_at_end".into(), &kept["unused_at_end"]));
    // A torn last line is left out and counted; a directory without metrics has no update yet.
    let metrics = place.run("done").join("metrics.jsonl");
    let text = fs::read_to_string(&metrics).unwrap();
    fs::write(&metrics, text + "{\"update\": 99999, \"st").unwrap();
    let torn = place.finish(&["watch runs/done --once --json"]).with_code(0).json();
    assert_eq!(
        (&torn["state"]["skipped"], &torn["state"]["update"]),
        (&1.into(), &seen["state"]["update"])
    );
    fs::remove_file(&metrics).unwrap();
    let empty = place.finish(&["watch done --once"]).with_code(0);
    assert!(empty.stdout.contains("update 0 of"), "{}", empty.stdout);
}

#[test]
fn a_page_is_served_and_ends_within_a_second() {
    let place = Place::new();
    place.finish(&[&format!("up --name done {SHORT}")]).with_code(0);
    let (watcher, address) = page_of(&place, "done");
    let mut open: Vec<TcpStream> = (0..5).map(|_| events(&address)).collect();
    for stream in &mut open {
        read_until(stream, "event: about\n");
    }
    let asked = Instant::now();
    signal("TERM", watcher.id());
    watcher.finish(PATIENCE).with_code(130);
    assert!(asked.elapsed() < BEFORE_DEADLINE, "{:?}", asked.elapsed());
    for mut stream in open {
        let mut rest = String::new();
        stream.read_to_string(&mut rest).unwrap();
        assert!(rest.contains("event: bye"), "the page is told");
    }
}

/// Serves a page, and returns its address.
fn page_of(place: &Place, what: &str) -> (Running, String) {
    let watcher = place.start(&[&format!("watch {what} --http 127.0.0.1:0 --json")]);
    let address = page_address(&watcher);
    (watcher, address)
}

/// Waits until a process says as JSON where its page is.
fn page_address(process: &Running) -> String {
    wait_until("the page is served", PATIENCE, || process.stdout().ends_with('\n'));
    let said: Value = serde_json::from_str(&process.stdout()).unwrap();
    let link = said["page"].as_str().unwrap();
    link.trim_start_matches("http://").trim_end_matches('/').to_owned()
}

/// Asks for events, in a version of the protocol that cuts a body into no chunks.
fn events(address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    write!(stream, "GET /events HTTP/1.0\r\nHost: {address}\r\n\r\n").unwrap();
    stream
}

/// Reads on until a text came.
fn read_until(stream: &mut TcpStream, text: &str) -> String {
    let (mut read, mut byte) = (Vec::new(), [0]);
    while !read.ends_with(text.as_bytes()) {
        stream.read_exact(&mut byte).unwrap();
        read.push(byte[0]);
    }
    String::from_utf8_lossy(&read).into_owned()
}

#[test]
fn a_run_on_this_disk_goes_on_where_its_learner_went_on() {
    let place = Place::new();
    place.finish(&[&format!("up --name back {SHORT} --set learner.n_steps=32")]).with_code(0);
    let metrics = place.run("back").join("metrics.jsonl");
    let text = fs::read_to_string(&metrics).unwrap();
    let lines: Vec<&str> = text.split_inclusive('\n').collect();
    let (n, back) = (lines.len(), lines.len() - 10);
    let (_watcher, address) = page_of(&place, "back --play off");
    let mut events = events(&address);
    read_until(&mut events, "event: history\ndata: {");
    assert!(read_until(&mut events, "\n").contains(&format!("\"to\":{n},")));
    // What a learner does that goes on from an earlier update, and makes the one after it again.
    let mut journal = fs::OpenOptions::new().append(true).open(&metrics).unwrap();
    journal.set_len(lines[..back].concat().len() as u64).unwrap();
    read_until(&mut events, "event: history\ndata: {");
    let told = read_until(&mut events, "\n");
    assert!(told.contains(&format!("\"to\":{back},")), "{told}");
    assert!(told.contains(&format!("\"update\":{back},")), "the mark: {told}");
    journal.write_all(lines[back].as_bytes()).unwrap();
    let newest = format!("\"update\":{},", back + 1);
    read_until(&mut events, "event: update\ndata: {");
    while !read_until(&mut events, "\n").contains(&newest) {}
    // All that scripts get agrees.
    let state: Value = serde_json::from_str(&get(&address, "/state.json").1).unwrap();
    let newest = Value::from(back + 1);
    assert_eq!((&state["state"]["update"], &state["history"]["to"]), (&newest, &newest));
}

#[test]
fn a_run_that_makes_no_update_is_not_stopped_while_its_learner_is_there() {
    let place = Place::new();
    let learner = format!("learner --name quiet {SHORT} --listen {}", place.endpoint("l"));
    let learner = place.start(&[&learner]);
    look(&place, 0);
    let metrics = fs::File::options().write(true).open(place.run("quiet").join("metrics.jsonl"));
    metrics.unwrap().set_modified(UNIX_EPOCH).unwrap();
    let seen = || place.finish(&["watch quiet --once --json"]).with_code(0).json();
    assert_ne!(seen()["state"]["state"], "stopped");
    learner.kill();
    assert_eq!(seen()["state"]["state"], "stopped");
}

#[test]
fn an_untrained_policy_plays_and_so_does_one_that_follows_an_unreadable_one() {
    let place = Place::new();
    // Nobody acts, so the learner stays at version 0.
    let learner = format!("learner --name r {SHORT} --listen {}", place.endpoint("l"));
    let learner = place.start(&[&learner]);
    let (_watcher, address) = page_of(&place, &format!("--connect {}", place.endpoint("l")));
    let mut stream = events(&address);
    assert!(read_until(&mut stream, "event: frame\n").contains("\"version\":0"));
    drop(learner);

    place.finish(&[&format!("up --name done {SHORT}")]).with_code(0);
    let policy = place.run("done").join("policy.safetensors");
    let bytes = fs::read(&policy).unwrap();
    fs::write(&policy, "torn").unwrap();
    let (_watcher, address) = page_of(&place, "done");
    let mut stream = events(&address);
    read_until(&mut stream, "\"problem\":\"the policy cannot be read");
    fs::write(&policy, bytes).unwrap();
    read_until(&mut stream, "event: frame\n");
}

#[test]
fn a_run_that_cannot_be_watched_is_reported_in_one_sentence() {
    let place = Place::new();
    let _processes = at_work(&place, "r");
    look(&place, 1);
    let at = place.endpoint("l");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap();
    for (command, code, told) in [
        ("watch".to_owned(), 2, "--connect"),
        ("watch nothing".to_owned(), 2, "there is no run `nothing`"),
        (format!("watch --connect {at} --run other --once"), 2, "there: `r`"),
        ("watch --connect tcp/127.0.0.1:9 --connect-timeout 100ms --once".to_owned(), 3, "refused"),
        (
            "watch --connect tls/127.0.0.1:9 --connect-timeout 1s --once".to_owned(),
            2,
            "needs a certificate",
        ),
        (format!("watch --connect {at} --http 8080"), 2, "`8080` is not an address"),
        (format!("watch --connect {at} --http {taken}"), 2, "--http: "),
        (format!("watch --connect {at} --http {taken}"), 2, "is in use"),
        (format!("up -c cartpole --watch {taken}"), 2, "--watch: "),
        (format!("up -c cartpole --watch {taken}"), 2, "is in use"),
        (format!("watch --connect {at} --http 0.0.0.0:0"), 2, "--token auto"),
        (format!("watch --connect {at} --token short"), 2, "--token"),
        (format!("watch --connect {at} --once --http 127.0.0.1:0"), 2, "cannot be used with"),
        ("up -c cartpole --watch 127.0.0.1".to_owned(), 2, "such as 127.0.0.1:8080"),
    ] {
        place.finish(&[&command]).with_code(code).saying(&[told]);
    }
}
