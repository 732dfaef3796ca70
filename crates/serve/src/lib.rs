//! A notifier at work: live sessions with robots, cars and simulators.
//!
//! ```text
//! client --obs-->  LivePort  -->  LiveSession  (sims' Session + policy + words)  --say, status-->  client
//!                  newest wins     pure: order, staleness, steps, words
//!        --open--> LiveService: who gets a session, on which thread
//! robot  --its own key, or a topic of ROS 2-->  robot::RobotReader  -->  the same
//! ```
//!
//! A live notifier advises a listener. It never commands a machine: no key carries actions.
//!
//! What this crate does not know: files, the command line, zenoh (that is `link::live`), how a policy learned.
//!
//! # Invariants
//!
//! * **Nothing stale is said.** An utterance starts only on an observation younger than `stale_after`, and goes on without one
//!   only if it is understood already.
//! * **Every silence has a reason**, on the status key.
//! * The decisions are those of training and evaluation, bit for bit; with `clock = "observation"` so are whole episodes.
//! * [`LiveSession`] reads no clock, and allocates nothing per step once it is open.
//!
//! # Where to start
//!
//! [`LiveSession`], whose header has the table of what must happen; then [`LiveService`].

mod bus_player;
mod client;
pub mod heard;
mod json_fault;
pub mod latency;
mod live_clock;
pub mod live_session;
mod live_thread;
pub mod observation;
pub mod open;
pub mod phrases;
pub mod robot;
pub mod say;
mod service;
mod state_keeper;
pub mod status;
pub mod taken;
#[cfg(test)]
mod test_support;
mod travel;
pub mod working_policy;

pub use bus_player::{BusPlayer, SaidMessage};
pub use client::{ClientError, ClientSettings, LiveClient};
pub use json_fault::JsonFault;
pub use latency::LatencyHistogram;
pub use live_session::{LiveSession, LiveSnapshot, ObservationBytes};
pub use open::{
    OpenRefusal, SayForm, SessionAnswer, SessionNote, SessionPlan, StepClock, WordClock,
};
pub use robot::{ObservationSource, RobotForm, RobotSession, RobotWriter};
pub use say::{HeardSay, SayEvent, SayTo};
pub use service::{LiveService, MAX_SESSIONS, ServiceError, ServiceSettings};
pub use state_keeper::StateStore;
pub use status::{LiveCounts, LiveState, Silence};
pub use taken::{TakenInput, TakenLine};
pub use working_policy::{LiveDecider, PolicyOrigin, UnfitPolicy, WorkingPolicy, told_voice};
