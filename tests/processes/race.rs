//! A race of several seeds: who is stopped, who wins, and that neither a race nor its interruption changes a run.

use std::fs;

use crate::support::{
    PATIENCE, Place, checkpoints, children, is_alive, result, signal, updates, wait_for_updates,
    wait_until,
};
use serde_json::Value;

/// Three racers of 20 updates, of whom one goes on after five.
const RACE: &str = "race -c cartpole --racers 3 --name q --actors 1 --episodes 10 --set learner.n_steps=64 \
                    --set learner.total_steps=5120 --set run.checkpoint_every=2 --seed 4";
const NAMES: [&str; 3] = ["q-s4", "q-s5", "q-s6"];

fn race(place: &Place, more: &str) -> Value {
    place.finish(&[RACE, "--json", more]).with_code(0).json()
}

#[test]
fn a_race_stops_the_others_and_its_winner_has_learned_what_it_would_have_learned_alone() {
    let place = Place::new();
    let told = place.finish(&[RACE]).with_code(0);
    for text in ["at most 7680 steps, as many as 1.50 whole trainings", "goes on like this"] {
        assert!(told.stderr.contains(text), "{}", told.stderr);
    }
    assert!(told.stdout.lines().all(|line| line.chars().count() <= 80), "{}", told.stdout);
    let raced = race(&place, "");
    let winner = raced["winner"].as_str().unwrap();
    assert!(told.stdout.ends_with(&format!("Winner: runs/{winner}\n")), "{}", told.stdout);
    let listed = place.finish(&["runs --json"]).with_code(0).json();
    for name in NAMES {
        let (state, n_updates) = if name == winner { ("finished", 20) } else { ("stopped", 5) };
        assert_eq!(updates(&place.run(name)), n_updates, "{name}");
        let row = listed.as_array().unwrap().iter().find(|row| row["name"] == *name).unwrap();
        assert_eq!(row["state"], state, "{name}");
    }
    let digest = |name: &str| result(&place.run(name))["weights_sha256"].clone();
    let alone = RACE.split(" --racers").next().unwrap().replace("race", "up");
    let settings = RACE.split("--episodes 10").nth(1).unwrap().replace("--seed 4", "");
    let seed = winner.trim_start_matches("q-s");
    let alone = format!("{alone} --actors 1 --name alone --seed {seed} {settings}");
    place.finish(&[&alone]).with_code(0);
    assert_eq!(digest(winner), digest("alone"));
    // A racer that was stopped is a run like any other.
    let stopped = NAMES.into_iter().find(|name| *name != winner).unwrap();
    let on = format!("up -c runs/{stopped}/config.toml --name {stopped} --actors 1");
    place.finish(&[&on]).with_code(0);
    assert_eq!(result(&place.run(stopped))["updates"], 20);
}

#[test]
fn a_racer_that_lost_its_best_policy_gets_it_back_from_its_checkpoint() {
    let place = Place::new();
    let raced = race(&place, "");
    let winner = place.run(raced["winner"].as_str().unwrap());
    for file in ["best.safetensors", "race.json"] {
        fs::remove_file(winner.join(file)).unwrap();
    }
    assert_eq!(race(&place, ""), raced);
    assert!(winner.join("best.safetensors").is_file());
}

#[test]
fn a_race_that_was_killed_goes_on_and_ends_the_same() {
    let expected = race(&Place::new(), "");
    let place = Place::new();
    let killed = place.start(&[RACE]);
    wait_for_updates(&place.run(NAMES[1]), 3);
    let helpers = children(killed.id());
    killed.kill();
    wait_until("its processes end", PATIENCE, || !helpers.iter().any(|id| is_alive(*id)));
    assert_eq!(race(&place, ""), expected);
}

#[test]
fn a_race_that_is_drained_ends_well_and_is_to_go_on() {
    let place = Place::new();
    let long = [RACE, "--set learner.total_steps=100000000"];
    let drained = place.start(&long);
    wait_for_updates(&place.run(NAMES[0]), 3);
    let helpers = children(drained.id());
    signal("USR1", drained.id());
    let ended = drained.finish(PATIENCE).with_code(0);
    ended.saying(&["asked to drain", "The same command goes on with the race."]);
    assert!(!helpers.iter().any(|id| is_alive(*id)));
    assert!(!checkpoints(&place.run(NAMES[0])).is_empty());
}

#[test]
fn racers_are_compared_as_they_were_at_a_quarter_however_often_and_in_whichever_world() {
    let place = Place::new();
    race(&place, "");
    let at_a_quarter = |told: &Value| -> Vec<Value> {
        told["racers"].as_array().unwrap().iter().map(|it| it["quarter"].clone()).collect()
    };
    // The winner has gone on; its policy at the quarter is still the one that is compared.
    let longer = RACE.replace("--episodes 10", "--episodes 30");
    let again = place.finish(&[&longer, "--json"]).with_code(0).json();
    assert!(at_a_quarter(&again).iter().all(|it| it["updates"] == 5), "{again}");
    let short = race(&place, "--set evaluation.world.max_steps=3");
    let means: Vec<Value> = at_a_quarter(&short).iter().map(|it| it["mean"].clone()).collect();
    assert_ne!(short["racers"], race(&place, "")["racers"]);
    assert!(
        means.windows(2).all(|pair| pair[0] == pair[1]),
        "three steps tell nobody apart: {short}"
    );
    std::fs::write(place.run(NAMES[0]).join("race.json"), "{bad").unwrap();
    place.finish(&[RACE]).with_code(2).saying(&["race.json", "is damaged", "delete it"]);
}

#[test]
fn racers_that_end_before_the_quarter_are_compared_as_they_ended() {
    let place = Place::new();
    let early = "--set evaluation.stop_at=0.9 --set evaluation.world.max_steps=5 --set evaluation.during_training=20";
    let raced = race(&place, early);
    for racer in raced["racers"].as_array().unwrap() {
        assert_eq!(racer["quarter"]["updates"], 1, "{raced}");
    }
    assert_eq!(race(&place, early), raced);
    // How often they are evaluated decides where they end.
    let seldom = early.replace("during_training=20", "during_training=10");
    let refused = place.finish(&[RACE, &seldom]).with_code(2);
    refused.saying(&["began with another configuration: evaluation.during_training: 20 -> 10"]);
}

#[test]
fn what_a_race_costs_is_said_beforehand_and_a_wrong_one_is_refused() {
    let place = Place::new();
    let told = place.finish(&["race -c lander --plan"]).with_code(0).stdout;
    assert!(told.contains("4 racers train"), "{told}");
    assert!(told.lines().all(|line| line.chars().count() <= 80), "{told}");
    let plan = place.finish(&[RACE, "--plan --json"]).with_code(0).json();
    let [racers, keep, steps] = ["racers", "keep", "steps"].map(|key| plan[key].as_u64());
    assert_eq!((racers, keep, steps), (Some(3), Some(1), Some(7_680)), "{plan}");
    assert_eq!(plan["trainings"], 1.5, "{plan}");
    assert!(!place.path().join("runs").exists());
    let refused = place.finish(&["race -c lander --racers 3 --keep 4"]).with_code(2);
    refused.saying(&["--keep 4", "only 3 racers"]);
    place.finish(&["race -c lander --racers 1"]).with_code(2).saying(&["2..=64"]);
    // Its runs keep their configuration.
    race(&place, "");
    place.finish(&[RACE, "--set learner.clip=0.3"]).with_code(2).saying(&["learner.clip"]);
}
