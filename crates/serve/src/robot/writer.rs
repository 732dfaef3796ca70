//! Publishes on a robot's own key what is said to it.

use leadtime_link::live::LivePort;
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

    /// Publishes an event of what is said, at `now`, in nanoseconds of the notifier's own clock.
    pub(crate) fn say(&mut self, port: &LivePort, event: &[u8], now: u64) {
        self.put(0, event, now, |bytes, beside| port.say_to_robot(bytes, beside));
    }

    /// Puts a status, for the robot and whoever else reads its key.
    pub(crate) fn status(&mut self, port: &LivePort, status: &[u8], now: u64) {
        self.put(1, status, now, |bytes, beside| port.status_to_robot(bytes, beside));
    }

    fn put(
        &mut self,
        topic: usize,
        text: &[u8],
        now: u64,
        put: impl FnOnce(&[u8], Option<&[u8]>) -> leadtime_link::Result<()>,
    ) {
        let beside = self.marks.as_mut().map(|marks| {
            let mark = &mut marks[topic];
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
        if let Err(error) = put(bytes, beside.as_ref().map(<[u8; _]>::as_slice)) {
            debug!(%error, "nothing can be put on the robot's key");
        }
    }
}
