//! Who may do what, by the name in the certificate: the list that a router or a listening learner enforces.
//!
//! Everything that is not on the list is denied. Flows are seen from the process that enforces it: *in* is what a peer
//! sends, *out* what it is sent. Whatever depends on an actor's own name is allowed to that name alone, so that no actor can
//! deliver rollouts, show presence or read credit for another one.
//!
//! ```text
//! actor      in   its presence, orders to it, its rollouts and metrics, its credit; asks hello and weights, hears news
//!            out  the answers to that
//! learner    in   presence of learners; answers hello and weights; orders, credit, news; asks whether another one answers
//!            out  everything that actors send; the answers to that
//! observer   in   looks at presence, metrics, news and weights; asks for history and what the run is
//! recorder   in   as an observer, and rollouts; reads everything of notifiers at work, and asks for their sessions
//! service    in   its presence, that of its clients; answers who asks for a session; says, and takes what is observed; asks
//!                 whether another one answers
//! robot      in   its presence; asks for a session, observes, hears, under its own name alone
//! router     both everything of ours
//! ```
//!
//! The keys come from [`crate::keys`], with placeholders for names, so the list follows the layout.
//!
//! A learner that listens without a list keeps one thing for itself, the rollouts of its run: [`for_us_alone`].

use std::collections::BTreeMap;
use std::fmt;

use leadtime_certs::{PeerName, Role};
use leadtime_proto::{
    ActorId, ClientName, DomainName, Incarnation, RegionName, RunName, ServiceName,
};
use serde_json::{Value, json};
use zenoh::config::Config;

use crate::error::{NetworkFault, without_place};
use crate::keys::{Key, Keys, Member, ROOT};
use crate::live::{LIVE_ROOT, LiveKey, LiveTopic};
use crate::{Error, Result};

/// What the file begins with.
const HEADER: &str = "// Who may do what, by the common name of the certificate. Written by `leadtime certs acl`, which writes it \
                      anew when a certificate\n// is issued or a name is to be taken out; a router or learner reads it when it starts.\n";
/// The setting that holds the list.
const SETTING: &str = "access_control";
/// Every message that a list can name.
const EVERYTHING: &[&str] = &[
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
];

/// The lists that a list consists of.
const PARTS: [&str; 3] = ["rules", "subjects", "policies"];

/// The messages that it takes to find out who is present.
const LOOK: &[&str] = &["liveliness_query", "declare_liveliness_subscriber"];

/// Placeholders, which only become part of keys that are made here: every name of ours has other letters or another place.
const RUN: &str = "0run";
const DOMAIN: &str = "0domain";
const REGION: &str = "0region";
const ACTOR: &str = "0actor";
const SERVICE: &str = "0service";
const CLIENT: &str = "0client";

/// A list of who may do what. A peer that is not on it may do nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessList(Value);

impl AccessList {
    /// Makes the list for these processes; `None` if there are none.
    pub fn of(peers: &[(Role, PeerName)]) -> Option<Self> {
        let mut names: BTreeMap<Role, Vec<&str>> = BTreeMap::new();
        for (role, name) in peers {
            names.entry(*role).or_default().push(name.as_str());
        }
        let mut list = Draft::default();
        for (role, names) in &names {
            let rules = rules_of(*role);
            list.allow(role.as_str(), names, &rules);
            for name in names {
                let subject = format!("{} {name}", role.as_str());
                list.allow(&subject, &[name], &rules_of_one(*role, name));
            }
        }
        (!list.subjects.is_empty()).then(|| Self(list.finish()))
    }

    /// Reads a list as [`AccessList::to_text`] writes it, comments included.
    ///
    /// # Errors
    ///
    /// [`Error::AccessList`] if it is not one, with the line in which that shows.
    pub fn parse(text: &str) -> Result<Self> {
        let bad = |problem: String| Error::AccessList(leadtime_proto::text::sentence(&problem));
        let config = Config::from_json5(text).map_err(|error| bad(with_line(error)))?;
        let list = config.get_json(SETTING).map_err(|error| bad(error.to_string()))?;
        let list: Value = serde_json::from_str(&list).map_err(|error| bad(error.to_string()))?;
        if list["enabled"] != true || list["default_permission"] != "deny" {
            let problem = "`access_control` has to be enabled and to deny what it does not name";
            return Err(bad(problem.to_owned()));
        }
        if let Some(part) = PARTS.into_iter().find(|part| !list[part].is_array()) {
            return Err(bad(format!("`access_control` has no list of `{part}`")));
        }
        Ok(Self(list))
    }

    /// Returns the list as a file, which zenoh's own router reads as well.
    ///
    /// # Panics
    ///
    /// Never: a list is plain data.
    pub fn to_text(&self) -> String {
        let text = serde_json::to_string_pretty(&json!({ SETTING: self.0 }));
        format!("{HEADER}{}\n", text.expect("a list is plain data"))
    }

    /// Returns the list as the network library takes it. A unix socket has no certificates; where one is listened on, every
    /// process that may open its file is let in.
    pub(crate) fn setting(&self, has_socket: bool) -> (&'static str, String) {
        let mut list = self.0.clone();
        if has_socket {
            let mut local = Draft::default();
            local.allow("socket", &[], &[rule("both", EVERYTHING, everywhere())]);
            let mut local = local.finish();
            local["subjects"][0]["link_protocols"] = json!(["unixsock-stream"]);
            for part in PARTS {
                let more = local[part].as_array().cloned().unwrap_or_default();
                if let Some(all) = list[part].as_array_mut() {
                    all.extend(more);
                }
            }
        }
        (SETTING, list.to_string())
    }
}

/// Returns the setting of a session that passes on nothing of what comes at these keys, and lets everybody do everything else.
///
/// Without it, who reads everything is sent every rollout, and one that stops reading holds up the connections on which they arrive.
/// What this session itself subscribes to does not pass here: the network library asks the list about its connections only, and not about
/// its own subscribers. A subject that names nothing is everybody.
pub(crate) fn for_us_alone(keys: Keys<'_>) -> (&'static str, String) {
    const RULE: &str = "what comes here is for this process";
    const SUBJECT: &str = "everybody";
    let list = json!({
        "enabled": true,
        "default_permission": "allow",
        "rules": [{
            "id": RULE,
            "messages": ["put", "delete"],
            "flows": ["egress"],
            "permission": "deny",
            "key_exprs": [keys.to_string()],
        }],
        "subjects": [{ "id": SUBJECT }],
        "policies": [{ "rules": [RULE], "subjects": [SUBJECT] }],
    });
    (SETTING, list.to_string())
}

/// What a subject may send or be sent.
#[derive(Debug)]
struct AccessRule {
    flow: &'static str,
    messages: Vec<&'static str>,
    keys: Vec<String>,
}

fn rule(
    flow: &'static str,
    messages: &[&'static str],
    keys: impl IntoIterator<Item = String>,
) -> AccessRule {
    AccessRule { flow, messages: messages.to_vec(), keys: keys.into_iter().collect() }
}

/// A list in the making.
#[derive(Debug, Default)]
struct Draft {
    rules: Vec<Value>,
    subjects: Vec<Value>,
    policies: Vec<Value>,
}

impl Draft {
    fn allow(&mut self, subject: &str, names: &[&str], rules: &[AccessRule]) {
        if rules.is_empty() {
            return;
        }
        let mut ids = Vec::new();
        for AccessRule { flow, messages, keys } in rules {
            let id = format!("{subject}, {flow}, {}", messages.join(" and "));
            let flows = match *flow {
                "in" => json!(["ingress"]),
                "out" => json!(["egress"]),
                _ => json!(["ingress", "egress"]),
            };
            self.rules.push(json!({
                "id": id,
                "messages": messages,
                "flows": flows,
                "permission": "allow",
                "key_exprs": keys,
            }));
            ids.push(id);
        }
        let mut described = json!({ "id": subject });
        if !names.is_empty() {
            described["cert_common_names"] = json!(names);
        }
        self.subjects.push(described);
        self.policies.push(json!({ "rules": ids, "subjects": [subject] }));
    }

    fn finish(self) -> Value {
        json!({
            "enabled": true,
            "default_permission": "deny",
            "rules": self.rules,
            "subjects": self.subjects,
            "policies": self.policies,
        })
    }
}

/// Every key of the layout with `*` for whatever is not fixed.
#[derive(Debug)]
struct Patterns {
    run: RunName,
    domain: DomainName,
    region: RegionName,
    actor: ActorId,
}

impl Patterns {
    fn new() -> Self {
        let is_name = "placeholders are names";
        Self {
            run: RunName::new(RUN).expect(is_name),
            domain: DomainName::new(DOMAIN).expect(is_name),
            region: RegionName::new(REGION).expect(is_name),
            actor: ActorId::new(ACTOR).expect(is_name),
        }
    }

    fn any(key: Key<'_>) -> String {
        pattern(key, "*")
    }

    fn hello(&self) -> String {
        Self::any(Key::Hello(&self.run))
    }

    fn pulls(&self) -> String {
        Self::any(Key::Weights(&self.run, &self.domain))
    }

    /// What a region's relay is asked, which is a router.
    fn relayed_pulls(&self) -> String {
        Self::any(Key::RelayedWeights(&self.run, &self.region, &self.domain))
    }

    fn news(&self) -> String {
        Self::any(Key::Announcement(&self.run, &self.domain))
    }

    fn learners(&self) -> String {
        let key = Self::any(Key::Alive(&self.run, &Member::Learner, Incarnation::default()));
        // The place of the id is free, as in the subscriptions of actors.
        key.replace("/learner/learner/", "/learner/*/")
    }

    fn members(&self) -> String {
        below(&self.learners(), "alive")
    }

    fn alive(&self, actor: &str) -> String {
        let member = Member::Actor(self.actor.clone());
        pattern(Key::Alive(&self.run, &member, Incarnation::default()), actor)
    }

    fn orders(&self, actor: &str) -> String {
        pattern(Key::Control(&self.run, &self.actor), actor)
    }

    fn rollouts(&self, actor: &str) -> String {
        pattern(Key::Rollouts(&self.run, &self.domain, &self.actor), actor)
    }

    fn credit(&self, actor: &str) -> String {
        pattern(Key::Credit(&self.run, &self.actor), actor)
    }

    fn metrics(&self, actor: &str) -> String {
        pattern(Key::Metrics(&self.run, &Member::Actor(self.actor.clone())), actor)
    }

    fn learner_metrics(&self) -> String {
        self.metrics("*").replace("/metrics/actor/", "/metrics/learner/")
    }

    fn all_metrics(&self) -> String {
        below(&self.metrics("*"), "metrics")
    }

    fn all_rollouts(&self) -> String {
        below(&self.rollouts("*"), "traj")
    }

    /// What observers ask of a learner beside weights.
    fn about() -> [String; 2] {
        ["history", "about"].map(|what| format!("{ROOT}/*/{what}"))
    }
}

/// Writes a key with `own` in the place of the name that the rule is for, and `*` in those of all others.
fn pattern(key: impl fmt::Display, own: &str) -> String {
    let start = Incarnation::default().hex();
    let chunk = |chunk: &str| match chunk {
        ACTOR | CLIENT => own.to_owned(),
        RUN | DOMAIN | REGION | SERVICE => "*".to_owned(),
        text if text == start => "*".to_owned(),
        text => text.to_owned(),
    };
    key.to_string().split('/').map(chunk).collect::<Vec<_>>().join("/")
}

/// Returns everything below one of a run's branches, however a subscriber writes it.
fn below(key: &str, branch: &str) -> String {
    let chunks: Vec<&str> = key.split('/').take_while(|chunk| *chunk != branch).collect();
    format!("{}/{branch}/**", chunks.join("/"))
}

/// Returns every key of ours.
fn everywhere() -> [String; 2] {
    [format!("{ROOT}/**"), format!("{LIVE_ROOT}/**")]
}

/// Every key of a notifier at work with `*` for whatever is not fixed.
#[derive(Debug)]
struct LivePatterns {
    service: ServiceName,
    client: ClientName,
    name: String,
}

impl LivePatterns {
    /// Writes keys with `client` in the client's place.
    fn new(client: &str) -> Self {
        let is_name = "placeholders are names";
        Self {
            service: ServiceName::new(SERVICE).expect(is_name),
            client: ClientName::new(CLIENT).expect(is_name),
            name: client.to_owned(),
        }
    }

    fn of(&self, key: LiveKey<'_>) -> String {
        pattern(key, &self.name)
    }

    fn notifiers(&self) -> String {
        self.of(LiveKey::Service(&self.service, Incarnation::default()))
    }

    fn presence(&self) -> String {
        self.of(LiveKey::Client(&self.service, &self.client, Incarnation::default()))
    }

    fn open(&self) -> String {
        self.of(LiveKey::Open(&self.service, &self.client))
    }

    /// Where a notifier asks whether another one of its name answers.
    fn life(&self) -> String {
        self.of(LiveKey::Life(&self.service))
    }

    /// What a client sends.
    fn sent(&self) -> [String; 2] {
        let (service, client) = (&self.service, &self.client);
        [LiveTopic::Observations, LiveTopic::Heard].map(|it| self.of(it.key(service, client)))
    }

    /// What only recorders receive.
    fn taken(&self) -> String {
        self.of(LiveTopic::Taken.key(&self.service, &self.client))
    }

    /// Where recorders ask.
    fn session(&self) -> String {
        self.of(LiveKey::Session(&self.service, &self.client))
    }

    /// Everything that is published about a client.
    fn published(&self) -> impl Iterator<Item = String> {
        self.sent().into_iter().chain(self.told()).chain([self.taken()])
    }

    /// What a client is sent.
    fn told(&self) -> [String; 2] {
        let (service, client) = (&self.service, &self.client);
        [LiveTopic::Say, LiveTopic::Status].map(|it| self.of(it.key(service, client)))
    }
}

/// Returns what a notifier at work may do.
fn service() -> Vec<AccessRule> {
    let keys = LivePatterns::new("*");
    let presence = || [keys.notifiers(), keys.presence()];
    vec![
        rule("in", &["liveliness_token"], [keys.notifiers()]),
        rule("in", LOOK, presence()),
        rule("in", &["declare_queryable", "reply"], [keys.open(), keys.session()]),
        rule("in", &["query"], [keys.life()]),
        rule("in", &["put"], keys.told().into_iter().chain([keys.taken()])),
        rule("in", &["declare_subscriber"], keys.sent()),
        rule("out", &["liveliness_token"], presence()),
        rule("out", &["query"], [keys.open(), keys.session()]),
        rule("out", &["reply"], [keys.life()]),
        rule("out", &["declare_queryable"], [keys.open()]),
        rule("out", &["put"], keys.sent()),
        rule("out", &["declare_subscriber"], keys.published()),
    ]
}

/// Returns what a robot may do under its own name.
fn rules_of_one_robot(name: &str) -> Vec<AccessRule> {
    let keys = LivePatterns::new(name);
    // A notifier declares one place for the questions of all clients.
    let places = LivePatterns::new("*").open();
    vec![
        rule("in", &["liveliness_token"], [keys.presence()]),
        rule("in", LOOK, [keys.notifiers()]),
        rule("in", &["query"], [keys.open()]),
        rule("in", &["put"], keys.sent()),
        rule("in", &["declare_subscriber"], keys.told()),
        rule("out", &["liveliness_token"], [keys.notifiers()]),
        rule("out", &["declare_queryable"], [places]),
        rule("out", &["reply"], [keys.open()]),
        rule("out", &["put"], keys.told()),
        rule("out", &["declare_subscriber"], keys.sent()),
    ]
}

/// Returns what is wrong with a list, and in which line where the network library's reader knows it.
fn with_line(error: zenoh::Error) -> String {
    let Some(json5::Error::Message { msg, location: Some(place) }) = error.downcast_ref() else {
        return NetworkFault(error).to_string();
    };
    // About text that is no JSON5 it draws the place; what it expected there is in the last line.
    let said = msg.lines().last().unwrap_or_default().trim_start_matches([' ', '=']);
    format!("line {}: {}", place.line, without_place(said))
}

/// Returns what everybody of a role may do.
fn rules_of(role: Role) -> Vec<AccessRule> {
    let keys = Patterns::new();
    let [history, about] = Patterns::about();
    let serve: &[&str] = &["declare_queryable", "reply"];
    match role {
        Role::Router => vec![rule("both", EVERYTHING, everywhere())],
        Role::Learner => vec![
            rule("in", &["liveliness_token"], [keys.learners()]),
            rule("in", LOOK, [keys.members()]),
            rule("in", serve, [keys.hello(), keys.pulls(), history.clone(), about.clone()]),
            rule("in", &["query"], [keys.orders("*"), keys.pulls()]),
            rule("in", &["put"], [keys.credit("*"), keys.news(), keys.learner_metrics()]),
            rule("in", &["declare_subscriber"], [keys.all_rollouts(), keys.all_metrics()]),
            rule("out", &["put"], [keys.all_rollouts(), keys.all_metrics()]),
            rule("out", &["query"], [keys.hello(), keys.pulls(), history, about]),
            rule("out", &["reply", "declare_queryable"], [keys.orders("*"), keys.pulls()]),
            rule("out", &["liveliness_token"], [keys.members()]),
            rule(
                "out",
                &["declare_subscriber"],
                [keys.credit("*"), keys.news(), keys.all_metrics()],
            ),
        ],
        Role::Actor => vec![
            rule("in", LOOK, [keys.learners()]),
            rule("in", &["query"], [keys.hello(), keys.pulls(), keys.relayed_pulls()]),
            rule("in", &["declare_subscriber"], [keys.news()]),
            rule("out", &["put"], [keys.news()]),
            rule(
                "out",
                &["reply", "declare_queryable"],
                [keys.hello(), keys.pulls(), keys.relayed_pulls()],
            ),
            rule("out", &["liveliness_token"], [keys.learners()]),
            rule("out", &["declare_subscriber"], [keys.all_rollouts(), keys.all_metrics()]),
        ],
        Role::Observer => observer(&keys, false),
        Role::Recorder => observer(&keys, true),
        Role::Service => service(),
        // What a robot may do, it may do under its own name.
        Role::Robot => Vec::new(),
    }
}

fn observer(keys: &Patterns, is_recorder: bool) -> Vec<AccessRule> {
    let [history, about] = Patterns::about();
    let live = is_recorder.then(|| LivePatterns::new("*"));
    let told = || {
        let of_recorder = live.iter().flat_map(|it| it.published().chain([keys.all_rollouts()]));
        [keys.all_metrics(), keys.news()].into_iter().chain(of_recorder)
    };
    let asked = || {
        let of_run = [keys.pulls(), history.clone(), about.clone()];
        of_run.into_iter().chain(live.iter().map(LivePatterns::session))
    };
    let seen = || [keys.members()].into_iter().chain(live.iter().map(LivePatterns::notifiers));
    vec![
        rule("in", LOOK, seen()),
        rule("in", &["query"], asked()),
        rule("in", &["declare_subscriber"], told()),
        rule("out", &["put"], told()),
        rule("out", &["reply", "declare_queryable"], asked()),
        rule("out", &["liveliness_token"], seen()),
    ]
}

/// Returns what a process of a role may do under its own name; most may do nothing but what everybody of their role may.
fn rules_of_one(role: Role, name: &str) -> Vec<AccessRule> {
    match role {
        Role::Actor => rules_of_one_actor(name),
        Role::Robot => rules_of_one_robot(name),
        _ => Vec::new(),
    }
}

/// Returns what an actor may do under its own name.
fn rules_of_one_actor(name: &str) -> Vec<AccessRule> {
    let keys = Patterns::new();
    vec![
        rule("in", &["liveliness_token"], [keys.alive(name)]),
        rule("in", &["declare_queryable", "reply"], [keys.orders(name)]),
        rule("in", &["put"], [keys.rollouts(name), keys.metrics(name)]),
        rule("in", &["declare_subscriber"], [keys.credit(name)]),
        rule("out", &["put"], [keys.credit(name)]),
        rule("out", &["query"], [keys.orders(name)]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(peers: &[(Role, &str)]) -> AccessList {
        let peers: Vec<_> =
            peers.iter().map(|(role, name)| (*role, name.parse().unwrap())).collect();
        AccessList::of(&peers).unwrap()
    }

    #[test]
    fn the_keys_are_those_of_the_layout() {
        let keys = Patterns::new();
        let made = [
            keys.hello(),
            keys.pulls(),
            keys.relayed_pulls(),
            keys.news(),
            keys.learners(),
            keys.members(),
            keys.alive("a7"),
            keys.orders("a7"),
            keys.rollouts("a7"),
            keys.credit("a7"),
            keys.metrics("a7"),
            keys.learner_metrics(),
            keys.all_metrics(),
            keys.all_rollouts(),
        ];
        let expected = [
            "ctl/hello",
            "weights/*/latest",
            "region/*/weights/*/latest",
            "weights/*",
            "alive/learner/*/*",
            "alive/**",
            "alive/actor/a7/*",
            "ctl/actor/a7",
            "traj/*/a7",
            "credit/a7",
            "metrics/actor/a7",
            "metrics/learner/*",
            "metrics/**",
            "traj/**",
        ];
        assert_eq!(made, expected.map(|key| format!("leadtime/1/*/{key}")));
    }

    #[test]
    fn a_list_is_read_as_it_is_written_and_an_unknown_message_is_refused() {
        let written = list(&[
            (Role::Router, "r1"),
            (Role::Learner, "l1"),
            (Role::Actor, "a7"),
            (Role::Actor, "a8"),
            (Role::Observer, "o1"),
            (Role::Recorder, "w1"),
            (Role::Service, "s1"),
            (Role::Robot, "m1"),
        ]);
        let text = written.to_text();
        let read = AccessList::parse(&text).unwrap();
        assert_eq!(read.0["rules"].as_array().unwrap().len(), 65);
        assert_eq!(AccessList::parse(&read.to_text()).unwrap(), read);
        let before = &text[..text.find("\"query\"").unwrap()];
        let line = format!("line {}: unknown variant `ask`", before.lines().count());
        let error = AccessList::parse(&text.replace("\"query\"", "\"ask\"")).unwrap_err();
        assert!(error.to_string().contains(&line), "{error}");
        let torn = AccessList::parse("{\n  access_control: {\n    enabled: }\n}").unwrap_err();
        let torn = torn.to_string();
        assert!(torn.contains("line 3: expected ") && !torn.contains('^'), "{torn}");
        let open = text.replace("\"deny\"", "\"allow\"");
        AccessList::parse(&open).unwrap_err();
        AccessList::parse("{}").unwrap_err();
        let said = |text: &str| AccessList::parse(text).unwrap_err().to_string();
        let key = said(&text.replacen("leadtime/", "leadtime//", 1));
        assert!(key.contains("Invalid Key Expr") && !key.contains(".rs"), "{key}");
        let lacking = said(r#"{access_control: {enabled: true, default_permission: "deny"}}"#);
        assert!(lacking.contains("has no list of `rules`"), "{lacking}");
        assert_eq!(AccessList::of(&[]), None, "nothing to allow");
    }

    #[test]
    fn the_keys_of_a_notifier_at_work_are_those_of_its_layout() {
        let keys = LivePatterns::new("m1");
        let [observations, heard] = keys.sent();
        let [say, status] = keys.told();
        let made = [
            keys.notifiers(),
            keys.presence(),
            keys.open(),
            keys.life(),
            observations,
            heard,
            say,
            status,
        ];
        let expected = [
            "alive/*",
            "m1/alive/*",
            "m1/open",
            "alive/open",
            "m1/obs",
            "m1/heard",
            "m1/say",
            "m1/status",
        ];
        assert_eq!(made, expected.map(|key| format!("leadtime/live/1/*/{key}")));
    }

    #[test]
    fn a_robot_gets_nothing_under_another_name() {
        let list = list(&[(Role::Robot, "m1"), (Role::Robot, "m2"), (Role::Service, "s1")]);
        let rules = list.0["rules"].as_array().unwrap().clone();
        let own = |rule: &&Value| rule["id"].as_str().unwrap().starts_with("robot m1");
        let keys = rules.iter().filter(own).flat_map(|rule| rule["key_exprs"].as_array().unwrap());
        let keys: Vec<&str> = keys.filter_map(Value::as_str).collect();
        let foreign = ["leadtime/live/1/*/alive/*", "leadtime/live/1/*/*/open"];
        assert!(keys.iter().all(|key| key.contains("/m1/") || foreign.contains(key)), "{keys:?}");
        assert!(keys.len() > foreign.len());
    }

    #[test]
    fn an_actor_gets_nothing_under_another_name() {
        let list = list(&[(Role::Actor, "a7"), (Role::Actor, "0actor")]);
        let rules = list.0["rules"].as_array().unwrap().clone();
        let own = |rule: &&Value| rule["id"].as_str().unwrap().starts_with("actor a7");
        let keys = rules.iter().filter(own).flat_map(|rule| rule["key_exprs"].as_array().unwrap());
        assert!(keys.clone().count() > 0);
        assert!(keys.clone().all(|key| key.as_str().unwrap().contains("a7")));
        let odd = |rule: &&Value| rule["id"].as_str().unwrap().starts_with("actor 0actor");
        let keys = rules.iter().filter(odd).flat_map(|rule| rule["key_exprs"].as_array().unwrap());
        assert!(keys.clone().all(|key| key.as_str().unwrap().contains("0actor")), "no wildcard");
    }
}
