//! Words from a language model behind HTTP, through the program: killed in the middle and resumed, given up when
//! the model talks nonsense. The model is a server of the test's own that answers by a grammar.

use std::collections::BTreeSet;
use std::fs;

use leadtime_taxonomy::pipeline::DatabasePlan;
use leadtime_taxonomy::pipeline::fakes::{Manner, Server};

use crate::support::{Finished, PATIENCE, Place, Running, WRONG_INPUT, repository};

/// A plan of the highway's first topic alone, as file and read.
fn small_plan(place: &Place) -> DatabasePlan {
    let whole = fs::read_to_string(repository("crates/taxonomy/data/highway/plan.toml")).unwrap();
    let mut parts = whole.split_inclusive("[[topic]]");
    let text = [parts.next().unwrap(), parts.next().unwrap()].concat();
    let text = text.trim_end_matches("[[topic]]").replace("keep = 4", "keep = 3\ntarget = 3");
    place.write("plan.toml", &text);
    DatabasePlan::from_toml(&text).unwrap()
}

fn start(place: &Place, server: &Server) -> Running {
    let http = "taxonomy build plan.toml --backend http --model m --json -o words";
    place.start(&[http, "--timeout 3s --backoff 2ms --url", &server.url])
}

fn finish(place: &Place, server: &Server) -> Finished {
    start(place, server).finish(PATIENCE)
}

fn n_paid_twice(server: &Server) -> usize {
    let answered = server.seen().answered.clone();
    answered.len() - answered.iter().collect::<BTreeSet<_>>().len()
}

#[test]
fn a_build_that_is_killed_goes_on_without_paying_for_a_call_twice() {
    use Manner::{Broken, Short, Slowly, Truncated, Well, WrongCount};
    let place = Place::new();
    let plan = small_plan(&place);
    // The sixth request is the first that is held.
    let mut manners = vec![Well, Broken, Truncated, Well, WrongCount, Well, Slowly, Well, Short];
    manners.extend([Well; 1000]);
    let server = Server::start(&plan, &manners);
    let log = place.path().join("words/calls.jsonl");
    let lines = || fs::read_to_string(&log).unwrap().lines().count();
    for n_answers in [3, 10, 25] {
        server.hold_after(n_answers);
        let build = start(&place, &server);
        server.wait_held(PATIENCE);
        // It waits for its next answer, and has written down every one it got, below the line that says who answers.
        build.kill();
        server.go_on();
        assert_eq!(lines(), 1 + n_answers);
        assert!(!place.path().join("words/taxonomy.toml").exists());
    }
    // A kill in the middle of a write tears the last line: that call alone is made again.
    let whole = fs::read(&log).unwrap();
    fs::write(&log, &whole[..whole.len() - 5]).unwrap();
    let made = finish(&place, &server).with_code(0).json();
    // Beside the model, the program's own embedder writes to the log.
    assert_eq!(made["calls"], lines() - 25, "{made}");
    assert_eq!(n_paid_twice(&server), 1, "the torn call, and no other, was paid twice");
    assert_eq!(made["filled"], 10, "{made}");
    // What the log holds makes the same files without the server.
    place.finish(&["taxonomy build plan.toml --replay words/calls.jsonl -o again"]).with_code(0);
    for file in ["taxonomy.toml", "coverage.md", "candidates.jsonl"] {
        let read = |run: &str| fs::read(place.path().join(run).join(file)).unwrap();
        assert_eq!(read("words"), read("again"), "{file}");
    }
}

#[test]
fn a_model_that_talks_nonsense_is_given_up_and_its_replies_are_kept() {
    let place = Place::new();
    let server = Server::start(&small_plan(&place), &[Manner::Nonsense]);
    let wrong = "are malformed: its template or the model is wrong";
    let says = format!("error: 50 of the last 50 replies of m at {} {wrong}\n", server.url);
    // A model that cannot do it is wrong input.
    for _ in 0..2 {
        let given_up = finish(&place, &server).with_code(WRONG_INPUT);
        assert!(given_up.stderr.ends_with(&says), "{}", given_up.stderr);
        assert_eq!(given_up.stdout, "");
    }
    // The summary and fifty replies, paid once.
    assert_eq!(server.seen().answered.len(), 51);
    let log = fs::read_to_string(place.path().join("words/calls.jsonl")).unwrap();
    assert_eq!(log.lines().count(), 52);
}

#[test]
fn a_server_that_breaks_down_loses_nothing_that_was_paid() {
    let place = Place::new();
    let plan = small_plan(&place);
    let mut manners = vec![Manner::Well; 6];
    manners.extend([Manner::Broken; 5]);
    manners.extend([Manner::Well; 1000]);
    let server = Server::start(&plan, &manners);
    let url = &server.url;
    let told = format!("the server at {url} cannot be reached after 5 tries: status 500");
    finish(&place, &server).with_code(3).saying(&[&told]);
    finish(&place, &server).with_code(0);
    assert_eq!(n_paid_twice(&server), 0);
}
