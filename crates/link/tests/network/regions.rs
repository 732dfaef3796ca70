//! Regions: a router pulls each version once for all of its actors, and nobody depends on it.

use std::time::Duration;

use leadtime_link::{
    ActorLink, ConnectSettings, Endpoint, LearnerEvent, LearnerLink, ListenSettings, RelayCounts,
    RouterLink,
};
use leadtime_proto::{PolicyVersion, RegionName};

use crate::support::*;

const VERSIONS: u64 = 5;

fn region(name: &str) -> RegionName {
    RegionName::new(name).unwrap()
}

async fn router(above: Option<&Endpoint>) -> (RouterLink, Endpoint) {
    let any = "tcp/127.0.0.1:0".parse().unwrap();
    let settings = ListenSettings {
        connect: above.into_iter().cloned().collect(),
        ..ListenSettings::new(vec![any])
    };
    let router = RouterLink::open(&settings).await.unwrap();
    let endpoint = router.locators()[0].parse().unwrap();
    (router, endpoint)
}

async fn actor(
    id: &str,
    at: &Endpoint,
    name: &str,
    events: &flume::Receiver<LearnerEvent>,
) -> ActorLink {
    let settings = ConnectSettings {
        timeout: SOON,
        region: Some(region(name)),
        ..ConnectSettings::new(vec![at.clone()])
    };
    let (actor, _events) = ActorLink::open(&settings, &actor_id(id), &start(id)).await.unwrap();
    say_hello(&actor, id, events).await;
    actor
}

#[tokio::test(flavor = "multi_thread")]
async fn each_version_is_pulled_once_for_a_region_and_without_its_relay_from_the_learner() {
    let (top, at_top) = router(None).await;
    let dial = ListenSettings { connect: vec![at_top.clone()], ..ListenSettings::new(Vec::new()) };
    let opened = LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &dial).await;
    let (learner, events) = opened.unwrap();
    let (mut routers, mut actors) = (Vec::new(), Vec::new());
    for name in ["eu", "us"] {
        let (mut router, endpoint) = router(Some(&at_top)).await;
        router.relay_weights(&region(name)).unwrap();
        for i in 0..3 {
            actors.push(actor(&format!("{name}{i}"), &endpoint, name, &events).await);
        }
        routers.push(router);
    }
    for version in 1..=VERSIONS {
        let weights = vec![version as u8; 70_000];
        learner.offer_weights(PolicyVersion(version), weights.clone().into()).unwrap();
        let sha256 = learner.announcement().versions.last().unwrap().1;
        // All at once: those that are not first wait for the one pull.
        let mut pulls = tokio::task::JoinSet::new();
        for actor in actors.drain(..) {
            pulls.spawn(async move {
                let pulled = actor.pull_weights(PolicyVersion(version), sha256).await;
                (actor, pulled.unwrap())
            });
        }
        for (actor, pulled) in pulls.join_all().await {
            assert_eq!(pulled, weights);
            actors.push(actor);
        }
    }
    for router in &routers {
        let counts = RelayCounts { pulled: VERSIONS, answered: 3 * VERSIONS, refused: 0 };
        assert_eq!(router.relay_counts(), counts);
    }

    // A fork begins with weights that the relay has under another number.
    let (again, sha256) = (PolicyVersion(VERSIONS + 1), learner.announcement().versions[0].1);
    let (first, _) = learner.announcement().versions[0];
    let weights = vec![first.0 as u8; 70_000];
    learner.offer_weights(again, weights.clone().into()).unwrap();
    assert_eq!(actors[0].pull_weights(again, sha256).await.unwrap(), weights);
    // Whose actor is the first now depends on which pull was done first.
    let total = |count: fn(RelayCounts) -> u64| -> u64 {
        routers.iter().map(|router| count(router.relay_counts())).sum()
    };
    assert_eq!(total(|counts| counts.pulled), 2 * VERSIONS, "it had them");
    assert_eq!(total(|counts| counts.answered), 6 * VERSIONS + 1);

    // What the learner does not keep, the relay says no to, and the learner as well.
    let error = actors[0].pull_weights(PolicyVersion(99), [0; 32]).await.unwrap_err();
    assert!(error.to_string().contains("version 99 is not kept"), "{error}");
    let refused: u64 = routers.iter().map(|router| router.relay_counts().refused).sum();
    assert_eq!(refused, 1);

    // A region without a relay costs nothing but a warning.
    let stray = actor("stray", &at_top, "nowhere", &events).await;
    let (version, sha256) = *learner.announcement().versions.last().unwrap();
    let pulled = tokio::time::timeout(Duration::from_secs(5), stray.pull_weights(version, sha256));
    assert_eq!(pulled.await.unwrap().unwrap(), weights);
    drop(top);
}

/// Waits until so many routers are above and below this one.
async fn until_connected(router: &RouterLink, expected: (usize, usize)) {
    let mut looks = tokio::time::interval(Duration::from_millis(20));
    let connected = async {
        while router.n_routers().await != expected {
            looks.tick().await;
        }
    };
    tokio::time::timeout(SOON, connected).await.expect("in time");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_below_is_not_taken_for_the_one_above() {
    let directory = tempfile::tempdir().unwrap();
    let nobody = directory.path().join("none");
    let nobody: Endpoint = format!("unixsock-stream/{}", nobody.display()).parse().unwrap();
    let (middle, at_middle) = router(Some(&nobody)).await;
    let (leaf, _) = router(Some(&at_middle)).await;
    until_connected(&leaf, (1, 0)).await;
    until_connected(&middle, (0, 1)).await;
}
