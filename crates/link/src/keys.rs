//! Every key on the network, declared once and built from checked names.
//!
//! ```text
//! leadtime/1/{run}/alive/{role}/{id}/{incarnation}   presence; incarnation as 16 hexadecimal digits
//! leadtime/1/{run}/ctl/hello                         query to the learner
//! leadtime/1/{run}/ctl/actor/{id}                    query to one actor
//! leadtime/1/{run}/traj/{domain}/{id}                rollouts
//! leadtime/1/{run}/credit/{id}                       acknowledgement and window
//! leadtime/1/{run}/weights/{domain}                  announcements
//! leadtime/1/{run}/weights/{domain}/latest           query for weights, `?version=N;sha256=HEX`
//! leadtime/1/{run}/region/{region}/weights/{domain}/latest   the same query to the relay of a region
//! leadtime/1/{run}/metrics/{role}/{id}               metrics
//! leadtime/1/{run}/about                             query: what the run is
//! leadtime/1/{run}/history                           query: its updates so far, `?from=U;points=N`
//! ```
//!
//! The `1` is the layout of the keys; the version of the messages is in their headers. The learner's `{id}` is
//! `learner`.

use std::fmt;

use leadtime_proto::{ActorId, DomainName, Incarnation, RegionName, RunName};
use zenoh::key_expr::OwnedKeyExpr;

/// The parameter of an order that says for which start of the actor it is meant.
pub(crate) const INCARNATION: &str = "incarnation";
/// The parameter of a pull that says which version is wanted.
pub(crate) const VERSION: &str = "version";
/// The parameter of a pull that says which digest the weights have, as 64 hexadecimal digits: a relay knows them by it.
pub(crate) const SHA256: &str = "sha256";
/// The parameter of a question about a run's history that says from which update on.
pub(crate) const FROM: &str = "from";
/// The parameter of such a question that says how many points the answer may have.
pub(crate) const POINTS: &str = "points";

/// What every key of ours begins with.
pub(crate) const ROOT: &str = "leadtime/1";
const LEARNER: &str = "learner";
const ACTOR: &str = "actor";

/// Who takes part in a run.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Member {
    /// The learner, of which a run has one.
    Learner,
    /// One of the actors, by name.
    Actor(ActorId),
}

impl Member {
    fn parse(role: &str, id: &str) -> Option<Self> {
        match role {
            LEARNER if id == LEARNER => Some(Self::Learner),
            ACTOR => ActorId::new(id).ok().map(Self::Actor),
            _ => None,
        }
    }
}

impl fmt::Display for Member {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Learner => write!(f, "{LEARNER}/{LEARNER}"),
            Self::Actor(id) => write!(f, "{ACTOR}/{id}"),
        }
    }
}

/// A key of a run, as its parts; displayed it is the text that the network knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key<'a> {
    /// Presence of one start of a member.
    Alive(&'a RunName, &'a Member, Incarnation),
    /// Where actors say hello.
    Hello(&'a RunName),
    /// Where an actor takes orders.
    Control(&'a RunName, &'a ActorId),
    /// Where an actor publishes its rollouts.
    Rollouts(&'a RunName, &'a DomainName, &'a ActorId),
    /// Where the learner tells an actor its credit.
    Credit(&'a RunName, &'a ActorId),
    /// Where the learner announces versions of the weights.
    Announcement(&'a RunName, &'a DomainName),
    /// Where weights are pulled.
    Weights(&'a RunName, &'a DomainName),
    /// Where they are pulled from the relay of a region.
    RelayedWeights(&'a RunName, &'a RegionName, &'a DomainName),
    /// Where a member publishes its metrics.
    Metrics(&'a RunName, &'a Member),
    /// Where observers ask what a run is.
    About(&'a RunName),
    /// Where observers ask for the history of a run.
    History(&'a RunName),
}

impl fmt::Display for Key<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Alive(run, member, Incarnation(start)) => {
                write!(f, "{ROOT}/{run}/alive/{member}/{start:016x}")
            }
            Self::Hello(run) => write!(f, "{ROOT}/{run}/ctl/hello"),
            Self::Control(run, actor) => write!(f, "{ROOT}/{run}/ctl/actor/{actor}"),
            Self::Rollouts(run, domain, actor) => write!(f, "{ROOT}/{run}/traj/{domain}/{actor}"),
            Self::Credit(run, actor) => write!(f, "{ROOT}/{run}/credit/{actor}"),
            Self::Announcement(run, domain) => write!(f, "{ROOT}/{run}/weights/{domain}"),
            Self::Weights(run, domain) => write!(f, "{ROOT}/{run}/weights/{domain}/latest"),
            Self::RelayedWeights(run, region, domain) => {
                write!(f, "{ROOT}/{run}/region/{region}/weights/{domain}/latest")
            }
            Self::Metrics(run, member) => write!(f, "{ROOT}/{run}/metrics/{member}"),
            Self::About(run) => write!(f, "{ROOT}/{run}/about"),
            Self::History(run) => write!(f, "{ROOT}/{run}/history"),
        }
    }
}

/// A set of keys that one subscription covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keys<'a> {
    /// The learner of every run.
    Learners,
    /// The learner of a run.
    LearnerOf(&'a RunName),
    /// Actors of a run.
    ActorsOf(&'a RunName),
    /// Everyone in a run.
    MembersOf(&'a RunName),
    /// Rollouts of all actors.
    RolloutsOf(&'a RunName, &'a DomainName),
    /// Announcements of all domains.
    AnnouncementsOf(&'a RunName),
    /// Where the weights of every domain of a run are pulled.
    PullsOf(&'a RunName),
    /// Where a region's relay is asked for weights, for every run and domain.
    PullsIn(&'a RegionName),
    /// The metrics of every member of a run.
    MetricsOf(&'a RunName),
}

impl fmt::Display for Keys<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Learners => write!(f, "{ROOT}/*/alive/{LEARNER}/*/*"),
            Self::LearnerOf(run) => write!(f, "{ROOT}/{run}/alive/{LEARNER}/*/*"),
            Self::ActorsOf(run) => write!(f, "{ROOT}/{run}/alive/{ACTOR}/*/*"),
            Self::MembersOf(run) => write!(f, "{ROOT}/{run}/alive/*/*/*"),
            Self::RolloutsOf(run, domain) => write!(f, "{ROOT}/{run}/traj/{domain}/*"),
            Self::AnnouncementsOf(run) => write!(f, "{ROOT}/{run}/weights/*"),
            Self::PullsOf(run) => write!(f, "{ROOT}/{run}/weights/*/latest"),
            Self::PullsIn(region) => write!(f, "{ROOT}/*/region/{region}/weights/*/latest"),
            Self::MetricsOf(run) => write!(f, "{ROOT}/{run}/metrics/*/*"),
        }
    }
}

/// Who is alive in which run, as read from a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alive {
    /// The run that the member takes part in.
    pub run: RunName,
    /// The learner, or which actor.
    pub member: Member,
    /// Which start of the member is alive.
    pub incarnation: Incarnation,
}

/// Reads a key of presence, `None` if the key is not one of these.
pub fn parse_alive(key: &str) -> Option<Alive> {
    let [run, "alive", role, id, digits] = chunks(key)[..] else { return None };
    let (run, member) = (RunName::new(run).ok()?, Member::parse(role, id)?);
    Some(Alive { run, member, incarnation: Incarnation::from_hex(digits)? })
}

/// Reads the sender from a key of rollouts, `None` if the key is not one of these.
pub fn parse_rollouts(key: &str) -> Option<ActorId> {
    let [_, "traj", _, actor] = chunks(key)[..] else { return None };
    ActorId::new(actor).ok()
}

/// Reads the sender from a key of metrics, `None` if the key is not one of these.
pub fn parse_metrics(key: &str) -> Option<Member> {
    let [_, "metrics", role, id] = chunks(key)[..] else { return None };
    Member::parse(role, id)
}

/// Reads the domain from a key of announcements, `None` if the key is not one of these.
pub fn parse_announcement(key: &str) -> Option<DomainName> {
    let [_, "weights", domain] = chunks(key)[..] else { return None };
    DomainName::new(domain).ok()
}

/// Reads run and domain from a key at which a relay is asked for weights, `None` if the key is not one of these.
pub(crate) fn parse_relayed(key: &str) -> Option<(RunName, DomainName)> {
    let [run, "region", _, "weights", domain, "latest"] = chunks(key)[..] else { return None };
    Some((RunName::new(run).ok()?, DomainName::new(domain).ok()?))
}

/// Splits what follows the root, the run's name first.
fn chunks(key: &str) -> Vec<&str> {
    let rest = key.strip_prefix(ROOT).and_then(|rest| rest.strip_prefix('/'));
    rest.map_or_else(Vec::new, |rest| rest.split('/').collect())
}

/// Makes a key what the network takes; names are checked, so this cannot fail.
pub(crate) fn expr(key: impl fmt::Display) -> OwnedKeyExpr {
    OwnedKeyExpr::try_from(key.to_string())
        .expect("keys of checked names are valid key expressions")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> (RunName, DomainName, ActorId, Member) {
        let actor = ActorId::new("a7").unwrap();
        let domain = DomainName::new("cue_recall").unwrap();
        (RunName::new("lander-1").unwrap(), domain, actor.clone(), Member::Actor(actor))
    }

    #[test]
    fn keys_read_as_documented_and_can_be_read_back() {
        let (run, domain, actor, member) = names();
        let region = RegionName::new("eu").unwrap();
        for (key, text) in [
            (Key::Alive(&run, &member, Incarnation(255)), "alive/actor/a7/00000000000000ff"),
            (
                Key::Alive(&run, &Member::Learner, Incarnation(1)),
                "alive/learner/learner/0000000000000001",
            ),
            (Key::Hello(&run), "ctl/hello"),
            (Key::Control(&run, &actor), "ctl/actor/a7"),
            (Key::Rollouts(&run, &domain, &actor), "traj/cue_recall/a7"),
            (Key::Credit(&run, &actor), "credit/a7"),
            (Key::Announcement(&run, &domain), "weights/cue_recall"),
            (Key::Weights(&run, &domain), "weights/cue_recall/latest"),
            (Key::RelayedWeights(&run, &region, &domain), "region/eu/weights/cue_recall/latest"),
            (Key::Metrics(&run, &member), "metrics/actor/a7"),
            (Key::About(&run), "about"),
            (Key::History(&run), "history"),
        ] {
            let key = expr(key);
            assert_eq!(key.as_str(), format!("leadtime/1/lander-1/{text}"));
            let sender = text.starts_with("traj").then(|| actor.clone());
            assert_eq!(parse_rollouts(&key), sender);
            assert_eq!(parse_metrics(&key), text.starts_with("metrics").then(|| member.clone()));
            let is_relayed = text.starts_with("region");
            assert_eq!(parse_relayed(&key), is_relayed.then(|| (run.clone(), domain.clone())));
            assert_eq!(expr(Keys::PullsIn(&region)).includes(&key), is_relayed);
            let is_announcement = text == "weights/cue_recall";
            assert_eq!(parse_announcement(&key), is_announcement.then(|| domain.clone()));
        }
        let incarnation = Incarnation(u64::MAX);
        let alive = parse_alive(&Key::Alive(&run, &member, incarnation).to_string());
        assert_eq!(alive, Some(Alive { run, member, incarnation }));
    }

    #[test]
    fn foreign_keys_are_not_read() {
        for key in [
            "",
            "leadtime/1",
            "leadtime/2/r/alive/actor/a/0000000000000001",
            "leadtime/1/r/alive/actor/a/1",
            "leadtime/1/r/alive/actor/A/0000000000000001",
            "leadtime/1/r/alive/learner/other/0000000000000001",
            "leadtime/1/r/alive/actor/a/0000000000000001/x",
        ] {
            assert_eq!(parse_alive(key), None, "{key}");
        }
        assert_eq!(parse_rollouts("leadtime/1/r/traj/lander/A"), None);
        assert_eq!(parse_rollouts("leadtime/1/r/traj/lander/a/b"), None);
    }

    #[test]
    fn subscriptions_cover_their_keys() {
        let (run, domain, actor, member) = names();
        let alive = expr(Key::Alive(&run, &member, Incarnation(3)));
        assert!(expr(Keys::ActorsOf(&run)).includes(&alive));
        assert!(expr(Keys::MembersOf(&run)).includes(&alive));
        assert!(!expr(Keys::LearnerOf(&run)).includes(&alive));
        let learner = expr(Key::Alive(&run, &Member::Learner, Incarnation(3)));
        assert!(expr(Keys::Learners).includes(&learner));
        assert!(expr(Keys::LearnerOf(&run)).includes(&learner));
        let rollouts = expr(Key::Rollouts(&run, &domain, &actor));
        assert!(expr(Keys::RolloutsOf(&run, &domain)).includes(&rollouts));
        // A subscription to announcements must not answer for the queryable beside it.
        assert!(!expr(Keys::AnnouncementsOf(&run)).includes(&expr(Key::Weights(&run, &domain))));
        assert!(expr(Keys::MetricsOf(&run)).includes(&expr(Key::Metrics(&run, &member))));
    }
}
