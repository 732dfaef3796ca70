//! Publishes on a robot's own key what is said to it.

use leadtime_link::live::{LivePort, LiveTopic};
use tracing::debug;

use crate::robot::cdr;
use crate::robot::ros2::SourceMark;

/// Places of the two topics among those of the node, which distinguish their sources.
const SAY: u8 = 2;
const STATUS: u8 = 3;

/// How events and statuses are written for a robot.
#[derive(Clone, Debug)]
pub struct RobotWriter {
    is_cdr: bool,
    /// Who says something, and as which message: of what is said, and of the status. `None` where no source is asked
    /// for.
    marks: Option<[SourceMark; 2]>,
    /// What the wall clock showed when the notifier's own clock was at zero, in nanoseconds.
    epoch: i64,
    written: Vec<u8>,
}

impl RobotWriter {
    /// Writes what the session writes: JSON, or 24 bytes.
    pub fn plain() -> Self {
        Self { is_cdr: false, marks: None, epoch: 0, written: Vec::new() }
    }

    /// Writes `std_msgs/String` in CDR.
    pub fn cdr() -> Self {
        Self { is_cdr: true, ..Self::plain() }
    }

    /// Writes `std_msgs/String` in CDR with the attachment that `rmw_zenoh` asks for. `process` is unlike that of any
    /// other process, `unix` what the wall clock shows now, in nanoseconds.
    pub fn ros2(process: u64, unix: i64) -> Self {
        let mark = |place: u8| {
            let mut gid = [0; 16];
            gid[..8].copy_from_slice(&process.to_le_bytes());
            gid[8] = place;
            SourceMark { number: 0, time: 0, gid }
        };
        Self { marks: Some([mark(SAY), mark(STATUS)]), epoch: unix, ..Self::cdr() }
    }

    /// Says what the notifier's own clock shows now, in nanoseconds.
    pub(crate) fn started_at(self, now: u64) -> Self {
        let now = i64::try_from(now).unwrap_or(i64::MAX);
        Self { epoch: self.epoch.saturating_sub(now), ..self }
    }

    /// Puts an event of what is said, or a status, at `now`, in nanoseconds of the notifier's own clock. A status is for the robot
    /// and whoever else reads its key.
    pub(crate) fn put(&mut self, port: &LivePort, topic: LiveTopic, text: &[u8], now: u64) {
        let beside = self.marks.as_mut().map(|marks| {
            let mark = &mut marks[usize::from(topic == LiveTopic::Status)];
            mark.number += 1;
            mark.time = self.epoch.saturating_add(i64::try_from(now).unwrap_or(i64::MAX));
            mark.write()
        });
        let bytes = if self.is_cdr {
            cdr::write_string(text, &mut self.written);
            &self.written
        } else {
            text
        };
        let beside = beside.as_ref().map(<[u8; _]>::as_slice);
        if let Err(error) = port.put_to_robot(topic, bytes, beside) {
            debug!(%error, "nothing can be put on the robot's key");
        }
    }
}
