//! What a channel of a recording holds, and its schema.

use leadtime_link::live::{LIVE_ROOT, LiveTopic};

/// What a channel of a recording holds: what is published about a client and what its session is, or about a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordedTopic {
    /// What is published about a client.
    Live(LiveTopic),
    /// What the session is.
    Session,
    /// What a learner or an actor reports of its run.
    Metrics,
}

impl RecordedTopic {
    /// Lists those about a client.
    fn of_client() -> impl Iterator<Item = Self> {
        LiveTopic::ALL.into_iter().map(Self::Live).chain([Self::Session])
    }

    /// Returns the part of the channel's name that distinguishes it from others; the name is a key.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Live(topic) => topic.as_str(),
            Self::Session => "session",
            Self::Metrics => "metrics",
        }
    }

    /// Returns name and text of the JSON Schema.
    pub(crate) fn schema(self) -> (&'static str, &'static str) {
        match self {
            Self::Live(topic) => match topic {
                LiveTopic::Observations => {
                    ("leadtime.live.Observation", include_str!("../schemas/observation.json"))
                }
                LiveTopic::Say => ("leadtime.live.Say", include_str!("../schemas/say.json")),
                LiveTopic::Heard => ("leadtime.live.Heard", include_str!("../schemas/heard.json")),
                LiveTopic::Status => {
                    ("leadtime.live.Status", include_str!("../schemas/status.json"))
                }
                LiveTopic::Taken => ("leadtime.live.Taken", include_str!("../schemas/taken.json")),
            },
            Self::Session => ("leadtime.live.Session", include_str!("../schemas/session.json")),
            Self::Metrics => ("leadtime.run.Metrics", include_str!("../schemas/metrics.json")),
        }
    }

    /// Reads a channel's name, `leadtime/live/1/{service}/{client}/{topic}`: what comes before the topic, and the topic.
    pub(crate) fn of_key(key: &str) -> Option<(&str, Self)> {
        let (before, last) = key.rsplit_once('/')?;
        let topic = Self::of_client().find(|topic| topic.as_str() == last)?;
        Some((before.strip_prefix(LIVE_ROOT)?.strip_prefix('/')?, topic))
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{ClientName, ServiceName};
    use serde_json::Value;

    use super::*;

    #[test]
    fn channels_are_named_by_keys_and_schemas_are_json() {
        let (service, client) =
            (ServiceName::new("notifier").unwrap(), ClientName::new("car-1").unwrap());
        for topic in LiveTopic::ALL {
            let key = topic.key(&service, &client).to_string();
            let read = RecordedTopic::of_key(&key).unwrap();
            assert_eq!(read, ("notifier/car-1", RecordedTopic::Live(topic)));
        }
        for other in [
            "leadtime/1/run/obs",
            "obs",
            "leadtime/live/1/a/b/alive",
            "leadtime/1/r/metrics/actor/a",
        ] {
            assert_eq!(RecordedTopic::of_key(other), None);
        }
        for topic in RecordedTopic::of_client().chain([RecordedTopic::Metrics]) {
            let (name, text) = topic.schema();
            let schema: Value = serde_json::from_str(text).unwrap();
            assert_eq!(schema["title"], name);
        }
    }
}
