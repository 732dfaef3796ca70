//! `leadtime health`: whether a learner or an actor is well, as its status address says. For containers without a shell.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use anyhow::anyhow;
use leadtime_proto::phrase::duration;
use leadtime_proto::text::printable;

use crate::cli::{HealthArgs, STATUS_ADDRESS};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// How long the answer may take.
const PATIENCE: Duration = Duration::from_secs(2);
/// The longest answer that is read, in bytes.
const MAX_ANSWER: u64 = 64 << 10;

pub(super) fn run(args: &HealthArgs) -> Result<(), Failure> {
    let address = leadtime_web::parse_address(&args.address, STATUS_ADDRESS);
    let address = address.blame(ExitCode::WrongInput)?;
    let path = if args.live { "/live" } else { "/ready" };
    let answer = ask(address, path).map_err(|error| unanswered(address, &error));
    let answer = answer.blame(ExitCode::PeerLost)?;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    let status = head.split(' ').nth(1).unwrap_or_default();
    let sentence = printable(body.trim());
    match status {
        // Other programs answer 200 as well, some of them at every path.
        "200" if body.trim() == "ok" => {
            output::line(&sentence);
            Ok(())
        }
        "503" => {
            output::say(&format!("{path}: {sentence}"));
            Err(Failure::silent(ExitCode::Failed))
        }
        _ => {
            let told = "is no status page of a learner or an actor: is it the right port?";
            let error = anyhow!("what listens at {address} {told}");
            Err(Failure::of(ExitCode::PeerLost, error))
        }
    }
}

/// Says why there is no answer.
fn unanswered(address: SocketAddr, error: &std::io::Error) -> anyhow::Error {
    if error.kind() == ErrorKind::WouldBlock {
        let told = "it stands still, or is no learner or actor";
        return anyhow!(
            "what listens at {address} does not answer within {}: {told}",
            duration(PATIENCE)
        );
    }
    anyhow!(
        "nobody answers at {address}: {error}; start a learner or an actor with --status {address}"
    )
}

fn ask(address: SocketAddr, path: &str) -> std::io::Result<String> {
    let mut stream = TcpStream::connect_timeout(&address, PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    // In one piece: another program may answer the first one and close, and the others could not be written.
    stream.write_all(request.as_bytes())?;
    let mut answer = Vec::new();
    match stream.take(MAX_ANSWER).read_to_end(&mut answer) {
        // A page that has not read everything breaks off the connection: somebody is there, and what they said before counts.
        Err(error) if error.kind() != ErrorKind::ConnectionReset => Err(error),
        Ok(_) | Err(_) => Ok(String::from_utf8_lossy(&answer).into_owned()),
    }
}
