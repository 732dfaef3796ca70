//! The whole pipeline over HTTP, against a server that answers well most of the time and badly in every known way.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::{Arc, Mutex};

use super::*;
use crate::pipeline::backend::{Input, Sampling, Stage};
use crate::pipeline::grammar::Grammar;
use crate::pipeline::job::{self, Backend, BuildJob};
use crate::pipeline::plan::{Plan, RateForm};
use crate::utterance::Cell;

/// How the server answers one request.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Manner {
    Well,
    /// After the client has given up.
    Slowly,
    /// Status 500.
    Broken,
    /// JSON that ends in the middle.
    Truncated,
    /// Fewer bytes than announced.
    Short,
    /// A rating with a number too few.
    WrongCount,
    /// Text that is no answer at all.
    Nonsense,
    /// Status 401.
    Refusing,
}

/// What the server has seen.
#[derive(Debug, Default)]
struct Seen {
    requests: usize,
    /// Bodies of the requests that were answered in full.
    answered: Vec<String>,
    authorization: Option<String>,
}

struct Server {
    url: String,
    seen: Arc<Mutex<Seen>>,
}

/// Starts a server that answers in the given manners, in turn, by a grammar.
fn serve(plan: &Plan, manners: &'static [Manner]) -> Server {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    let seen = Arc::new(Mutex::new(Seen::default()));
    let (shared, plan) = (Arc::clone(&seen), plan.clone());
    let accept = move || {
        for stream in listener.incoming() {
            let (Ok(stream), shared, plan) = (stream, Arc::clone(&shared), plan.clone()) else {
                break;
            };
            // One thread per connection, so that a slow answer does not hold up the next.
            let answer = move || while handle(&stream, &plan, manners, &shared).is_some() {};
            std::thread::Builder::new().name("mock answer".to_owned()).spawn(answer).unwrap();
        }
    };
    std::thread::Builder::new().name("mock server".to_owned()).spawn(accept).unwrap();
    Server { url, seen }
}

fn handle(stream: &TcpStream, plan: &Plan, manners: &[Manner], seen: &Mutex<Seen>) -> Option<()> {
    let (body, authorization) = request(stream)?;
    let manner = {
        let mut seen = seen.lock().unwrap();
        seen.requests += 1;
        seen.authorization = authorization;
        manners[(seen.requests - 1) % manners.len()]
    };
    let json: serde_json::Value = serde_json::from_str(&body).unwrap();
    assert_eq!(json["stream"], false);
    let mut text = answer(plan, json["messages"][1]["content"].as_str().unwrap());
    let mut stream = stream;
    match manner {
        Manner::Slowly => std::thread::sleep(Duration::from_millis(700)),
        Manner::WrongCount => text.truncate(text.rfind(',').unwrap_or(text.len())),
        Manner::Nonsense => "As a model I cannot:".clone_into(&mut text),
        _ => {}
    }
    let good = serde_json::json!({
        "choices": [{"message": {"role": "assistant", "content": text}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 10, "completion_tokens": 5}, "something_new": {},
    })
    .to_string();
    let (status, sent, length) = match manner {
        Manner::Broken => ("500 Oops", String::new(), 0),
        Manner::Refusing => ("401 Unauthorized", "no\nkey".to_owned(), 6),
        Manner::Truncated => ("200 OK", good[..good.len() / 2].to_owned(), good.len() / 2),
        Manner::Short => ("200 OK", good[..good.len() / 2].to_owned(), good.len()),
        _ => ("200 OK", good.clone(), good.len()),
    };
    let head =
        format!("HTTP/1.1 {status}\r\ncontent-length: {length}\r\nconnection: close\r\n\r\n");
    let delivered = stream.write_all(format!("{head}{sent}").as_bytes()).is_ok();
    if delivered && matches!(manner, Manner::Well | Manner::WrongCount | Manner::Nonsense) {
        seen.lock().unwrap().answered.push(body);
    }
    None
}

fn request(stream: &TcpStream) -> Option<(String, Option<String>)> {
    let mut reader = BufReader::new(stream);
    let (mut length, mut authorization) = (0, None);
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok().filter(|n| *n > 0)?;
        let lower = line.to_lowercase();
        if let Some(value) = lower.strip_prefix("content-length:") {
            length = value.trim().parse().unwrap();
        }
        if lower.starts_with("authorization:") {
            authorization = Some(line.trim().to_owned());
        }
        if line == "\r\n" {
            break;
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    Some((String::from_utf8(body).unwrap(), authorization))
}

/// Understands a prompt well enough to have a grammar answer it.
fn answer(plan: &Plan, prompt: &str) -> String {
    let after = |mark: &str| prompt.rsplit_once(mark).map(|(_, rest)| rest);
    let topic = |named: &str| {
        let topic = plan.topic.iter().find(|topic| named.starts_with(&topic.action));
        topic.unwrap().id.clone()
    };
    let input = if let Some(action) = after("intended action is: ") {
        let text = after("Instruction: ").unwrap().trim().to_owned();
        Input::Sentence { topic: topic(action), text, words: None }
    } else if let Some(action) = after("whose only message is: ") {
        let number = |mark| after(mark).unwrap().split([' ', ',']).next().unwrap().parse().unwrap();
        let cell = Cell::new(number("by word number "), number("have exactly "));
        let there =
            after("so write others:\n").unwrap().lines().take_while(|line| !line.is_empty());
        let round = u32::from(there.count() > 1);
        Input::Sentences { topic: topic(action), cell, n: 6, round }
    } else {
        Input::Domain
    };
    let sampling = Sampling { temperature: 0.0, top_p: 1.0, max_tokens: 16 };
    let (system, prompt) = (String::new(), String::new());
    let call = Call { stage: Stage::Generate, system, prompt, sampling, seed: 0, input };
    Grammar::new(plan).complete(&call).unwrap().text
}

/// A plan of one topic, so that a run takes seconds.
fn small_plan() -> Plan {
    let mut plan = job::plan("highway").unwrap();
    plan.topic.truncate(1);
    plan.settings.rate = RateForm::Joint;
    plan.settings.target = 3;
    plan.settings.attempts_per_cell = 6;
    plan
}

fn impatient(url: &str) -> HttpSettings {
    HttpSettings {
        timeout: Duration::from_millis(300),
        backoff: Duration::from_millis(2),
        api_key: Some("secret".to_owned()),
        ..HttpSettings::new(url, "test-model")
    }
}

fn job(log: &Path, url: &str, max_calls: Option<u64>) -> BuildJob {
    BuildJob {
        backend: Backend::Http(impatient(url)),
        log: log.to_owned(),
        prompts: None,
        embedder: None,
        rater: None,
        max_calls,
    }
}

#[test]
fn a_run_survives_a_server_that_misbehaves_and_pays_for_nothing_twice() {
    use Manner::{Broken, Short, Slowly, Truncated, Well, WrongCount};
    const MANNERS: &[Manner] = &[
        Well, Well, Broken, Well, Truncated, Well, Well, WrongCount, Well, Short, Well, Well,
        Slowly, Well, Well, Well, Well, Well, Well, Well, Well, Well, Well,
    ];
    let plan = small_plan();
    let server = serve(&plan, MANNERS);
    let directory = tempfile::tempdir().unwrap();
    let log = directory.path().join("calls.jsonl");
    let built = loop {
        // Cut off every 25 calls, and taken up again.
        match job::run(&plan, job(&log, &server.url, Some(25))) {
            Ok((built, _)) => break built,
            Err(PipelineError::BudgetSpent { .. }) => {}
            Err(other) => panic!("{other}"),
        }
    };
    let seen = server.seen.lock().unwrap();
    let mut distinct = seen.answered.clone();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), seen.answered.len(), "a call was paid twice");
    assert!(seen.requests > seen.answered.len() + 5);
    assert_eq!(seen.authorization.as_deref(), Some("authorization: Bearer secret"));
    assert!(!std::fs::read_to_string(&log).unwrap().contains("secret"));
    assert_eq!(
        built.taxonomy.as_ref().unwrap().header().generator,
        format!("test-model at {}", server.url)
    );
    assert!(built.taxonomy.as_ref().unwrap().topics()[0].cells().count() == 10);
    drop(seen);
    // What the log holds makes the same file without the server.
    let replay = BuildJob { backend: Backend::Replay, ..job(&log, "http://nobody", None) };
    assert_eq!(job::run(&plan, replay).unwrap().0.text, built.text);
}

#[test]
fn a_model_that_talks_nonsense_is_given_up_with_one_sentence() {
    let plan = small_plan();
    let server = serve(&plan, &[Manner::Nonsense]);
    let directory = tempfile::tempdir().unwrap();
    let job = job(&directory.path().join("calls.jsonl"), &server.url, None);
    let error = job::run(&plan, job).unwrap_err().to_string();
    let says = format!(
        "50 of the last 50 replies of test-model at {} are malformed: its template or the model is wrong",
        server.url
    );
    assert_eq!(error, says);
}

#[test]
fn a_server_that_refuses_is_not_asked_again() {
    let plan = small_plan();
    let server = serve(&plan, &[Manner::Refusing]);
    let directory = tempfile::tempdir().unwrap();
    let job = job(&directory.path().join("calls.jsonl"), &server.url, None);
    let error = job::run(&plan, job).unwrap_err().to_string();
    assert_eq!(error, format!("the server at {} refuses with status 401: no key", server.url));
    assert_eq!(server.seen.lock().unwrap().requests, 1);
}

#[test]
fn nobody_there_is_said_in_one_sentence() {
    // A port that was free a moment ago.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    drop(listener);
    let directory = tempfile::tempdir().unwrap();
    let job = job(&directory.path().join("calls.jsonl"), &url, None);
    let error = job::run(&small_plan(), job).unwrap_err().to_string();
    let says = format!("the server at {url} cannot be reached after 5 tries: ");
    assert!(error.starts_with(&says) && !error.contains('\n'), "{error}");
}

#[test]
fn an_address_that_cannot_be_is_named() {
    let error = Http::new(HttpSettings::new("localhost:8080", "m")).unwrap_err().to_string();
    assert!(error.starts_with("`url` of the plan is localhost:8080; allowed: http://"), "{error}");
}
