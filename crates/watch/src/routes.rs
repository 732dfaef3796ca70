//! What is served: the page's files, the stream of events, and everything at once for scripts.

use std::future::{Ready, ready};
use std::sync::Arc;
use std::time::Instant;

use leadtime_proto::hex;
use leadtime_web::axum::Router;
use leadtime_web::axum::body::Body;
use leadtime_web::axum::extract::{RawQuery, State};
use leadtime_web::axum::http::header::{
    CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH, RETRY_AFTER,
};
use leadtime_web::axum::http::{HeaderMap, HeaderValue, StatusCode};
use leadtime_web::axum::response::{IntoResponse as _, Response};
use leadtime_web::axum::routing::get;
use sha2::{Digest as _, Sha256};

use crate::events::{MAX_CLIENTS, NoPlace, Wanted};
use crate::page::Page;

/// Where a page asks for events.
const EVENTS: &str = "/events";
/// Where a script asks for everything.
const STATE: &str = "/state.json";
/// What the page's own file names are followed by, so that a changed program is not hidden by a browser's cache.
const VERSION: &str = "?v=";

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const PLAIN: &str = "text/plain; charset=utf-8";

const INDEX: &[u8] = include_bytes!("../assets/index.html");

/// Every other file of the page: its path, its kind, and its bytes.
const ASSETS: [(&str, &str, &[u8]); 6] = [
    ("/watch.js", SCRIPT, include_bytes!("../assets/watch.js")),
    ("/icon.svg", "image/svg+xml", include_bytes!("../assets/icon.svg")),
    ("/watch.css", STYLE, include_bytes!("../assets/watch.css")),
    ("/vendor/uPlot-1.6.32.min.js", SCRIPT, include_bytes!("../assets/vendor/uPlot-1.6.32.min.js")),
    ("/vendor/uPlot.css", STYLE, include_bytes!("../assets/vendor/uPlot.css")),
    ("/vendor/LICENSE", PLAIN, include_bytes!("../assets/vendor/LICENSE")),
];

/// Lists the paths that need no token: the page itself, which then asks with one.
pub fn open_paths() -> impl Iterator<Item = &'static str> {
    ["/"].into_iter().chain(ASSETS.iter().map(|(path, ..)| *path))
}

/// Serves a page, its files, its events, and the state as JSON.
pub fn routes(page: Arc<Page>) -> Router {
    let mut router = Router::new();
    let all = digest(&ASSETS.map(|(.., bytes)| bytes).concat());
    let index = String::from_utf8_lossy(INDEX).replace(VERSION, &format!("{VERSION}{all}"));
    let tag = digest(index.as_bytes());
    let index: Arc<str> = index.into();
    router = router.route(
        "/",
        get(move |headers: HeaderMap| {
            let index = index.as_bytes().to_vec();
            let answer = file(&headers, HTML, &tag, "no-cache", index);
            async move { answer }
        }),
    );
    for (path, kind, bytes) in ASSETS {
        let tag = digest(bytes);
        let serve = move |headers: HeaderMap| {
            let answer = file(&headers, kind, &tag, "max-age=3600", bytes.to_vec());
            async move { answer }
        };
        router = router.route(path, get(serve));
    }
    router.route(EVENTS, get(events)).route(STATE, get(state)).with_state(page)
}

fn digest(bytes: &[u8]) -> String {
    hex::encode(&Sha256::digest(bytes)[..8])
}

/// Answers with a file, unless the browser has it.
fn file(
    headers: &HeaderMap,
    kind: &'static str,
    tag: &str,
    cache: &'static str,
    bytes: Vec<u8>,
) -> Response {
    let tag = format!("\"{tag}\"");
    let is_known =
        headers.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let mut answer = if is_known {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        ([(CONTENT_TYPE, HeaderValue::from_static(kind))], bytes).into_response()
    };
    answer.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static(cache));
    if let Ok(tag) = HeaderValue::from_str(&tag) {
        answer.headers_mut().insert(ETAG, tag);
    }
    answer
}

/// Returns a parameter of a query string as it is written: no value of ours needs to be escaped.
fn parameter<'a>(query: Option<&'a str>, name: &str) -> Option<&'a str> {
    let pairs = query?.split('&').filter_map(|pair| pair.split_once('='));
    pairs.filter(|(key, _)| *key == name).map(|(_, value)| value).next_back()
}

#[expect(clippy::needless_pass_by_value, reason = "what a handler is given is its own")]
fn events(
    State(page): State<Arc<Page>>,
    RawQuery(query): RawQuery,
    headers: HeaderMap,
) -> Ready<Response> {
    ready(stream(&page, query.as_deref(), &headers))
}

/// Takes a client in, and streams events to it.
fn stream(page: &Page, query: Option<&str>, headers: &HeaderMap) -> Response {
    // Digits of an escape may be small letters.
    let only = parameter(query, "only").map(|only| only.replace("%2C", ",").replace("%2c", ","));
    let wanted = match Wanted::parse(only.as_deref()) {
        Ok(wanted) => wanted,
        Err(sentence) => return (StatusCode::BAD_REQUEST, sentence).into_response(),
    };
    let last = headers.get("last-event-id").and_then(|id| id.to_str().ok());
    let last = last.or_else(|| parameter(query, "after"));
    let events = match page.join(wanted, last, Instant::now()) {
        Ok(events) => events,
        Err(no_place) => {
            let sentence = match no_place {
                NoPlace::Full => format!("{MAX_CLIENTS} pages are open: close one\n"),
                NoPlace::Closed => "the watcher has ended\n".to_owned(),
            };
            let retry = [(RETRY_AFTER, HeaderValue::from_static("5"))];
            return (StatusCode::SERVICE_UNAVAILABLE, retry, sentence).into_response();
        }
    };
    let kind = HeaderValue::from_static("text/event-stream");
    let mut answer = Response::new(Body::from_stream(events.into_stream()));
    answer.headers_mut().insert(CONTENT_TYPE, kind);
    answer
}

fn state(State(page): State<Arc<Page>>) -> Ready<Response> {
    let text = page.with(|view, now| view.json(now)).to_string();
    let kind = [(CONTENT_TYPE, HeaderValue::from_static("application/json"))];
    ready((kind, text).into_response())
}

#[cfg(test)]
#[path = "routes_tests.rs"]
mod tests;
