//! What a notifier knows of its listener: the same numbers whenever it is asked, and clear words where there are none.

use std::fs;

use crate::support::{Place, WRONG_INPUT};

/// A person whose delay differs from episode to episode.
const VARIED: &str = "human.reaction_delay={uniform={low=0,high=5,drawn=\"per_episode\"}}";

fn trained(place: &Place, domain: &str) {
    let args = format!("up -c {domain} --name {domain} --actors 1 --stop-after 1");
    place.finish(&[&args]).with_code(0);
}

#[test]
fn a_probe_is_reproducible_and_says_where_its_numbers_are_from() {
    let place = Place::new();
    trained(&place, "lander");
    let args = ["probe lander --episodes 40 --set", VARIED];
    let with = |more| place.finish(&[&args[..], &[more]].concat());
    let probed = with("--json").with_code(0).json();
    let knowledge = &probed["knowledge"];
    assert_eq!(knowledge["stages"].as_array().map(Vec::len), Some(6));
    assert_eq!(knowledge["stages"][0]["n_evaluated_on"], 20);
    let readers = knowledge["readers"].as_array().unwrap();
    assert_eq!((&readers[2]["n_features"], &readers[3]["n_features"]), (&89.into(), &64.into()));
    assert_eq!(probed["reaction_delay"]["uniform"]["high"], 5);
    let text = with("--markdown page.md").with_code(0).stdout;
    assert!(text.contains("hidden features minus constant: "), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    let page = fs::read_to_string(place.file("page.md")).unwrap();
    let command = format!("* command: `leadtime probe lander --episodes 40 --set '{VARIED}'");
    assert!(page.contains(&command), "{page}");
    assert_eq!(with("--json").with_code(0).json(), probed);
    let nowhere = with("--markdown no/where.md").with_code(WRONG_INPUT).saying(&["no/where.md"]);
    assert!(!nowhere.stderr.contains("probing"), "{}", nowhere.stderr);
    // The seed that it was trained with.
    with("--eval-seed 1").with_code(0).saying(&["seed 1 is that of its training"]);
}

#[test]
fn a_probe_with_nothing_to_find_says_so_in_a_sentence() {
    let place = Place::new();
    trained(&place, "lander");
    let refuse = |args: &str, text: &str| {
        place.finish(&["probe", args]).with_code(WRONG_INPUT).saying(&[text])
    };
    refuse("lander --episodes 40", "reaction delay is 2 in every episode");
    let few = refuse("lander --episodes 39", "39 episodes are too few");
    refuse("nobody", "`nobody` is no policy file");
    trained(&place, "cartpole");
    let unheard = refuse("cartpole", "this task has no listener");
    for told in [few, unheard] {
        assert!(!told.stderr.contains("probing"), "it was known before: {}", told.stderr);
    }
}
