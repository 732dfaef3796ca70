//! The handlers, asked without a network.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use leadtime_numerics::Pcg64;
use leadtime_web::Guard;
use leadtime_web::axum::body::to_bytes;
use leadtime_web::axum::extract::Request;
use serde_json::{Value, json};
use tower::ServiceExt as _;

use super::*;

fn page() -> Arc<Page> {
    let page = Page::new("r", || 1_000.0);
    page.with(|view, now| {
        view.about(json!({"domain": "lander", "total_updates": 9, "steps_per_update": 8}), now);
        for update in 1..=5 {
            let line = json!({"update": update, "steps": update * 8, "train/entropy": 1.0});
            view.update(line.as_object().unwrap().clone(), now);
        }
    });
    // Nothing is due any more.
    page.flush(Instant::now());
    page
}

async fn ask(page: &Arc<Page>, path: &str, headers: &[(&str, &str)]) -> Response {
    let mut request = Request::builder().uri(path).header("host", "localhost");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let router = Guard::new().protect(routes(Arc::clone(page)));
    router.oneshot(request.body(Body::empty()).unwrap()).await.unwrap()
}

async fn text(answer: Response) -> String {
    let bytes = to_bytes(answer.into_body(), 1 << 24).await.unwrap();
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Reads what a new client is told first: the page is closed after it came.
async fn told(page: &Arc<Page>, path: &str, headers: &[(&str, &str)]) -> Vec<(String, Value)> {
    let answer = ask(page, path, headers).await;
    assert_eq!(answer.headers()["content-type"], "text/event-stream");
    assert_eq!(answer.headers()["cache-control"], "no-store");
    page.close();
    let text = text(answer).await;
    let event = |block: &str| {
        let field = |name: &str| block.lines().find_map(|line| line.strip_prefix(name)).unwrap();
        (field("event: ").to_owned(), serde_json::from_str(field("data: ")).unwrap())
    };
    text.split("\n\n").filter(|block| !block.is_empty()).map(event).collect()
}

#[tokio::test]
async fn every_file_of_the_page_is_served_and_known_by_its_tag() {
    let page = page();
    for path in open_paths() {
        let answer = ask(&page, path, &[]).await;
        assert_eq!(answer.status(), 200, "{path}");
        let tag = answer.headers()["etag"].to_str().unwrap().to_owned();
        let body = text(answer).await;
        assert!(body.len() > 100, "{path}");
        let known = ask(&page, path, &[("if-none-match", &tag)]).await;
        assert_eq!(known.status(), 304, "{path}");
        // Another program would have another tag.
        let other = ask(&page, path, &[("if-none-match", "\"0123456789abcdef\"")]).await;
        assert_eq!(other.status(), 200, "{path}");
    }
    let index = text(ask(&page, "/", &[]).await).await;
    assert!(!index.contains("?v=\""), "every file is named with its version");
    assert!(!index.contains("style=") && !index.contains("onclick"), "the policy forbids both");
}

#[tokio::test]
async fn the_page_is_small() {
    let sum: usize = ASSETS.map(|(.., bytes)| bytes.len()).iter().sum::<usize>() + INDEX.len();
    assert!(sum <= 120_000, "{sum}");
    let (.., code) = ASSETS.into_iter().find(|(path, ..)| *path == "/watch.js").unwrap();
    assert!(String::from_utf8_lossy(code).lines().count() <= 900);
}

#[tokio::test]
async fn a_new_page_is_told_everything_in_order() {
    let kinds: Vec<String> =
        told(&page(), "/events", &[]).await.into_iter().map(|it| it.0).collect();
    assert_eq!(kinds[..6], ["about", "state", "history", "update", "actors", "log"]);
    // How the run stands at the end, and goodbye.
    assert_eq!(kinds[6..], ["state", "actors", "bye"]);
}

#[tokio::test]
async fn a_client_gets_what_it_asks_for() {
    let events = told(&page(), "/events?only=update,history", &[]).await;
    assert_eq!(events.iter().map(|it| it.0.as_str()).collect::<Vec<_>>(), ["history", "update"]);
    assert_eq!(events[0].1["x"], json!([1, 2, 3, 4, 5]));
    for escaped in ["/events?only=update%2Chistory", "/events?only=update%2chistory"] {
        assert_eq!(told(&page(), escaped, &[]).await, events, "{escaped}");
    }
    let events = told(&page(), "/events?only=history", &[("last-event-id", "4.0.1000000")]).await;
    assert_eq!((&events[0].1["from"], &events[0].1["x"]), (&json!(4), &json!([4, 5])));
    for unknown in ["99.0.1000000", "4.7.1000000", "4.0.7", "4.0", "4", "x.y.z", "4.0.1000000.0"] {
        let events = told(&page(), "/events?only=history", &[("last-event-id", unknown)]).await;
        assert_eq!(events[0].1["from"], 0, "{unknown}");
    }
}

#[tokio::test]
async fn watchers_are_told_apart() {
    let events = told(&page(), "/events?only=about", &[]).await;
    assert_eq!(events[0].1["watcher"], 1_000_000, "when it started, in milliseconds");
    // One on a port that another had before.
    let next = Page::new("r", || 2_000.0);
    next.with(|view, now| view.update(json!({"update": 7}).as_object().unwrap().clone(), now));
    let events = told(&next, "/events?only=history", &[("last-event-id", "4.0.1000000")]).await;
    assert_eq!(events[0].1["from"], 0);
}

#[tokio::test]
async fn an_update_that_came_late_does_not_delay_the_next() {
    let (page, start) = (Page::new("r", || 1_000.0), Instant::now() + Duration::from_secs(9));
    let events = page.join(Wanted::parse(Some("update")).unwrap(), None, start).unwrap();
    let n_told = |update: u64, at: u64| {
        let line = json!({"update": update});
        page.with(|view, now| view.update(line.as_object().unwrap().clone(), now));
        page.flush(start + Duration::from_millis(at));
        events.drain().count()
    };
    assert_eq!(n_told(1, 1_000), 2, "one with the page");
    // Its learner tells five a second; the way to the page takes longer now and then.
    assert_eq!([(2, 1_290), (3, 1_400), (4, 1_600)].map(|(update, at)| n_told(update, at)), [1; 3]);
    // One that tells more often is not told more often.
    let n: usize = (10..110).map(|tick| n_told(tick, 1_600 + 10 * tick)).sum();
    assert!(n <= 6, "{n}");
}

#[tokio::test]
async fn curves_as_a_whole_are_told_once_a_second_at_most() {
    let (page, start) = (Page::new("r", || 1_000.0), Instant::now());
    let events = page.join(Wanted::parse(Some("history,update")).unwrap(), None, start).unwrap();
    events.drain();
    let mut n_histories = 0;
    for tick in 0..50 {
        // A learner that starts again and again.
        page.with(|view, now| {
            let told = json!({"kind": "update", "update": tick + 1});
            view.learner_left(&(tick.max(1) - 1).to_string(), now);
            view.learner_says(&tick.to_string(), told, now);
        });
        page.flush(start + Duration::from_millis(100 * tick));
        let told = events.drain().map(|event| String::from_utf8(event.unwrap().to_vec()).unwrap());
        n_histories += told.filter(|text| text.contains("event: history\n")).count();
    }
    assert_eq!(n_histories, 5);
}

#[tokio::test]
async fn what_is_due_when_a_page_comes_is_told_once_to_it_and_to_those_before_it() {
    let (page, now) = (Page::new("r", || 1_000.0), Instant::now());
    let told = |events: &flume::Receiver<crate::events::EventBytes>| {
        let texts = events.drain().map(|event| String::from_utf8(event.unwrap().to_vec()).unwrap());
        let kind = |text: String| {
            text.lines().find_map(|line| line.strip_prefix("event: ")).map(str::to_owned)
        };
        let kinds = texts.filter_map(kind);
        kinds.filter(|kind| !["state", "actors"].contains(&kind.as_str())).collect::<Vec<_>>()
    };
    let change = |update: u64| {
        page.with(|view, now| {
            let told = json!({"kind": "update", "update": update});
            view.learner_left(&(update - 1).to_string(), now);
            view.learner_says(&update.to_string(), told, now);
        });
    };
    let all = || Wanted::parse(None).unwrap();
    change(1);
    change(2);
    page.flush(now);
    let first = page.join(all(), None, now).unwrap();
    change(3);
    // The pause between two histories is not over.
    page.flush(now);
    assert_eq!(told(&first), ["about", "history", "update", "log", "log"]);
    let second = page.join(all(), None, now).unwrap();
    assert_eq!(told(&first), ["about", "history", "update"]);
    page.flush(now + Duration::from_secs(2));
    assert_eq!(told(&second), ["about", "history", "update", "log"]);
    assert!(told(&first).is_empty());
}

#[tokio::test]
async fn an_actor_that_is_gone_for_long_leaves_the_table_without_a_roster() {
    static NOW: AtomicU64 = AtomicU64::new(1_000);
    let page = Page::new("r", || NOW.load(Ordering::Relaxed) as f64);
    page.with(|view, now| {
        view.actor_joined("a", "01", now);
        view.actor_left("a", "01", now);
    });
    let actors =
        |page: &Page| page.with(|view, now| view.actors_json(now)).as_array().unwrap().len();
    page.flush(Instant::now());
    assert_eq!(actors(&page), 1);
    NOW.store(1_061, Ordering::Relaxed);
    page.flush(Instant::now());
    assert_eq!(actors(&page), 0);
}

#[tokio::test]
async fn a_wrong_request_is_answered_with_what_is_possible() {
    let page = page();
    let answer = ask(&page, "/events?only=everything", &[]).await;
    assert_eq!(answer.status(), 400);
    assert!(text(answer).await.contains("about, history, update"));
    for path in
        ["/nothing", "/../Cargo.toml", "/vendor/../../Cargo.toml", "/%2e%2e/etc/passwd", "/vendor/"]
    {
        assert_eq!(ask(&page, path, &[]).await.status(), 404, "{path}");
    }
    // A part of a file is not served: the whole is small.
    assert_eq!(ask(&page, "/watch.js", &[("range", "bytes=0-9")]).await.status(), 200);
}

#[tokio::test]
async fn one_page_too_many_is_told_so_and_one_that_leaves_makes_room() {
    let page = page();
    let mut open = Vec::new();
    for _ in 0..MAX_CLIENTS {
        open.push(ask(&page, "/events", &[]).await);
    }
    let answer = ask(&page, "/events", &[]).await;
    assert_eq!(answer.status(), 503);
    assert!(text(answer).await.contains("32 pages are open"));
    open.pop();
    assert_eq!(ask(&page, "/events", &[]).await.status(), 200);
    page.close();
    let answer = ask(&page, "/events", &[]).await;
    assert_eq!(
        (answer.status().as_u16(), text(answer).await.as_str()),
        (503, "the watcher has ended\n")
    );
}

#[tokio::test]
async fn scripts_get_everything_at_once() {
    let answer = ask(&page(), "/state.json", &[]).await;
    assert_eq!(answer.headers()["content-type"], "application/json");
    let told: Value = serde_json::from_str(&text(answer).await).unwrap();
    assert_eq!((&told["schema"], &told["state"]["update"]), (&json!(1), &json!(5)));
}

#[tokio::test]
async fn any_query_is_answered() {
    // A generator of its own: nothing here may depend on luck.
    let mut draws = Pcg64::seed_from_u64(7);
    let letters = b"only=after&%,.?update0123456789-+[]{}~abc";
    let page = page();
    for _ in 0..2_000 {
        let query: String =
            (0..draws.below(60)).map(|_| letters[draws.below(letters.len())] as char).collect();
        let Ok(uri) = format!("/events?{query}").parse::<leadtime_web::axum::http::Uri>() else {
            continue;
        };
        let status = ask(&page, &uri.to_string(), &[]).await.status();
        assert!([200, 400].contains(&status.as_u16()), "{uri}: {status}");
    }
}
