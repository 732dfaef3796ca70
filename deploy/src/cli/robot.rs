//! The arguments of a session with a robot that does not ask for one.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use leadtime_proto::ClientName;
use leadtime_serve::StepClock;
use leadtime_serve::robot::ros2::MAX_DOMAIN;

use super::seconds;

/// A robot with keys of its own.
#[derive(Debug, Args)]
pub(crate) struct RobotArgs {
    /// Take a robot's observations from this key of its own: it asks for no session.
    #[arg(long, value_name = "KEY", group = "robot", help_heading = HEADING)]
    pub obs_key: Option<String>,
    /// Tell it on this key what is said.
    #[arg(long, value_name = "KEY", requires = "obs_key", help_heading = HEADING)]
    pub say_key: Option<String>,
    /// The form of its observations: numbers alone (f32, little-endian), our JSON, or the CDR of a `Float32MultiArray`.
    #[arg(long, value_name = "FORM", value_enum, default_value_t, requires = "obs_key")]
    #[arg(help_heading = HEADING)]
    pub obs_form: ObsForm,
    /// The form of what is said (default: JSON; with --obs-form cdr the CDR of a String that holds it).
    #[arg(long, value_name = "FORM", value_enum, requires = "say_key", help_heading = HEADING)]
    pub say_form: Option<SayKeyForm>,
    /// Speak to ROS 2 through `rmw_zenoh`, in this domain (experimental): `Float32MultiArray` in, `String` out.
    #[arg(long, value_name = "DOMAIN", group = "robot", help_heading = HEADING)]
    #[arg(value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_DOMAIN)))]
    pub ros2: Option<u32>,
    /// The ROS distribution; what came after Jazzy speaks as Jazzy does.
    #[arg(long, value_name = "DISTRO", value_enum, default_value_t, requires = "ros2")]
    #[arg(help_heading = HEADING)]
    pub ros2_distro: DistroName,
    /// What its topics begin with: NAME/obs, NAME/say, NAME/status.
    #[arg(long, value_name = "NAME", default_value = "leadtime", requires = "ros2")]
    #[arg(help_heading = HEADING)]
    pub ros2_topic: String,
    /// The robot's name among the clients.
    #[arg(long, value_name = "NAME", default_value = "robot", requires = "robot")]
    #[arg(help_heading = HEADING)]
    pub client: ClientName,
    /// When a step is taken: every --seconds-per-step, with every observation, or where a word ends.
    #[arg(long, value_name = "CLOCK", value_parser = clock(), default_value = "timer")]
    #[arg(requires = "robot", help_heading = HEADING)]
    pub clock: StepClock,
    /// How long a step (a word) takes, in seconds.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, default_value_t = 0.3, requires = "robot")]
    #[arg(help_heading = HEADING)]
    pub seconds_per_step: f64,
    /// From which age on an observation is too old, in seconds (default: as for any client).
    #[arg(long, value_name = "SECONDS", value_parser = seconds, requires = "robot", help_heading = HEADING)]
    pub stale_after: Option<f64>,
    /// After which silence the robot counts as lost, in seconds (default: as for any client).
    #[arg(long, value_name = "SECONDS", value_parser = seconds, requires = "robot", help_heading = HEADING)]
    pub lost_after: Option<f64>,
}

const HEADING: &str = "A robot with keys of its own";

/// The form of observations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ObsForm {
    /// The numbers alone: f32, little-endian.
    #[default]
    F32,
    /// Our JSON; `seq` and `t` may both be left out.
    Json,
    /// `std_msgs/Float32MultiArray`, as zenoh-plugin-ros2dds brings it.
    Cdr,
}

/// The form of what is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SayKeyForm {
    /// Our JSON.
    Json,
    /// 24 bytes.
    Binary,
    /// `std_msgs/String` with our JSON.
    Cdr,
}

/// A distribution of ROS 2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum DistroName {
    /// With `rmw_zenoh` 0.2.4 or later; also Kilted and Rolling.
    #[default]
    Jazzy,
    /// Which knows no hashes of types.
    Humble,
}

fn clock() -> impl TypedValueParser<Value = StepClock> {
    let clock = |name: String| match name.as_str() {
        "observation" => StepClock::Observation,
        "word" => StepClock::Word,
        _ => StepClock::Timer,
    };
    PossibleValuesParser::new(["timer", "observation", "word"]).map(clock)
}
