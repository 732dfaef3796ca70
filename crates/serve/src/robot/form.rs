//! In which form a robot's own key has observations.

use crate::observation::{BadObservation, LiveObservation};
use crate::robot::cdr;

/// The form of observations on a robot's own key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotForm {
    /// The numbers alone, f32 little-endian.
    F32,
    /// Our JSON; `seq` and `t` may both be left out.
    Json,
    /// `std_msgs/Float32MultiArray` in CDR, as a bridge of DDS sends it.
    Cdr,
    /// The same with the attachment of `rmw_zenoh`.
    Ros2,
}

/// Where a session's observations come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ObservationSource {
    /// A client that has asked for the session, in the form that each sample states.
    #[default]
    Client,
    /// A robot's own key. No client can ask for such a session again, so it never ends.
    Robot(RobotForm),
}

impl RobotForm {
    /// Reads an observation; returns whether it brought a number and a time of its own.
    ///
    /// # Errors
    ///
    /// [`BadObservation`] if the bytes are no observation in this form, or its numbers are not as many as the task has,
    /// or not finite.
    pub(crate) fn read(
        self,
        into: &mut LiveObservation,
        payload: &[u8],
    ) -> Result<bool, BadObservation> {
        match self {
            Self::F32 => {
                let (numbers, rest) = payload.as_chunks();
                if rest.is_empty() && numbers.len() == into.obs_dim() {
                    return into.read_numbers(numbers).map(|()| false);
                }
                let (found, expected) = (payload.len(), into.obs_dim());
                let looks_like = if payload.starts_with(b"{") {
                    "; it looks like JSON: --obs-form json"
                } else if cdr::float32_array(payload).is_ok() {
                    "; it looks like a Float32MultiArray of ROS 2: --obs-form cdr"
                } else {
                    ""
                };
                Err(BadObservation::NumbersAlone { found, expected, looks_like })
            }
            Self::Json => into.read_json_of_robot(payload),
            Self::Cdr | Self::Ros2 => {
                into.read_numbers(cdr::float32_array(payload)?).map(|()| false)
            }
        }
    }
}
