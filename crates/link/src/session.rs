//! Opening and closing a session: who listens, who dials, what may arrive.
//!
//! No multicast, no gossip, no shared memory: a session talks to the addresses it was given and to nobody else.

use std::io;
use std::time::{Duration, Instant};

use leadtime_certs::Identity;
use leadtime_proto::phrase::duration;
use leadtime_proto::{RegionName, limits};
use tracing::{debug, info};
use zenoh::Wait as _;
use zenoh::config::Config;
use zenoh::session::Session;

use crate::diagnose::diagnose;
use crate::error::NetworkFault;
use crate::keys::Keys;
use crate::{AccessList, Endpoint, Error, Result, access, security};

/// After this silence a peer counts as gone (frozen host, cut cable); a killed process is noticed at once.
const LEASE_MS: u64 = 2_000;
/// How long an actor's rollout may wait for a stalled learner before the connection is given up, in microseconds.
pub(crate) const ACTOR_WAIT_BEFORE_CLOSE_US: u64 = 60_000_000;
/// The same for a learner, which must not wait long for one actor, in microseconds.
pub(crate) const LEARNER_WAIT_BEFORE_CLOSE_US: u64 = 5_000_000;
/// Messages that may wait for a link in each of [`QUICK`] (the most there can be; 2 by default). Where there is no room for a
/// thousandth of a second they are dropped, and on a busy machine the thread that sends them waits longer than that: an actor that
/// misses an announcement stands still until it is repeated, and a recorder is sent several messages for each step. Room is made when
/// a message first needs it, 64 KiB each, and kept: a short message uses a page of that.
const QUICK_BATCHES: usize = 16;
/// The priorities of messages that are sent at once and dropped rather than waited for: speech, announcements, credit.
const QUICK: [&str; 3] = ["real_time", "interactive_high", "interactive_low"];
/// The same for rollouts of a process that dials. While one waits for room the library ends no connection, not even one that is cut,
/// for as long as [`ACTOR_WAIT_BEFORE_CLOSE_US`]. So there is room for what an actor has under way.
const BULK: (&str, usize) = ("transport/link/tx/queue/size/data", QUICK_BATCHES);
/// The largest message that a learner or a router takes: twice the largest rollout, so that what is a little too large is refused and
/// counted by us.
const MAX_BYTES: usize = 2 * limits::MAX_ROLLOUT_BYTES;
/// Room over the largest message for keys and headers.
const MESSAGE_SLACK: usize = 64 << 10;
/// The first pause between attempts to connect.
const MIN_RETRY_MS: u64 = 100;
/// The longest pause between them.
const MAX_RETRY_MS: u64 = 1_000;
/// Longest single round of attempts; after the first that fails, the log says that nobody answers.
const ROUND: Duration = Duration::from_secs(2);
/// Connections that may be opening at once: a peer that connects and says nothing must not keep out those who do.
pub(crate) const ACCEPT_PENDING: usize = 1_000;
/// How long each of them may take.
const ACCEPT_TIMEOUT_MS: u64 = 4_000;
/// Pipes, of two files each, that can be opened before a session is: the library opens 14 files and one for each connection, and a
/// process that has a connection has files of its own to write.
const SPARE_PIPES: usize = 12;
/// Longest time that closing may take.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// How a learner is reached.
#[derive(Clone, Debug)]
pub struct ListenSettings {
    /// Addresses to listen on; port 0 takes a free one. Empty if the learner only connects to a router.
    pub endpoints: Vec<Endpoint>,
    /// Routers to connect to. Default: none.
    pub connect: Vec<Endpoint>,
    /// How long to try to reach a router that the learner depends on. Default: 30 s.
    pub timeout: Duration,
    /// The certificate of this process; with one, everything is encrypted and everybody has to show theirs. Default: none.
    pub identity: Option<Identity>,
    /// Who may do what, enforced here. Default: everybody everything, but a learner's rollouts are passed on to nobody.
    pub access: Option<AccessList>,
    /// The most rollouts of one actor that wait in the event queue, at least the run's window. Default: 64.
    pub rollouts_per_actor: usize,
    /// The most actors whose rollouts wait in the event queue at once, at most [`Self::MOST_ACTORS`]. Default:
    /// [`Self::DEFAULT_MAX_ACTORS`].
    pub max_actors: usize,
    /// The most bytes of rollouts that wait in the event queue: one half is shared out among `max_actors` senders, the
    /// other half is shared by the senders that need more. Default: 256 MiB.
    pub max_queued_bytes: usize,
}

impl ListenSettings {
    /// How many actors a learner keeps room for unless it is told otherwise.
    pub const DEFAULT_MAX_ACTORS: u32 = 256;
    /// The most that it can be told: the network library holds a thousand connections, and has threads for so many to end and
    /// open at once.
    pub const MOST_ACTORS: u32 = 1_000;

    /// Listens on these addresses, everything else as documented.
    pub fn new(endpoints: Vec<Endpoint>) -> Self {
        Self {
            endpoints,
            connect: Vec::new(),
            timeout: Duration::from_secs(30),
            identity: None,
            access: None,
            rollouts_per_actor: 64,
            max_actors: Self::DEFAULT_MAX_ACTORS as usize,
            max_queued_bytes: 256 << 20,
        }
    }

    /// Checks addresses and certificate as far as possible without listening. A caller that creates files of its own
    /// calls this first.
    ///
    /// # Errors
    ///
    /// [`Error::NoCertificate`], [`Error::NotEncrypted`], [`Error::TlsTwice`], [`Error::TlsFile`] or [`Error::TlsPath`].
    pub fn check(&self) -> Result<()> {
        let Self { endpoints, connect, identity, .. } = self;
        [endpoints, connect].into_iter().try_for_each(|it| check(it, identity.as_ref()))
    }
}

/// How an actor or an observer finds a learner or a router.
#[derive(Clone, Debug)]
pub struct ConnectSettings {
    /// Addresses to try, in order.
    pub endpoints: Vec<Endpoint>,
    /// How long to try before giving up. Default: 30 s.
    pub timeout: Duration,
    /// The certificate of this process; with one, everything is encrypted. Default: none.
    pub identity: Option<Identity>,
    /// Whose relay is asked for weights before the learner. Default: nobody's.
    pub region: Option<RegionName>,
    /// Who is looked for, as a noun for messages. Default: `learner`.
    pub whom: &'static str,
}

impl ConnectSettings {
    /// Connects to these addresses, everything else as documented.
    pub fn new(endpoints: Vec<Endpoint>) -> Self {
        let timeout = Duration::from_secs(30);
        Self { endpoints, timeout, identity: None, region: None, whom: "learner" }
    }

    /// Checks addresses and certificate as far as that can be done without dialling, as [`ListenSettings::check`].
    ///
    /// # Errors
    ///
    /// Those of [`ListenSettings::check`].
    pub fn check(&self) -> Result<()> {
        check(&self.endpoints, self.identity.as_ref())
    }
}

/// Checks that the files which addresses name can be read, and that addresses and certificate belong together.
fn check(endpoints: &[Endpoint], identity: Option<&Identity>) -> Result<()> {
    endpoints.iter().try_for_each(Endpoint::check_files)?;
    security::check(endpoints, identity)?;
    identity.map_or(Ok(()), |identity| security::settings(identity, false).map(drop))
}

/// Returns addresses as a person reads them.
pub(crate) fn describe(endpoints: &[Endpoint]) -> String {
    let quoted = endpoints.iter().map(|endpoint| format!("`{}`", endpoint.plain()));
    quoted.collect::<Vec<_>>().join(", ")
}

/// Opens a learner's session: listening, or as a client of a router if it has nothing to listen on. Where no list says otherwise, what
/// arrives at the keys `own` is passed on to nobody.
pub(crate) async fn listen(settings: &ListenSettings, own: Keys<'_>) -> Result<Session> {
    if settings.endpoints.is_empty() {
        return dial(&upwards(settings), LEARNER_WAIT_BEFORE_CLOSE_US).await;
    }
    listen_with("peer", settings, MAX_BYTES, Some(own)).await
}

/// Opens the session of a notifier at work, as [`listen`]: it takes small messages only.
pub(crate) async fn listen_live(settings: &ListenSettings) -> Result<Session> {
    if settings.endpoints.is_empty() {
        return dial(&upwards(settings), LEARNER_WAIT_BEFORE_CLOSE_US).await;
    }
    listen_with("peer", settings, limits::MAX_LIVE_BYTES, None).await
}

/// Returns how a process that listens nowhere reaches a router.
pub(crate) fn upwards(settings: &ListenSettings) -> ConnectSettings {
    ConnectSettings {
        timeout: settings.timeout,
        identity: settings.identity.clone(),
        whom: "router",
        ..ConnectSettings::new(settings.connect.clone())
    }
}

/// Returns whether a session has ended, or what listens for others, if it `listens`.
pub(crate) async fn is_dead(session: &Session, listens: bool) -> bool {
    // The library does not report that its listener ended; it only stops listing the address.
    session.is_closed() || listens && session.info().locators().await.is_empty()
}

/// Opens a router's session.
pub(crate) async fn listen_as_router(settings: &ListenSettings) -> Result<Session> {
    listen_with("router", settings, MAX_BYTES, None).await
}

async fn listen_with(
    mode: &str,
    settings: &ListenSettings,
    max_bytes: usize,
    own: Option<Keys<'_>>,
) -> Result<Session> {
    settings.endpoints.iter().try_for_each(Endpoint::check_listen)?;
    settings.check()?;
    let identity = settings.identity.as_ref();
    let all = [&settings.endpoints, &settings.connect];
    let has_socket = security::has_socket(all.into_iter().flatten());
    let mut special = vec![
        ("mode", format!("\"{mode}\"")),
        ("listen/endpoints", json_list(&settings.endpoints)),
        ("connect/endpoints", json_list(&settings.connect)),
        ("transport/unicast/accept_pending", ACCEPT_PENDING.to_string()),
        ("transport/unicast/accept_timeout", ACCEPT_TIMEOUT_MS.to_string()),
        max_message(max_bytes),
        wait_before_close(LEARNER_WAIT_BEFORE_CLOSE_US),
    ];
    if let Some(identity) = identity {
        special.extend(security::settings(identity, has_socket)?);
    }
    if let Some(access) = &settings.access {
        special.push(access.setting(has_socket));
    } else if let Some(own) = own {
        special.push(access::for_us_alone(own));
    }
    open(config(&special)).await?.map_err(|source| not_listening(&settings.endpoints, source))
}

/// Says at which address nobody can listen, and why. The library has no codes, only words: the kernel's for a port, its own for a
/// socket's lock file.
fn not_listening(endpoints: &[Endpoint], source: zenoh::Error) -> Error {
    let text = source.to_string();
    let has = |words: &str| text.contains(words);
    let named = at_fault(endpoints, &text);
    let shown = named.map_or_else(
        || describe(endpoints).trim_matches('`').to_owned(),
        |endpoint| endpoint.plain().to_owned(),
    );
    if has("in use") || has("Unable to acquire lock") {
        return Error::AddressInUse(shown);
    }
    match named.and_then(Endpoint::host) {
        Some(host) if has("Cannot assign requested address") => {
            Error::NotOurAddress(host.to_owned())
        }
        _ => Error::Listen { endpoint: shown, source: NetworkFault(source) },
    }
}

/// Finds the address that the library's words are about; `None` if they name none of several. One may be the beginning of another, so
/// the longest counts.
fn at_fault<'a>(endpoints: &'a [Endpoint], text: &str) -> Option<&'a Endpoint> {
    if let [only] = endpoints {
        return Some(only);
    }
    let named = endpoints.iter().filter(|endpoint| text.contains(endpoint.parts().1));
    named.max_by_key(|endpoint| endpoint.parts().1.len())
}

/// Returns whether somebody is at the other end of a client's session.
pub(crate) async fn has_peer(session: &Session) -> bool {
    let info = session.info();
    info.peers_zid().await.next().is_some() || info.routers_zid().await.next().is_some()
}

/// Opens a client's session in place of another, with a single round of attempts; `wait_us` is how long a message may wait for a
/// stalled peer before the connection is given up.
pub(crate) async fn reconnect(settings: &ConnectSettings, wait_us: u64) -> Result<Session> {
    let opened = open(client(settings, ROUND, wait_us)?).await?;
    opened.map_err(Error::network("connect to", &describe(&settings.endpoints)))
}

/// Returns the configuration of a client that tries to connect for this long.
fn client(settings: &ConnectSettings, round: Duration, wait_us: u64) -> Result<Config> {
    let ConnectSettings { endpoints, identity, .. } = settings;
    let mut special = vec![
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", json_list(endpoints)),
        // 0 would mean a single attempt without a limit of its own.
        ("connect/timeout_ms", round.as_millis().max(1).to_string()),
        ("connect/exit_on_failure", "true".to_owned()),
        max_message(limits::MAX_MESSAGE_BYTES),
        wait_before_close(wait_us),
        (BULK.0, BULK.1.to_string()),
    ];
    if let Some(identity) = identity {
        special.extend(security::settings(identity, security::has_socket(endpoints.iter()))?);
    }
    Ok(config(&special))
}

/// Opens a client's session, trying again with growing pauses until the time-out.
pub(crate) async fn connect(settings: &ConnectSettings) -> Result<Session> {
    dial(settings, ACTOR_WAIT_BEFORE_CLOSE_US).await
}

async fn dial(settings: &ConnectSettings, wait_us: u64) -> Result<Session> {
    let ConnectSettings { endpoints, timeout, identity, whom, .. } = settings;
    let (timeout, identity) = (*timeout, identity.as_ref());
    if endpoints.is_empty() {
        return Err(Error::NoEndpoint);
    }
    settings.check()?;
    let deadline = Instant::now() + timeout;
    let mut reported = false;
    loop {
        let round = deadline.saturating_duration_since(Instant::now()).min(ROUND);
        let source = match open(client(settings, round, wait_us)?).await? {
            Ok(session) => return Ok(session),
            Err(source) => source,
        };
        debug!(%source, "round of attempts to connect failed");
        if Instant::now() >= deadline {
            let obstacles = obstacles(endpoints, identity, whom).await;
            return Err(Error::Unreachable { whom, obstacles, timeout });
        }
        if !reported {
            reported = true;
            let obstacles = obstacles(endpoints, identity, whom).await;
            let timeout = duration(timeout);
            info!("no {whom} can be reached yet, trying for {timeout}: {obstacles}");
        }
    }
}

/// Finds out what is in the way at each address.
async fn obstacles(
    endpoints: &[Endpoint],
    identity: Option<&Identity>,
    whom: &'static str,
) -> String {
    let (endpoints, identity) = (endpoints.to_vec(), identity.cloned());
    let look = move || {
        let identity = identity.as_ref();
        let told = endpoints
            .iter()
            .map(|e| format!("at `{}`, {}", e.plain(), diagnose(e, identity, whom)));
        told.collect::<Vec<_>>().join("; ")
    };
    tokio::task::spawn_blocking(look).await.unwrap_or_default()
}

/// Closes a session within a limited time. What was published and not acknowledged may be lost.
pub(crate) async fn close(session: &Session) -> Result<()> {
    match tokio::time::timeout(CLOSE_TIMEOUT, session.close()).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(source)) => Err(Error::network("close", "session")(source)),
        Err(_) => Err(Error::Close(CLOSE_TIMEOUT)),
    }
}

/// Makes sure that this process may open [`SPARE_PIPES`] more: where the library cannot open a file, it panics.
fn check_files() -> Result<()> {
    let pipes: io::Result<Vec<_>> = (0..SPARE_PIPES).map(|_| io::pipe()).collect();
    pipes.map(drop).map_err(Error::TooFewFiles)
}

/// Opening waits on its thread, so it gets one of its own. Where no thread can be made, the library panics.
async fn open(config: Config) -> Result<zenoh::Result<Session>> {
    check_files()?;
    let opened = tokio::task::spawn_blocking(move || zenoh::open(config).wait()).await;
    opened.map_err(|_panicked| Error::Panicked("open a connection"))
}

fn queue_size(priority: &str) -> String {
    format!("transport/link/tx/queue/size/{priority}")
}

fn max_message(bytes: usize) -> (&'static str, String) {
    ("transport/link/rx/max_message_size", (bytes + MESSAGE_SLACK).to_string())
}

fn wait_before_close(micros: u64) -> (&'static str, String) {
    ("transport/link/tx/queue/congestion_control/block/wait_before_close", micros.to_string())
}

fn config(special: &[(&'static str, String)]) -> Config {
    let retry = format!(
        "{{ period_init_ms: {MIN_RETRY_MS}, period_max_ms: {MAX_RETRY_MS}, period_increase_factor: 2 }}"
    );
    let always = [
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("transport/shared_memory/enabled", "false".to_owned()),
        ("transport/link/tx/lease", LEASE_MS.to_string()),
        ("connect/retry", retry),
    ];
    let mut config = Config::default();
    let mut set = |key: &str, value: &str| {
        config
            .insert_json5(key, value)
            .unwrap_or_else(|error| panic!("setting `{key}` is not known to the network: {error}"));
    };
    for priority in QUICK {
        set(&queue_size(priority), &QUICK_BATCHES.to_string());
    }
    always.iter().chain(special).for_each(|(key, value)| set(key, value));
    config
}

fn json_list(endpoints: &[Endpoint]) -> String {
    // An endpoint holds no quotation mark, backslash or control character, so quotes are all it needs.
    let quoted: Vec<String> = endpoints.iter().map(|endpoint| format!("\"{endpoint}\"")).collect();
    format!("[{}]", quoted.join(","))
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{ActorId, DomainName, RunName};
    use zenoh::key_expr::OwnedKeyExpr;
    use zenoh::qos::{CongestionControl, Priority};

    use super::*;
    use crate::keys::{self, Key};
    use crate::wire;

    #[test]
    fn every_setting_is_one_that_the_network_knows() {
        let endpoint: Endpoint = "tcp/127.0.0.1:0".parse().unwrap();
        let config = config(&[
            ("mode", "\"client\"".to_owned()),
            ("listen/endpoints", json_list(std::slice::from_ref(&endpoint))),
            ("connect/endpoints", json_list(&[endpoint])),
            ("connect/timeout_ms", "1".to_owned()),
            ("connect/exit_on_failure", "true".to_owned()),
            max_message(1),
            wait_before_close(1),
        ]);
        assert!(config.get_json("listen/endpoints").unwrap().contains("127.0.0.1:0"));
    }

    #[test]
    fn the_address_at_fault_is_the_one_that_is_named() {
        let endpoints = ["unixsock-stream//tmp/a", "tcp/127.0.0.1:744", "tcp/127.0.0.1:7447"];
        let endpoints = endpoints.map(|text| text.parse::<Endpoint>().unwrap());
        for at in &endpoints {
            let told = format!("Can not create a new listener bound to {at}: in use");
            assert_eq!(at_fault(&endpoints, &told), Some(at));
        }
        assert_eq!(at_fault(&endpoints, "something else"), None);
        assert_eq!(at_fault(&endpoints[..1], "something else"), Some(&endpoints[0]));
    }

    #[test]
    fn what_is_dropped_rather_than_waited_for_has_room_in_every_session() {
        let name = |priority: Priority| match priority {
            Priority::RealTime => "real_time",
            Priority::InteractiveHigh => "interactive_high",
            Priority::InteractiveLow => "interactive_low",
            other => panic!("{other:?} has a short queue"),
        };
        let config = config(&[]);
        for qos in [wire::SPEECH, wire::NOTICE, wire::CREDIT] {
            assert_eq!(qos.congestion, CongestionControl::Drop);
            let size = config.get_json(&queue_size(name(qos.priority))).unwrap();
            assert_eq!(size, QUICK_BATCHES.to_string());
        }
        // Credit for many actors behind one router cannot take an announcement's place.
        assert_ne!(wire::NOTICE.priority, wire::CREDIT.priority);
    }

    #[test]
    fn rollouts_of_a_process_that_dials_have_room_while_its_connection_is_cut() {
        let settings = ConnectSettings::new(vec!["tcp/127.0.0.1:7447".parse().unwrap()]);
        let config = client(&settings, ROUND, ACTOR_WAIT_BEFORE_CLOSE_US).unwrap();
        assert_eq!(wire::BULK.priority, Priority::Data);
        assert_eq!(config.get_json(BULK.0).unwrap(), BULK.1.to_string());
    }

    #[test]
    fn a_learner_keeps_its_own_rollouts_and_nothing_else() {
        let (one, two) = (RunName::new("one").unwrap(), RunName::new("two").unwrap());
        let (domain, actor) = (DomainName::new("d").unwrap(), ActorId::new("a").unwrap());
        let config = config(&[access::for_us_alone(Keys::RolloutsOf(&one, &domain))]);
        let list = config.get_json("access_control").unwrap();
        let list: serde_json::Value = serde_json::from_str(&list).unwrap();
        assert!(list["enabled"] == true && list["default_permission"] == "allow", "{list}");
        let rules = list["rules"].as_array().unwrap();
        let kept = rules[0]["key_exprs"][0].as_str().unwrap();
        let kept = OwnedKeyExpr::try_from(kept).unwrap();
        assert_eq!((rules.len(), rules[0]["permission"].as_str()), (1, Some("deny")));
        let keeps = |key: Key<'_>| kept.includes(&keys::expr(key));
        assert!(keeps(Key::Rollouts(&one, &domain, &actor)));
        // The learner of another run may be behind a router above this one.
        assert!(!keeps(Key::Rollouts(&two, &domain, &actor)));
        for passed in [Key::Credit(&one, &actor), Key::Announcement(&one, &domain)] {
            assert!(!keeps(passed), "{passed}");
        }
    }
}
