//! Feeds noise to what reads questions about a run: the query string of a page's events, the event that a page knows last, and
//! what an observer asks a history for.
//!
//! A panic, an allocation over libFuzzer's `-malloc_limit_mb`, or an answer that blames the watcher is a finding.
#![no_main]

use leadtime_link::history_question;
use leadtime_watch::{Page, routes};
use leadtime_web::Guard;
use leadtime_web::axum::body::Body;
use leadtime_web::axum::extract::Request;
use libfuzzer_sys::fuzz_target;
use tower::ServiceExt as _;

fuzz_target!(|bytes: &[u8]| {
    let text = &*String::from_utf8_lossy(bytes);
    if let Ok((_, n_points)) = history_question(text) {
        assert!((1..=leadtime_proto::limits::MAX_HISTORY_POINTS).contains(&n_points));
    }
    let request = Request::builder().uri(format!("/events?{text}")).header("host", "localhost");
    let Ok(request) = request.header("last-event-id", text).body(Body::empty()) else { return };
    let page = Guard::new().protect(routes(Page::new("r", || 1_000.0)));
    let runtime = tokio::runtime::Builder::new_current_thread().build();
    let runtime = runtime.expect("a runtime without input and output needs nothing");
    let Ok(answer) = runtime.block_on(page.oneshot(request));
    assert!(!answer.status().is_server_error(), "{}", answer.status());
});
