//! The vocabulary between Leadtime's processes: identifiers, specifications, messages, limits and one codec.
//!
//! What this crate does not know: networks, files, clocks, how a policy computes or how a world moves. Two
//! processes that agree on this crate's [`header::PROTOCOL_VERSION`] and schema ids understand each other.
//!
//! ```text
//! ids      who and which        EnvId, ActorId, PolicyVersion, Epoch, Sequence ...
//! spec     what a run is        RunSpec: TaskSpec, EnvSpec, PolicySpec, ActionSpec (factored heads, masks)
//! schedule who waits for whom   Schedule (sync, lag k, async)
//! rollout  what an actor sends  Rollout, EpisodeEnd
//! repeats  what it leaves out   RowRepeats: the part of an observation that the one before has
//! message  everything else      Hello, Welcome, Control, Credit, Announcement ...
//! header   48 bytes in front    Header
//! codec    the one door         encode, decode (the only file that names bincode)
//! receive  message validation   size, header, schema, checksum, decode
//! refusal  what fails there     Refusal: cause, sentence, sender; the books count it
//! text     words for people     quoted and cut; `phrase`: counted, timed, guessed; `wording`: of wrong TOML
//! fakes    for tests            a small run: its spec, a hello, a welcome, a rollout
//! ```
//!
//! # Where to start
//!
//! [`rollout::Rollout`] is the message that everything else exists for.

pub mod codec;
#[cfg(any(test, feature = "fakes"))]
pub mod fakes;
pub mod header;
pub mod hex;
pub mod ids;
pub mod limits;
pub mod message;
pub mod packed;
pub mod phrase;
pub mod receive;
pub mod refusal;
pub mod repeats;
pub mod rollout;
pub mod schedule;
pub mod spec;
pub mod text;
pub mod wording;

pub use header::Header;
pub use ids::{
    ActorId, ClientName, DomainName, EnvId, Epoch, Incarnation, Iteration, PolicyVersion,
    RegionName, RunName, Sequence, ServiceName, Staleness,
};
pub use refusal::{Refusal, RefusalCause};
pub use repeats::{RowOverlap, RowRepeats};
pub use rollout::{CheckedRollout, EpisodeEnd, EpisodeSummary, Rollout};
pub use schedule::Schedule;
pub use spec::{
    ActionSpec, Conditional, EgoAttention, Encoder, EnvSpec, Gate, Head, HeadCredit, Mask,
    PolicySpec, RunSpec, TaskSpec,
};
