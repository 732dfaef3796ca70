//! A robot that knows nothing of ours: its observations come from a key of its own, and it gets what is said on
//! another.
//!
//! ```text
//! leadtime serve --obs-key KEY      numbers, JSON or CDR on any key
//! leadtime serve --ros2 DOMAIN      std_msgs/Float32MultiArray in, std_msgs/String out, as rmw_zenoh sends them
//! ```
//!
//! It does not ask for its session, so the command line does ([`RobotSession`]). Where a message has no number and
//! no time of its own, [`RobotReader`] gives it those of its arrival.
//!
//! # Where to start
//!
//! [`RobotSession`]; then [`ros2`], for which [`cdr`] has the bytes.

pub mod cdr;
mod form;
mod reader;
pub mod ros2;
mod session;
mod writer;

pub use form::{ObservationSource, RobotForm};
pub(crate) use reader::{Arrived, RobotReader};
pub use session::RobotSession;
pub use writer::RobotWriter;
