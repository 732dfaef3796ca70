//! A server for tests: speaks the chat API, answers by a plan's grammar, and misbehaves in every known way.
//!
//! It checks what it is sent, and panics (in the thread of the connection, which then stays unanswered) if that is not
//! what a server may expect. It runs until the process ends.

#![expect(clippy::unwrap_used, reason = "a fake panics where its user breaks the rules")]

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

use super::backend::{Call, CallStage, Input, Model as _, Sampling};
use super::grammar::Grammar;
use super::plan::DatabasePlan;
use crate::utterance::Cell;
use crate::words;

/// How the server answers one request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manner {
    /// With the reply that was asked for.
    Well,
    /// Not before the client has given up.
    Slowly,
    /// With status 500, as if it were broken.
    Broken,
    /// JSON that ends in the middle.
    Truncated,
    /// Fewer bytes than announced.
    Short,
    /// A rating with a number too few.
    WrongCount,
    /// Text that is no answer at all.
    Nonsense,
    /// With status 401, as if a key were missing.
    Refusing,
}

/// What the server has seen.
#[derive(Debug, Default)]
pub struct ServerLog {
    /// Requests, answered or not.
    pub requests: usize,
    /// Bodies of the requests that were answered in full.
    pub answered: Vec<String>,
    /// The last request's header of that name.
    pub authorization: Option<String>,
    /// Answers after which requests are held.
    hold_after: Option<usize>,
    /// Requests that are held now.
    held: usize,
    /// How often held requests were answered.
    n_released: usize,
}

#[derive(Debug, Default)]
struct Shared {
    seen: Mutex<ServerLog>,
    changed: Condvar,
}

/// A server that runs on a port of this machine.
#[derive(Debug)]
pub struct Server {
    /// Base of its API.
    pub url: String,
    shared: Arc<Shared>,
}

impl Server {
    /// Starts a server on a free port that answers in the given manners, in turn, by a grammar.
    ///
    /// # Panics
    ///
    /// If there is no port or no thread to be had.
    pub fn start(plan: &DatabasePlan, manners: &[Manner]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/v1", listener.local_addr().unwrap());
        let shared = Arc::new(Shared::default());
        let (kept, plan, manners) = (Arc::clone(&shared), plan.clone(), manners.to_vec());
        let accept = move || {
            for stream in listener.incoming() {
                let Ok(stream) = stream else { break };
                let (shared, plan, manners) = (Arc::clone(&shared), plan.clone(), manners.clone());
                // One thread per connection, so that a slow answer does not hold up the next.
                let answer = move || {
                    handle(&stream, &plan, &manners, &shared);
                };
                std::thread::Builder::new().name("fake answer".to_owned()).spawn(answer).unwrap();
            }
        };
        std::thread::Builder::new().name("fake server".to_owned()).spawn(accept).unwrap();
        Self { url, shared: kept }
    }

    /// Looks at what it has seen.
    ///
    /// # Panics
    ///
    /// If a connection's thread panicked while it counted.
    pub fn seen(&self) -> MutexGuard<'_, ServerLog> {
        self.shared.seen.lock().unwrap()
    }

    /// Holds every request after that many answers: they stay unanswered, also after [`Server::go_on`].
    pub fn hold_after(&self, n_answers: usize) {
        self.seen().hold_after = Some(n_answers);
    }

    /// Waits until a request is held.
    ///
    /// # Panics
    ///
    /// If none is within `patience`.
    pub fn wait_held(&self, patience: Duration) {
        let (seen, wait) = (self.seen(), |seen: &mut ServerLog| seen.held == 0);
        let (seen, waited) = self.shared.changed.wait_timeout_while(seen, patience, wait).unwrap();
        assert!(!waited.timed_out(), "no request is held after {} answers", seen.answered.len());
    }

    /// Answers the held requests, and later ones again.
    pub fn go_on(&self) {
        let mut seen = self.seen();
        (seen.hold_after, seen.held) = (None, 0);
        seen.n_released += 1;
        self.shared.changed.notify_all();
    }
}

fn handle(
    stream: &TcpStream,
    plan: &DatabasePlan,
    manners: &[Manner],
    shared: &Shared,
) -> Option<()> {
    let (body, authorization) = request(stream)?;
    let manner = {
        let mut seen = shared.seen.lock().unwrap();
        seen.requests += 1;
        seen.authorization = authorization;
        if seen.hold_after.is_some_and(|most| seen.answered.len() >= most) {
            seen.held += 1;
            shared.changed.notify_all();
            let n_released = seen.n_released;
            let held = |seen: &mut ServerLog| seen.n_released == n_released;
            drop(shared.changed.wait_while(seen, held).unwrap());
            return None;
        }
        manners[(seen.requests - 1) % manners.len()]
    };
    let json: serde_json::Value = serde_json::from_str(&body).unwrap();
    assert_eq!(json["stream"], false);
    let mut text = answer(plan, json["messages"][1]["content"].as_str().unwrap());
    let mut stream = stream;
    match manner {
        // Whatever comes first, the client's end or an error, it has given up.
        Manner::Slowly => return stream.read(&mut [0]).ok().map(drop),
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
    if matches!(manner, Manner::Well | Manner::WrongCount | Manner::Nonsense) {
        // Counted first: whoever has the answer may look at once.
        shared.seen.lock().unwrap().answered.push(body);
    }
    stream.write_all(format!("{head}{sent}").as_bytes()).ok()
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
fn answer(plan: &DatabasePlan, prompt: &str) -> String {
    let after = |mark: &str| prompt.rsplit_once(mark).map(|(_, rest)| rest);
    let topic = |named: &str| {
        let topic = plan.topic.iter().find(|topic| named.starts_with(&topic.action));
        topic.unwrap().id.clone()
    };
    let input = if let Some(action) = after("intended action is: ") {
        let text = after("Instruction: ").unwrap().trim().to_owned();
        Input::Sentence { topic: topic(action), text, words: None }
    } else if let Some(action) = after("meant to do this: ") {
        let text = after("Heard so far: \"").unwrap().split('"').next().unwrap().to_owned();
        let words = Some(words::count(&text) as usize);
        Input::Sentence { topic: topic(action), text, words }
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
    let call = Call { stage: CallStage::Generate, system, prompt, sampling, seed: 0, input };
    Grammar::new(plan).complete(&call).unwrap().text
}
