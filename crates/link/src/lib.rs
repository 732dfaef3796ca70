//! Leadtime's network: the only crate that names zenoh.
//!
//! What this crate does not know: environments, policies, optimisers, files. It carries the messages of
//! `leadtime-proto` between a learner, its actors and observers, and reports who is present.
//!
//! ```text
//!                 ┌───────────────── ctl/hello ── ctl/actor/{id} ── credit/{id} ─────────────────┐
//!   ActorLink ────┤                                                                              ├── LearnerLink
//!  (client, dials)└── traj/{domain}/{id} ──▶      ◀── weights/{domain} (announce), …/latest (pull)┘  (listens)
//!                            metrics/{role}/{id}, alive/{role}/{id}/{incarnation} ──▶ ObserverLink
//!                                                    about, history (query) ◀───────
//! ```
//!
//! # Invariants
//!
//! * **Callbacks never block.** What arrives goes into a bounded queue by `try_send`; what does not fit is refused and
//!   counted. A sender within its share always fits, so a stalled consumer costs nobody else anything.
//! * **A name in a key proves nothing.** The sender of a message is the one in its header; a message without a readable header has none.
//! * **Weights are what was announced.** A pull accepts only bytes with the announced digest, from any peer.
//! * Nothing relies on the network's congestion control as flow control; the credit window does that.
//! * Topology is a star, dialled one way: actors and observers are clients of the learner or of a router.
//! * A session with a certificate listens and dials by TLS alone (and on unix sockets, whose files guard them), and never falls back.
//! * A learner that listens passes the rollouts of its run on to nobody, unless a list lets somebody read them: a reader
//!   of everything that stands still holds up no rollout.
//! * A message between learner and actors proves which start it comes from, with or without certificates: nobody is
//!   charged, credited or ordered about in the name of another.
//! * A connection that leads nowhere is replaced by actors, observers and recorders, and by learners that only connect to a router; the
//!   library does not always see it.
//! * Every wait has a limit and every error names the address, key, actor or run it is about.
//!
//! | flow | priority | when the network is congested |
//! |---|---|---|
//! | control (hello, orders) | `RealTime` | waits |
//! | announcements | `InteractiveHigh` | dropped; repeated every second |
//! | credit | `InteractiveLow` | dropped; repeated twice a second |
//! | rollouts, weights | `Data` | waits; publish from a thread of its own |
//! | metrics | `Background` | dropped |
//! | about, history | `Background` | waits; answered by threads of their own |
//!
//! A notifier at work speaks to its clients beside all that, on a tree of keys of its own: [`live`].
//!
//! Needs tokio's multi-threaded runtime.
//!
//! # Where to start
//!
//! [`LearnerLink::open`] and [`ActorLink::open`]; who is let in is in [`AccessList`]; the keys are in [`keys`], the order of the receiver's checks in
//! [`leadtime_proto::receive`].

// What tests share names this crate as its users do.
#[cfg(test)]
extern crate self as leadtime_link;

pub mod keys;
pub mod live;

mod access;
mod actor;
mod admitted;
mod answer;
mod archive;
mod ask;
mod diagnose;
mod discovery;
mod endpoint;
mod error;
mod event;
#[cfg(feature = "fakes")]
mod fakes;
mod intake;
mod latest;
mod learner;
mod lock;
mod observer;
mod others;
mod proof;
mod pubsub;
mod queue;
mod redial;
mod relay;
mod router;
mod runtime;
mod security;
mod session;
#[cfg(test)]
#[path = "../tests/network/support.rs"]
#[expect(dead_code, reason = "only a part of it is needed here")]
mod test_support;
mod told;
mod weights;
mod wire;

pub use access::AccessList;
pub use actor::ActorLink;
pub use answer::{ControlResponder, HelloResponder, Responder};
#[cfg(feature = "fakes")]
pub use archive::history_question;
pub use archive::{Archive, HistoryMaker};
pub use endpoint::Endpoint;
pub use error::{Error, NetworkFault, RUN_IS_ENDING, Result};
pub use event::{ActorEvent, LearnerEvent, Payload, QueuePermit};
#[cfg(feature = "fakes")]
pub use fakes::ForeignLearner;
pub use intake::RefusalCounts;
pub use latest::Events;
pub use learner::LearnerLink;
pub use observer::{ObserverEvent, ObserverLink};
pub use proof::StartKey;
pub use relay::RelayCounts;
pub use router::RouterLink;
pub use runtime::{RUNTIME_VARIABLE, runtime, runtime_fault};
pub use session::{ConnectSettings, ListenSettings};
pub use told::RareLine;
#[cfg(any(test, feature = "fakes"))]
pub use wire::fake_hello;
