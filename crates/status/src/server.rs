//! The routes of a status page.

use std::fs;
use std::net::SocketAddr;
use std::sync::Arc;

use leadtime_learner::checkpoint::FORMAT_VERSION;
use leadtime_proto::header::PROTOCOL_VERSION;
use leadtime_web::axum::Router;
use leadtime_web::axum::extract::State;
use leadtime_web::axum::http::StatusCode;
use leadtime_web::axum::http::header::CONTENT_TYPE;
use leadtime_web::axum::response::{IntoResponse as _, Response};
use leadtime_web::axum::routing::get;
use leadtime_web::{Error, Guard, HttpServer};
use tokio_util::sync::{CancellationToken, DropGuard};

/// What the text of `/metrics` is; without it the counters of this format would be read as something else.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// What a status page is made of.
pub(crate) trait StatusSource: Send + Sync + 'static {
    /// Writes the numbers in the text format of `OpenMetrics`.
    fn metrics(&self) -> Result<String, std::fmt::Error>;

    /// Says in one sentence why the process is not alive, if it is not.
    fn live(&self) -> Result<(), String>;

    /// Says in one sentence why the process is not ready, if it is not.
    fn ready(&self) -> Result<(), String>;
}

/// An address that is taken for a status page.
#[derive(Debug)]
pub struct StatusServer(HttpServer);

impl StatusServer {
    /// Takes the address.
    ///
    /// # Errors
    ///
    /// If it is in use, or the system does not let this process listen there.
    pub async fn bind(address: SocketAddr) -> Result<Self, Error> {
        HttpServer::bind(address).await.map(Self)
    }

    /// Serves a page until the returned guard is dropped.
    pub(crate) fn serve(self, source: Arc<dyn StatusSource>) -> DropGuard {
        let (stop, address) = (CancellationToken::new(), self.0.address());
        tracing::info!("status at http://{address}/metrics, /live, /ready, /version");
        if !self.0.is_local() {
            tracing::info!("anyone who reaches {address} can read the numbers of this process");
        }
        tokio::spawn(self.0.serve(routes(source), guard(address), stop.clone()));
        stop.drop_guard()
    }
}

/// Answers to this machine's own name, too: scrapers ask for it.
fn guard(address: SocketAddr) -> Guard {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    if address.ip().is_loopback() { Guard::new() } else { Guard::new().with_name(name.trim()) }
}

type Source = State<Arc<dyn StatusSource>>;

fn routes(source: Arc<dyn StatusSource>) -> Router {
    Router::new()
        .route("/metrics", get(|State(source): Source| async move { metrics(&*source) }))
        .route("/live", get(|State(source): Source| async move { told(source.live()) }))
        .route("/ready", get(|State(source): Source| async move { told(source.ready()) }))
        .route("/version", get(|| async { ([(CONTENT_TYPE, "application/json")], version()) }))
        .with_state(source)
}

fn told(found: Result<(), String>) -> (StatusCode, String) {
    match found {
        Ok(()) => (StatusCode::OK, "ok\n".to_owned()),
        Err(sentence) => (StatusCode::SERVICE_UNAVAILABLE, sentence + "\n"),
    }
}

fn metrics(source: &dyn StatusSource) -> Response {
    match source.metrics() {
        Ok(text) => ([(CONTENT_TYPE, OPEN_METRICS)], text).into_response(),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
    }
}

fn version() -> String {
    let version = env!("CARGO_PKG_VERSION");
    format!(
        "{{\"version\":\"{version}\",\"protocol\":{PROTOCOL_VERSION},\"checkpoint_format\":{FORMAT_VERSION}}}\n"
    )
}
