//! How ROS 2 speaks over Zenoh with `rmw_zenoh`: its keys, its signs of presence, and the 33 bytes attached to every
//! message.
//!
//! ```text
//! 7/leadtime/obs/std_msgs::msg::dds_::Float32MultiArray_/RIHS01_0599...    what a robot observes
//! 7/leadtime/say/std_msgs::msg::dds_::String_/RIHS01_df66...               what is said, our JSON
//! 7/leadtime/status/std_msgs::msg::dds_::String_/RIHS01_df66...            what the notifier does, our JSON
//! @ros2_lv/7/{zid}/0/0/NN/%/%/leadtime_notifier                            the node, for `ros2 node list`
//! @ros2_lv/7/{zid}/0/2/MP/%/%/leadtime_notifier/%leadtime%say/{type}/{hash}/{qos}
//!                                                                          a topic of it, for `ros2 topic list`
//!
//! attached to a message, little-endian: number i64, time of its source i64 in ns, 16 u8, gid of its source 16 bytes
//! ```
//!
//! # Source
//!
//! `ros2/rmw_zenoh`: `docs/design.md`, `liveliness_utils.cpp` and `attachment_helpers.cpp`, as of Jazzy 0.2.4 and Humble 0.1.2;
//! the hashes of the types are those of `rosbags` (`tests/data/ros2.py`).

use std::fmt;

use leadtime_proto::text::quoted;
use thiserror::Error;

/// The type of a message, as keys name it.
#[derive(Clone, Copy)]
struct MessageType {
    name: &'static str,
    /// The hash of its definition.
    hash: &'static str,
}

const ARRAY: MessageType = MessageType {
    name: "std_msgs::msg::dds_::Float32MultiArray_",
    hash: "RIHS01_0599f6f85b4bfca379873a0b4375a0aca022156bd2d7021275d116ed1fa8bfe0",
};
const STRING: MessageType = MessageType {
    name: "std_msgs::msg::dds_::String_",
    hash: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
};
/// What Humble writes in place of a hash, which it does not know.
const NO_HASH: &str = "TypeHashNotSupported";
/// Reliable, volatile, the last ten; every other policy as it is by default.
const QOS: &str = "::,10:,:,:,,";
/// Bytes attached to a message.
pub const ATTACHMENT: usize = 33;
/// The length of a gid, which is written before it.
const GID: u8 = 16;
/// The greatest number of a ROS domain.
pub const MAX_DOMAIN: u32 = 232;
/// The longest name of a topic, in bytes.
const MAX_TOPIC: usize = 200;

/// Whose keys are spoken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distro {
    /// Jazzy with `rmw_zenoh` 0.2.4 or later, and what came after it.
    Jazzy,
    /// Humble, which knows no hashes of types.
    Humble,
}

/// Why a topic cannot be called so.
#[derive(Debug, Error)]
#[error(
    "`{}` is no name of a ROS topic: parts of letters, digits and `_` with `/` between, none beginning with a digit", quoted(.0)
)]
pub struct BadTopic(pub String);

/// The names of a notifier in a ROS graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ros2Names {
    domain: u32,
    distro: Distro,
    /// What its topics begin with, without a `/` at either end.
    topic: String,
    node: String,
}

impl Ros2Names {
    /// Names a notifier: its topics are `topic/obs`, `topic/say` and `topic/status`, its node is `leadtime_{service}`.
    ///
    /// # Errors
    ///
    /// [`BadTopic`] if the topic's name breaks ROS 2's rules, so that no key can be made of it.
    pub fn new(domain: u32, distro: Distro, topic: &str, service: &str) -> Result<Self, BadTopic> {
        let plain = topic.strip_prefix('/').unwrap_or(topic);
        let is_name = |part: &str| {
            part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
                && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        };
        if plain.len() > MAX_TOPIC || !plain.split('/').all(is_name) {
            return Err(BadTopic(topic.to_owned()));
        }
        let node = format!("leadtime_{}", service.replace('-', "_"));
        Ok(Self { domain, distro, topic: plain.to_owned(), node })
    }

    /// Returns the key of what the robot observes.
    pub fn observations(&self) -> String {
        self.key("obs", ARRAY)
    }

    /// Returns the key of what is said.
    pub fn say(&self) -> String {
        self.key("say", STRING)
    }

    /// Returns the key of what the notifier does.
    pub fn status(&self) -> String {
        self.key("status", STRING)
    }

    /// Returns the tokens of the node and of its topics, for the session `zid` of the network.
    pub fn tokens(&self, zid: &str) -> [String; 4] {
        let head = |number: u8, kind| {
            let Self { domain, node, .. } = self;
            format!("@ros2_lv/{domain}/{zid}/0/{number}/{kind}/%/%/{node}")
        };
        let topic = |number, kind, name, message: MessageType| {
            let topic = self.topic.replace('/', "%");
            let (head, hash) = (head(number, kind), self.hash_of(message));
            format!("{head}/%{topic}%{name}/{}/{hash}/{QOS}", message.name)
        };
        [
            head(0, "NN"),
            topic(1, "MS", "obs", ARRAY),
            topic(2, "MP", "say", STRING),
            topic(3, "MP", "status", STRING),
        ]
    }

    fn key(&self, name: &str, message: MessageType) -> String {
        let hash = self.hash_of(message);
        format!("{}/{}/{name}/{}/{hash}", self.domain, self.topic, message.name)
    }

    fn hash_of(&self, message: MessageType) -> &'static str {
        match self.distro {
            Distro::Jazzy => message.hash,
            Distro::Humble => NO_HASH,
        }
    }
}

impl fmt::Display for Ros2Names {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { domain, topic, .. } = self;
        write!(f, "/{topic}/obs, /{topic}/say and /{topic}/status of ROS domain {domain}")
    }
}

/// What is attached to a message: who sent it, when, and as which one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceMark {
    /// Its number among those of its source.
    pub number: i64,
    /// When it was sent, in nanoseconds by the clock of its source.
    pub time: i64,
    /// The endpoint that sent it.
    pub gid: [u8; GID as usize],
}

impl SourceMark {
    /// Reads what is attached to a message; `None` if it is something else.
    pub fn read(beside: &[u8]) -> Option<Self> {
        let beside: &[u8; ATTACHMENT] = beside.try_into().ok()?;
        let (number, rest) = beside.split_first_chunk()?;
        let (time, rest) = rest.split_first_chunk()?;
        let gid = rest.strip_prefix(&[GID])?.try_into().ok()?;
        Some(Self { number: i64::from_le_bytes(*number), time: i64::from_le_bytes(*time), gid })
    }

    /// Writes it as it is attached to a message.
    pub fn write(&self) -> [u8; ATTACHMENT] {
        let mut beside = [GID; ATTACHMENT];
        beside[..8].copy_from_slice(&self.number.to_le_bytes());
        beside[8..16].copy_from_slice(&self.time.to_le_bytes());
        beside[17..].copy_from_slice(&self.gid);
        beside
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_and_tokens_are_those_of_rmw_zenoh() {
        let names = Ros2Names::new(7, Distro::Jazzy, "/car_1/leadtime", "night-shift").unwrap();
        let golden: serde_json::Value =
            serde_json::from_str(include_str!("../../tests/data/ros2.json")).unwrap();
        let hash = |name| golden["hashes"][name].as_str().unwrap().to_owned();
        let (array, string) = (hash("std_msgs/msg/Float32MultiArray"), hash("std_msgs/msg/String"));
        let obs = format!("7/car_1/leadtime/obs/std_msgs::msg::dds_::Float32MultiArray_/{array}");
        assert_eq!(names.observations(), obs);
        let say = format!("7/car_1/leadtime/say/std_msgs::msg::dds_::String_/{string}");
        assert_eq!((names.say(), names.status()), (say.clone(), say.replace("/say/", "/status/")));
        let [node, subscription, publisher, _] = names.tokens("a1b2");
        assert_eq!(node, "@ros2_lv/7/a1b2/0/0/NN/%/%/leadtime_night_shift");
        assert_eq!(
            subscription,
            format!(
                "@ros2_lv/7/a1b2/0/1/MS/%/%/leadtime_night_shift/%car_1%leadtime%obs/\
                 std_msgs::msg::dds_::Float32MultiArray_/{array}/::,10:,:,:,,"
            )
        );
        assert!(publisher.contains("/0/2/MP/%/%/leadtime_night_shift/%car_1%leadtime%say/std"));
        let humble = Ros2Names::new(0, Distro::Humble, "leadtime", "notifier").unwrap();
        let key = "0/leadtime/say/std_msgs::msg::dds_::String_/TypeHashNotSupported";
        assert_eq!(humble.say(), key);
        for topic in ["", "/", "a//b", "a/", "1a", "a b", "~/a", "a/*", "a-b", &"a".repeat(201)] {
            Ros2Names::new(0, Distro::Jazzy, topic, "notifier").unwrap_err();
        }
    }

    #[test]
    fn a_message_keeps_its_attachment_and_other_bytes_are_not_taken_for_one() {
        let gid = *b"0123456789abcdef";
        let mark = SourceMark { number: 17, time: 1_796_000_000_123_456_789, gid };
        let beside = mark.write();
        assert_eq!(SourceMark::read(&beside), Some(mark));
        assert_eq!(beside[..9], [17, 0, 0, 0, 0, 0, 0, 0, 0x15]);
        assert_eq!(beside[16], 16);
        for n in (0..ATTACHMENT).chain([ATTACHMENT + 1]) {
            assert_eq!(SourceMark::read(&vec![GID; n]), None, "{n}");
        }
        let mut other = beside;
        other[16] = 15;
        assert_eq!(SourceMark::read(&other), None);
    }
}
