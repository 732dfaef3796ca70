//! The keys of notifiers at work, built from checked names.

use std::fmt;

use leadtime_proto::{ClientName, Incarnation, ServiceName};

use crate::{Error, Result};

/// What every key of a notifier at work begins with. The `1` is the layout of the keys.
pub const LIVE_ROOT: &str = "leadtime/live/1";
/// The part of a key that no client can be called.
const ALIVE: &str = "alive";
/// The last part of the keys at which a notifier is asked.
const OPEN: &str = "open";
const SESSION: &str = "session";

/// A key of a notifier at work, as its parts; displayed it is the text that the network knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LiveKey<'a> {
    /// Presence of one start of a notifier.
    Service(&'a ServiceName, Incarnation),
    /// Presence of one start of a client.
    Client(&'a ServiceName, &'a ClientName, Incarnation),
    /// Where a client asks for a session.
    Open(&'a ServiceName, &'a ClientName),
    /// What is published about a client: the last part of a key.
    Topic(&'a ServiceName, &'a ClientName, LiveTopic),
    /// Where another notifier of the name asks whether one answers: where the client would ask that nobody can be.
    Life(&'a ServiceName),
    /// Where a recorder asks what a client's session is.
    Session(&'a ServiceName, &'a ClientName),
    /// Every notifier that is there.
    Services,
    /// Every start of a notifier that is there.
    Starts(&'a ServiceName),
    /// Every client of a notifier that is there.
    Clients(&'a ServiceName),
    /// Where any client asks for a session.
    Opens(&'a ServiceName),
    /// Where a recorder asks for the session of any client.
    Sessions(&'a ServiceName),
    /// The same of any client.
    Any(&'a ServiceName, LiveTopic),
}

/// What is published about a client: the last part of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LiveTopic {
    /// What it observes.
    Observations,
    /// What is said to it.
    Say,
    /// What it has heard.
    Heard,
    /// What the notifier does for it.
    Status,
    /// What the notifier took in of it, and when, for recorders.
    Taken,
}

impl LiveTopic {
    /// Every topic.
    pub const ALL: [Self; 5] =
        [Self::Observations, Self::Say, Self::Heard, Self::Status, Self::Taken];

    /// Returns it as it stands in keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Observations => "obs",
            Self::Say => "say",
            Self::Heard => "heard",
            Self::Status => "status",
            Self::Taken => "taken",
        }
    }

    /// Returns its key for a client.
    pub fn key<'a>(self, service: &'a ServiceName, client: &'a ClientName) -> LiveKey<'a> {
        LiveKey::Topic(service, client, self)
    }
}

impl fmt::Display for LiveKey<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(LIVE_ROOT)?;
        match self {
            Self::Service(service, Incarnation(start)) => {
                write!(f, "/{service}/{ALIVE}/{start:016x}")
            }
            Self::Client(service, client, Incarnation(start)) => {
                write!(f, "/{service}/{client}/{ALIVE}/{start:016x}")
            }
            Self::Open(service, client) => write!(f, "/{service}/{client}/{OPEN}"),
            Self::Life(service) => write!(f, "/{service}/{ALIVE}/{OPEN}"),
            Self::Topic(service, client, topic) => {
                write!(f, "/{service}/{client}/{}", topic.as_str())
            }
            Self::Session(service, client) => write!(f, "/{service}/{client}/{SESSION}"),
            Self::Services => write!(f, "/*/{ALIVE}/*"),
            Self::Starts(service) => write!(f, "/{service}/{ALIVE}/*"),
            Self::Clients(service) => write!(f, "/{service}/*/{ALIVE}/*"),
            Self::Opens(service) => write!(f, "/{service}/*/{OPEN}"),
            Self::Sessions(service) => write!(f, "/{service}/*/{SESSION}"),
            Self::Any(service, topic) => write!(f, "/{service}/*/{}", topic.as_str()),
        }
    }
}

/// Who is alive, as read from a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LiveAlive {
    /// The notifier, or whose client it is.
    pub service: ServiceName,
    /// The client; `None` for the notifier itself.
    pub client: Option<ClientName>,
    /// Which start of it is alive.
    pub incarnation: Incarnation,
}

/// Reads a key of presence, `None` if the key is not one of these.
pub(crate) fn parse_alive(key: &str) -> Option<LiveAlive> {
    let rest = key.strip_prefix(LIVE_ROOT)?.strip_prefix('/')?;
    let (service, client, digits) = match rest.split('/').collect::<Vec<_>>()[..] {
        [service, ALIVE, digits] => (service, None, digits),
        [service, client, ALIVE, digits] => (service, Some(ClientName::new(client).ok()?), digits),
        _ => return None,
    };
    let (service, incarnation) = (ServiceName::new(service).ok()?, Incarnation::from_hex(digits)?);
    Some(LiveAlive { service, client, incarnation })
}

/// Reads the client from the key of a question for a session, `None` if the key is not one of these.
pub(crate) fn parse_open(key: &str) -> Option<ClientName> {
    parse_of_client(key).filter(|(_, last)| *last == OPEN).map(|(client, _)| client)
}

/// Reads the client from the key of a recorder's question, `None` if the key is not one of these.
pub(crate) fn parse_session(key: &str) -> Option<ClientName> {
    parse_of_client(key).filter(|(_, last)| *last == SESSION).map(|(client, _)| client)
}

/// Reads the client from the key of what is published, `None` if the key is not one of these.
pub(crate) fn parse_topic(key: &str) -> Option<(ClientName, LiveTopic)> {
    let (client, last) = parse_of_client(key)?;
    let topic = LiveTopic::ALL.into_iter().find(|topic| topic.as_str() == last)?;
    Some((client, topic))
}

/// Reads client and last part from a key that belongs to a client.
fn parse_of_client(key: &str) -> Option<(ClientName, &str)> {
    let rest = key.strip_prefix(LIVE_ROOT)?.strip_prefix('/')?;
    let [_, client, last] = rest.split('/').collect::<Vec<_>>()[..] else { return None };
    Some((ClientName::new(client).ok()?, last))
}

/// Checks that a client may be called so.
pub(crate) fn check_name(client: &ClientName) -> Result<()> {
    if client.as_str() == ALIVE { Err(Error::ReservedName(client.clone())) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::expr;

    #[test]
    fn keys_read_as_documented_and_can_be_read_back() {
        let service = ServiceName::new("notifier").unwrap();
        let client = ClientName::new("car-1").unwrap();
        let start = Incarnation(255);
        for (key, text) in [
            (LiveKey::Service(&service, start), "alive/00000000000000ff"),
            (LiveKey::Client(&service, &client, start), "car-1/alive/00000000000000ff"),
            (LiveKey::Open(&service, &client), "car-1/open"),
            (LiveTopic::Observations.key(&service, &client), "car-1/obs"),
            (LiveTopic::Say.key(&service, &client), "car-1/say"),
            (LiveTopic::Heard.key(&service, &client), "car-1/heard"),
            (LiveTopic::Status.key(&service, &client), "car-1/status"),
            (LiveTopic::Taken.key(&service, &client), "car-1/taken"),
            (LiveKey::Session(&service, &client), "car-1/session"),
        ] {
            let key = expr(key);
            assert_eq!(key.as_str(), format!("leadtime/live/1/notifier/{text}"));
            let alive = text.contains("alive").then(|| LiveAlive {
                service: service.clone(),
                client: text.contains("car-1").then(|| client.clone()),
                incarnation: start,
            });
            assert_eq!(parse_alive(&key), alive);
            assert_eq!(parse_open(&key), text.contains("open").then(|| client.clone()));
            assert_eq!(parse_session(&key), text.contains("session").then(|| client.clone()));
            let topic = LiveTopic::ALL.into_iter().find(|topic| text.ends_with(topic.as_str()));
            assert_eq!(parse_topic(&key), topic.map(|topic| (client.clone(), topic)));
            if let Some(topic) = topic {
                assert!(expr(LiveKey::Any(&service, topic)).includes(&key));
            }
        }
        let starts = expr(LiveKey::Starts(&service));
        assert!(starts.includes(&expr(LiveKey::Service(&service, start))));
        assert!(expr(LiveKey::Services).includes(&starts));
        let own = expr(LiveKey::Client(&service, &client, start));
        assert!(expr(LiveKey::Clients(&service)).includes(&own));
        assert!(!expr(LiveKey::Services).includes(&own));
        assert!(expr(LiveKey::Opens(&service)).includes(&expr(LiveKey::Open(&service, &client))));
        assert!(expr(LiveKey::Opens(&service)).includes(&expr(LiveKey::Life(&service))));
        for key in ["", "leadtime/1/a/alive/00000000000000ff", "leadtime/live/1/a/alive/ff"] {
            assert_eq!(parse_alive(key), None, "{key}");
        }
        check_name(&client).unwrap();
        check_name(&ClientName::new("alive").unwrap()).unwrap_err();
    }
}
