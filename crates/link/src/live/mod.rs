//! A notifier at work and its clients: robots, cars, simulators.
//!
//! ```text
//! leadtime/live/1/{service}/alive/{incarnation}             presence of the notifier
//! leadtime/live/1/{service}/alive/open                      query of another notifier of the name: who is at work says no
//! leadtime/live/1/{service}/{client}/alive/{incarnation}    presence of a client
//! leadtime/live/1/{service}/{client}/open                   query: what the client is; the answer is its session
//! leadtime/live/1/{service}/{client}/obs                    observations, client to notifier
//! leadtime/live/1/{service}/{client}/say                    what is said, word by word
//! leadtime/live/1/{service}/{client}/heard                  what the loudspeaker really did
//! leadtime/live/1/{service}/{client}/status                 what the notifier does, and why it is silent
//! leadtime/live/1/{service}/{client}/taken                  what the notifier took in, and when, for recorders
//! leadtime/live/1/{service}/{client}/session                query of a recorder: what the session is
//! ```
//!
//! A robot that does not speak our protocol has keys of its own instead ([`RobotKeys`]).
//!
//! The keys lie beside those of runs, and other programs use their messages too: JSON for everybody, a few raw bytes for
//! microcontrollers. What is in them this crate does not know.
//!
//! # Invariants
//!
//! * Of a client's observations only the newest waits ([`LivePort::take`]): a flood costs nobody else anything.
//! * What is said is put with priority, at once, and dropped where a client does not read: the next event repeats it.
//!
//! # Where to start
//!
//! [`LiveServiceLink::open`], [`LiveClientLink::open`] and [`LiveRecorderLink::open`].

mod client;
#[cfg(feature = "fakes")]
mod fakes;
mod keys;
mod port;
mod recorder;
mod robot;
mod service;

pub use client::{ClientPort, LiveClientLink, LiveMessage};
#[cfg(feature = "fakes")]
pub use fakes::TakenAt;
pub use keys::{LIVE_ROOT, LiveAlive, LiveKey, LiveTopic};
pub use port::{Arrival, ArrivalEncoding, LivePort};
pub use recorder::{LiveRecorderLink, LiveSample, SessionAsker};
pub use robot::RobotKeys;
pub use service::{LiveEvent, LiveServiceLink, OpenResponder, OtherNotifier};
