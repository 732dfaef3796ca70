//! Accepting connections, and ending them in time.
//!
//! hyper waits for open event streams when it ends gracefully, for ever if need be (hyperium/hyper#2787). So every
//! connection is a task of the server's own: when the token is cancelled they are asked to end, and after [`GRACE`] they
//! are dropped. A handler that streams should end its stream on the same token, to say goodbye.

use std::convert::Infallible;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, HttpBody as _};
use axum::http::HeaderValue;
use axum::http::header::CONNECTION;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rustix::net::sockopt::set_tcp_user_timeout;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;
use tracing::debug;

use crate::error::Error;
use crate::guard::Guard;
use crate::heads::{HeadDebt, OwedHeads};

/// How many connections are served at a time. One more takes the place of the one that has owed the head of a request for the longest
/// time; if all are being answered, it waits.
const MAX_CONNECTIONS: usize = 64;
/// How long open connections may take to end after the server was asked to.
const GRACE: Duration = Duration::from_millis(700);
/// How long a client may take to send the head of a request, and how long an idle connection stays open.
const HEAD_TIME: Duration = Duration::from_secs(10);
/// How long an answer may wait for its client to take in more of it.
const WRITE_TIME: Duration = Duration::from_secs(30);
/// The longest head of a request, in bytes: more than an URL that the guard lets pass.
const MAX_HEAD_BYTES: usize = 64 << 10;
/// Pause after a connection could not be accepted: the system is out of files, say.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Reads an address: `127.0.0.1:8080`, `[::1]:0`, `localhost:8080`. No name but `localhost` is looked up.
/// `usual` is the address that is suggested where none was written.
///
/// # Errors
///
/// [`Error::NotAnAddress`] if the text is no address with a port.
///
/// # Example
///
/// ```
/// let usual = "127.0.0.1:8080";
/// assert!(leadtime_web::parse_address("localhost:0", usual)?.ip().is_loopback());
/// assert!(leadtime_web::parse_address("8080", usual).is_err());
/// # Ok::<(), leadtime_web::Error>(())
/// ```
pub fn parse_address(text: &str, usual: &'static str) -> Result<SocketAddr, Error> {
    let local = text.strip_prefix("localhost:").and_then(|port| port.parse().ok());
    let local = local.map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    let address = local.or_else(|| text.parse().ok());
    let shown = || text.escape_debug().take(80).collect();
    address.ok_or_else(|| Error::NotAnAddress { text: shown(), usual })
}

/// A port that is taken, and not served yet.
#[derive(Debug)]
pub struct HttpServer {
    listener: TcpListener,
    address: SocketAddr,
    write_time: Duration,
}

impl HttpServer {
    /// Takes an address; call it inside the async runtime.
    ///
    /// # Errors
    ///
    /// [`Error::AddressInUse`] if another program listens there, [`Error::Bind`] if the system refuses for another
    /// reason.
    pub async fn bind(address: SocketAddr) -> Result<Self, Error> {
        let failed = |source: io::Error| match source.kind() {
            io::ErrorKind::AddrInUse => Error::AddressInUse(address),
            _ => Error::Bind { address, source },
        };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address, write_time: WRITE_TIME })
    }

    /// Returns the address, with the port that was taken.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns whether only this machine can reach it.
    pub fn is_local(&self) -> bool {
        self.address.ip().is_loopback()
    }

    /// Serves until the token is cancelled, and [`GRACE`] longer at most.
    pub async fn serve(self, router: Router, guard: Guard, stop: CancellationToken) {
        let router = guard.protect(router);
        let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
        let heads = Arc::new(OwedHeads::default());
        let mut connections = JoinSet::new();
        loop {
            let accepted = tokio::select! {
                () = stop.cancelled() => break,
                accepted = self.listener.accept() => accepted,
            };
            // Those that have ended.
            while connections.try_join_next().is_some() {}
            match accepted {
                Ok((stream, _peer)) => {
                    if let Err(error) = prepare(&stream, self.write_time) {
                        debug!(%error, "a connection cannot be prepared");
                        continue;
                    }
                    let place = tokio::select! {
                        () = stop.cancelled() => break,
                        place = place(&places, &heads) => place,
                    };
                    let (router, stop, heads) = (router.clone(), stop.clone(), Arc::clone(&heads));
                    connections.spawn(async move {
                        converse(stream, router, stop, &heads).await;
                        drop(place);
                    });
                }
                Err(error) => {
                    debug!(%error, "a connection cannot be accepted");
                    sleep(ACCEPT_PAUSE).await;
                }
            }
        }
        drop(self.listener);
        let ended = timeout(GRACE, async { while connections.join_next().await.is_some() {} });
        if ended.await.is_err() {
            connections.shutdown().await;
        }
    }
}

/// Finds a place for a connection, if need be that of one that owes a head; `None` never comes, because places are never closed.
async fn place(places: &Arc<Semaphore>, heads: &OwedHeads) -> Option<OwnedSemaphorePermit> {
    if let Ok(place) = Arc::clone(places).try_acquire_owned() {
        return Some(place);
    }
    let mut free = pin!(Arc::clone(places).acquire_owned());
    while !heads.close_oldest() {
        tokio::select! {
            place = free.as_mut() => return place.ok(),
            () = heads.one_more() => {}
        }
    }
    free.await.ok()
}

/// Prepares a connection for events, which are small and wanted at once, and for clients that do not read: the system ends
/// what waits for them for too long.
fn prepare(stream: &TcpStream, write_time: Duration) -> io::Result<()> {
    stream.set_nodelay(true)?;
    Ok(set_tcp_user_timeout(stream, write_time.as_millis() as u32)?)
}

/// Answers the requests of one connection.
async fn converse(
    stream: TcpStream,
    router: Router,
    stop: CancellationToken,
    heads: &Arc<OwedHeads>,
) {
    let router = TowerToHyperService::new(router);
    let debt = HeadDebt::new(heads);
    let owing = Arc::clone(&debt);
    let answer = service_fn(move |request: hyper::Request<Incoming>| {
        let (router, answering) = (router.clone(), owing.answering());
        let has_body = !request.body().is_end_stream();
        async move {
            let answer = hyper::service::Service::call(&router, request.map(Body::new)).await;
            let mut answer = answer.unwrap_or_else(|never| match never {});
            if has_body {
                // hyper takes the next head before the client has read this answer, and asks the service for one that it
                // does not poll: a connection that is never read would never owe a head.
                answer.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
            }
            Ok::<_, Infallible>(answer.map(|body| answering.with(body)))
        }
    });
    let mut protocol = http1::Builder::new();
    protocol.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME).max_buf_size(MAX_HEAD_BYTES);
    let mut connection = pin!(protocol.serve_connection(TokioIo::new(stream), answer));
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = debt.has_to_go() => return debug!("a connection that owes a request makes room"),
        () = stop.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        debug!(%error, "a connection ended early");
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use axum::body::Bytes;
    use axum::response::Response;
    use axum::routing::get;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    use super::*;

    /// A route whose answers say something and never end by themselves.
    fn endless() -> Router {
        let open = Arc::new(Mutex::new(Vec::new()));
        let answer = move || {
            let (sender, events) = flume::bounded::<Result<Bytes, Infallible>>(1);
            sender.send(Ok(Bytes::from_static(b"data: hello\n\n"))).unwrap();
            open.lock().unwrap().push(sender);
            async { Response::new(Body::from_stream(events.into_stream())) }
        };
        Router::new().route("/events", get(answer))
    }

    async fn started(
        router: Router,
    ) -> (SocketAddr, CancellationToken, tokio::task::JoinHandle<()>) {
        let server = HttpServer::bind(parse_address("127.0.0.1:0", "127.0.0.1:8080").unwrap())
            .await
            .unwrap();
        assert!(server.is_local());
        let (address, stop) = (server.address(), CancellationToken::new());
        let serving = tokio::spawn(server.serve(router, Guard::new(), stop.clone()));
        (address, stop, serving)
    }

    /// Asks, and reads until the answer holds `expected`.
    async fn ask(address: SocketAddr, request: &str, expected: &str) -> TcpStream {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut answer = Vec::new();
        while !String::from_utf8_lossy(&answer).contains(expected) {
            let mut part = [0; 4096];
            let n_read = timeout(Duration::from_secs(10), stream.read(&mut part)).await;
            let n_read = n_read.expect("in time").unwrap();
            assert!(n_read > 0, "no `{expected}` in {}", String::from_utf8_lossy(&answer));
            answer.extend_from_slice(&part[..n_read]);
        }
        stream
    }

    #[test]
    fn a_text_that_is_not_an_address_is_named() {
        for text in ["", "8080", "localhost", "localhost:x", "127.0.0.1:99999", "example.org:80"] {
            let error = parse_address(text, "127.0.0.1:9464").unwrap_err().to_string();
            let told =
                format!("`{text}` is not an address: write IP:PORT, such as 127.0.0.1:9464,");
            assert!(error.starts_with(&told), "{error}");
        }
    }

    #[tokio::test]
    async fn open_event_streams_do_not_keep_the_server() {
        let (address, stop, serving) = started(endless()).await;
        let request = "GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n";
        let mut open = Vec::new();
        for _ in 0..5 {
            open.push(ask(address, request, "data: hello").await);
        }
        stop.cancel();
        // The streams have no end.
        timeout(Duration::from_secs(10), serving).await.expect("it ends").unwrap();
        assert!(TcpStream::connect(address).await.is_err());
    }

    #[tokio::test]
    async fn a_client_that_does_not_read_is_cut_off() {
        let (sender, parts) = flume::bounded::<Result<Bytes, Infallible>>(1);
        let parts = Arc::new(Mutex::new(Some(parts)));
        let answer = move || {
            let parts = parts.lock().unwrap().take().unwrap();
            async { Response::new(Body::from_stream(parts.into_stream())) }
        };
        let mut server = HttpServer::bind(parse_address("127.0.0.1:0", "127.0.0.1:8080").unwrap())
            .await
            .unwrap();
        server.write_time = Duration::from_millis(300);
        let (address, stop) = (server.address(), CancellationToken::new());
        let router = Router::new().route("/", get(answer));
        let serving = tokio::spawn(server.serve(router, Guard::new(), stop.clone()));
        let silent = ask(address, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", "200 OK").await;
        // The answer goes on until its connection has ended.
        let part = Bytes::from(vec![0; 1 << 20]);
        let told = async { while sender.send_async(Ok(part.clone())).await.is_ok() {} };
        timeout(Duration::from_secs(10), told).await.expect("the connection ends");
        drop(silent);
        stop.cancel();
        serving.await.unwrap();
    }

    #[tokio::test]
    async fn an_address_in_use_is_told_as_such() {
        let (address, stop, serving) = started(Router::new()).await;
        let error = HttpServer::bind(address).await.unwrap_err();
        assert!(matches!(error, Error::AddressInUse(it) if it == address), "{error}");
        stop.cancel();
        serving.await.unwrap();
    }

    const ASKED: &str = "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";

    /// Reads until the other side has closed the connection.
    async fn is_closed(stream: &mut TcpStream) {
        let mut rest = Vec::new();
        let closed = timeout(Duration::from_secs(10), stream.read_to_end(&mut rest)).await;
        // It may be reset as well.
        drop(closed.expect("it is closed soon"));
    }

    #[tokio::test]
    async fn connections_that_send_no_request_keep_nobody_out() {
        let router = Router::new().route("/", get(|| async { "here" }));
        let (address, stop, serving) = started(router).await;
        // This one sends no second request.
        let mut answered = ask(address, ASKED, "here").await;
        let mut silent = Vec::new();
        for _ in 0..150 {
            silent.push(TcpStream::connect(address).await.unwrap());
        }
        let mut begun = TcpStream::connect(address).await.unwrap();
        begun.write_all(b"GET / HTTP/1.1\r\n").await.unwrap();
        ask(address, ASKED, "here").await;
        for stream in silent.iter_mut().take(80) {
            is_closed(stream).await;
        }
        is_closed(&mut answered).await;
        begun.write_all(b"Host: localhost\r\n\r\n").await.unwrap();
        let mut head = [0; 15];
        begun.read_exact(&mut head).await.unwrap();
        assert_eq!(&head, b"HTTP/1.1 200 OK", "newer ones stay");
        stop.cancel();
        serving.await.unwrap();
    }

    #[tokio::test]
    async fn connections_that_ask_on_with_bodies_and_read_nothing_keep_nobody_out() {
        let long = Bytes::from(vec![b'x'; 4 << 20]);
        let answer = move || async move { long };
        let router = Router::new().route("/", get(|| async { "here" })).route("/long", get(answer));
        let (address, stop, serving) = started(router).await;
        let request =
            "GET /long HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1\r\n\r\nx".repeat(20);
        let mut deaf = Vec::new();
        for _ in 0..MAX_CONNECTIONS {
            // Its first answer has begun.
            deaf.push(ask(address, &request, "200 OK").await);
        }
        ask(address, ASKED, "here").await;
        drop(deaf);
        stop.cancel();
        serving.await.unwrap();
    }

    #[tokio::test]
    async fn connections_beyond_the_limit_wait_while_all_others_are_answered() {
        let (address, stop, serving) =
            started(endless().route("/", get(|| async { "here" }))).await;
        let mut open = Vec::new();
        for _ in 0..MAX_CONNECTIONS {
            let request = "GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n";
            open.push(ask(address, request, "data: hello").await);
        }
        let mut waiting = pin!(ask(address, ASKED, "here"));
        assert!(timeout(Duration::from_millis(100), waiting.as_mut()).await.is_err());
        open.pop();
        waiting.await;
        stop.cancel();
        serving.await.unwrap();
    }

    #[tokio::test]
    async fn a_connection_owes_a_head_but_for_the_time_of_an_answer() {
        let heads = Arc::new(OwedHeads::default());
        let (first, second) = (HeadDebt::new(&heads), HeadDebt::new(&heads));
        let answer = first.answering().with(Body::empty());
        assert_eq!(heads.len(), 1);
        drop(answer);
        assert!(heads.close_oldest());
        timeout(Duration::from_secs(10), second.has_to_go()).await.expect("it owes for longer");
        drop((first, second));
        assert!(!heads.close_oldest(), "all have ended");
    }
}
