//! Who may ask, and how: host, origin, method, length, token; and the headers of every answer.
//!
//! A browser lets a page of another site ask a server on this machine, and a name that the page's owner controls can be
//! made to point here (DNS rebinding), which makes the answer readable. Such a request bears that name as its `Host`. So
//! only addresses, `localhost` and the names that the server was given are answered.

use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::header::{
    ALLOW, AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, HOST, ORIGIN, REFERRER_POLICY,
    WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse as _, Response};
use sha2::{Digest as _, Sha256};

/// The longest URL that is answered, in bytes.
const MAX_URL_BYTES: usize = 8 << 10;
/// What is in front of a token.
const SCHEME: &str = "Bearer ";
/// Headers of every answer.
const SECURITY: [(HeaderName, &str); 4] = [
    (
        CONTENT_SECURITY_POLICY,
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (X_FRAME_OPTIONS, "DENY"),
    (REFERRER_POLICY, "no-referrer"),
];

/// A secret that a client sends as `Authorization: Bearer SECRET`; only its digest is kept.
#[derive(Clone, Copy, Debug)]
pub struct AccessToken([u8; 32]);

impl AccessToken {
    /// Keeps a secret's digest.
    pub fn new(secret: &str) -> Self {
        Self(Sha256::digest(secret).into())
    }

    /// Returns whether a request bears the secret; takes as long for a wrong one as for the right one.
    fn is_borne_by(self, headers: &HeaderMap) -> bool {
        let value = headers.get(AUTHORIZATION).map_or(&b""[..], HeaderValue::as_bytes);
        let given = Sha256::digest(value.strip_prefix(SCHEME.as_bytes()).unwrap_or_default());
        let difference =
            self.0.iter().zip(given).fold(0, |all, (ours, theirs)| all | (ours ^ theirs));
        std::hint::black_box(difference) == 0
    }
}

/// The rules of a server.
#[derive(Clone, Debug, Default)]
pub struct Guard {
    names: Vec<String>,
    token: Option<AccessToken>,
    open_paths: Vec<String>,
}

/// Why a request is not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Objection {
    Method,
    Length,
    NoHost,
    ForeignHost,
    ForeignOrigin,
    Token,
}

impl Guard {
    /// Makes a guard that answers everybody who reaches the server by an address or as `localhost`.
    pub fn new() -> Self {
        Self::default()
    }

    /// Also answers requests to this host name.
    pub fn with_name(mut self, name: &str) -> Self {
        self.names.push(name.to_ascii_lowercase());
        self
    }

    /// Asks for a token, but for the paths of [`Self::with_open_path`].
    pub fn with_token(mut self, token: AccessToken) -> Self {
        self.token = Some(token);
        self
    }

    /// Answers this path without a token: a page that then asks with it.
    pub fn with_open_path(mut self, path: &str) -> Self {
        self.open_paths.push(path.to_owned());
        self
    }

    /// Lays the guard around routes, unknown paths included.
    pub fn protect(self, router: Router) -> Router {
        router.fallback(nothing_here).layer(middleware::from_fn_with_state(Arc::new(self), guarded))
    }

    fn check(&self, request: &Request) -> Result<(), Objection> {
        let headers = request.headers();
        let is_read = [Method::GET, Method::HEAD].contains(request.method());
        let url = request.uri().path_and_query().map_or(0, |it| it.as_str().len());
        let host = host_of(request).ok_or(Objection::NoHost)?;
        let origin = headers.get(ORIGIN).map(HeaderValue::as_bytes);
        // A page that this server sent.
        let own = || origin == Some(format!("http://{host}").as_bytes());
        let is_open = |path: &str| self.open_paths.iter().any(|open| open == path);
        let has_token = |token: AccessToken| token.is_borne_by(headers);
        match () {
            () if !is_read => Err(Objection::Method),
            () if url > MAX_URL_BYTES => Err(Objection::Length),
            () if !self.knows(&host) => Err(Objection::ForeignHost),
            () if origin.is_some() && !own() => Err(Objection::ForeignOrigin),
            () if is_foreign_fetch(headers) => Err(Objection::ForeignOrigin),
            () if is_open(request.uri().path()) || self.token.is_none_or(has_token) => Ok(()),
            () => Err(Objection::Token),
        }
    }

    /// Returns whether a host is this one: an address cannot be anybody else's name.
    fn knows(&self, host: &Authority) -> bool {
        let name = host.host();
        let inner = name.strip_prefix('[').and_then(|name| name.strip_suffix(']'));
        let is_address = match inner {
            Some(inner) => inner.parse::<Ipv6Addr>().is_ok(),
            None => name.parse::<IpAddr>().is_ok(),
        };
        let name = name.to_ascii_lowercase();
        is_address || name == "localhost" || self.names.contains(&name)
    }
}

/// Returns the host that a request names: in its header, or in its URL.
fn host_of(request: &Request) -> Option<Authority> {
    let mut hosts = request.headers().get_all(HOST).into_iter();
    match (hosts.next(), hosts.next()) {
        (Some(host), None) => Authority::try_from(host.as_bytes()).ok(),
        (None, _) => request.uri().authority().cloned(),
        _ => None,
    }
}

/// Returns whether a browser says that a page of another site asks. Where that page wants no answer that it can read, the browser
/// names no origin. A visitor who follows a link is welcome.
fn is_foreign_fetch(headers: &HeaderMap) -> bool {
    let said = |name: &str| headers.get(name).map_or(&b""[..], HeaderValue::as_bytes);
    let is_foreign = [&b"cross-site"[..], b"same-site"].contains(&said("sec-fetch-site"));
    let is_visit = said("sec-fetch-mode") == b"navigate" && said("sec-fetch-dest") == b"document";
    is_foreign && !is_visit
}

/// Answers where nothing is.
async fn nothing_here() -> (StatusCode, &'static str) {
    (
        StatusCode::NOT_FOUND,
        "nothing is at this path: look at the address, or ask for one that the program names\n",
    )
}

async fn guarded(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    let mut answer = match guard.check(&request) {
        Ok(()) => next.run(request).await,
        Err(objection) => refusal(objection),
    };
    let headers = answer.headers_mut();
    for (name, value) in SECURITY {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    answer
}

fn refusal(objection: Objection) -> Response {
    let too_long = format!("the URL is too long: {MAX_URL_BYTES} bytes are allowed\n");
    let (status, sentence) = match objection {
        Objection::Method => (StatusCode::METHOD_NOT_ALLOWED, "only GET and HEAD are answered\n"),
        Objection::Length => (StatusCode::URI_TOO_LONG, too_long.as_str()),
        Objection::NoHost => (StatusCode::BAD_REQUEST, "the request names no host\n"),
        Objection::ForeignHost => (
            StatusCode::MISDIRECTED_REQUEST,
            "this server has another name than the one in the request: use its address, or localhost\n",
        ),
        Objection::ForeignOrigin => {
            (StatusCode::FORBIDDEN, "a page of another site may not ask this server\n")
        }
        Objection::Token => (
            StatusCode::UNAUTHORIZED,
            "a token is needed: send it as `Authorization: Bearer TOKEN`\n",
        ),
    };
    let mut answer = (status, sentence.to_owned()).into_response();
    match objection {
        Objection::Method => {
            answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
        }
        Objection::Token => {
            answer.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        _ => {}
    }
    answer
}

#[cfg(test)]
mod tests {
    use axum::body::Body;
    use axum::routing::get;
    use hyper::service::Service as _;
    use hyper_util::service::TowerToHyperService;

    use super::*;

    async fn answer(guard: &Guard, request: &[(&str, &str)], method: &str, url: &str) -> Response {
        let router = Router::new()
            .route("/", get(|| async { "page" }))
            .route("/data", get(|| async { "data" }));
        let router = TowerToHyperService::new(guard.clone().protect(router));
        let mut built = Request::builder().method(method).uri(url);
        for (name, value) in request {
            built = built.header(*name, *value);
        }
        router.call(built.body(Body::empty()).unwrap()).await.unwrap()
    }

    async fn status(guard: &Guard, request: &[(&str, &str)], method: &str, url: &str) -> u16 {
        answer(guard, request, method, url).await.status().as_u16()
    }

    #[tokio::test]
    async fn only_addresses_localhost_and_known_names_are_hosts() {
        let guard = Guard::new().with_name("Learner-0");
        for host in [
            "localhost",
            "LOCALHOST:8080",
            "127.0.0.1:1",
            "10.1.2.3",
            "[::1]:8080",
            "learner-0:9464",
        ] {
            assert_eq!(status(&guard, &[("host", host)], "GET", "/").await, 200, "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "learner-1",
            "[evil]",
            "1.2.3.4.example",
        ] {
            let found = status(&guard, &[("host", host)], "GET", "/").await;
            assert!([400, 421].contains(&found), "{host}: {found}");
        }
        assert_eq!(status(&guard, &[], "GET", "/").await, 400);
        let twice = [("host", "localhost"), ("host", "evil.example")];
        assert_eq!(status(&guard, &twice, "GET", "/").await, 400);
    }

    #[tokio::test]
    async fn a_page_of_another_site_is_refused_and_our_own_is_not() {
        let guard = Guard::new();
        let asked = |origin| [("host", "localhost:8080"), ("origin", origin)];
        assert_eq!(status(&guard, &asked("http://localhost:8080"), "GET", "/").await, 200);
        for origin in
            ["http://evil.example", "null", "", "http://localhost:8081", "https://localhost:8080"]
        {
            assert_eq!(status(&guard, &asked(origin), "GET", "/").await, 403, "{origin}");
        }
    }

    #[tokio::test]
    async fn a_page_of_another_site_that_hides_its_origin_is_refused_and_a_link_is_not() {
        let guard = Guard::new();
        let asked = |site, mode, dest| {
            [
                ("host", "localhost:8080"),
                ("sec-fetch-site", site),
                ("sec-fetch-mode", mode),
                ("sec-fetch-dest", dest),
            ]
        };
        for (site, mode, dest, expected) in [
            ("cross-site", "no-cors", "empty", 403),
            ("cross-site", "no-cors", "image", 403),
            ("same-site", "no-cors", "script", 403),
            ("cross-site", "navigate", "iframe", 403),
            ("cross-site", "navigate", "document", 200),
            ("same-origin", "cors", "empty", 200),
            ("none", "navigate", "document", 200),
        ] {
            let found = status(&guard, &asked(site, mode, dest), "GET", "/data").await;
            assert_eq!(found, expected, "{site} {mode} {dest}");
        }
    }

    #[tokio::test]
    async fn an_unknown_path_is_answered_with_a_sentence() {
        let host = [("host", "localhost")];
        let answer = answer(&Guard::new(), &host, "GET", "/nothing").await;
        assert_eq!(answer.status().as_u16(), 404);
        let bytes = axum::body::to_bytes(answer.into_body(), 1_000).await.unwrap();
        assert!(bytes.starts_with(b"nothing is at this path"), "{bytes:?}");
    }

    #[tokio::test]
    async fn nothing_but_reading_is_answered() {
        let guard = Guard::new();
        let host = [("host", "localhost")];
        assert_eq!(status(&guard, &host, "HEAD", "/").await, 200);
        for method in ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "PATCH"] {
            let answer = answer(&guard, &host, method, "/").await;
            assert_eq!(
                (answer.status().as_u16(), &answer.headers()["allow"]),
                (405, &HeaderValue::from_static("GET, HEAD"))
            );
        }
        assert_eq!(status(&guard, &host, "GET", "/nothing").await, 404);
    }

    #[tokio::test]
    async fn an_url_that_is_too_long_is_refused() {
        let url = |n_bytes: usize| format!("/?{}", "a".repeat(n_bytes - 2));
        let host = [("host", "localhost")];
        assert_eq!(status(&Guard::new(), &host, "GET", &url(MAX_URL_BYTES)).await, 200);
        assert_eq!(status(&Guard::new(), &host, "GET", &url(MAX_URL_BYTES + 1)).await, 414);
    }

    #[tokio::test]
    async fn data_need_the_token_and_the_page_does_not() {
        let guard = Guard::new().with_token(AccessToken::new("secret")).with_open_path("/");
        let bearing = |value| [("host", "localhost"), ("authorization", value)];
        assert_eq!(status(&guard, &[("host", "localhost")], "GET", "/").await, 200);
        assert_eq!(status(&guard, &bearing("Bearer secret"), "GET", "/data").await, 200);
        for value in ["", "secret", "Bearer ", "Bearer secre", "Bearer secret ", "Basic secret"] {
            assert_eq!(status(&guard, &bearing(value), "GET", "/data").await, 401, "{value}");
        }
        assert_eq!(status(&guard, &[("host", "localhost")], "GET", "/data").await, 401);
    }

    #[tokio::test]
    async fn every_answer_has_the_headers_that_keep_a_browser_safe() {
        for (url, host) in [("/", "localhost"), ("/nothing", "localhost"), ("/", "evil.example")] {
            let answer = answer(&Guard::new(), &[("host", host)], "GET", url).await;
            let policy = answer.headers()["content-security-policy"].to_str().unwrap();
            assert!(policy.starts_with("default-src 'self'"), "{policy}");
            assert_eq!(answer.headers()["x-content-type-options"], "nosniff");
            assert_eq!(answer.headers()["cache-control"], "no-store");
        }
    }
}
