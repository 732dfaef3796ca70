//! What `replay` and `play` share: reading a recording, and saying what of it cannot be read.

use std::io::BufReader;
use std::path::Path;

use anyhow::Context as _;
use leadtime_proto::ClientName;
use leadtime_recording::{RecordedSession, RecordingEnd, RecordingFile, sessions};
use leadtime_runs::regular;

use crate::exit::{Blame as _, ExitCode, Failure};

/// Reads the sessions of a recording: of all clients, or of one.
pub(super) fn read(
    path: &Path,
    client: Option<&ClientName>,
) -> Result<Vec<RecordedSession>, Failure> {
    let place = || path.display().to_string();
    let file = regular::open(path).with_context(place).blame(ExitCode::WrongInput)?;
    let is_wanted =
        |name: &str| client.is_none_or(|client| name.rsplit('/').next() == Some(client.as_str()));
    let recording = RecordingFile::read_of(BufReader::new(file), is_wanted).with_context(place);
    let recording = recording.blame(ExitCode::WrongInput)?;
    let shown = place();
    match &recording.end {
        RecordingEnd::Whole => {}
        RecordingEnd::Cut => {
            tracing::warn!("{shown} ends in the middle: it is read up to its last whole chunk");
        }
        RecordingEnd::Damaged(why) => {
            tracing::warn!("{shown} is damaged and is read up to there: {why}");
        }
    }
    let names: Vec<String> = recording.clients.iter().map(|it| it.name.clone()).collect();
    // The messages of each are given up when its sessions are found.
    let clients = recording.clients.into_iter();
    let found: Vec<RecordedSession> = clients.flat_map(|client| sessions(&client)).collect();
    if found.is_empty() {
        let names = names.join(", ");
        return Err(Failure::input(match client {
            Some(client) => {
                format!("{shown} holds no session of `{client}`; it is about: {names}")
            }
            None => format!("{shown} holds no session: nothing was taken in while it was recorded"),
        }));
    }
    Ok(found)
}
