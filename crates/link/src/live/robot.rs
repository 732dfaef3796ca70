//! A robot's own keys: where it publishes observations, and where it receives what is said.

use std::fmt;

use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::session::Session;

use super::keys::LiveTopic;
use crate::pubsub::{appear, publisher};
use crate::{Error, Result, wire};

/// What our own keys begin with.
const OURS: &str = "leadtime/";

/// The keys of a robot that knows nothing of ours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RobotKeys {
    /// Where it puts what it observes.
    pub observations: String,
    /// The key on which it receives what is said; `None` if it receives nothing.
    pub say: Option<String>,
    /// The key on which it receives the notifier's status.
    pub status: Option<String>,
    /// Signs of presence that its own software looks for.
    pub tokens: Vec<String>,
    /// What samples say of their form, such as `application/cdr`.
    pub encoding: &'static str,
}

impl RobotKeys {
    /// Checks every key: one place each, none of them ours, none of them twice.
    ///
    /// # Errors
    ///
    /// [`Error::RobotKey`] with what is wrong with the first.
    pub fn check(&self) -> Result<()> {
        let keys = || [&self.say, &self.status].into_iter().flatten().chain([&self.observations]);
        for key in keys() {
            let problem = match KeyExpr::autocanonize(key.clone()) {
                Err(_) => "keys are parts with `/` between, without `#`, `?` or empty parts",
                Ok(expr) if expr.is_wild() => "it has to be one key, without `*`",
                Ok(expr) if expr.starts_with(OURS) => "keys below `leadtime/` are ours",
                Ok(_) if keys().filter(|other| *other == key).count() > 1 => {
                    "observations and what is said need a key each"
                }
                Ok(_) => continue,
            };
            return Err(Error::RobotKey { key: key.clone(), problem });
        }
        Ok(())
    }
}

/// Publishes what is said, and the status, on a robot's own keys.
pub(super) struct RobotPort {
    say: Option<Publisher<'static>>,
    status: Option<Publisher<'static>>,
    _tokens: Vec<LivelinessToken>,
}

impl fmt::Debug for RobotPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RobotPort").finish_non_exhaustive()
    }
}

impl RobotPort {
    pub(super) fn open(session: &Session, keys: &RobotKeys) -> Result<Self> {
        let declare = |key: &Option<String>, qos| {
            let form = || Encoding::from(keys.encoding);
            key.as_ref().map(|key| publisher(session, key, qos, form())).transpose()
        };
        let tokens = keys.tokens.iter().map(|token| appear(session, token)).collect::<Result<_>>();
        Ok(Self {
            say: declare(&keys.say, wire::SPEECH)?,
            status: declare(&keys.status, wire::NOTICE)?,
            _tokens: tokens?,
        })
    }

    /// Puts what is said, or a status, on the robot's key for it, if there is one.
    pub(super) fn put(&self, topic: LiveTopic, bytes: &[u8], beside: Option<&[u8]>) -> Result<()> {
        let to = match topic {
            LiveTopic::Say => &self.say,
            LiveTopic::Status => &self.status,
            LiveTopic::Observations | LiveTopic::Heard | LiveTopic::Taken => return Ok(()),
        };
        let Some(to) = to else { return Ok(()) };
        let put = to.put(bytes).attachment(beside).wait();
        put.map_err(Error::network("publish on", to.key_expr()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robots_key_is_a_single_key_outside_our_own() {
        let keys = |observations: &str, say: Option<&str>| RobotKeys {
            observations: observations.to_owned(),
            say: say.map(str::to_owned),
            status: None,
            tokens: Vec::new(),
            encoding: "application/json",
        };
        keys("robot1/leadtime/obs", Some("robot1/leadtime/say")).check().unwrap();
        keys("7/obs/std_msgs::msg::dds_::Float32MultiArray_/RIHS01_05", None).check().unwrap();
        for (observations, say, told) in [
            ("robot1/*", None, "`robot1/*` cannot be a robot's key: it has to be one key"),
            ("robot1//obs", None, "parts with `/` between"),
            ("", None, "parts with `/` between"),
            ("a#b", None, "parts with `/` between"),
            ("leadtime/live/1/notifier/car-1/obs", None, "`leadtime/` are ours"),
            ("a", Some("a"), "need a key each"),
            ("a", Some("b/**"), "`b/**` cannot be"),
        ] {
            let error = keys(observations, say).check().unwrap_err().to_string();
            assert!(error.contains(told), "{error}");
        }
    }
}
