//! The whole pipeline over HTTP, against a server that answers well most of the time and badly in every known way.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::path::Path;

use super::*;
use crate::pipeline::fakes::{Manner, Server};
use crate::pipeline::job::{self, Backend, BuildJob};
use crate::pipeline::plan::{DatabasePlan, RateForm};

/// A plan of one topic, so that a run takes seconds.
fn small_plan() -> DatabasePlan {
    let mut plan = job::plan("highway").unwrap();
    plan.topic.truncate(1);
    plan.settings.rate = RateForm::Joint;
    plan.settings.target = 3;
    plan.settings.attempts_per_cell = 6;
    plan
}

fn impatient(url: &str) -> HttpSettings {
    HttpSettings {
        url: url.to_owned(),
        model: "test-model".to_owned(),
        api_key: Some("secret".to_owned()),
        fidelity: Fidelity::Local,
        // Long enough for a busy machine: an answer that comes too late would be paid twice.
        timeout: Duration::from_secs(2),
        tries: 5,
        backoff: Duration::from_millis(2),
    }
}

fn job(log: &Path, url: &str, max_calls: Option<u64>) -> BuildJob {
    let (backend, log) = (Backend::Http(impatient(url)), log.to_owned());
    BuildJob { backend, log, prompts: None, embedder: None, rater: None, max_calls }
}

/// What ends a run of the small plan against an address.
fn stopped(url: &str) -> String {
    let directory = tempfile::tempdir().unwrap();
    let job = job(&directory.path().join("calls.jsonl"), url, None);
    job::run(&small_plan(), job).unwrap_err().to_string()
}

#[test]
fn a_run_survives_a_server_that_misbehaves_and_pays_for_nothing_twice() {
    use Manner::{Broken, Short, Slowly, Truncated, Well, WrongCount};
    let mut manners =
        vec![Well, Well, Broken, Well, Truncated, Well, Well, WrongCount, Well, Short];
    manners.extend([Well, Slowly, Well, Well, WrongCount, Broken, Broken, Well, Short]);
    // From then on it answers well.
    manners.extend([Well; 500]);
    let plan = small_plan();
    let server = Server::start(&plan, &manners);
    let directory = tempfile::tempdir().unwrap();
    let log = directory.path().join("calls.jsonl");
    let built = loop {
        // Cut off every 25 calls, and resumed.
        match job::run(&plan, job(&log, &server.url, Some(25))) {
            Ok((built, _)) => break built,
            Err(PipelineError::BudgetSpent { .. }) => {}
            Err(other) => panic!("{other}"),
        }
    };
    let seen = server.seen();
    let distinct: BTreeSet<&String> = seen.answered.iter().collect();
    assert_eq!(distinct.len(), seen.answered.len(), "a call was paid twice");
    assert!(seen.requests > seen.answered.len() + 5);
    assert_eq!(seen.authorization.as_deref(), Some("authorization: Bearer secret"));
    assert!(!std::fs::read_to_string(&log).unwrap().contains("secret"));
    let taxonomy = built.taxonomy.unwrap();
    assert_eq!(taxonomy.header().generator, format!("test-model at {}", server.url));
    assert_eq!(taxonomy.topics()[0].cells().count(), 10);
    drop(seen);
    // What the log holds makes the same file without the server.
    let replay = BuildJob { backend: Backend::Replay, ..job(&log, "http://nobody", None) };
    assert_eq!(job::run(&plan, replay).unwrap().0.text, built.text);
}

#[test]
fn a_server_that_refuses_is_not_asked_again() {
    let server = Server::start(&small_plan(), &[Manner::Refusing]);
    let says = format!("the server at {} refuses with status 401: no key", server.url);
    assert_eq!(stopped(&server.url), says);
    assert_eq!(server.seen().requests, 1);
}

#[test]
fn nobody_there_is_said_in_one_sentence() {
    // A port that was free a moment ago.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    drop(listener);
    let error = stopped(&url);
    let says = format!("the server at {url} cannot be reached after 5 tries: ");
    assert!(error.starts_with(&says) && !error.contains('\n'), "{error}");
}

#[test]
fn an_address_that_cannot_be_is_named() {
    let error = Http::new(impatient("localhost:8080")).unwrap_err().to_string();
    assert!(error.starts_with("--url is localhost:8080; allowed: http://"), "{error}");
    let model = Http::new(impatient("http://localhost:8080/v1/")).unwrap();
    assert_eq!(model.id, "test-model at http://localhost:8080/v1");
}
