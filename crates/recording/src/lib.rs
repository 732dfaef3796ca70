//! Recordings of a notifier at work: MCAP files that Foxglove, Lichtblick and Python read, and their replay.
//!
//! ```text
//! link::live ─▶ LiveRecorder ─▶ RecordingWriter ─▶ FILE.mcap ─▶ RecordingFile ─▶ sessions ─▶ replay
//!                 one channel per key, JSON         killed or cut: read to        │
//!                                                   its last whole chunk          └─▶ transcript, picture
//! ```
//!
//! What this crate does not know: files by name, the command line, how a session decides (that is `serve`).
//!
//! # Invariants
//!
//! * JSON is recorded byte for byte; raw bytes become JSON, with the original as `x_raw`. A replay is fed the originals.
//! * A chunk is written whole: what is readable was right, and is never half of something.
//! * A replay takes in what the notifier took in, at the times of its own clock, so it says the same whatever the clock was.
//! * What is missing in a recording is reported, and never counted as equal.
//!
//! # Where to start
//!
//! [`LiveRecorder`] and [`RecordingFile::read`]; then [`sessions()`] and [`replay()`].

mod course;
mod error;
mod message;
mod network;
mod picture;
mod read;
mod recorder;
mod replay;
mod sessions;
mod topic;
mod transcript;
mod write;

pub use course::{RecordedState, RecordedUtterance, SessionCourse};
pub use error::Error;
pub use message::SentObservation;
pub use network::SessionOverNetwork;
pub use picture::picture;
pub use read::{MAX_READ_BYTES, RecordedClient, RecordedMessage, RecordingEnd, RecordingFile};
pub use recorder::LiveRecorder;
pub use replay::{
    MessageTally, ReplayDifference, ReplayOutcome, ReplayTarget, SessionAtHand, StartedMessage,
    check_for_network, replay,
};
pub use sessions::{Gap, RecordedInput, RecordedSession, RecordedStatus, Stretch, sessions};
pub use topic::RecordedTopic;
pub use transcript::transcript;
pub use write::RecordingWriter;
