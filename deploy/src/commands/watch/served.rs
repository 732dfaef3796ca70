//! The page's address, its token, and its server.

use std::fs::File;
use std::io::Read as _;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use leadtime_watch::{Page, TICK, open_paths, routes};
use leadtime_web::{AccessToken, Guard, HttpServer, parse_address};
use serde_json::json;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use crate::cli::{AccessArgs, PAGE_ADDRESS};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// The shortest token of one's own.
const MIN_TOKEN: usize = 8;
/// Bytes of a token that is made.
const TOKEN_BYTES: usize = 16;

/// An address that is taken, and who may ask there.
#[derive(Debug)]
pub(in crate::commands) struct PageServer {
    server: HttpServer,
    token: Option<String>,
}

impl PageServer {
    /// Takes an address that an option names. One that others can reach needs a token.
    pub(in crate::commands) async fn bind(
        option: &'static str,
        http: &str,
        access: &AccessArgs,
    ) -> Result<Self, Failure> {
        let address = parse_address(http, PAGE_ADDRESS).context(option);
        let address = address.blame(ExitCode::WrongInput)?;
        let token = access.token.as_deref().map(token).transpose()?;
        if !address.ip().is_loopback() && token.is_none() {
            return Err(Failure::input(format!(
                "others can reach {address}: add --token auto, so that only who has the link sees the page; or serve at \
                 127.0.0.1, and look at it through `ssh -L`"
            )));
        }
        let server = HttpServer::bind(address).await.context(option);
        let server = server.blame(ExitCode::WrongInput)?;
        if !server.is_local() {
            tracing::warn!(
                "the page is served as plain HTTP: anyone who can read the network can read it, and its token"
            );
        }
        Ok(Self { server, token })
    }

    /// Returns the page's link.
    fn link(&self) -> String {
        let address = self.server.address();
        // Where the page listens on all addresses, the one that works on this machine is printed.
        let is_any = address.ip().is_unspecified();
        let shown =
            if is_any { SocketAddr::from(([127, 0, 0, 1], address.port())) } else { address };
        let token = self.token.as_ref().map_or(String::new(), |token| format!("#token={token}"));
        format!("http://{shown}/{token}")
    }

    /// Prints the page's link.
    pub(in crate::commands) fn announce(&self, as_json: bool) {
        let link = self.link();
        if as_json {
            output::json(&json!({"page": link}));
        } else {
            output::line(&format!("page     {link}"));
        }
    }

    /// Serves a page until the token is cancelled, and tells at every moment what is due.
    pub(in crate::commands) fn serve(
        self,
        page: &Arc<Page>,
        stop: &CancellationToken,
    ) -> JoinHandle<()> {
        let mut guard = Guard::new();
        if let Some(token) = &self.token {
            guard = guard.with_token(AccessToken::new(token));
            for path in open_paths() {
                guard = guard.with_open_path(path);
            }
        }
        let router = routes(Arc::clone(page));
        let (page, stop) = (Arc::clone(page), stop.clone());
        tokio::spawn(async move {
            tokio::join!(tell(&page, &stop), self.server.serve(router, guard, stop.clone()));
        })
    }
}

/// Tells pages what is due until the token is cancelled, and then says goodbye.
async fn tell(page: &Page, stop: &CancellationToken) {
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while stop.run_until_cancelled(ticks.tick()).await.is_some() {
        page.flush(Instant::now());
    }
    // Open streams end by that, and the server with them.
    page.close();
}

/// Makes a token, or checks one.
fn token(text: &str) -> Result<String, Failure> {
    if text == "auto" {
        let mut bytes = [0; TOKEN_BYTES];
        let read = File::open("/dev/urandom").and_then(|mut file| file.read_exact(&mut bytes));
        read.blame(ExitCode::Failed)?;
        return Ok(leadtime_proto::hex::encode(&bytes));
    }
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-._~".contains(c);
    if text.len() < MIN_TOKEN || !text.chars().all(is_plain) {
        return Err(Failure::input(format!(
            "--token: write at least {MIN_TOKEN} letters, digits or `-._~`, or `auto`"
        )));
    }
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_made_token_is_new_and_one_of_ones_own_must_be_long_and_plain() {
        let made = [token("auto").unwrap(), token("auto").unwrap()];
        assert!(made[0] != made[1] && made.iter().all(|token| token.len() == 2 * TOKEN_BYTES));
        assert_eq!(token("my-own_token.1").unwrap(), "my-own_token.1");
        for bad in ["", "short", "with spaces in it", "ümlaut-token", "a&b=c&d=e"] {
            assert_eq!(token(bad).unwrap_err().code, ExitCode::WrongInput, "{bad}");
        }
    }
}
