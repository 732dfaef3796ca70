//! A session that the command line opens, because the robot does not ask for one.

use leadtime_link::live::RobotKeys;
use leadtime_proto::ClientName;

use crate::robot::form::RobotForm;
use crate::robot::writer::RobotWriter;

/// What is known of a robot that does not ask for its session. The session stays as long as the notifier.
#[derive(Debug)]
pub struct RobotSession {
    /// The name under which its status is published, and what it hears may be reported.
    pub client: ClientName,
    /// What it would ask, JSON: the same question as any client's.
    pub question: Vec<u8>,
    /// The keys on which it observes and listens.
    pub keys: RobotKeys,
    /// The form of its observations.
    pub form: RobotForm,
    /// Writes for it what is said.
    pub writer: RobotWriter,
}
