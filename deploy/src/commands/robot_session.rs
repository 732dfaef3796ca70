//! The session of a robot that does not ask for one, from the arguments of `leadtime serve`.

use leadtime_link::live::RobotKeys;
use leadtime_proto::{Incarnation, ServiceName};
use leadtime_runs::clock;
use leadtime_serve::robot::ros2::{BadTopic, Distro, Ros2Names};
use leadtime_serve::{RobotForm, RobotSession, RobotWriter, SayForm};
use serde_json::json;

use crate::cli::{DistroName, ObsForm, RobotArgs, SayKeyForm};

/// Describes the session that the arguments ask for; `None` if they ask for none; with it, where the
/// robot is in words. `zid` is the name of this session on the network.
///
/// # Errors
///
/// [`BadTopic`].
pub(super) fn robot_session(
    args: &RobotArgs,
    domain: &str,
    service: &ServiceName,
    own: Incarnation,
    zid: &str,
) -> Result<Option<(RobotSession, String)>, BadTopic> {
    let client = args.client.clone();
    if let Some(ros_domain) = args.ros2 {
        let distro = match args.ros2_distro {
            DistroName::Jazzy => Distro::Jazzy,
            DistroName::Humble => Distro::Humble,
        };
        let names = Ros2Names::new(ros_domain, distro, &args.ros2_topic, service.as_str())?;
        let keys = RobotKeys {
            observations: names.observations(),
            say: Some(names.say()),
            status: Some(names.status()),
            tokens: names.tokens(zid).into(),
            // As rmw_zenoh puts its own.
            encoding: "zenoh/bytes",
        };
        let unix = i64::try_from(clock::now().as_nanosecond()).unwrap_or(i64::MAX);
        let writer = RobotWriter::ros2(own.0, unix);
        let question = question(args, domain, SayForm::Json);
        let robot_session = RobotSession { client, question, keys, form: RobotForm::Ros2, writer };
        return Ok(Some((robot_session, names.to_string())));
    }
    let Some(observations) = args.obs_key.clone() else { return Ok(None) };
    let form = match args.obs_form {
        ObsForm::F32 => RobotForm::F32,
        ObsForm::Json => RobotForm::Json,
        ObsForm::Cdr => RobotForm::Cdr,
    };
    let usual = if form == RobotForm::Cdr { SayKeyForm::Cdr } else { SayKeyForm::Json };
    let (writer, say_form, encoding) = match args.say_form.unwrap_or(usual) {
        SayKeyForm::Json => (RobotWriter::plain(), SayForm::Json, "application/json"),
        SayKeyForm::Binary => (RobotWriter::plain(), SayForm::Binary, "application/octet-stream"),
        SayKeyForm::Cdr => (RobotWriter::cdr(), SayForm::Json, "application/cdr"),
    };
    let place = format!("`{observations}`");
    let (say, status, tokens) = (args.say_key.clone(), None, Vec::new());
    let keys = RobotKeys { observations, say, status, tokens, encoding };
    let question = question(args, domain, say_form);
    Ok(Some((RobotSession { client, question, keys, form, writer }, place)))
}

/// Asks what a client would ask.
fn question(args: &RobotArgs, domain: &str, form: SayForm) -> Vec<u8> {
    let question = json!({
        "protocol": leadtime_serve::open::LIVE_PROTOCOL,
        "domain": domain,
        "clock": args.clock,
        "seconds_per_step": args.seconds_per_step,
        "stale_after": args.stale_after,
        "lost_after": args.lost_after,
        "encoding": form,
    });
    question.to_string().into_bytes()
}
