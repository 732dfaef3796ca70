//! Odd questions about a run, made of genuine ones: a page's, with which it asks for events, and an observer's, with which it asks
//! a learner for its history. Each is answered or refused.
//!
//! ```console
//! cargo run --release -p leadtime-watch --example odd_questions -- 60
//! ```
//!
//! The number is the seconds that it goes on; the questions are the same every time. `fuzz/fuzz_targets/questions.rs` has a guided
//! fuzzer, which needs a nightly compiler.

#![expect(clippy::print_stdout, clippy::expect_used, reason = "a program for people")]

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use leadtime_link::history_question;
use leadtime_numerics::Pcg64;
use leadtime_numerics::thin::ThinSeries;
use leadtime_proto::limits::MAX_HISTORY_POINTS;
use leadtime_watch::{Page, routes};
use leadtime_web::Guard;
use leadtime_web::axum::Router;
use leadtime_web::axum::body::Body;
use leadtime_web::axum::extract::Request;
use leadtime_web::axum::http::StatusCode;
use serde_json::json;
use tower::ServiceExt as _;

/// What is asked in earnest.
const GENUINE: [&str; 6] = [
    "",
    "only=update,actors",
    "only=history&after=4.0.1000000",
    "after=5.0.1000000&only=flight%2Cframe",
    "from=3;points=400",
    "from=0",
];
/// What is put between.
const PIECES: [&str; 20] = [
    "&",
    "=",
    ";",
    "|",
    ",",
    ".",
    "%",
    "%2C",
    "%00",
    "-1",
    "0",
    "4000",
    "4001",
    "18446744073709551616",
    "only=",
    "after=",
    "from=",
    "points=",
    "update",
    "\u{e9}",
];
/// The longest question, in characters: longer than any address that is answered.
const LONGEST: usize = 16_384;
/// Questions between two looks at the clock.
const AT_ONCE: usize = 256;

/// Puts pieces into a genuine question, takes characters out, and now and then doubles it.
fn odd(draws: &mut Pcg64) -> String {
    let mut text: Vec<char> = GENUINE[draws.below(GENUINE.len())].chars().collect();
    for _ in 0..draws.below(8) {
        let place = draws.below(text.len() + 1);
        match draws.below(8) {
            0 | 1 if place < text.len() => {
                text.remove(place);
            }
            2 => text.truncate(place),
            _ => drop(text.splice(place..place, PIECES[draws.below(PIECES.len())].chars())),
        }
    }
    while draws.below(16) == 0 && (1..LONGEST / 2).contains(&text.len()) {
        text.extend_from_within(..);
    }
    text.into_iter().collect()
}

/// Asks a page for events; `None` where no browser could ask that.
async fn ask_page(page: &Router, draws: &mut Pcg64) -> Option<StatusCode> {
    let path = format!("/events?{}", odd(draws));
    let request = Request::builder().uri(path).header("host", "localhost");
    let request = request.header("last-event-id", odd(draws)).body(Body::empty()).ok()?;
    let Ok(answer) = page.clone().oneshot(request).await;
    // What it is sent is dropped with the answer, which makes room for the next page.
    Some(answer.status())
}

/// Asks for a history; returns whether that is answered.
fn ask_history(draws: &mut Pcg64) -> bool {
    let Ok((_, n_points)) = history_question(&odd(draws)) else { return false };
    assert!((1..=MAX_HISTORY_POINTS).contains(&n_points));
    let mut series = ThinSeries::new(n_points);
    for update in 1..=8 {
        series.push(update, [("train/entropy", 1.0)]);
    }
    assert!(series.x.len() <= n_points.max(2));
    true
}

#[tokio::main(flavor = "current_thread")]
async fn main() {
    let seconds = std::env::args().nth(1).map_or(Ok(5), |text| text.parse::<u64>());
    let patience = Duration::from_secs(seconds.expect("write for how many seconds"));
    let page = Page::new("r", || 1_000.0);
    page.with(|view, now| {
        for update in 1..=5 {
            let line = json!({"update": update, "steps": update * 8, "train/entropy": 1.0});
            view.update(line.as_object().cloned().unwrap_or_default(), now);
        }
    });
    let page = Guard::new().protect(routes(page));
    let (started, mut draws) = (Instant::now(), Pcg64::seed_from_u64(7));
    let mut answers: BTreeMap<String, u64> = BTreeMap::new();
    while started.elapsed() < patience {
        for _ in 0..AT_ONCE {
            let status = ask_page(&page, &mut draws).await;
            let told = status.map_or("no address".to_owned(), |status| status.to_string());
            *answers.entry(format!("page: {told}")).or_default() += 1;
            let told = if ask_history(&mut draws) { "answered" } else { "refused" };
            *answers.entry(format!("history: {told}")).or_default() += 1;
        }
    }
    println!("{} questions, no panic", answers.values().sum::<u64>());
    for (answer, n) in &answers {
        println!("{n:9} {answer}");
    }
    // Neither an error of its own nor a page that is full.
    assert!(!answers.keys().any(|answer| answer.starts_with("page: 5")));
    for expected in ["page: 200 OK", "page: 400 Bad Request", "history: answered"] {
        assert!(answers.contains_key(expected), "{expected}");
    }
}
